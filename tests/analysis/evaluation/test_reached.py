"""Sizes told beside the true ones, and delays beside the limit's."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from made_story import GOLDEN, event, known, story

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.reached import reached
from faultline.analysis.evaluation.measure.sizes import size_told
from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.analysis.limit.limits import Limits, Smallest
from faultline.service.bundle.load import load_bundle
from faultline.service.core.records.event import Event, Size

EVIDENCE = load_bundle(GOLDEN / "bundle").manifest.evidence


def truth(name: str, size: float, unit: str) -> Truth:
    fault = TrueFault(name=name, size=size, onset_s=60.0, profile="abrupt", unit=unit)
    return Truth(schema=1, recording="golden", fault=[fault])


def sized(name: str, low: float, high: float, unit: str) -> Event:
    found = event(500, (name, 1, 0.9))
    [diagnosis] = found.diagnoses
    sizes = [Size(low=low, high=high, unit=unit, of="a filter")]
    return msgspec.structs.replace(found, diagnoses=[msgspec.structs.replace(diagnosis, sizes=sizes)])


@pytest.mark.parametrize(
    ("given", "told", "true", "covered"),
    [
        (("fA_du", 0.65, "1"), ("fA_du", -66.7, -62.4, "%"), -65.0, True),
        (("fA_du", 0.5, "1"), ("fA_du", -66.7, -62.4, "%"), -50.0, False),
        (("fy_p_ap", 4e4, "Pa"), ("fy_p_ap", 0.39, 0.42, "bar"), 0.4, True),
        (("fy_p_ap", -4e4, "Pa"), ("fy_p_ap", 0.39, 0.42, "bar"), -0.4, False),
        (("fy_p_ap", 4e4, ""), ("fy_p_ap", 0.39, 0.42, "bar"), None, None),
        (("fq_pump", 0.2, "1"), ("fq_pump", -0.3, -0.2, "mL/s"), None, None),
    ],
)
def test_a_size_is_compared_in_the_unit_that_was_told(
    given: tuple[str, float, str], told: tuple[str, float, float, str], true: float | None, *, covered: bool | None
) -> None:
    found = size_told(truth(*given), [sized(*told)], 200.0)
    assert found is not None
    assert (found.true, found.covered) == (true, covered)


def test_no_size_is_told_of_another_fault_of_two_or_before_it_was() -> None:
    one = truth("fA_du", 0.65, "1")
    du, other = sized("fA_du", -66.7, -62.4, "%"), sized("fA_t", -66.7, -62.4, "%")
    assert size_told(one, [other], 200.0) is None
    assert size_told(one, [du, event(600)], 200.0) is None
    assert size_told(one, [du], 99.0) is None
    assert size_told(msgspec.structs.replace(one, fault=one.fault * 2), [du], 200.0) is None


def limits(*rows: Smallest) -> Limits:
    return Limits("b", ["free"], 500.0, [10.0, 40.0, 120.0], 3.0, 13.3, [12, 12, 12], [], list(rows))


def chain(fault: str, *sizes: float | None, share_of: str | None = None) -> Smallest:
    return Smallest(fault, share_of, [[size, size, size] for size in sizes])


def told(name: str, size: float, unit: str, delay_s: float | None) -> Facts:
    zero = np.zeros((900, 2))
    found = known(story(zero, zero), [name])
    verdict = msgspec.structs.replace(found.verdict, delay_s=delay_s)
    return replace(found, given=found.given._replace(truth=truth(name, size, unit)), verdict=verdict)


@pytest.mark.parametrize(
    ("size", "limit_s"),
    [(0.8, 3.0), (0.4, 10.0), (0.2, 25.0), (0.1, 40.0), (0.05, 120.0), (0.04, None)],
)
def test_the_limit_of_a_size_lies_between_its_times(size: float, limit_s: float | None) -> None:
    """Below the first time it goes with the size's square, down to a block; between two with its logarithm."""
    [found] = reached([told("fA_t", size, "1", 12.0)], limits(chain("fA_t", -0.4, -0.1, -0.05)), EVIDENCE)
    assert found.limit_s == limit_s
    assert (found.delay_s, found.smallest, found.within_s, found.detected.hits) == (12.0, 0.05, 120.0, 1)


def test_the_form_and_the_sign_are_those_of_the_truth() -> None:
    pump = [chain("fq_pump", -1e-6, -1e-7, -1e-8), chain("fq_pump", -0.4, -0.1, -0.05, share_of="eps_p")]
    sensor = [chain("fy_p_ap", None, -4e3, -1e3), chain("fy_p_ap", None, 5e3, 2e3)]
    of = [told("fq_pump", 0.1, "1", 12.0), told("fy_p_ap", 2e3, "Pa", None), told("leak_ap", 1.0, "mL/s", 9.0)]
    pumped, read = reached(of, limits(*pump, *sensor), EVIDENCE)
    assert (pumped.case, pumped.limit_s, pumped.smallest) == ("fq_pump", 40.0, 0.05)
    assert (read.case, read.limit_s, read.smallest, read.delay_s) == ("fy_p_ap", 120.0, 2e3, None)
