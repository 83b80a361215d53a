"""The fault memory, told by made events: what joins, refines, passes, heals, ages, is displaced and is erased."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from uds_time import IDLE, MAXIMUM, TIME

from faultline.service.core.memory.fault_memory import FaultChange, FaultMemory
from faultline.service.core.memory.rules import Rules
from faultline.service.core.memory.system import AMBIGUOUS, UNKNOWN, System
from faultline.service.core.records.event import SCHEMA, Diagnosis, Event, Transition
from faultline.service.core.records.fault import Dtc, Fault

SYSTEM = System(
    "uds",
    "b" * 64,
    TIME,
    ("edge", "idle", "partial", "maximum"),
    ("t02", "t08", "t13"),
    {"fA_t": "tank filter", "fA_du": "dosing unit filter", "fq_pump": "pump"},
    {"fA_t": Dtc(spn=520193, fmi=7), "fA_du": Dtc(spn=3362, fmi=7)},
)
ALL = np.ones(3, dtype=np.bool_)
NONE = np.zeros(3, dtype=np.bool_)


def one(*faults: str, p: float | None = None, rank: int = 1, near: Sequence[str] = ()) -> Diagnosis:
    return Diagnosis(faults=[*faults], rank=rank, p=p, near=[*near])


class Vehicle:
    """Tells a memory what a monitor would tell."""

    def __init__(self, memory: FaultMemory | None = None, system: System = SYSTEM, **rules: object) -> None:
        self.memory = memory or FaultMemory(Rules(**rules))  # type: ignore[arg-type]
        self.memory.watch(system)
        self.seq = 0
        if self.memory.cycle == 0:
            self.memory.begin_cycle(1)

    def tell(
        self,
        transition: Transition,
        *diagnoses: Diagnosis,
        alarm: Sequence[str] = ("t02",),
        modes: Sequence[str] = ("idle",),
    ) -> list[FaultChange]:
        self.seq += 1
        event = Event(
            schema=SCHEMA,
            id=f"truck-{self.seq}",
            seq=self.seq,
            tick=self.seq,
            t_s=0.2 * self.seq,
            wall=f"2026-11-23T12:00:{self.seq:02}Z",
            transition=transition,
            diagnoses=[*diagnoses],
            alarm=[*alarm],
            cannot_tell=[],
            since_tick=None,
            bundle=SYSTEM.bundle,
        )
        return self.memory.event("uds", event, modes)

    def drive(
        self, seconds: float, mode: int = IDLE, usable: np.ndarray = ALL, suspicious: bool = False
    ) -> list[FaultChange]:
        return [n for _ in range(round(seconds / 0.2)) for n in self.memory.tick("uds", mode, usable, suspicious)]

    def cycle(self) -> list[FaultChange]:
        """The key off and on."""
        return [*self.memory.end_cycle(), *self.memory.begin_cycle(self.memory.cycle + 1)]

    @property
    def overflow(self) -> bool:
        return self.memory.remembered.overflow

    @property
    def faults(self) -> list[Fault]:
        return [*self.memory.faults.values()]


def changes(news: Sequence[FaultChange]) -> list[tuple[str | None, int]]:
    return [(each.change, each.fault.number) for each in news]


def told(news: Sequence[FaultChange]) -> list[tuple[str, int]]:
    return [(change, number) for change, number in changes(news) if change is not None]


def test_a_fault_is_confirmed_by_its_first_trip_and_refined_not_told_twice() -> None:
    truck = Vehicle()
    assert changes(truck.tell("occurred", one("fA_t"), one("fA_du"))) == [("confirmed", 1)]
    assert changes(truck.tell("refined", one("fA_t", p=0.9), alarm=("t02", "t08"))) == [("refined", 1)]
    (fault,) = truck.faults
    assert fault.components == ["tank filter"]
    assert fault.dtcs == [Dtc(spn=520193, fmi=7)]
    assert (fault.tests, fault.modes, fault.occurrences) == (["t02", "t08"], ["idle"], 1)
    assert (fault.first.id, fault.latest.id) == ("truck-1", "truck-2")
    assert fault.mask == 0b10101111
    assert fault.fdc == 127


def test_codes_name_a_component_only_where_one_explanation_is_left() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"), one("fA_du"))
    assert truck.faults[0].dtcs == [AMBIGUOUS]
    truck.tell("refined", one("fA_t", "fA_du"))
    assert truck.faults[0].dtcs == [Dtc(spn=520193, fmi=7), Dtc(spn=3362, fmi=7)]
    truck.tell("refined", one("fA_t"), one(near=["e10"]))
    assert truck.faults[0].dtcs == [AMBIGUOUS]
    truck.memory.clear(None)
    truck.tell("occurred", one(near=["e10"]))
    assert truck.faults[0].dtcs == [UNKNOWN]
    truck.memory.clear(None)
    truck.tell("occurred", one("fq_pump"))
    assert truck.faults[0].dtcs == []  # the model gives it none: nothing is made up


def test_a_fault_that_heals_and_comes_again_is_the_same_one() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"), one("fA_du"))
    assert changes(truck.tell("healed")) == [("passed", 1)]
    assert truck.faults[0].mask == 0b10101110
    assert truck.faults[0].fdc == -128
    assert changes(truck.tell("occurred", one("fA_du"))) == [("failed", 1)]
    assert (truck.faults[0].occurrences, truck.faults[0].trips) == (2, 1)
    assert truck.faults[0].diagnoses == [one("fA_du")]


def test_another_fault_is_another_entry() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    assert changes(truck.tell("occurred", one("fA_du"))) == [("confirmed", 2)]
    assert [(fault.number, fault.status.test_failed) for fault in truck.faults] == [(1, False), (2, True)]


def test_what_turns_out_to_be_another_one_leaves_the_first_as_it_was() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    before = truck.faults[0]
    assert changes(truck.tell("occurred", one("fA_t"), one("fA_du"))) == [("failed", 1)]
    assert changes(truck.tell("refined", one("fA_du"))) == [("withdrawn", 1), ("confirmed", 2)]
    assert truck.faults[0] == before
    assert changes(truck.tell("healed")) == [("passed", 2)]


@pytest.mark.parametrize("rules", [{}, {"failed_after_s": 2.0, "confirm_trips": 2}])
def test_a_new_one_that_turns_out_to_be_a_remembered_one_is_that_one_and_no_second_entry(
    rules: dict[str, Any],
) -> None:
    truck = Vehicle(**rules)
    truck.tell("occurred", one("fA_t"))
    truck.drive(5.0, suspicious=True)
    truck.tell("healed")
    truck.tell("occurred", one("fA_du"))
    truck.drive(5.0, suspicious=True)
    assert [fault.number for fault in truck.faults] == [1, 2]
    told = changes(truck.tell("refined", one("fA_t")))
    assert told[0] == ("revoked", 2)
    assert told[1][1] == 1
    assert [(fault.number, fault.occurrences, fault.status.test_failed) for fault in truck.faults] == [(1, 2, True)]
    assert truck.faults[0].fdc == 127
    assert len({dtc for fault in truck.faults for dtc in fault.dtcs}) == len(truck.faults)


def test_one_candidate_in_common_makes_a_new_entry_no_remembered_one() -> None:
    """The wound: a confirmed fault became another entry's, and then pending, as explanations came and went."""
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.drive(5.0, suspicious=True)
    truck.tell("healed")
    truck.tell("occurred", one("fA_du"))
    truck.drive(5.0, suspicious=True)
    for diagnoses in ([one("fA_du"), one("fA_t")], [one("fA_du")], [one("fA_du"), one("fA_t")]):
        assert {change for change, _ in changes(truck.tell("refined", *diagnoses))} <= {"refined"}
    assert [fault.number for fault in truck.faults] == [1, 2]


