"""Every dialect of candump, and tables of other loggers, as those write them."""

from pathlib import Path

import numpy as np
import pytest

from faultline.service.logs import Log, LogError, open_any, open_log
from faultline.service.logs.batch import ERROR, EXTENDED, FD, REMOTE, SENT, Batch, joined


def opened(folder: Path, text: str, name: str = "drive.log") -> Log:
    path = folder / name
    path.write_bytes(text.encode())
    return open_any(path)


def whole(log: Log) -> Batch:
    return joined(list(log.batches()))


SCREEN = """\
(1700000000.123456)  can0  18FF103D   [8]  00 11 22 33 44 55 66 77   '.."3DUfw'
(1700000000.223456)  can0       123   [4]  remote request
(1700000000.323456)  can1       123  [16]  AA BB CC DD EE FF 00 11 22 33 44 55 66 77 88 99
(1700000001.000000)  can0  20000080   [8]  00 00 00 00 00 00 00 00   ERRORFRAME
\tcontroller-problem{rx-error-passive}
(1700000001.000001)  can0       123   [0]                            ''
(1700000001.000002)  can0       123   {E}  11 22 33 44 55 66 77 88   '."3DUfw.'
 (1700000001.000003)  can0  TX B E  18FF103D   [2]  AB CD
"""
"""As can-utils' candump and log2long write it."""


def test_the_screen(tmp_path: Path) -> None:
    log = opened(tmp_path, SCREEN)
    batch = whole(log)
    assert log.format.name == "candump screen"
    assert (log.report.frames, log.report.remote, log.report.errors, log.report.lost) == (5, 1, 1, False)
    assert log.channels == ("can0", "can1")
    assert batch.flags.tolist() == [EXTENDED, REMOTE, FD, ERROR | EXTENDED, 0, 0, EXTENDED | SENT]
    assert batch.length.tolist() == [8, 4, 16, 8, 0, 8, 2]
    assert batch.identifier.tolist() == [0x18FF103D, 0x123, 0x123, 0x80, 0x123, 0x123, 0x18FF103D]
    assert batch.time[0] == 1700000000.123456
    assert batch.data[2, :16].tobytes().hex() == "aabbccddeeff00112233445566778899"


SCREENS = {
    "-i": "  {0}  [3] 00010001 00100010 00110011\n  {0}  [0]\n  {0}  [1] 10000001\n",
    "-i -a": "  {0}  [3] 00010001 00100010 00110011{1}'.\"3'\n  {0}  [0]{1}''\n  {0}  [1] 10000001{1}'.'\n",
    "-S": "  {0}  [3] 33`22`11\n  {0}  [0]\n  {0}  [1] 81\n",
    "-S -a": '  {0}  [3] 33`22`11{1}`3".`\n  {0}  [0]{1}``\n  {0}  [1] 81{1}`.`\n',
    "-S -i": "  {0}  [3]  00110011`00100010`00010001\n  {0}  [0]\n  {0}  [1]  10000001\n",
    "-S -i -a": '  {0}  [3]  00110011`00100010`00010001{1}`3".`\n  {0}  [0]{1}``\n  {0}  [1]  10000001{1}`.`\n',
}


@pytest.mark.parametrize("options", SCREENS)
@pytest.mark.parametrize("identifier", ["can0  18FF103D", "can0  RX - -  18FF103D", "can0   8FF103D"])
def test_binary_and_swapped_data_on_the_screen(tmp_path: Path, options: str, identifier: str) -> None:
    batch = whole(opened(tmp_path, 9 * SCREENS[options].format(identifier, " " * 60)))
    assert batch.length.tolist() == 9 * [3, 0, 1]
    assert {row.tobytes() for row in batch.data[0::3]} == {bytes([0x11, 0x22, 0x33, *bytes(5)])}
    assert {row.tobytes() for row in batch.data[2::3]} == {bytes([0x81, *bytes(7)])}
    assert set(batch.identifier.tolist()) == {int(identifier.split()[-1], 16)}
    assert set(batch.flags.tolist()) == {EXTENDED}


