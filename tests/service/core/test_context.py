"""Trouble codes of other devices: what real trucks sent, what changes, who falls silent, what makes no sense."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.service.core.j1939.context import GAP_S, SILENT_S, Change, CodeTracker
from faultline.service.core.j1939.dm1 import Code, encode
from faultline.service.core.j1939.log_context import LogContext
from faultline.service.core.records import line
from faultline.service.core.records.context import LampStates, TroubleCode, decode_context
from faultline.service.logs import Frame
from faultline.service.logs.batch import batch_of
from faultline.service.watching.records import describe_context

DM1, DM2, TP_CM, TP_DT = 0x18FECA00, 0x18FECB00, 0x1CECFF00, 0x1CEBFF00
Sent = tuple[int, bytes]


def in_parts(payload: bytes, source: int, pgn: int = 0xFECA) -> list[Sent]:
    count = -(-len(payload) // 7)
    begin = bytes([0x20]) + len(payload).to_bytes(2, "little") + bytes([count, 0xFF]) + pgn.to_bytes(3, "little")
    parts = [bytes([k + 1]) + payload[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(count)]
    return [(TP_CM | source, begin), *((TP_DT | source, part) for part in parts)]


def said(tracker: CodeTracker, t: float, *sent: Sent) -> list[Change]:
    return [change for can_id, data in sent for change in tracker.frame(t, can_id, True, data)]


TRUCK = bytes.fromhex("43ff bf000908 54000908 ed141f01")
NO_FAULT = bytes.fromhex("00ff 00000000 ffff")


def test_what_real_trucks_sent() -> None:
    tracker = CodeTracker()
    [change] = said(tracker, 1.0, *in_parts(TRUCK, 0x21))
    record = change.record(("golden-1", 1, None), 1.0)
    assert (record.sender, record.message, record.silent) == (0x21, "DM1", False)
    assert record.lamps == LampStates(malfunction="on", red_stop="off", amber_warning="off", protect="none")
    assert [(code.spn, code.fmi, code.count) for code in record.codes] == [(191, 9, 8), (84, 9, 8), (5357, 31, 1)]
    [change] = said(tracker, 1.1, (DM1 | 0x3D, NO_FAULT))
    record = change.record(("golden-2", 2, None), 1.1)
    assert (record.sender, record.codes) == (0x3D, [])
    assert decode_context(line.encode(record)) == record
    assert describe_context(record) == "      1.1 s  another device, 0x3D, has no trouble code (DM1)"


def test_a_sender_is_told_when_its_codes_change_and_not_when_a_count_does() -> None:
    tracker = CodeTracker()
    told = []
    for second, codes in enumerate(
        [[], [], [Code(191, 9, 1)], [Code(191, 9, 2)], [Code(191, 9, 2), Code(84, 9, 1)], []]
    ):
        payload = encode(codes, amber=bool(codes))
        sent = [(DM1 | 7, payload)] if len(payload) == 8 else in_parts(payload, 7)
        told += [
            (change.t, [code.spn for code in change.said.codes])
            for change in said(tracker, second, *sent)
            if change.said
        ]
    assert told == [(0.0, []), (2.0, [191]), (4.0, [191, 84]), (5.0, [])]


def test_a_sender_that_says_nothing_any_more_is_told_once_and_again_when_it_comes_back() -> None:
    tracker = CodeTracker()
    assert said(tracker, 0.0, (DM1 | 7, NO_FAULT))
    assert tracker.look(SILENT_S) == []
    assert tracker.look(SILENT_S + 0.1) == [Change(SILENT_S + 0.1, 7, "DM1", None)]
    assert tracker.look(SILENT_S + 20.0) == []
    [change] = said(tracker, 40.0, (DM1 | 7, NO_FAULT))
    assert change.said is not None
    record = Change(12.0, 7, "DM1", None).record(("x-1", 1, None), 12.0)
    assert (record.silent, record.lamps, record.codes) == (True, None, [])
    assert describe_context(record).endswith("another device, 0x07, says nothing any more of its trouble codes")


def test_previously_active_codes_are_only_asked_for_so_their_absence_says_nothing() -> None:
    tracker = CodeTracker()
    [change] = said(tracker, 0.0, (DM2 | 7, bytes.fromhex("00ff 7d140a7f ffff")))
    record = change.record(("x-1", 1, None), 0.0)
    assert (record.message, record.codes) == ("DM2", [TroubleCode(spn=5245, fmi=10, count=None)])
    assert "had SPN 5245 FMI 10 (DM2)" in describe_context(record)
    assert tracker.look(1000.0) == []


def test_a_device_that_flickers_is_told_twice_a_second_at_most() -> None:
    tracker = CodeTracker()
    told = 0
    for k in range(1000):
        told += len(said(tracker, 0.01 * k, (DM1 | 7, encode([Code(190 + k % 2, 3, 1)], amber=True))))
    assert told <= 10.0 / GAP_S + 1


def test_older_layouts_of_the_spn_are_all_given() -> None:
    """Conversion method 1: 1208 by version 1 is 00 97 03, by version 2 97 00 03, by version 3 B8 04 03."""
    tracker = CodeTracker()
    for second, (row, spns) in enumerate({"0097038a": 0, "9700038a": 1, "b804038a": 2}.items()):
        [change] = said(tracker, float(second), (DM1 | 7, bytes.fromhex(f"04ff{row}ffff")))
        [code] = change.record(("x-1", 1, None), 0.0).codes
        assert [*code.other_spns, code.spn][spns] == 1208
        assert (code.fmi, code.count) == (3, 10)
    assert "SPN 1208 or 376864 or 9664 FMI 3 (10 times)" in describe_context(change.record(("x-1", 1, None), 0.0))


def test_lamps_that_flash() -> None:
    [change] = said(CodeTracker(), 0.0, (DM1, bytes.fromhex("544f bf000908 ffff")))
    record = change.record(("x-1", 1, None), 0.0)
    assert record.lamps == LampStates(malfunction="fast", red_stop="slow", amber_warning="on", protect="off")
    assert describe_context(record).endswith(
        "SPN 191 FMI 9 (8 times); malfunction lamp, flashing fast; red stop lamp, flashing; amber warning lamp (DM1)"
    )


def test_what_makes_no_sense_is_counted_by_its_sender() -> None:
    tracker = CodeTracker()
    assert said(tracker, 0.0, (DM1 | 7, b""), (DM1 | 7, bytes(5)), *in_parts(bytes(13), 9)) == []
    assert tracker.unreadable == {7: 2, 9: 1}


IDENTIFIERS = st.sampled_from([DM1, DM2, TP_CM, TP_DT, 0x18FF1000])


@given(st.lists(st.tuples(st.floats(0, 3), IDENTIFIERS, st.booleans(), st.binary(max_size=8))))
def test_no_frames_break_it(frames: list[tuple[float, int, bool, bytes]]) -> None:
    tracker, t = CodeTracker(), 0.0
    for gap_s, can_id, is_extended, data in frames:
        t += gap_s
        for change in tracker.frame(t, can_id, is_extended, data):
            record = change.record(("x-1", 1, None), t)
            assert decode_context(line.encode(record)) == record
            assert describe_context(record)


@settings(deadline=None)  # it would measure how busy the machine is
@given(st.lists(st.tuples(st.floats(0, 6), IDENTIFIERS, st.booleans(), st.binary(max_size=8))), st.integers(0, 20))
def test_many_frames_at_once_give_the_changes_of_one_by_one(
    sent: list[tuple[float, int, bool, bytes]], cut: int
) -> None:
    """Who falls silent is seen at the same frames, of whatever group these are."""
    times = np.cumsum([gap_s for gap_s, *_ in sent])
    frames = [Frame(float(t), *each[1:]) for t, each in zip(times, sent, strict=True)]
    one_by_one, at_once = CodeTracker(), CodeTracker()
    expected = [change for frame in frames for change in one_by_one.frame(*frame)]
    found = [change for part in (frames[:cut], frames[cut:]) for change in at_once.frames(batch_of(part))]
    assert found == expected


def test_along_a_log_records_come_in_order_on_the_time_scale_of_its_events() -> None:
    context = LogContext("truck")
    sent = [(t, can_id, True, data) for t in (0.5, 1.5, 2.5) for can_id, data in in_parts(TRUCK, int(t))]
    sent.append((3.0, TP_CM | 9, True, in_parts(TRUCK, 9)[0][1]))
    sent.append((3.0, DM1 | 9, True, b"?"))
    frames = [Frame(*each) for each in sent]
    batches = [batch_of(frames[:2]), batch_of(frames[2:])]
    assert list(context.passing(batches)) == batches
    assert [(r.t_s, r.id, r.seq) for r in context.until(1.5, 1.0)] == [
        (-0.5, "truck-context-1", 1),
        (0.5, "truck-context-2", 2),
    ]
    assert [(r.t_s, r.sender) for r in context.until(9.0, None)] == [(None, 2)]
    assert context.losses() == (
        "trouble codes of other devices that could not be read: 1 DM1 in parts (cut off by the end), "
        "1 of 0x09 that make no sense"
    )


def test_a_log_without_trouble_codes_has_no_context() -> None:
    context = LogContext("truck")
    list(context.passing([batch_of([Frame(0.1 * k, 0x18FF1000, True, bytes(8)) for k in range(100)])]))
    assert list(context.until(1e9, 0.0)) == []
    assert context.losses() == ""


@pytest.mark.parametrize("identifier", [0x18FECA00 | 1 << 25, 0x18FFCA00, 0x00000ECA])
def test_other_groups_are_none_of_it(identifier: int) -> None:
    assert said(CodeTracker(), 0.0, (identifier, NO_FAULT)) == []
