"""The shipped models written by hand and solved by scipy, one step at a time: what a free run is compared with."""

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from faultline.analysis.model import Model
from faultline.analysis.simulation.system import LAMINAR

Array = npt.NDArray[np.float64]
Values = Mapping[str, float]
Rates = Callable[[Array, Array, Values], list[float]]
"""Derivatives of the states from states, inputs and parameters."""


def values_of(model: Model, changed: Values | None = None) -> dict[str, float]:
    """All parameters' values."""
    return {name: p.value for name, p in model.parameters.items()} | dict(changed or {})


def velocity(d: float, laminar: float = LAMINAR) -> float:
    """v with v (|v| + laminar) = d: the root, and a straight line through zero where |v| is far below `laminar`."""
    return float(np.sign(d) * 0.5 * (np.sqrt(laminar**2 + 4.0 * abs(d)) - laminar))


def uds(s: Array, u: Array, p: Values, laminar: float = LAMINAR) -> list[float]:
    """Thesis (4.3)-(4.16)."""
    p_tp, p_bp, p_ap, p_du = s
    n_p, dc_dose = u

    def orifice(area: float, d: float) -> float:
        return p["C_q"] * area * velocity(2.0 / p["rho"] * d, laminar)

    q_pump = p["D_p"] * (n_p - p["C_v"] * (p_ap - p_bp) / p["eta"])
    q_t, q_p = orifice(p["A_t"], p["p_tank"] - p_tp), orifice(p["A_p"], p_tp - p_bp)
    q_du = orifice(p["A_du"], p_ap - p_du)
    q_ori = orifice(p["A_ori"], p_du - p["p_tank"])
    q_dos = dc_dose * orifice(p["A_dos"], p_du - p["p_exh"])
    return [
        p["B_tp"] / p["V_tp"] * (q_t - q_p),
        p["B_bp"] / p["V_bp"] * (q_p - q_pump),
        p["B_ap"] / p["V_ap"] * (q_pump - q_du),
        p["B_du"] / p["V_du"] * (q_du - q_ori - q_dos),
    ]


def uds1_flow(p_du: float, n_p: float, p: Values) -> float:
    """(4.3), (4.4), (4.18)-(4.20): the flow at which the pump and the filters around it agree."""

    def missing(q: float) -> float:
        lost = p["rho"] / 2.0 * (q / p["C_q"]) ** 2 * (p["A_t"] ** -2 + p["A_p"] ** -2 + p["A_du"] ** -2)
        rise = p_du - p["p_tank"] + lost
        return q / p["D_p"] - n_p + p["C_v"] * rise / p["eta"]

    return float(brentq(missing, -1e-6, 1e-4, xtol=1e-22, rtol=1e-14))


def uds1(s: Array, u: Array, p: Values) -> list[float]:
    """(4.17)-(4.20)."""
    [p_du] = s
    q_ori = p["C_q"] * p["A_ori"] * velocity(2.0 / p["rho"] * (p_du - p["p_tank"]))
    q_dos = u[1] * p["C_q"] * p["A_dos"] * velocity(2.0 / p["rho"] * (p_du - p["p_exh"]))
    return [p["B_du"] / p["V_du"] * (uds1_flow(p_du, u[0], p) - q_ori - q_dos)]


def three_tank(s: Array, u: Array, p: Values) -> list[float]:
    """Torricelli."""
    h1, h2, h3 = s
    q12 = p["A_12"] * velocity(2.0 * p["g"] * (h1 - h2))
    q23 = p["A_23"] * velocity(2.0 * p["g"] * (h2 - h3))
    q3 = p["A_3"] * velocity(2.0 * p["g"] * h3)
    return [(p["k_pump"] * u[0] - q12) / p["S"], (q12 - q23) / p["S"], (q23 - q3) / p["S"]]


def solved(rates: Rates, start: Array, t: Array, u: Callable[[float], Array], p: Values, size: float) -> Array:
    """The states (K, states) at the times `t` (K,), with inputs by time; `size` of a state."""
    with np.errstate(divide="ignore"):  # where nothing moves, Radau divides by its own error
        found = solve_ivp(
            lambda now, s: rates(s, u(now), p),
            (t[0], t[-1]),
            start,
            method="Radau",
            t_eval=t,
            rtol=1e-9,
            atol=1e-9 * size,
            max_step=0.5,
        )
    assert found.success, found.message
    return np.asarray(found.y.T)


def on_lines(t: Array, u: Array) -> Callable[[float], Array]:
    """Inputs (K, inputs) at times `t`, on straight lines between them."""
    return lambda now: np.array([np.interp(now, t, column) for column in u.T])
