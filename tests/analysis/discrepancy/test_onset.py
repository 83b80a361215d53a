"""Something that set in looks like a fault; what was there from the start, grows, or comes and goes does not."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.discrepancy.find.locate import Location, Suspect
from faultline.analysis.discrepancy.find.onset import Onset, onset
from faultline.analysis.model import load_model

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
UDS4 = load_model("uds")
T = np.arange(20.0, 480.0, 4.0)
FLAT = np.zeros(len(T))


def suspect(equation: str, value: Array, evidence: float = 500.0, log: Ints | None = None) -> Suspect:
    return Suspect(
        equation=equation,
        description=UDS4.equations[equation].description,
        evidence=evidence,
        probability=1e-6,
        prior="smooth",
        t=T,
        log=np.zeros(len(T), dtype=np.int64) if log is None else log,
        value=value + 0.1 * np.random.default_rng(1).standard_normal(len(T)),
        sd=np.full(len(T), 0.1),
        variable="q",
        unit="m3/s",
        size=1.0,
    )


def location(*suspects: Suspect, members: tuple[str, ...] | None = None, course: Array = FLAT) -> Location:
    """What it follows, as it was found, is `course`."""
    names = tuple(s.equation for s in suspects) if members is None else members
    courses = dict.fromkeys(names, course[:, None])
    return Location(suspects, names, (), (), (), courses, (), np.zeros(0))


RECORDINGS = ("drive-1",)
STEP = np.where(T >= 260.0, 1.0, 0.0)


def test_a_step_is_a_fault_that_set_in_with_its_component() -> None:
    found = onset(UDS4, location(suspect("e07", STEP)), RECORDINGS)
    assert found == Onset(260.0, "e07", ("fA_du",), "drive-1")
    fault = UDS4.faults["fA_du"]
    assert found.what(UDS4) == (
        "something set in at 260 s of drive-1, as faults do "
        f"(e07, where these enter: {fault.component}: {fault.description})"
    )


def test_all_components_of_the_class_are_named_and_what_no_fault_enters_has_none() -> None:
    found = onset(UDS4, location(suspect("e04", STEP), suspect("e07", STEP, 400.0)), RECORDINGS)
    assert found is not None
    assert found.faults == ("fA_dos", "fA_du")
    assert "; or " in found.what(UDS4)
    none = next(name for name, e in UDS4.equations.items() if e.fault is None)
    bare = onset(UDS4, location(suspect(none, STEP)), RECORDINGS)
    assert bare is not None
    assert bare.faults == ()
    assert bare.what(UDS4).endswith(f"as faults do ({none})")
    new = dataclasses.replace(suspect("e07", STEP), equation="creeping_hose_creeps")
    of_an_effect = onset(UDS4, location(new, suspect("e07", STEP, 400.0)), RECORDINGS)
    assert of_an_effect is not None
    assert (of_an_effect.equation, of_an_effect.faults) == ("creeping_hose_creeps", ("fA_du",))


@pytest.mark.parametrize("up", [1.0, -3.0])
@pytest.mark.parametrize("base", [0.0, 5.0])
def test_it_may_go_either_way_from_anywhere(up: float, base: float) -> None:
    found = onset(UDS4, location(suspect("e07", base + up * STEP)), RECORDINGS)
    assert found is not None
    assert found.t_s == 260.0


@pytest.mark.parametrize(
    "value",
    [
        np.zeros(len(T)),
        np.ones(len(T)),
        (T - 20.0) / 460.0,
        np.where(np.floor(T / 40.0) % 2 == 0.0, 1.0, 0.0),
        np.sin(T / 30.0),
        1.0 - np.exp(-(T - 20.0) / 50.0),
        np.where(T >= 464.0, 1.0, 0.0),
        np.where(T <= 36.0, 1.0, 0.0),
    ],
    ids=[
        "nothing",
        "from the start",
        "ramp",
        "switching",
        "waves",
        "settling",
        "just before the end",
        "just after the start",
    ],
)
def test_what_did_not_set_in_is_no_fault(value: Array) -> None:
    assert onset(UDS4, location(suspect("e07", value)), RECORDINGS) is None


def test_what_follows_the_quantities_that_it_was_found_to_follow_is_no_fault() -> None:
    """A pressure ladder at the end of a cycle shows physics that nothing before it does."""
    ladder = np.where(T > 360.0, np.floor((T - 300.0) / 40.0) ** 2, 0.0)
    assert onset(UDS4, location(suspect("e07", 0.3 * ladder), course=ladder), RECORDINGS) is None
    assert onset(UDS4, location(suspect("e07", 0.3 * ladder)), RECORDINGS) is not None


def test_every_recording_is_looked_at_by_itself() -> None:
    log = np.where(T < 240.0, 0, 1).astype(np.int64)
    value = np.where(T >= 360.0, 1.0, 0.0)
    found = onset(UDS4, location(suspect("e07", value, log=log)), ("drive-1", "drive-2"))
    assert found is not None
    assert (found.t_s, found.recording) == (360.0, "drive-2")
    assert onset(UDS4, location(suspect("e07", np.where(log, 1.0, 0.0), log=log)), ("drive-1", "drive-2")) is None


def test_a_curve_that_hardly_is_one_is_not_looked_at() -> None:
    assert onset(UDS4, location(suspect("e07", STEP, 40.0)), RECORDINGS) is None


def test_where_nothing_is_missing_nothing_set_in() -> None:
    assert onset(UDS4, location(suspect("e07", STEP), members=()), RECORDINGS) is None


def test_the_curve_is_that_of_the_class_with_the_most_evidence() -> None:
    far = suspect("e10", STEP, 9e9)
    near = suspect("e04", (T - 20.0) / 460.0), suspect("e07", STEP, 1.0)
    found = onset(UDS4, location(far, *near, members=("e04", "e07")), RECORDINGS)
    assert found is None
