"""Show the structural analysis of a model: tests, fault signatures, isolability."""

import argparse
import json

from analysis.model import Model, load_model
from analysis.structure.arguments import arguments
from analysis.structure.causality import residual_causality
from analysis.structure.isolability import detectable, isolability
from analysis.structure.report import report
from analysis.structure.structure import over_determined, redundancy, structure_of
from analysis.structure.supports import Support, Test, find_tests, mso_sets, mtes_sets

EXAMPLE = """example:
  faultline structure uds4 --tests
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code: 1 if the model has no test."""
    parser = argparse.ArgumentParser(
        "faultline structure", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, or the name of a shipped model")
    parser.add_argument("--tests", action="store_true", help="also print how every test is computed")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    options = parser.parse_args(argv)
    model = load_model(options.model)
    print(json.dumps(as_json(model), indent=1) if options.json else report(model, computations=options.tests))
    return 0 if find_tests(model) else 1


def as_json(model: Model) -> dict[str, object]:
    """The analysis as data: names only, lists in the model's order, no fault in its own list."""
    structure = structure_of(model)
    tests = find_tests(model)
    runnable = [test for test in tests if isinstance(test, Test)]
    return {
        "model": model.name,
        "equations": structure.equations,
        "unknowns": structure.unknowns,
        "knowns": structure.known,
        "faults": structure.faults,
        "redundancy": redundancy(structure, over_determined(structure)),
        "over_determined": over_determined(structure),
        "mso": mso_sets(structure),
        "mtes": mtes_sets(structure),
        "tests": [_test(model, test) for test in tests],
        "detectability": {
            "mixed": detectable(tests, structure.faults),
            "runnable": detectable(runnable, structure.faults),
        },
        "isolability": {
            "mixed": isolability(tests, structure.faults),
            "runnable": isolability(runnable, structure.faults),
        },
    }


def _test(model: Model, test: Support) -> dict[str, object]:
    structure = structure_of(model)
    single = redundancy(structure, test.equations) == 1
    found: dict[str, object] = {
        "name": test.name,
        "equations": test.equations,
        "faults": test.faults,
        "knowns": test.known,
        "states": test.states,
        "causality": residual_causality(structure, test.equations) if single else None,
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