def test_what_rested_on_doubted_samples_was_never_there() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    assert changes(truck.tell("withdrawn")) == [("revoked", 1)]
    assert truck.faults == []
    assert truck.drive(10.0) == []
    assert changes(truck.tell("occurred", one("fA_t"))) == [("confirmed", 2)], "no number is used twice"


def test_a_remembered_fault_is_as_it_was_where_its_coming_again_rested_on_doubted_samples() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    before = truck.faults[0]
    truck.tell("occurred", one("fA_t"), one("fA_du"))
    assert changes(truck.tell("withdrawn")) == [("withdrawn", 1)]
    assert truck.faults == [before]
    assert truck.tell("withdrawn") == []


def test_a_new_one_follows_its_candidates_wherever_they_go() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    assert changes(truck.tell("refined", one("fA_du"))) == [("refined", 1)]
    assert truck.faults[0].diagnoses == [one("fA_du")]


def test_a_pair_shares_its_entry_with_either() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    assert changes(truck.tell("refined", one("fA_t", "fA_du"))) == [("refined", 1)]
    truck.tell("healed")
    assert changes(truck.tell("occurred", one("fA_du"))) == [("failed", 1)]


def test_unknown_faults_are_alike_where_they_are_near_the_same() -> None:
    truck = Vehicle()
    truck.tell("occurred", one(near=["e10"]))
    truck.tell("healed")
    assert changes(truck.tell("occurred", one(near=["e11"]))) == [("confirmed", 2)]
    truck.tell("healed")
    assert changes(truck.tell("occurred", one(near=["e10", "e12"]))) == [("failed", 1)]


