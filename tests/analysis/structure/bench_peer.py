"""The Fault Diagnosis Toolbox as a worker of `bench_engine.py`, in a Python of its own: one JSON line in, one out.

The first line is a model (names of variables in every equation), each further one a task; answers are CPU time [s] and
result. It runs in a process of its own because it may crash and leaks memory.
"""

import functools
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

CAUSALITIES = {"int": "integral", "der": "derivative"}


def main() -> None:
    """Answers until there is no more input."""
    import faultdiagnosistoolbox as fdt  # not where our own tests run

    given = json.loads(sys.stdin.readline())
    relations = [
        fdt.DiffConstraint(content["derivative"], content["state"]) if isinstance(content, dict) else content
        for content in given["equations"]
    ]
    names = {"x": given["unknowns"], "f": given["faults"], "z": given["known"]}
    model = fdt.DiagnosisModel({"type": "VarStruc", **names, "rels": relations}, name=given["name"])
    sets: list[Any] = []
    for line in sys.stdin:
        task, *arguments = json.loads(line)
        match task:
            case "mso":
                seconds, sets = timed(model.MSO)
                answer: Any = [sorted(map(int, chosen)) for chosen in sets]
            case "mtes":
                seconds, found = timed(model.MTES)
                answer = [sorted(map(int, chosen)) for chosen in found]
            case "isolability":
                seconds, found = timed(functools.partial(model.IsolabilityAnalysis, causality=arguments[0]))
                answer = [[int(entry) for entry in row] for row in found]
            case "causality":
                chosen = [np.sort(sets[k]) for k in arguments]
                seconds, found = timed(functools.partial(list, map(model.MSOCausalitySweep, chosen)))
                answer = [[CAUSALITIES.get(entry, entry) for entry in sweep] for sweep in found]
        print(json.dumps([seconds, answer]), flush=True)


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """CPU time [s] and result of a call."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


if __name__ == "__main__":
    main()
