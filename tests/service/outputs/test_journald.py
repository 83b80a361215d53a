"""Entries of the system's journal, as a socket in its place receives them."""

import re
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import (
    CLEARED,
    SCHEMA,
    Change,
    Cleared,
    Dtc,
    Fault,
    FaultRecord,
    Seen,
    Status,
)
from faultline.service.core.records.line import encode
from faultline.service.outputs.journald import MESSAGES, MOST, WITHIN_S, Journald
from faultline.service.store.file import Record

PAGE = (Path(__file__).parents[3] / "docs" / "service.md").read_text()


def record(change: Change, seq: int = 7, faults: tuple[str, ...] = ("fA_du",)) -> Record:
    seen = Seen(id="truck-1", wall=None, cycle=1)
    status = Status(**dict.fromkeys(Status.__struct_fields__, False) | {"test_failed": True, "confirmed": True})
    fault = Fault(
        number=3, system="uds", bundle="b" * 64, diagnoses=[Diagnosis(faults=[*faults], rank=1, p=None)],
        components=["dosing unit filter"] if faults else [], dtcs=[Dtc(spn=3362, fmi=7)], tests=["t02"], modes=["idle"],
        status=status, mask=status.mask, fdc=127, occurrences=1, trips=1, healing=0, aging=0, first=seen, latest=seen,
    )  # fmt: skip
    told = FaultRecord(schema=SCHEMA, id=f"truck-9-{seq}", seq=seq, wall=None, change=change, fault=fault)
    return Record(seq, "fault", encode(told))


class System:
    """The journal, and a clock."""

    def __init__(self, path: Path) -> None:
        self.now = 0.0
        self.path = path
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.sock.bind(str(path))
        self.journald = Journald(lambda: self.now, path)

    def entries(self) -> list[dict[str, str]]:
        found: list[dict[str, str]] = []
        while True:
            try:
                content = self.sock.recv(65536).decode()
            except BlockingIOError:
                return found
            found.append(dict(line.split("=", 1) for line in content.splitlines()))


@pytest.fixture
def system(tmp_path: Path) -> Iterator[System]:
    made = System(tmp_path / "socket")
    yield made
    made.sock.close()


def test_an_alarm_has_fields_that_can_be_asked_for(system: System) -> None:
    system.journald.told(record("confirmed"))
    assert system.entries() == [
        {
            "MESSAGE": "uds: dosing unit filter is faulty",
            "MESSAGE_ID": MESSAGES["confirmed"][0],
            "PRIORITY": "4",
            "SYSLOG_IDENTIFIER": "faultline",
            "FAULTLINE_ID": "truck-9-7",
            "FAULTLINE_SEQ": "7",
            "FAULTLINE_CHANGE": "confirmed",
            "FAULTLINE_NUMBER": "3",
            "FAULTLINE_SYSTEM": "uds",
            "FAULTLINE_COMPONENTS": "dosing unit filter",
            "FAULTLINE_STATUS": "0x09",
            "SPN": "3362",
            "FMI": "7",
        }
    ]


def test_what_a_person_erased_is_said_with_who_did_it(system: System) -> None:
    cleared = Cleared(schema=CLEARED, id="truck-9-8", seq=8, wall=None, numbers=[3, 4], by="root")
    system.journald.told(Record(8, "fault", encode(cleared)))
    (entry,) = system.entries()
    assert (entry["MESSAGE"], entry["FAULTLINE_BY"]) == ("3, 4 erased", "root")


def test_events_health_and_refinements_are_no_entries(system: System) -> None:
    for each in (Record(1, "event", b"{}\n"), Record(2, "health", b"{}\n"), record("refined"), record("settled")):
        system.journald.told(each)
    assert system.entries() == []


def test_what_is_unknown_is_said_so(system: System) -> None:
    system.journald.told(record("confirmed", faults=()))
    assert system.entries()[0]["MESSAGE"] == "uds: something unknown is faulty"


def test_a_storm_is_counted(system: System) -> None:
    entries: list[dict[str, str]] = []
    for seq in range(500):
        system.now += 0.01
        system.journald.told(record("failed", seq))
        entries += system.entries()
    assert len(entries) == MOST
    system.now += WITHIN_S
    system.journald.told(record("passed", 501))
    system.journald.told(record("failed", 502))
    first, second = system.entries()
    assert first["FAULTLINE_LEFT_OUT"] == str(500 - MOST)
    assert "FAULTLINE_LEFT_OUT" not in second


def test_a_journal_that_is_behind_is_not_waited_for(system: System) -> None:
    for seq in range(MOST):  # more than its queue holds
        system.journald.told(record("failed", seq))
    taken = len(system.entries())
    assert 0 < taken < MOST
    system.now += WITHIN_S
    system.journald.told(record("passed", 501))
    assert system.entries()[0]["FAULTLINE_LEFT_OUT"] == str(MOST - taken)


def test_without_a_journal_nothing_happens(system: System, tmp_path: Path) -> None:
    alone = Journald(lambda: 0.0, tmp_path / "absent")
    alone.told(record("confirmed"))
    system.sock.close()
    system.journald.told(record("confirmed"))


def test_the_page_has_every_message_id() -> None:
    for change, (message, _, _) in MESSAGES.items():
        assert re.search(rf"\| `{change or 'cleared'}` \| `{message}` \|", PAGE), change
    assert len({message for message, _, _ in MESSAGES.values()}) == len(MESSAGES)