def test_two_trips_confirm_where_two_are_wanted() -> None:
    truck = Vehicle(confirm_trips=2)
    assert changes(truck.tell("occurred", one("fA_t"))) == [("pending", 1)]
    assert truck.faults[0].mask == 0b00100111
    truck.tell("healed")
    assert changes(truck.tell("occurred", one("fA_t"))) == [("pending", 1)], "the same trip"
    truck.tell("healed")
    truck.cycle()
    assert changes(truck.tell("occurred", one("fA_t"))) == [("confirmed", 1)]


def test_a_good_cycle_between_two_trips_begins_the_count_anew() -> None:
    truck = Vehicle(confirm_trips=2)
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    truck.cycle()
    truck.drive(70.0)
    assert told(truck.cycle()) == [("settled", 1)]
    assert not truck.faults[0].status.pending
    assert changes(truck.tell("occurred", one("fA_t"))) == [("pending", 1)]


def test_a_fault_that_lasts_over_the_key_fails_in_the_next_cycle_too() -> None:
    truck = Vehicle(confirm_trips=2)
    truck.tell("occurred", one("fA_t"))
    truck.cycle()
    assert not truck.faults[0].status.test_failed_this_cycle
    assert told(truck.drive(1.0, suspicious=True)) == [("confirmed", 1)]
    assert (truck.faults[0].trips, truck.faults[0].occurrences) == (2, 1)


def test_what_lasts_over_the_key_and_turns_out_to_be_another_one_takes_its_entry_along() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.cycle()
    truck.drive(1.0, suspicious=True)
    assert changes(truck.tell("refined", one("fA_du"))) == [("refined", 1)]
    assert changes(truck.tell("healed")) == [("passed", 1)]


def test_what_heals_before_it_could_be_seen_in_the_next_cycle_has_passed() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.cycle()
    assert changes(truck.tell("healed")) == [("passed", 1)]


def test_what_no_test_alarms_for_counts_while_any_can_tell() -> None:
    truck = Vehicle(failed_after_s=2.0)
    truck.tell("occurred", one("fA_t"), alarm=[])
    assert told(truck.drive(10.0, usable=NONE, suspicious=True)) == []
    assert told(truck.drive(2.0, suspicious=True)) == [("confirmed", 1)]


def test_it_heals_after_three_cycles_and_ages_after_forty_more() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    assert truck.cycle()[0].change is None  # it failed in this one: begins the next
    news = []
    for _ in range(2):
        truck.drive(70.0)
        news += told(truck.cycle())
    assert truck.faults[0].mask & 0x80
    truck.drive(70.0)
    assert told(truck.cycle()) == [("settled", 1)]
    assert not truck.faults[0].mask & 0x80
    for k in range(39):
        truck.drive(70.0)
        assert told(truck.cycle()) == [], k
    truck.drive(70.0)
    assert told(truck.cycle()) == [("aged", 1)]
    assert truck.faults == []
    truck.tell("occurred", one("fA_t"))
    assert truck.faults[0].number == 2, "no number is used twice"


