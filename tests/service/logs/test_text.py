"""Lines that are read with array operations give what the grammar alone gives: frames, bad lines, counts."""

import re
from base64 import b64encode
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.service.logs.asc import Asc
from faultline.service.logs.batch import Batch, joined
from faultline.service.logs.candump import CandumpLog, CandumpScreen
from faultline.service.logs.channels import Channels
from faultline.service.logs.delimited import PythonCanCsv, TableCsv, find_table
from faultline.service.logs.digits import decimal, hexadecimal
from faultline.service.logs.example import Line
from faultline.service.logs.lines import WholeLines
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.text import Dialect, TextReader
from faultline.service.logs.trc import Trc

Make = Callable[[], Dialect]


class Alone:
    """A dialect by its grammar alone: no line says where its fields are."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.headers, self.needs_newline = dialect.headers, dialect.needs_newline

    @property
    def is_relative(self) -> bool:
        return self._dialect.is_relative

    def header(self, line: bytes) -> None:
        self._dialect.header(line)

    def end(self, report: LogReport) -> None:
        self._dialect.end(report)

    def read(self, line: bytes) -> Line | None:
        found = self._dialect.read(line)
        return None if found is None else found._replace(fields=None)


def read(dialect: Dialect, pieces: Sequence[bytes]) -> tuple[Batch, LogReport, list[bytes]]:
    report, channels = LogReport(), Channels()
    reader, lines = TextReader(dialect, report, channels), WholeLines(report)
    found: list[Batch] = []
    for piece in pieces:
        if text := lines.take(piece):
            found += reader.read(text)
    found += reader.last(lines.rest)
    return joined(found), report, channels.names


def same(one: Batch, other: Batch) -> None:
    assert len(one) == len(other)
    width = min(one.data.shape[1], other.data.shape[1])
    for name in ("time", "identifier", "flags", "length"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    np.testing.assert_array_equal(one.data[:, :width], other.data[:, :width])
    assert not one.data[:, width:].any()
    assert not other.data[:, width:].any()


TABLE = b"Time [ms];Bus;ID (hex);DLC;Data;Nr\n"


def table() -> Dialect:
    found = find_table(TABLE)
    assert found is not None
    return TableCsv(found, TABLE)


DIALECTS: dict[str, Make] = {
    "log": CandumpLog,
    "delta": lambda: CandumpLog(is_relative=True),
    "screen": CandumpScreen,
    "without times": lambda: CandumpScreen(has_times=False),
    "asc": Asc,
    "trc": Trc,
    "csv": PythonCanCsv,
    "table": table,
}
LINES = {
    "log": (
        "({t:.6f}) can0 {i:08X}#{d}", "({t:.9f}) can1 {s:03X}#{d} R", "({t:.6f}) can0 {i:08X}##1{d}{d} T",
        "(2026-01-02 03:{m:02}:{m:02}.{u:06}) can0 {i:08X}#{d}", "({t:.6f}) vcan0 {i:08X}#{d}_9",
        "({t:.3f}) can0 123#R8",
        "({t:.6f}) can0 20000080#0000000000000000", "({t:.6f})  can0  {i:08X}#{d}\r",
    ),
    "screen": (
        " ({t:.6f})  can0  {i:08X}   [8]  {b}", " ({t:.6f})  can0  {i:08X}   [8]  {b}   '{a}'",
        " ({t:.6f})  can0  TX - -  {s:03X}   [3]  11 22 33", " ({t:.6f})  can0  {s:03X}  [12]  {b} 01 02 03 04",
        " (2026-01-02 03:{m:02}:{m:02}.{u:06})  can0  {i:08X}   [8]  {b}",
        " ({t:.6f})  can0  {s:03X}   [4]  remote request",
        "  can0  {i:08X}   [8]  {b}", " ({t:.6f})  can0  20000080   [8]  {b}   ERRORFRAME", "\tproblem{{rx}}",
        " ({t:.6f})  can0  {s:03X}   {{E}}  {b}", "  can0  {s:03X}   [2]  01 02",
    ),
    "asc": (
        "   {t:.6f} 1  {i:X}x       Rx   d 8 {b}", "   {t:.6f} 1  {i:X}x Rx d 8 {b}  Length = {u} BitCount = {m}",
        " {t:.6f} CANFD   1 Rx {i:08X}x 1 0 8 8 {b} {u} {m} 303000", "   {t:.6f} 2  {s:X}  Tx   d 2 0A fF",
        "   {t:.6f} 1  Statistic: D {u} R 0", "   {t:.6f} 1  200 Rx r 4", "   {t:.6f} 1  ErrorFrame", "// {u}",
        "base hex  timestamps relative", "base dec  timestamps absolute", "base hex  timestamps absolute",
    ),
    "trc": (
        "{n:7} {t:13.3f} DT  1 {i:08X} Rx -  8    {b}", "{n:7})  {m:5}.{u:06}  DT  1     {s:04X} Rx -  2    0A FF",
        "{n:7} {t:13.3f} FD  2 {i:08X} Tx -  9    {b} 01 02 03 04", "{n:7} {t:13.3f} ST  1 Rx 00 00",
        ";$STARTTIME=46023.5",
        ";$FILEVERSION=2.1", ";$COLUMNS=N,O,T,B,I,d,R,L,D", "; {u}", "{n:7} {t:13.3f} RR  1 {s:04X} Rx -  4",
    ),
    "csv": (
        "{t:.6f},0x{i:08x},1,0,0,8,{c}", "{t:.6f},0x{i:x},1,0,0,6,{c:.8}", "{t:.6f},0x123,0,0,0,4,{c:.5}A==",
        "{t:.3f},0x{s:x},0,1,0,4,", "{t:.3f},0x{s:x},0,0,1,0,",
    ),
    "table": (
        "{t:.3f};1;{i:08X};8;{d};{n}", "{m};1;0x{s:03x};2;0A FF;{n}", "{t:.3f};2;{i:08X};8;{b};{n}",
        '"{t:.3f}";2;{s:03X};0;;{n}', "Time [ms];Bus;ID (hex);DLC;Data;Nr",
    ),
}  # fmt: skip
LINES |= {"delta": LINES["log"], "without times": LINES["screen"]}


@st.composite
def texts(draw: st.DrawFn, name: str) -> list[bytes]:
    """Pieces of a text in which most lines are good, alike in runs, and some are damaged."""
    random = draw(st.randoms(use_true_random=False))
    text = bytearray()
    for _ in range(draw(st.integers(1, 6))):
        form = draw(st.sampled_from(LINES[name]))
        for n in range(draw(st.integers(1, 30))):
            data = random.randbytes(8)
            t = random.choice([random.uniform(0, 1), random.uniform(0, 1e6), random.uniform(1.6e9, 1.8e9)])
            values = {
                "t": t, "i": random.getrandbits(random.choice([27, 29])), "s": random.getrandbits(11), "n": n,
                "d": data.hex().upper(), "b": data.hex(" "), "m": random.randrange(60), "u": random.randrange(10**6),
                "c": b64encode(data).decode(),
                "a": "".join(chr(33 + byte % 90) for byte in data),
            }  # fmt: skip
            line = form.format(**values).encode()
            if random.random() < 0.1:
                at = random.randrange(len(line) + 1)
                line = random.choice(
                    [line[:at], line[:at] + bytes([random.randrange(256)]) + line[at + 1 :], b"\0\0" + line, b""]
                )
            text += line.replace(b"\n", b"") + b"\n"
    text += draw(st.sampled_from([b"", b"(1.5) can0 123#00", b"   ", b"0.5 1 12x Rx d 1"]))
    cuts = sorted(draw(st.lists(st.integers(0, len(text)), max_size=3)))
    return [bytes(text[a:b]) for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True)]


@pytest.mark.parametrize("name", DIALECTS)
def test_arrays_give_what_the_grammar_gives(name: str) -> None:
    @settings(max_examples=40, deadline=None)
    @given(texts(name))
    def check(pieces: list[bytes]) -> None:
        try:
            slow, slow_report, slow_names = read(Alone(DIALECTS[name]()), [b"".join(pieces)])
        except LogError as error:  # a version that is not known
            with pytest.raises(LogError, match=f"^{re.escape(str(error))}$"):
                read(DIALECTS[name](), pieces)
            return
        fast, fast_report, fast_names = read(DIALECTS[name](), pieces)
        same(fast, slow)
        assert fast_names == slow_names
        np.testing.assert_array_equal(fast.channel, slow.channel)
        assert fast_report == slow_report

    check()


@given(st.lists(st.binary(min_size=8, max_size=8), min_size=1), st.integers(1, 8))
def test_digits_are_what_python_reads(words: list[bytes], count: int) -> None:
    column = np.frombuffer(b"".join(words), "<u8")
    numbers, bad = decimal(column, count)
    hexes, no_hex = hexadecimal(column, count)
    for k, word in enumerate(words):
        text = word[8 - count :]
        assert (bad[k] == 0) == text.isdigit()
        if text.isdigit():
            assert numbers[k] == int(text)
        is_hex = all(c in b"0123456789abcdefABCDEF" for c in text)
        assert (no_hex[k] == 0) == is_hex
        if is_hex:
            assert int(hexes[k]).to_bytes(4, "little").hex() == text.rjust(8, b"0").decode().lower()


@given(st.lists(st.sampled_from("0123456789abcdefABCDEF"), min_size=8, max_size=8))
def test_all_hexadecimal_digits_are_read(digits: list[str]) -> None:
    number, bad = hexadecimal(np.frombuffer("".join(digits).encode(), "<u8"), 8)
    assert not bad[0]
    assert int(number[0]).to_bytes(4, "little").hex() == "".join(digits).lower()


@given(st.lists(st.integers(0, 2**64), min_size=8, max_size=40), st.integers(0, 9))
def test_times_are_what_float_reads(numbers: list[int], decimals: int) -> None:
    """Also of nanoseconds since 1970, whose digits no floating-point number holds."""
    stamps = [
        f"{n % 10**10:010}.{n % 10**9:09}"[: 11 + decimals] if decimals else f"{n % 10**10:010}.0" for n in numbers
    ]
    batch, report, _ = read(CandumpLog(), ["".join(f"({each}) can0 123#00\n" for each in stamps).encode()])
    assert not report.bad
    assert batch.time.tolist() == [float(each) for each in stamps]