@pytest.mark.parametrize(
    "data", ["0001000 00100010", "00010001 0010001", "00010001", "33`2", "33`22`11", "33 22`11 00"]
)
def test_binary_and_swapped_data_that_are_cut_or_mixed_are_none(tmp_path: Path, data: str) -> None:
    whole_line = "  can0  123   [2]  22`11\n"
    log = opened(tmp_path, 9 * whole_line + f"  can0  123   [2]  {data}\n" + whole_line)
    assert (log.report.frames, log.report.bad, log.report.places[0][0]) == (10, 1, 10)


def test_identifiers_of_old_versions_have_no_leading_zeros(tmp_path: Path) -> None:
    """Of 29 bits they are as wide as eight digits; three digits, indented, are those of 11 bits among them."""
    lines = ["can0   CF00400  [1] 01", "can0        7F  [1] 02", "can0   7F  [1] 03", "can0       123  [1] 04"]
    batch = whole(opened(tmp_path, "".join(f"  {line}\n" for line in lines)))
    assert batch.identifier.tolist() == [0xCF00400, 0x7F, 0x7F, 0x123]
    assert batch.flags.tolist() == [EXTENDED, EXTENDED, 0, 0]


def frames(stamp: str, times: list[str]) -> str:
    return "".join(
        stamp.format(t) + f"  can0  18FF103D   [8]  00 11 22 33 44 55 66 {k:02X}\n" for k, t in enumerate(times)
    )


ABSOLUTE = [f"{1700000000 + k / 10:.6f}" for k in range(20)]
DELTAS = [f"{0 if k == 0 else 0.1 + 0.001 * (-1) ** k:010.6f}" for k in range(20)]
ZERO = [f"{k / 10:010.6f}" for k in range(20)]
DATES = [f"2023-11-14 22:13:{20 + k // 10}.{k % 10}00000" for k in range(20)]


@pytest.mark.parametrize("times", [ABSOLUTE, DELTAS, ZERO, DATES], ids=["-t a", "-t d", "-t z", "-t A"])
@pytest.mark.parametrize("form", ["screen", "log"])
def test_each_kind_of_time(tmp_path: Path, times: list[str], form: str) -> None:
    text = frames(" ({})", times)
    if form == "log":
        text = "".join(f"({t}) can0 18FF103D#00112233445566{k:02X}\n" for k, t in enumerate(times))
    batch = whole(opened(tmp_path, text))
    np.testing.assert_allclose(np.diff(batch.time), 0.1, atol=2e-3)
    assert batch.data[:, 7].tolist() == list(range(20))
    if times in (ABSOLUTE, DATES):
        assert batch.time[0] == 1700000000.0


def test_without_times_it_is_refused_by_what_needs_them(tmp_path: Path) -> None:
    log = opened(tmp_path, frames("", ["x"] * 9))
    assert (log.format.name, log.report.frames, log.report.length_s) == ("candump screen without times", 9, 0.0)
    assert np.isnan(whole(log).time).all()
    with pytest.raises(
        LogError, match=r"drive\.log: its frames have no times, which this needs; record it with `candump -L`"
    ):
        open_log(tmp_path / "drive.log")


def test_a_drop_counter_is_a_loss_with_its_place(tmp_path: Path) -> None:
    dropped = "DROPCOUNT: dropped 5 CAN frames on 'can0' socket (total drops 5)\n"
    log = opened(tmp_path, frames(" ({})", ABSOLUTE[:9]) + dropped + frames(" ({})", ABSOLUTE[9:]))
    assert log.report.frames == 20
    assert log.report.damaged
    assert "line 10: candump says: DROPCOUNT: dropped 5 CAN frames" in log.report.summary()


def test_a_remote_frame_says_how_many_bytes_it_asks_for(tmp_path: Path) -> None:
    batch = whole(opened(tmp_path, "(1.0) can0 123#R4\n(1.1) can0 00000123#R\n(1.2) can0 123#0011_A\n"))
    assert (batch.flags.tolist(), batch.length.tolist()) == ([REMOTE, REMOTE | EXTENDED, 0], [4, 0, 2])
    assert not batch.data[:2].any()