@pytest.mark.parametrize(
    ("mode", "usable", "suspicious"),
    [(MAXIMUM, ALL, False), (IDLE, NONE, False), (IDLE, ALL, True)],
    ids=["another mode than showed it", "tests that cannot tell", "something is suspected"],
)
def test_a_cycle_that_could_not_tell_counts_for_nothing(mode: int, usable: np.ndarray, suspicious: bool) -> None:
    truck = Vehicle(heal_cycles=1, age_cycles=1)
    truck.tell("occurred", one("fA_t"), modes=["idle"])
    truck.tell("healed")
    truck.cycle()
    for _ in range(5):
        truck.drive(300.0, mode, usable, suspicious)
        truck.cycle()
    (fault,) = truck.faults
    assert (fault.healing, fault.aging, fault.status.not_completed_this_cycle) == (0, 0, True)


def test_after_a_restart_a_fault_is_there_until_it_was_seen_quiet() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"), modes=["idle", "maximum"])
    kept = truck.faults
    again = Vehicle(FaultMemory(Rules(), kept, truck.memory.remembered, cycle=1))
    again.tell("started")
    assert told(again.drive(100.0, IDLE)) == []
    assert again.faults[0].status.test_failed
    assert told(again.drive(70.0, MAXIMUM)) == [("passed", 1)]


def test_a_fault_of_modes_that_the_bundle_has_no_more_passes_where_tests_can_tell() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"), modes=["ascending"])
    again = Vehicle(FaultMemory(Rules(), truck.faults, truck.memory.remembered, cycle=1))
    again.tell("started")
    assert told(again.drive(100.0, IDLE, NONE)) == []
    assert told(again.drive(70.0, MAXIMUM)) == [("passed", 1)]


def test_after_a_restart_a_fault_that_is_still_there_is_no_new_one() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"), one("fA_du"))
    again = Vehicle(FaultMemory(Rules(), truck.faults, truck.memory.remembered, cycle=1))
    again.tell("started")
    assert changes(again.tell("occurred", one("fA_t"), one("fA_du"))) == [(None, 1)]
    assert again.faults[0].occurrences == 1
    again.tell("started")
    assert changes(again.tell("occurred", one("fA_t"))) == [("refined", 1)]


def test_the_least_important_makes_room() -> None:
    truck = Vehicle(entries=3, confirm_trips=2)
    for name in ("fA_t", "fA_du", "fq_pump"):
        truck.tell("occurred", one(name))
        truck.tell("healed")
    truck.cycle()
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    before = truck.overflow
    assert changes(truck.tell("occurred", one("fnew"))) == [("displaced", 2), ("pending", 4)]
    assert [fault.number for fault in truck.faults] == [1, 3, 4]
    after = truck.overflow
    truck.memory.clear(1)
    kept = truck.overflow  # only erasing all says that nothing is missing
    truck.memory.clear(None)
    assert (before, after, kept, truck.overflow) == (False, True, True, False)


def test_what_is_erased_and_still_there_is_told_under_a_new_number() -> None:
    truck = Vehicle()
    truck.tell("occurred", one("fA_t"))
    assert truck.memory.clear(7) == []
    assert truck.memory.clear(1) == [1]
    assert truck.faults == []
    assert changes(truck.drive(0.2, usable=ALL, suspicious=True)) == [("confirmed", 2)]


def test_debouncing_counts_what_is_told_for_so_long() -> None:
    truck = Vehicle(failed_after_s=10.0, passed_after_s=5.0)
    assert truck.tell("occurred", one("fA_t")) == []
    assert changes(truck.drive(9.6, suspicious=True)) == []
    assert changes(truck.drive(0.4, suspicious=True)) == [("confirmed", 1)]
    assert truck.tell("healed") == []
    assert changes(truck.drive(5.0)) == [("passed", 1)]


def test_what_is_dismissed_before_it_counts_is_never_remembered() -> None:
    truck = Vehicle(failed_after_s=10.0)
    truck.tell("occurred", one("fA_t"))
    truck.drive(5.0, suspicious=True)
    truck.tell("healed")
    truck.drive(100.0)
    assert truck.faults == []


