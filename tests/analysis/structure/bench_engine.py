"""The structural engine against the Fault Diagnosis Toolbox (FDT): `make bench` prints the table that docs/results has.

Both find the same on the same model, which is checked, and take turns; times are CPU times of the calls alone, medians
of the pairs with their range. FDT has C++ for the MSO sets and for the decomposition; all else of it, and all of ours,
is Python.

    python bench_engine.py PYTHON     the Python that has FDT
"""

import functools
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from made_models import air_path, electric_motor, induction_motor, tank_chain, three_tank

from faultline.analysis.model import load_model
from faultline.analysis.structure import Structure, mso_sets, mtes_sets, structure_of
from faultline.analysis.structure.causality import residual_causality
from faultline.analysis.structure.diagnosability import Interpretation, isolability_of

ROUNDS = 9
SWEPT = 5  # MSO sets whose causality is asked for: FDT takes a third of a second for each of the largest model
INTERPRETATIONS: dict[str, Interpretation] = {"mixed": "mixed", "int": "integral", "der": "derivative"}

Ask = Callable[..., tuple[float, Any]]


def main(python: str) -> None:
    """Prints the table."""
    models = {
        "three tanks": three_tank(),
        "electric motor": electric_motor(),
        "induction motor": induction_motor(),
        "urea dosing system": structure_of(load_model("uds")),
        **{f"chain of {n} tanks": tank_chain(n) for n in range(3, 9)},
        "air path, 4 volumes": air_path(4, ["speed", "p2"]),
        "air path, 6 volumes": air_path(6, ["speed", "p2", "p4", "p6"]),
        "air path, 8 volumes": air_path(8, ["speed", "p2", "p4", "p8"]),
    }
    print("| model | equations | MSO | MTES | what | ours [ms] | FDT [ms] | FDT / ours |")
    print("|---|---|---|---|---|---|---|---|")
    growth: list[tuple[int, float, float]] = []
    for name, structure in models.items():
        with peer(python, name, structure) as ask:
            pairs = compare(structure, ask)
        sizes = f"{len(structure.equations)} | {len(mso_sets(structure))} | {len(mtes_sets(structure))}"
        for what, times in pairs.items():
            ratio = [theirs / ours for ours, theirs in times]
            columns = [spread([ours * 1e3 for ours, _ in times]), spread([theirs * 1e3 for _, theirs in times])]
            print(f"| {name} | {sizes} | {what} | {' | '.join([*columns, spread(ratio)])} |", flush=True)
        if name.startswith("chain"):
            ours, theirs = (statistics.median(side) for side in zip(*pairs["MSO sets"], strict=True))
            growth.append((len(structure.equations), *(t / len(mso_sets(structure)) * 1e6 for t in (ours, theirs))))
    print("\n| equations of the chain | ours [us per MSO set] | FDT [us per MSO set] |\n|---|---|---|")
    for size, ours, theirs in growth:
        print(f"| {size} | {ours:.1f} | {theirs:.1f} |")


def compare(structure: Structure, ask: Ask) -> dict[str, list[tuple[float, float]]]:
    """Pairs of CPU times [s], ours and the peer's, by what is computed; the results must agree."""
    number = {name: row for row, name in enumerate(structure.equations)}
    msos = mso_sets(structure)
    some = range(0, len(msos), math.ceil(len(msos) / SWEPT))

    def numbers(sets: list[tuple[str, ...]]) -> list[list[int]]:
        return [[number[name] for name in chosen] for chosen in sets]

    def isolability(of: Interpretation) -> list[list[int]]:
        found = isolability_of(structure, of)
        return [[int(f == other or other in found[f]) for other in structure.faults] for f in structure.faults]

    def causality() -> list[list[str]]:
        return [list(residual_causality(structure, msos[k]).values()) for k in some]

    tasks: dict[str, tuple[list[object], Callable[[], object]]] = {
        "MSO sets": (["mso"], lambda: numbers(mso_sets(structure))),
        "MTES sets": (["mtes"], lambda: numbers(mtes_sets(structure))),
        f"causality of all residuals of {len(some)} MSO sets": (["causality", *some], causality),
        **{
            f"isolability, {of}": (["isolability", theirs], functools.partial(isolability, of))
            for theirs, of in INTERPRETATIONS.items()
        },
    }
    pairs: dict[str, list[tuple[float, float]]] = {}
    for what, (request, call) in tasks.items():
        pairs[what] = []
        for _ in range(ROUNDS if request[0] != "causality" else 3):
            start = time.process_time()
            found = call()
            ours = time.process_time() - start
            theirs, expected = ask(*request)
            if found != expected:
                sys.exit(f"{what}: ours and FDT's differ")
            pairs[what].append((ours, theirs))
    return pairs


@contextmanager
def peer(python: str, name: str, structure: Structure) -> Iterator[Ask]:
    """FDT in a process of its own, with the model loaded."""
    worker = Path(__file__).with_name("bench_peer.py")
    with subprocess.Popen(
        [python, "-W", "ignore", worker], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        source, sink = process.stdout, process.stdin
        print(json.dumps({"name": name, **document(structure)}), file=sink, flush=True)

        def ask(*request: object) -> tuple[float, Any]:
            print(json.dumps(request), file=sink, flush=True)
            seconds, answer = json.loads(source.readline())
            return seconds, answer

        yield ask


def document(structure: Structure) -> dict[str, object]:
    """The structure as the peer's worker reads it, equations in the same order."""
    equations: list[object] = []
    for name in structure.equations:
        d = structure.differentials.get(name)
        variables = [structure.unknowns_in([name]), structure.known_in([name]), structure.faults_in([name])]
        equations.append(
            [v for part in variables for v in part] if d is None else {"state": d.state, "derivative": d.derivative}
        )
    return {
        "equations": equations,
        "unknowns": structure.unknowns,
        "faults": structure.faults,
        "known": structure.known,
    }


def spread(values: list[float]) -> str:
    """Median and range."""
    return f"{statistics.median(values):.3g} [{min(values):.3g} .. {max(values):.3g}]"


if __name__ == "__main__":
    main(*sys.argv[1:])
