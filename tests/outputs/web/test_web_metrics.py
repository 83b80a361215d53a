"""Figures are what Prometheus reads: checked with a strict reader of text format 0.0.4."""

import re
from typing import NamedTuple

import pytest
from web_daemon import FAILED, PASSED, fault

from faultline.service.core.records.health import Standing
from faultline.service.protocol.answers import BusStatus, ServiceState, StoreStatus, SystemStatus
from faultline.service.web.metrics import Counts, Family, Sample, of_daemon, of_server, render

NAME = r"[a-zA-Z_:][a-zA-Z0-9_:]*"
LABEL = re.compile(r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\["\\n])*)"(,|$)')


class Read(NamedTuple):
    kind: str
    samples: dict[frozenset[tuple[str, str]], float]


def strictly(text: bytes) -> dict[str, Read]:
    """What is in it; fails on whatever the format does not allow, or only just allows."""
    lines = text.decode().split("\n")
    assert lines.pop() == "", "the last line has no end"
    families: dict[str, Read] = {}
    name = ""
    for number, line in enumerate(lines):
        if line.startswith("# HELP "):
            match = re.fullmatch(rf"# HELP ({NAME}) ((?:[^\\]|\\\\|\\n)+)", line)
            assert match, line
            name = match[1]
            assert name not in families, f"{name} is there twice"
            assert lines[number + 1].startswith(f"# TYPE {name} "), "TYPE follows HELP"
        elif line.startswith("#"):
            match = re.fullmatch(rf"# TYPE ({NAME}) (gauge|counter)", line)
            assert match, line
            assert match[1] == name
            assert (match[2] == "counter") == name.endswith("_total")
            families[name] = Read(match[2], {})
        else:
            match = re.fullmatch(rf"({NAME})(?:\{{(.*)\}})? (-?[0-9.e+-]+)", line)
            assert match, line
            assert match[1] == name, "samples of a family are together"
            labels = _labels(match[2] or "")
            assert labels not in families[name].samples, f"{line} is there twice"
            families[name].samples[labels] = float(match[3])
    assert all(read.samples for read in families.values())
    return families


def _labels(text: str) -> frozenset[tuple[str, str]]:
    found, place = [], 0
    while place < len(text):
        match = LABEL.match(text, place)
        assert match, text
        found.append((match[1], re.sub(r"\\(.)", lambda one: {"n": "\n"}.get(one[1], one[1]), match[2])))
        place = match.end()
    assert not text.endswith(",")
    assert len({name for name, _ in found}) == len(found)
    return frozenset(found)


def one(families: dict[str, Read], name: str, **labels: str) -> float:
    return families[name].samples[frozenset(labels.items())]


STATE = ServiceState(
    source="truck",
    version="0.1.0",
    seq=1234,
    cycle=7,
    conditions=[Standing(kind="missing", of="y_p_du"), Standing(kind="missing", of="n_p")],
    store=StoreStatus(path="/x", kept=1230, failing=True),
    buses=[BusStatus(name="a", frames=10, dropped=2, errors=1), BusStatus(name="b", trouble="bus-off")],
    systems=[SystemStatus(name="uds", bundle="ab", alarm=["t02"], cannot_tell=["t03", "t05"], suspected=True)],
)


def test_what_the_daemon_says() -> None:
    read = strictly(render(of_daemon(STATE, [fault(1, state=FAILED), fault(2, state=PASSED, occurrences=5)])))
    assert one(read, "faultline_up") == 1
    assert one(read, "faultline_info", source="truck", version="0.1.0") == 1
    assert one(read, "faultline_records_total") == 1234
    assert one(read, "faultline_store_kept") == 1230
    assert one(read, "faultline_store_failing") == 1
    assert one(read, "faultline_condition", kind="missing", of="n_p") == 1
    assert one(read, "faultline_bus_frames_total", bus="a") == 10
    assert one(read, "faultline_bus_dropped_total", bus="a") == 2
    assert [one(read, "faultline_bus_trouble", bus=bus) for bus in "ab"] == [0, 1]
    assert one(read, "faultline_system_cannot_tell", system="uds") == 2
    group = "dosing unit filter, pump pressure sensor"
    assert [one(read, "faultline_fault_active", system="uds", number=number, component=group) for number in "12"] == [
        1,
        0,
    ]
    assert one(read, "faultline_fault_confirmed", system="uds", number="2") == 1
    assert one(read, "faultline_fault_occurrences_total", system="uds", number="2") == 5


def test_a_daemon_that_is_away() -> None:
    assert {name: one(strictly(render(of_daemon(None, []))), name) for name in ("faultline_up",)} == {"faultline_up": 0}


def test_a_daemon_without_a_store_says_nothing_of_it() -> None:
    read = strictly(render(of_daemon(ServiceState(source="a", version="1", seq=0), [])))
    assert not [name for name in read if "store" in name or "fault_" in name]


def test_what_this_server_says() -> None:
    counts = Counts()
    counts.requests["GET", 200] += 3
    counts.requests["GET", 404] += 1
    counts.streams["events"] += 2
    counts.turned_away["late request"] += 4
    counts.connections = 5
    read = strictly(render(of_server(counts, subscribed=True)))
    assert one(read, "faultline_http_requests_total", method="GET", code="404") == 1
    assert one(read, "faultline_http_sse_clients", stream="events") == 2
    assert one(read, "faultline_http_sse_clients", stream="live") == 0
    assert one(read, "faultline_http_turned_away_total", reason="late request") == 4
    assert one(read, "faultline_http_connections") == 5


@pytest.mark.parametrize("value", ['a"b', "a\\b", "a\nb", "a\\nb", "ü{}=,", '\\"', "\r", ""])
def test_labels_are_escaped(value: str) -> None:
    read = strictly(render([Family("x", "gauge", "a\\b\nc", [Sample({"l": value, "m": "1"}, 0.5)])]))
    assert one(read, "x", l=value, m="1") == 0.5


def test_a_component_of_any_name() -> None:
    read = strictly(render(of_daemon(STATE, [fault(1, components=['the "big"\\ one\n'])])))
    assert one(read, "faultline_fault_active", system="uds", number="1", component='the "big"\\ one\n') == 1
