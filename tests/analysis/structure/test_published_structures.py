"""Published structures and chains of tanks: how many MSO sets and tests they have."""

import pytest
from made_models import air_path, electric_motor, induction_motor, tank_chain, three_tank

from faultline.analysis.structure import Structure, mso_sets, mtes_sets, redundancy
from faultline.analysis.structure.causality import IntegralCausality


@pytest.mark.parametrize(
    ("structure", "equations", "unknowns", "mso", "mtes"),
    [
        pytest.param(three_tank(), 12, 10, 6, 4, id="three tanks"),
        pytest.param(electric_motor(), 9, 7, 3, 3, id="electric motor"),
        pytest.param(induction_motor(), 15, 13, 9, 2, id="induction motor"),
    ],
)
def test_published_counts(structure: Structure, equations: int, unknowns: int, mso: int, mtes: int) -> None:
    """The sources are with the models."""
    assert (len(structure.equations), len(structure.unknowns)) == (equations, unknowns)
    assert len(mso_sets(structure)) == mso
    assert len(mtes_sets(structure)) == mtes


@pytest.mark.parametrize(("tanks", "sets", "integral"), [(3, 18, 10), (4, 58, 20), (5, 179, 35)])
def test_every_mso_set_of_a_chain_of_tanks_is_a_test(tanks: int, sets: int, integral: int) -> None:
    """The counts are those of the Fault Diagnosis Toolbox 0.12.5."""
    structure = tank_chain(tanks)
    found = mso_sets(structure)
    assert len(found) == len({*found}) == sets
    assert {*mtes_sets(structure)} == {*found}
    causality = IntegralCausality(structure)
    assert sum(bool(causality.residuals(structure.rows(mso))) for mso in found) == integral


def test_a_model_of_the_largest_size_in_the_literature() -> None:
    """The largest benchmark has 94 equations and 4496 MSO sets; this made one is as large."""
    structure = air_path(8, ["speed", "p2", "p4", "p8"])
    found = mso_sets(structure)
    assert (len(structure.equations), len(structure.unknowns)) == (92, 88)
    assert len(found) == len({*found}) == 5670
    assert all(redundancy(structure, mso) == 1 for mso in found)
    supports = {frozenset(structure.faults_in(mso)) for mso in found} - {frozenset()}
    minimal = {s for s in supports if not any(other < s for other in supports)}
    assert {frozenset(structure.faults_in(mtes)) for mtes in mtes_sets(structure)} == minimal
