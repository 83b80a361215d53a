"""Structural models to test and time the engine on: published benchmarks, and generators for models of any size.

The equations are written down from the literature; only which variable is in which equation is kept.
"""

from collections.abc import Mapping, Sequence

from faultline.analysis.model import Differential
from faultline.analysis.structure.matrix import structural_model
from faultline.analysis.structure.structure import Structure


def three_tank() -> Structure:
    """Three coupled tanks with a level, a flow and an inflow sensor: 6 MSO and 4 MTES sets.

    Source: Frisk, Krysander and Jung, A toolbox for analysis and design of model based diagnosis systems for large
    scale models (IFAC World Congress 2017).
    """
    return _model(
        {
            "e1": "q1 p1 p2 fV1",
            "e2": "q2 p2 p3 fV2",
            "e3": "q3 p3 fV3",
            "e4": "dp1 q0 q1 fT1",
            "e5": "dp2 q1 q2 fT2",
            "e6": "dp3 q2 q3 fT3",
            "e7": "y1 p1",
            "e8": "y2 q2",
            "e9": "y3 q0",
        },
        states="p1 p2 p3",
        faults="fV1 fV2 fV3 fT1 fT2 fT3",
        known="y1 y2 y3",
    )


def electric_motor() -> Structure:
    """A direct-current motor with current, speed and torque sensors: 3 MSO and 3 MTES sets.

    Source: the same authors, tutorial example of that toolbox.
    """
    return _model(
        {
            "e1": "u i di w fR",
            "e2": "Tm i",
            "e3": "dw T w",
            "e4": "T Tm Tl",
            "e7": "yi i fi",
            "e8": "yw w fw",
            "e9": "yT T fT",
        },
        states="i w",
        faults="fR fi fw fT",
        known="u yi yw yT",
    )


def induction_motor() -> Structure:
    """A three-phase motor in stator coordinates, current and speed measured: 9 MSO and 2 MTES sets.

    Source: Aslund and Frisk, An observer for non-linear differential-algebraic systems (Automatica, 2006); faults after
    Frisk et al., Diagnosability analysis considering causal interpretations for differential constraints (IEEE SMC-A,
    2012).
    """
    return _model(
        {
            "e1": "qa w la fa",
            "e2": "qb w lb fb",
            "e3": "dia ia la qb ua",
            "e4": "dib ib lb qa ub",
            "e5": "dla ia la qb",
            "e6": "dlb ib lb qa",
            "e7": "dw ia ib la lb Tl",
            "e8": "y1 ia",
            "e9": "y2 ib",
            "e10": "y3 w",
        },
        states="ia ib la lb w",
        faults="fa fb",
        known="ua ub y1 y2 y3",
    )


def tank_chain(tanks: int) -> Structure:
    """A chain of tanks, every level and the inflow measured, faults in valves, tanks and level sensors.

    3, 4 and 5 tanks have 18, 58 and 179 MSO sets, as many as MTES sets.
    """
    every = range(1, tanks + 1)
    equations = {"e0": "y0 q0"}
    for k in every:
        following = f"p{k + 1}" if k < tanks else ""
        equations |= {
            f"valve{k}": f"q{k} p{k} {following} fV{k}",
            f"tank{k}": f"dp{k} q{k - 1} q{k} fT{k}",
            f"level{k}": f"y{k} p{k} fy{k}",
        }
    return _model(
        equations,
        states=" ".join(f"p{k}" for k in every),
        faults=" ".join(f"{kind}{k}" for kind in ("fV", "fT", "fy") for k in every),
        known=" ".join(f"y{k}" for k in range(tanks + 1)),
    )


def air_path(stages: int, measured: Sequence[str]) -> Structure:
    """The air path of a turbocharged engine: volumes in a row, each behind a restriction.

    A stage is a volume with mass and temperature as states (ideal gas, energy balance) behind a restriction whose flow
    depends on the pressures, on the temperature of the air before it and, in the first, third and last, on an actuator.
    The second restriction is the compressor, the one before the last volume the turbine; both hang on one shaft.

    Args:
        stages: number of volumes, at least four.
        measured: unknowns with a sensor, besides pressure and temperature of the ambient air: the redundancy.
    """
    turbine = stages - 1
    equations: dict[str, str] = {}
    for k in range(1, stages + 1):
        before, flow = (f"p{k - 1} T{k - 1}" if k > 1 else "p0 T0"), f"w{k}"
        equations |= {
            f"restriction{k}": f"{flow} psi{k} area{k} {before}",
            f"ratio{k}": f"psi{k} p{k} {before.split()[0]}",
            f"gas{k}": f"p{k} m{k} T{k}",
            f"mass{k}": f"dm{k} w{k} w{k + 1}" + (f" leak{k}" if k in (2, 4) else ""),
            f"energy{k}": f"dT{k} m{k} T{k} w{k} w{k + 1} Tin{k}" + (f" heat{k}" if k % 2 else ""),
            f"mixing{k}": f"Tin{k} {before.split()[1]}" + (" Pc w2" if k == 2 else ""),
            f"opening{k}": f"area{k}" + (f" u{k}" if k in (1, 3, stages) else " speed" if k in (2, turbine) else ""),
        }
        if k in (2, 4):
            equations[f"hole{k}"] = f"leak{k} p{k} T{k} fleak{k}"
        if k % 2:
            equations[f"wall{k}"] = f"heat{k} T{k} w{k}"
    equations |= {
        "outlet": f"w{stages + 1} p{stages} T{stages} fclog",
        "compressor": "Pc w2 p1 p2 T1 etac",
        "efficiency_c": "etac w2 speed",
        "turbine": f"Pt w{turbine} p{turbine} p{turbine - 1} T{turbine - 1} etat",
        "efficiency_t": f"etat speed w{turbine}",
        "shaft": "dspeed Pt Pc friction",
        "bearing": "friction speed fbearing",
        "ambient_p": "y_p0 p0 fy_p0",
        "ambient_T": "y_T0 T0 fy_T0",
    }
    equations |= {f"sensor_{name}": f"y_{name} {name} fy_{name}" for name in measured}
    names = list(dict.fromkeys(name for text in equations.values() for name in text.split()))
    return _model(
        equations,
        states=" ".join([*(f"{s}{k}" for k in range(1, stages + 1) for s in "mT"), "speed"]),
        faults=" ".join(name for name in names if name.startswith("f") and name != "friction"),
        known=" ".join(name for name in names if name.startswith(("y_", "u"))),
    )


def _model(equations: Mapping[str, str], states: str, faults: str, known: str) -> Structure:
    """A structure from the names in every equation, with constraints d<state> that come after all equations."""
    return structural_model(
        {name: text.split() for name, text in equations.items()},
        [Differential(name=f"d/dt {s}".replace(" ", "_"), state=s, derivative=f"d{s}") for s in states.split()],
        faults.split(),
        known.split(),
    )
