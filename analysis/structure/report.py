"""The structural analysis of a model as text to read."""

from collections import Counter
from collections.abc import Mapping, Sequence

from faultline.analysis.model import Model
from faultline.analysis.structure.arguments import Arguments, arguments
from faultline.analysis.structure.causality import residual_causality
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import detectability, isolability_of
from faultline.analysis.structure.document import CAUSALITIES, findings, selected, sensor_sets
from faultline.analysis.structure.isolability import isolability, signature_matrix
from faultline.analysis.structure.placement import MANY_POSITIONS
from faultline.analysis.structure.structure import Structure, over_determined, redundancy, structure_of
from faultline.analysis.structure.supports import Found, Support, Test, find_all

SHOWN = 5
"""How many of many equally good sets are printed."""
MANY_TESTS = 100
"""How many tests are printed, unless their computations are asked for too."""


def report(
    model: Model | Structure,
    *,
    computations: bool = False,
    positions: Mapping[str, float] | None = None,
    found: Found | None = None,
) -> str:
    """What an engineer reads first: counts, parts, tests, fault signatures, isolability, sensors, findings.

    With `computations` also how every test is computed; `positions` are where sensors could be placed, `found` the
    tests and MSO sets.
    """
    found = found or find_all(model)
    tests = found.tests
    if isinstance(model, Model) and model.residuals:
        return _of_given_residuals(model, tests)
    structure = structure_of(model)
    parts = [_counts(model, structure, found), _classes(structure)]
    if tests:
        shown = tests if computations else tests[:MANY_TESTS]
        rest = [f"  and {len(tests) - len(shown)} more (--tests prints all)"] if len(shown) < len(tests) else []
        title = "Fault signatures (X: the test is sensitive to the fault)"
        parts += [
            [*_test_table(structure, shown), *rest],
            [title, *_signatures(shown, structure.faults), *rest],
            *_isolability(structure),
            [] if found.more_tests else _selections(tests, structure.faults),
        ]
    if structure.faults:
        parts.append(_placements(structure, positions))
    if computations:
        parts.extend(_computation(structure, test, model) for test in tests if isinstance(test, Test))
        parts.append(_obstacles(tests))
    told = findings(model, found)
    parts.append(["Findings", *(f"  {f.severity}: {f.place}: {f.message}" for f in told)] if told else [])
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _of_given_residuals(model: Model, tests: Sequence[Support]) -> str:
    """What the residuals of another tool tell apart, by their signatures alone."""
    faults, found = [*model.faults], isolability(tests, [*model.faults])
    parts = [
        [
            f"{model.name}: {model.description}".removesuffix(": "),
            f"{len(tests)} residuals of another tool, {len(faults)} faults",
        ],
        ["Fault signatures (X: the residual is sensitive to the fault)", *_signatures(tests, faults)],
        ["Isolability", *_columns([(fault, _verdict(others)) for fault, others in found.items()])],
        _selections(tests, faults),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _verdict(others: Sequence[str]) -> str:
    return f"not isolable from {', '.join(others)}" if others else "isolable from every other fault"


def _counts(model: Model | Structure, structure: Structure, found: Found) -> list[str]:
    differential = len(structure.differentials)
    part = over_determined(structure)
    runnable = sum(isinstance(test, Test) for test in found.tests)
    form = "(integral causality, no algebraic loop)"
    return [
        model.name + (f": {model.description}" if model.description else "")
        if isinstance(model, Model)
        else "a structural model, without formulas",
        f"{len(structure.equations)} equations ({len(structure.equations) - differential} algebraic, "
        f"{differential} differential), {len(structure.unknowns)} unknowns, {len(structure.known)} known signals, "
        f"{len(structure.faults)} faults",
        f"redundancy {redundancy(structure, part)}; {len(part)} equations in the over-determined part",
        f"{'more than ' * found.more_mso}{len(found.mso)} MSO sets, "
        f"{'more than ' * found.more_tests}{len(found.tests)} tests (MTES), "
        f"{runnable} of {'these' if found.more_tests else 'them'} can be run {form}",
    ]


def _classes(structure: Structure) -> list[str]:
    """The classes of equations that no test separates."""
    together = [found for found in dulmage_mendelsohn(structure).classes if len(found.equations) > 1]
    if not together:
        return []
    rows = [
        (_ranges(found.equations, structure.equations), ", ".join(found.unknowns), ", ".join(found.faults))
        for found in together
    ]
    return ["Equations that no test separates", *_columns([("equations", "private unknowns", "faults"), *rows])]


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


def _isolability(structure: Structure) -> list[list[str]]:
    """A table for every result, the causalities that give the same together."""
    tables: dict[tuple[str, ...], list[str]] = {}
    for causality in CAUSALITIES:
        found = detectability(structure, causality)
        rows = []
        for fault, others in isolability_of(structure, causality).items():
            rows.append((fault, _verdict(others) if fault in found else "not detectable"))
        tables.setdefault(tuple(_columns(rows)) if rows else (), []).append(causality)
    return [[f"Isolability, {' and '.join(names)} causality", *table] for table, names in tables.items() if table]


def _selections(tests: Sequence[Support], faults: Sequence[str]) -> list[str]:
    chosen = selected(tests, faults)
    if not chosen:
        return []
    kind = "tests that can be run" if any(isinstance(test, Test) for test in tests) else "tests"
    return [
        f"Smallest sets of {kind} that tell apart what all of them do: {len(chosen)}",
        *(f"  {', '.join(names)}" for names in chosen[:SHOWN]),
        *_more(len(chosen)),
    ]


def _placements(structure: Structure, positions: Mapping[str, float] | None) -> list[str]:
    sets = sensor_sets(structure, "integral", positions)
    if sets is None:
        return [f"More than {MANY_POSITIONS} positions for further sensors: name those that are possible, --positions"]
    if not any(found.sensors for found in sets):
        return ["No further sensor would improve isolability with integral causality"]
    price = ", cheapest first" if positions else ""
    return [
        "Minimal sets of further sensors for the best isolability with integral causality"
        f" (taken as free of faults{price}): {len(sets)}",
        *(f"  {', '.join(s.sensors)}" + (f"  (cost {s.cost:g})" if positions else "") for s in sets[:SHOWN]),
        *_more(len(sets)),
    ]


def _more(count: int) -> list[str]:
    return [f"  and {count - SHOWN} more (--json has all)"] if count > SHOWN else []


def _computation(structure: Structure, test: Test, model: Model | Structure) -> list[str]:
    """The sequence and the arguments of a test."""
    found = arguments(model, test)
    derivatives = {d.state: d.derivative for d in structure.differentials.values()}
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
    """Names with runs of numbers shortened, where the model has these next to each other: e03-e04,e07."""
    chosen = set(names)
    runs: list[list[str]] = []
    for before, name in zip(["", *order[:-1]], order, strict=True):
        if name in chosen:
            if runs and runs[-1][-1] == before and _follows(before, name):
                runs[-1].append(name)
            else:
                runs.append([name])
    return ",".join(run[0] if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _follows(before: str, name: str) -> bool:
    """Whether a name is another one with the next number: e04 after e03."""
    stem = before.rstrip("0123456789")
    number = before[len(stem) :]
    return number != "" and name == f"{stem}{int(number) + 1:0{len(number)}d}"


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as aligned lines, indented."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
