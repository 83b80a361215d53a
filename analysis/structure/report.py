"""The structural analysis of a model as text to read."""

from collections import Counter
from collections.abc import Sequence

from analysis.model import Model
from analysis.structure.arguments import Arguments, arguments
from analysis.structure.causality import residual_causality
from analysis.structure.isolability import detectable, isolability, signature_matrix
from analysis.structure.structure import Structure, over_determined, redundancy, structure_of
from analysis.structure.supports import Support, Test, find_tests, mso_sets


def report(model: Model, *, computations: bool) -> str:
    """Counts, tests, fault signatures and isolability; with `computations` also how every test is computed."""
    structure = structure_of(model)
    tests = find_tests(model)
    if not tests:
        return "\n".join([*_counts(model, structure, tests), _missing(structure)])
    runnable = [test for test in tests if isinstance(test, Test)]
    parts = [
        _counts(model, structure, tests),
        _test_table(structure, tests),
        ["Fault signatures (X: the test is sensitive to the fault)", *_signatures(tests, structure.faults)],
        ["Isolability with all tests (any causality)", *_isolability(tests, structure.faults)],
        ["Isolability with the tests that can be run", *_isolability(runnable, structure.faults)],
    ]
    if computations:
        parts.extend(_computation(model, test) for test in runnable)
        parts.append(_obstacles(tests))
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _counts(model: Model, structure: Structure, tests: Sequence[Support]) -> list[str]:
    algebraic, differential = len(model.equations), len(model.differentials)
    part = over_determined(structure)
    runnable = sum(isinstance(test, Test) for test in tests)
    return [
        f"{model.name}: {model.description}",
        f"{algebraic + differential} equations ({algebraic} algebraic, {differential} differential), "
        f"{len(structure.unknowns)} unknowns, {len(structure.known)} known signals, {len(structure.faults)} faults",
        f"redundancy {redundancy(structure, part)}; {len(part)} equations in the over-determined part",
        f"{len(mso_sets(structure))} MSO sets, {len(tests)} tests (MTES), {runnable} of them can be run "
        "(integral causality, no algebraic loop)",
    ]


def _missing(structure: Structure) -> str:
    if not over_determined(structure):
        return (
            "no redundancy: every equation is needed to compute the unknowns; a sensor of one of them would give some"
        )
    return "no test is sensitive to a fault: the redundant equations contain none"


def _test_table(structure: Structure, tests: Sequence[Support]) -> list[str]:
    rows = [("test", "residual", "predicts", "states", "causality of residual choices", "equations")]
    for test in tests:
        residual, predicts = (test.residual, test.predicts) if isinstance(test, Test) else ("-", "-")
        states, equations = ",".join(test.states), _ranges(test.equations, structure.equations)
        rows.append((test.name, residual, predicts, states, _choices(structure, test), equations))
    return _columns(rows)


def _choices(structure: Structure, test: Support) -> str:
    """How many residual choices have which causality."""
    if redundancy(structure, test.equations) > 1:
        return "several MSO sets"
    counts = Counter(residual_causality(structure, test.equations).values())
    return ", ".join(
        f"{kind} {counts[kind]}" for kind in ("algebraic", "integral", "derivative", "mixed") if counts[kind]
    )


def _signatures(tests: Sequence[Support], faults: Sequence[str]) -> list[str]:
    marks = [["X" if hit else "." for hit in row] for row in signature_matrix(tests, faults)]
    return _columns([("", *faults), *((test.name, *row) for test, row in zip(tests, marks, strict=True))])


def _isolability(tests: Sequence[Support], faults: Sequence[str]) -> list[str]:
    found = detectable(tests, faults)
    rows = []
    for fault, others in isolability(tests, faults).items():
        verdict = f"not isolable from {', '.join(others)}" if others else "isolable from every other fault"
        rows.append((fault, verdict if fault in found else "not detectable"))
    return _columns(rows)


def _computation(model: Model, test: Test) -> list[str]:
    """The sequence and the arguments of a test."""
    found = arguments(model, test)
    derivatives = {d.state: d.derivative for d in model.differentials}
    steps = ", ".join(f"{variable} ({equation})" for equation, variable in test.sequence)
    rates = [f"  {derivatives[state]} = g({_listed(a)})" for state, a in found.rates.items()]
    return [
        f"{test.name}: r = {test.predicts} - h({_listed(found.output)}) by {test.residual}",
        *rates,
        f"  computed in the order {steps}",
    ]


def _obstacles(tests: Sequence[Support]) -> list[str]:
    """Why some tests cannot be run, those with the same reason together."""
    reasons: dict[str, list[str]] = {}
    for test in tests:
        if test.obstacle is not None:
            reasons.setdefault(test.obstacle, []).append(test.name)
    return [f"{', '.join(names)}: cannot be run: {reason}" for reason, names in reasons.items()]


def _listed(found: Arguments) -> str:
    return ", ".join(found.states) + (f"; {', '.join(found.known)}" if found.known else "")


def _ranges(names: Sequence[str], order: Sequence[str]) -> str:
    """Names with runs shortened: e03-e04,e07."""
    chosen = set(names)
    runs: list[list[str]] = []
    previous = False
    for name in order:
        if name in chosen:
            if previous:
                runs[-1].append(name)
            else:
                runs.append([name])
        previous = name in chosen
    return ",".join(run[0] if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as aligned lines, indented."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