TABLES = {
    "savvycan": (
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
        "1000000,18FF103D,true,Rx,0,8,00,11,22,33,44,55,66,77,\n1500000,00000123,false,Tx,1,2,AB,CD,,,,,,,\n"
    ),
    "css": (
        "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n"
        "1.000000;0;18FF103D;1;8;8;0;0;0;0011223344556677\n1.500000;1;123;0;2;2;1;0;0;ABCD\n"
    ),
    "decimal": 'time,channel,can_id,data,tx,dir\n1.0,0,419369021,"00 11 22 33 44 55 66 77",,Rx\n1.5,1,291,AB CD,,Tx\n',
    "0x": "Time [ms]\tBus\tID\tDir\tData\n1000\t0\t0x18FF103D\tRx\t0x0011223344556677\n1500\t1\t0x123\tTx\tAB-CD\n",
    "dates": (
        "timestamp,bus,arbitration_id,direction,payload\n1970-01-01T00:00:01,0,18FF103D,rx,00:11:22:33:44:55:66:77\n"
        "1970-01-01 01:00:01.500+01:00,1,123,tx,ABCD\n"
    ),
    "epoch in ms": (
        "timestamp,bus,id,dir,data\n1700000000000,0,18FF103D,Rx,0011223344556677\n1700000000500,1,123,Tx,ABCD\n"
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_whose_header_names_their_columns(tmp_path: Path, name: str) -> None:
    log = opened(tmp_path, TABLES[name], "drive.csv")
    batch = whole(log)
    assert not log.report.lost, log.report.summary()
    assert np.diff(batch.time) == 0.5
    assert batch.time[0] == (1.7e9 if name == "epoch in ms" else 1.0)
    assert batch.identifier.tolist() == [0x18FF103D, 0x123]
    assert batch.flags.tolist() == [EXTENDED, SENT]
    assert batch.length.tolist() == [8, 2]
    assert batch.data.tolist() == [[0x00, 0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77], [0xAB, 0xCD, 0, 0, 0, 0, 0, 0]]
    assert log.channels == ("0", "1")


def test_a_bad_row_of_a_table_costs_only_itself(tmp_path: Path) -> None:
    head, first, second = TABLES["css"].splitlines(keepends=True)
    log = opened(tmp_path, head + first + "1.2;0;18FF103D;1;8;8;0;0;0;00112233\n1.3;0;xyz\n" + second, "drive.csv")
    assert (log.report.frames, log.report.bad) == (2, 2)
    assert log.report.places[0] == (3, "says 8 bytes and has 4: '1.2;0;18FF103D;1;8;8;0;0;0;00112233'")


def test_content_decides_and_not_the_name(tmp_path: Path) -> None:
    for name in ("drive.blf", "drive.trc", "drive.csv", "drive", "drive.txt", "drive.mf4"):
        log = opened(tmp_path, "".join(f"({t}) can0 123#0{k % 10}\n" for k, t in enumerate(ABSOLUTE)), name)
        assert (log.format.name, log.report.frames) == ("candump", 20)


def test_a_log_whose_beginning_is_damaged_is_known_by_what_follows(tmp_path: Path) -> None:
    log = opened(tmp_path, "\0" * 70_000 + "?\n" * 100 + "".join(f"({t}) can0 123#00\n" for t in ABSOLUTE), "drive")
    assert (log.format.name, log.report.frames) == ("candump", 20)
    assert log.report.damaged


def test_zeros_of_a_power_cut_cost_nothing_but_themselves(tmp_path: Path) -> None:
    """A file system fills what was not written yet with zeros, and the logger appends after the next start."""
    lines = [f"({t}) can0 123#00\n" for t in ABSOLUTE]
    for zeros in (10, 5000, 100_000):
        log = opened(tmp_path, "".join(lines[:10]) + "\0" * zeros + "".join(lines[10:]))
        assert (log.report.frames, log.report.bad, log.report.lost_bytes) == (20, 1, zeros)
        assert log.report.places == [(11, "zeros")]


def test_a_byte_order_mark_costs_nothing(tmp_path: Path) -> None:
    log = opened(tmp_path, "\ufeff" + "".join(f"({t}) can0 123#00\n" for t in ABSOLUTE))
    assert (log.format.name, log.report.frames, log.report.lost) == ("candump", 20, False)
