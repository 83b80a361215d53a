"""Shapes that follow what was: a rate, what follows late, time, something that settles, an integral."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.propose.shape import Shape, nice, scale

Array = npt.NDArray[np.float64]

LATE = (0.03, 0.1, 0.3, 1.0)
"""Settling times: how late something follows, tried; it is fitted then."""

SOFT = 0.03
"""Part of a rate's largest size that counts as zero where its sign changes."""


def late(operation: Operation, value: Array, tau_s: float) -> Array:
    """Return what follows a course (K,) late, as a lag of first order, each section from its first value on."""
    found = []
    for section, part in zip(operation.runs.sections, operation.split(value), strict=True):
        a = section.drive.step_s / (tau_s + section.drive.step_s)
        found.append(lfilter([a], [1.0, a - 1.0], part, zi=[(1.0 - a) * part[0]])[0])
    return np.concatenate(found)


def rates(operation: Operation, state: str, derivative: str) -> Iterator[Shape]:
    """The rate of a state, its direction, and the rate of what follows the state late."""
    d, unit = operation.values[derivative], operation.unit(derivative)
    fastest = float(np.quantile(np.abs(d), 0.99))
    if fastest <= 0.0:
        return
    r_0, w = nice(fastest), nice(SOFT * fastest)
    tables = {"r_0": scale(unit, r_0, f"scale of the rate of {state}")}
    words = f"with the rate of {state}"
    yield Shape("rate", words, f"{derivative}/r_0", d / r_0, f"rate {state}", bare=True, parameters=tables)
    soft = {"w": scale(unit, w, f"rate of {state} over which the sign changes")}
    formula, value = f"{derivative}/({derivative}**2 + w**2)**(1/2)", d / np.hypot(d, w)
    words = f"as {state} rises, and the other way as it falls"
    yield Shape("direction", words, formula, value, f"direction {state}", bare=True, parameters=soft)
    initial = list(operation.model.unknown[state].initial_text)
    for share in LATE:
        tau, s = nice(share * operation.model.settling_s, 2), operation.values[state]
        value = (s - late(operation, s, tau)) / tau / r_0
        yield Shape(
            form="late",
            words=f"with what follows {state} late, by its rate",
            formula="dz/r_0",
            value=value,
            family=f"late {state}",
            bare=True,
            parameters={**tables, "tau": {"unit": "s", "description": "how late", "value": tau, "prior": 0.7}},
            unknowns={
                "z": {"unit": operation.unit(state), "description": f"follows {state} late", "initial": initial},
                "dz": {"unit": unit},
            },
            equations=({"name": "late", "description": "lag of first order", "expr": f"tau*dz - ({state} - z)"},),
            differentials=({"name": "d", "state": "z", "derivative": "dz"},),
        )


def times(operation: Operation) -> Iterator[Shape]:
    """Time since the recording began, and something that settles."""
    span = float(np.ptp(operation.time))
    t_0, tau = nice(span), nice(span / 2.0)
    since = operation.time - operation.time.min()
    yield Shape(
        form="time",
        words="growing with time",
        formula="t/t_0",
        value=since / t_0,
        family="time",
        parameters={"t_0": scale("s", t_0, "scale of time")},
        unknowns={
            "t": {"unit": "s", "description": "time since the recording began", "initial": ["0"]},
            "dt": {"unit": "1"},
        },
        equations=({"name": "time", "description": "time", "expr": "dt - 1"},),
        differentials=({"name": "d", "state": "t", "derivative": "dt"},),
    )
    yield Shape(
        form="settling",
        words="growing with time until it settles",
        formula="x",
        value=1.0 - np.exp(-since / tau),
        family="settling",
        parameters={"tau": {"unit": "s", "description": "how long it takes to settle", "value": tau, "prior": 0.7}},
        unknowns={
            "x": {"unit": "1", "description": "part that has settled", "initial": ["0"]},
            "dx": {"unit": "1/s"},
        },
        equations=({"name": "settles", "description": "lag of first order", "expr": "tau*dx - (1 - x)"},),
        differentials=({"name": "d", "state": "x", "derivative": "dx"},),
    )


def sums(operation: Operation, name: str, *, foreign: bool) -> Iterator[Shape]:
    """What grows with the integral of a flow or an input: states are levels, and their integrals mean nothing."""
    if name in {d.state for d in operation.model.differentials}:
        return
    total, unit = operation.total(name), operation.unit(name)
    most = float(np.abs(total).max())
    if most <= 0.0:
        return
    V_0, of = nice(most), summed(unit)
    yield Shape(
        form="integral",
        words=f"growing with the integral of {name}",
        formula="V/V_0",
        value=total / V_0,
        family=f"integral {name}",
        foreign=foreign,
        parameters={"V_0": scale(of, V_0, f"scale of the integral of {name}")},
        unknowns={
            "V": {"unit": of, "description": f"integral of {name} since the recording began", "initial": ["0"]},
            "dV": {"unit": unit},
        },
        equations=({"name": "sum", "description": f"integral of {name}", "expr": f"dV - {name}"},),
        differentials=({"name": "d", "state": "V", "derivative": "dV"},),
    )


def summed(unit: str) -> str:
    """Return the unit of a signal's integral over time.

    >>> summed("m3/s"), summed("1"), summed("1/s"), summed("kg/(m s2)")
    ('m3', 's', '1', 's kg/(m s2)')
    """
    if unit == "1":
        return "s"
    return unit.removesuffix("/s") if unit.endswith("/s") else f"s {unit}"
