"""The whole structural analysis as data: names only, lists in the model's order, no fault in its own list."""

from collections.abc import Mapping, Sequence
from typing import get_args

from faultline.analysis.model import Model
from faultline.analysis.structure.arguments import arguments
from faultline.analysis.structure.causality import residual_causality
from faultline.analysis.structure.decomposition import Part, dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import Interpretation, detectability, isolability_of
from faultline.analysis.structure.index import low_index, observable
from faultline.analysis.structure.isolability import isolability, signature_matrix
from faultline.analysis.structure.lint import Finding, lint, lint_structure
from faultline.analysis.structure.placement import MANY_POSITIONS, SensorSet, place_sensors
from faultline.analysis.structure.selection import select_tests
from faultline.analysis.structure.structure import Structure, over_determined, redundancy, structure_of
from faultline.analysis.structure.supports import Found, Support, Test, find_all, mtes_sets

CAUSALITIES: tuple[Interpretation, ...] = get_args(Interpretation)

MANY_TESTS = 64
"""Beyond these, listing every smallest selection of tests may take minutes."""


MANY_RESIDUALS = 200
"""Tests whose residual choices are listed: each has as many as equations."""


def document(
    model: Model | Structure, positions: Mapping[str, float] | None = None, found: Found | None = None
) -> dict[str, object]:
    """The analysis, with the tests and MSO sets that were found.

    `positions` are the unknowns that sensors could measure, with their costs (see `sensor_sets`). `sensor_sets` and
    `selected_tests` are None where there are too many candidates to list every optimum, `residuals` of a test after the
    first `MANY_RESIDUALS`.
    """
    found = found or find_all(model)
    tests = found.tests
    if isinstance(model, Model) and model.residuals:
        return _of_given_residuals(model, tests)
    structure = structure_of(model)
    parts = dulmage_mendelsohn(structure)
    placed = [(causality, sensor_sets(structure, causality, positions)) for causality in CAUSALITIES]
    return {
        "model": model.name if isinstance(model, Model) else None,
        "equations": structure.equations,
        "unknowns": structure.unknowns,
        "knowns": structure.known,
        "faults": structure.faults,
        "structural_rank": parts.rank,
        "redundancy": redundancy(structure, over_determined(structure)),
        "low_index": low_index(structure),
        "observable": observable(structure),
        "lint": [vars(finding) for finding in findings(model, found)],
        "dm": {
            "under": _part(parts.under),
            "just": [_part(component) for component in parts.just],
            "over": _part(parts.over),
            "classes": [_part(found) for found in parts.classes],
            "rest_unknowns": parts.shared,
        },
        "mso": found.mso,
        "mtes": mtes_sets(structure, len(tests)),
        "more_mso": found.more_mso,
        "more_tests": found.more_tests,
        "tests": [_test(model, structure, test) for test in tests],
        "detectability": {causality: detectability(structure, causality) for causality in CAUSALITIES},
        "isolability": {causality: isolability_of(structure, causality) for causality in CAUSALITIES},
        "sensor_sets": {causality: _each(sets, "sensors") for causality, sets in placed},
        "sensor_costs": {causality: _each(sets, "cost") for causality, sets in placed},
        "selected_tests": None if found.more_tests else selected(tests, structure.faults),
    }


def findings(model: Model | Structure, found: Found) -> list[Finding]:
    """The findings of a model; whether faults are in no test that can be run is left open if there are more tests."""
    if isinstance(model, Structure):
        return lint_structure(model)
    return lint(model, () if found.more_tests else found.tests)


def _of_given_residuals(model: Model, tests: Sequence[Support]) -> dict[str, object]:
    """What there is of a system that residuals of another tool describe."""
    faults = [*model.faults]
    return {
        "model": model.name,
        "knowns": [*model.known],
        "faults": faults,
        "lint": [vars(finding) for finding in lint(model, tests)],
        "tests": [{"name": test.name, "faults": test.faults, "knowns": test.known} for test in tests],
        "isolability": isolability(tests, faults),
        "selected_tests": selected(tests, faults),
    }


def selected(tests: Sequence[Support], faults: Sequence[str]) -> list[list[str]] | None:
    """The smallest sets of tests that tell apart what all tests that can be run do; of all tests if none can be."""
    runnable: list[Support] = [test for test in tests if isinstance(test, Test)]
    usable = runnable or list(tests)
    if len(usable) > MANY_TESTS:
        return None
    chosen = select_tests(signature_matrix(usable, faults), faults)
    return [[usable[row].name for row in rows] for rows in chosen]


def sensor_sets(
    structure: Structure, causality: Interpretation, positions: Mapping[str, float] | None
) -> list[SensorSet] | None:
    """The minimal sets of further sensors for the best isolability, cheap ones first; None for too many positions.

    The sensors are taken as free of faults. Unless positions are given with their costs, every unknown is one but the
    derivatives, which no sensor measures.
    """
    derivatives = {d.derivative for d in structure.differentials.values()}
    costs = positions or {name: 1.0 for name in structure.unknowns if name not in derivatives}
    if len(costs) > MANY_POSITIONS:
        return None
    return place_sensors(structure, [*costs], causality, costs=costs)


def _each(sets: Sequence[SensorSet] | None, field: str) -> list[object] | None:
    return None if sets is None else [getattr(found, field) for found in sets]


def _part(part: Part) -> dict[str, tuple[str, ...]]:
    return {"equations": part.equations, "unknowns": part.unknowns, "faults": part.faults}


def _test(model: Model | Structure, structure: Structure, test: Support) -> dict[str, object]:
    found: dict[str, object] = {
        "name": test.name,
        "equations": test.equations,
        "faults": test.faults,
        "knowns": test.known,
        "states": test.states,
        "redundancy": redundancy(structure, test.equations),
        "residuals": residuals(structure, test) if test.number <= MANY_RESIDUALS else None,
        "obstacle": test.obstacle,
    }
    if isinstance(test, Test):
        computation = arguments(model, test)
        found |= {"residual": test.residual, "predicts": test.predicts, "sequence": test.sequence}
        found["arguments"] = {
            "g": {state: vars(a) for state, a in computation.rates.items()},
            "h": vars(computation.output),
        }
    return found


def residuals(structure: Structure, test: Support) -> list[dict[str, object]]:
    """Every equation of a test as its residual: what it predicts if it is a sensor's, and which states are integrated.

    None unless the test's redundancy is one: otherwise its equations are several minimal sets. `states` is None for
    mixed causality, where it depends on how the loop is broken.
    """
    if redundancy(structure, test.equations) != 1:
        return []
    found: list[dict[str, object]] = []
    for equation, causality in residual_causality(structure, test.equations).items():
        known, unknown = structure.known_in([equation]), structure.unknowns_in([equation])
        states = {"integral": test.states, "mixed": None}.get(causality, ())
        predicts = known[0] if len(known) == len(unknown) == 1 else None
        found.append({"equation": equation, "causality": causality, "states": states, "predicts": predicts})
    return found