@pytest.mark.parametrize(("disabled", "left_s"), [("freeze", 5.0), ("reset", 10.0)])
def test_while_tests_cannot_tell_the_count_stands_or_begins_anew(disabled: str, left_s: float) -> None:
    truck = Vehicle(failed_after_s=10.0, disabled=disabled)
    truck.tell("occurred", one("fA_t"))
    truck.drive(4.8, suspicious=True)
    assert changes(truck.drive(60.0, usable=NONE, suspicious=True)) == []
    assert changes(truck.drive(left_s - 0.2, suspicious=True)) == []
    assert changes(truck.drive(0.2, suspicious=True)) == [("confirmed", 1)]


def test_systems_do_not_share_their_faults() -> None:
    truck = Vehicle()
    truck.memory.watch(SYSTEM._replace(name="trailer"))
    truck.tell("occurred", one("fA_t"))
    truck.tell("healed")
    event = Event(
        schema=SCHEMA, id="truck-9", seq=9, tick=9, t_s=1.8, wall=None, transition="occurred", diagnoses=[one("fA_t")],
        alarm=["t02"], cannot_tell=[], since_tick=None, bundle=SYSTEM.bundle,
    )  # fmt: skip
    assert changes(truck.memory.event("trailer", event, [])) == [("confirmed", 2)]
    assert [fault.system for fault in truck.faults] == ["uds", "trailer"]


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_told_the_memory_holds_together(seed: int) -> None:
    chance = np.random.default_rng(seed)
    truck = Vehicle(entries=4, confirm_trips=2, heal_cycles=1, age_cycles=2, failed_after_s=1.0)
    names = ["fA_t", "fA_du", "fq_pump", "f4", "f5", "f6"]
    transitions: list[Transition] = [
        "started",
        "suspected",
        "dismissed",
        "occurred",
        "refined",
        "healed",
        "cannot_tell",
    ]
    highest, erased = 0, set[int]()
    for _ in range(2000):
        match chance.integers(8):
            case 0:
                truck.cycle()
            case 1 if chance.random() < 0.1:
                erased |= {*truck.memory.clear(None if chance.random() < 0.3 else int(chance.integers(1, 30)))}
            case 2 | 3:
                truck.drive(
                    float(chance.uniform(0.0, 90.0)),
                    int(chance.integers(4)),
                    chance.random(3) < 0.8,
                    chance.random() < 0.5,
                )
            case _:
                chosen = chance.choice(names, size=int(chance.integers(1, 4)), replace=False)
                given = [one(*chosen)] if chance.random() < 0.3 else [one(str(name)) for name in chosen]
                truck.tell(transitions[chance.integers(7)], *given)
        assert len(truck.faults) <= 4
        assert len({fault.number for fault in truck.faults}) == len(truck.faults)
        highest = max([highest, *(fault.number for fault in truck.faults)])
        assert highest < truck.memory.remembered.number
        for fault in truck.faults:
            assert fault.number not in erased
            assert fault.status.mask == fault.mask
            assert fault.diagnoses
            assert not fault.status.test_failed_this_cycle or fault.trips > 0
            assert fault.status.confirmed or not fault.status.warning
            assert fault.status.failed_since_clear


def test_another_fault_while_the_last_one_passes_is_an_entry_of_its_own() -> None:
    truck = Vehicle(passed_after_s=20.0)
    assert changes(truck.tell("occurred", one("fA_t"))) == [("confirmed", 1)]
    assert truck.tell("healed") == []
    assert changes(truck.tell("occurred", one("fA_du"))) == [("passed", 1), ("confirmed", 2)]
    assert [fault.status.test_failed for fault in truck.faults] == [False, True]
    assert truck.faults[1].diagnoses == [one("fA_du")]


def test_the_same_fault_while_it_passes_is_still_there_with_what_is_told_now() -> None:
    truck = Vehicle(passed_after_s=20.0)
    truck.tell("occurred", one("fA_t"), one("fA_du"))
    truck.tell("healed")
    truck.drive(10.0)
    assert changes(truck.tell("occurred", one("fA_t"))) == [("refined", 1)]
    truck.drive(30.0, suspicious=True)
    [fault] = truck.faults
    assert fault.status.test_failed
    assert (fault.occurrences, fault.diagnoses) == (1, [one("fA_t")])
