"""The hydraulics of a family's plant, with a choice of integrators.

    C_tp p_tp' = q_t - q_p                 q_x = k_x s(dp),  s(d) = d / sqrt(|d| + 1 Pa)
    C_bp p_bp' = q_p - q_pump              q_pump = D n - L (p_ap - p_bp) - slip
    C_ap p_ap' = q_pump - q_f - leak - relief
    C_du p_du' = q_f - q_o - opening q_v

The pressures (p_tp, p_bp, p_ap, p_du) are absolute [Pa], flows in m^3/s; `opening` is the part of the time that the
dosing valve is open. The fast volumes settle within milliseconds, so that explicit integrators cannot have them:
`implicit_euler`, `runge_kutta` (R. Alexander, SIAM Journal on Numerical Analysis, 1977) and `tr_bdf2` (Bank and others,
IEEE Transactions on Electron Devices, 1985) solve by Newton's method; `reduced` takes them for settled and integrates
p_ap alone by the classical method of Runge and Kutta. Linearly implicit methods were tried: a root's steep slope at
nought sends them to a wrong steady state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

from faultline.testbench.units import ATMOSPHERE, BAR

State = tuple[float, float, float, float]
"""p_tp, p_bp, p_ap and p_du [Pa]."""

HIDDEN = {
    "full_open": "the part that the dosing valve passes more when it is held open",
    "air": "m^3 of free air in the hose",
    "stiffening": "of the hose, in parts per 10 bar",
    "slip": "m^3/s that the pump loses at 10 bar, with the square of the pressure",
    "leak": "m^3/s through a hole in the hose at 10 bar",
    "relief": "m^3/s/Pa that a relief valve passes from 9.7 bar on",
    "deposit": "the part of the nozzle's area that is lost with each decilitre dosed",
    "dead": "the part of a period that the dosing valve takes to open",
}
"""Effects that the diagnosis model lacks, with what their size means."""

SETTLED = 1e-4  # Pa, of a Newton step
SWEEPS = 40
GAMMA = 1.0 - 1.0 / sqrt(2.0)
RATED = 10 * BAR


@dataclass(frozen=True, kw_only=True)
class Circuit:
    """Flow coefficients `k_` [m^3/s/sqrt(Pa)], compliances `c_` [m^3/Pa], the pump's displacement and leakage.

    The rest is `HIDDEN`, by default absent.
    """

    displacement: float
    leakage: float
    k_t: float
    k_p: float
    k_f: float
    k_o: float
    k_v: float
    c_tp: float
    c_bp: float
    c_ap: float
    c_du: float
    ambient: float = ATMOSPHERE
    full_open: float = 0.0
    air: float = 0.0
    stiffening: float = 0.0
    slip: float = 0.0
    leak: float = 0.0
    relief: float = 0.0
    deposit: float = 0.0
    dead: float = 0.0

    @property
    def rest(self) -> State:
        """The pressures at standstill."""
        return self.ambient, self.ambient, self.ambient, self.ambient

    def compliance(self, p: float) -> float:
        """Of the hose at the pressure `p` [Pa]."""
        return self.c_ap / (1.0 + self.stiffening * (p - RATED) / RATED) + self.air * ATMOSPHERE / (p * p)

    def lost(self, p: float) -> float:
        """What leaves the hose besides [m^3/s]."""
        rise = p - self.ambient
        return self.leak * root(rise) / sqrt(RATED - ATMOSPHERE) + self.relief * max(p - 9.7 * BAR, 0.0)

    def delivered(self, speed: float, p_bp: float, p_ap: float) -> float:
        """The pump's flow."""
        rise = p_ap - p_bp
        return self.displacement * speed - self.leakage * rise - self.slip * (rise / RATED) ** 2


def root(d: float) -> float:
    """The root of a pressure drop with its sign, smooth at nought."""
    return d / sqrt(abs(d) + 1.0)


Integrator = Callable[[Circuit, State, float, float, float], State]
"""From circuit, pressures, step [s], speed [rev/s] and opening to the pressures after it."""


def implicit_euler(circuit: Circuit, x: State, h: float, speed: float, opening: float) -> State:
    """Backward Euler; raises ArithmeticError where Newton's method does not converge."""
    return _solved(circuit, x, x, h, speed, opening)


def runge_kutta(circuit: Circuit, x: State, h: float, speed: float, opening: float) -> State:
    """Alexander's diagonally implicit method of two stages; raises ArithmeticError as `implicit_euler`."""
    first = _solved(circuit, x, x, GAMMA * h, speed, opening)
    on = (1.0 - GAMMA) / GAMMA
    p_tp, p_bp, p_ap, p_du = (a + on * (b - a) for a, b in zip(x, first, strict=True))
    return _solved(circuit, (p_tp, p_bp, p_ap, p_du), first, GAMMA * h, speed, opening)


def tr_bdf2(circuit: Circuit, x: State, h: float, speed: float, opening: float) -> State:
    """A trapezoidal step to a part of `h`, then a backward difference; raises ArithmeticError as `implicit_euler`.

    Where a flow has just turned round, so that the root's kink keeps Newton's method from the solution, it is that one.
    """
    part = 2.0 - sqrt(2.0)
    half = 0.5 * part * h
    slopes = _rates(circuit, x, speed, opening)
    p_tp, p_bp, p_ap, p_du = (a + half * slope for a, slope in zip(x, slopes, strict=True))
    new, old = 1.0 / (part * (2.0 - part)), (1.0 - part) ** 2 / (part * (2.0 - part))
    try:
        y = _solved(circuit, (p_tp, p_bp, p_ap, p_du), x, half, speed, opening)
        p_tp, p_bp, p_ap, p_du = (new * b - old * a for a, b in zip(x, y, strict=True))
        return _solved(circuit, (p_tp, p_bp, p_ap, p_du), y, (1.0 - part) / (2.0 - part) * h, speed, opening)
    except ArithmeticError:
        return implicit_euler(circuit, x, h, speed, opening)


def _rates(c: Circuit, x: State, speed: float, opening: float) -> State:
    """Of the pressures [Pa/s]."""
    p_tp, p_bp, p_ap, p_du = x
    q_t, q_p, q_f = c.k_t * root(c.ambient - p_tp), c.k_p * root(p_tp - p_bp), c.k_f * root(p_ap - p_du)
    q_pump, q_o = c.delivered(speed, p_bp, p_ap), (c.k_o + opening * c.k_v) * root(p_du - c.ambient)
    return (
        (q_t - q_p) / c.c_tp,
        (q_p - q_pump) / c.c_bp,
        (q_pump - q_f - c.lost(p_ap)) / c.compliance(p_ap),
        (q_f - q_o) / c.c_du,
    )


def _solved(circuit: Circuit, base: State, guess: State, h: float, speed: float, opening: float) -> State:
    """The pressures that are `base` and `h` times their own rates, by Newton's method on either side of the pump."""
    c, (p_tp, p_bp, p_ap, p_du) = circuit, guess
    h_tp, h_bp, h_du, out = h / c.c_tp, h / c.c_bp, h / c.c_du, c.k_o + opening * c.k_v
    for _ in range(SWEEPS):
        q_t, g_t = _flow(c.k_t, c.ambient - p_tp)
        q_p, g_p = _flow(c.k_p, p_tp - p_bp)
        d_tp, d_bp = _step(
            (1.0 + h_tp * (g_t + g_p), -h_tp * g_p, -h_bp * g_p, 1.0 + h_bp * (g_p + c.leakage)),
            base[0] - p_tp + h_tp * (q_t - q_p),
            base[1] - p_bp + h_bp * (q_p - c.delivered(speed, p_bp, p_ap)),
        )
        p_tp, p_bp = p_tp + d_tp, p_bp + d_bp
        q_f, g_f = _flow(c.k_f, p_ap - p_du)
        q_o, g_o = _flow(out, p_du - c.ambient)
        h_ap = h / c.compliance(p_ap)
        d_ap, d_du = _step(
            (1.0 + h_ap * (g_f + c.leakage), -h_ap * g_f, -h_du * g_f, 1.0 + h_du * (g_f + g_o)),
            base[2] - p_ap + h_ap * (c.delivered(speed, p_bp, p_ap) - q_f - c.lost(p_ap)),
            base[3] - p_du + h_du * (q_f - q_o),
        )
        p_ap, p_du = p_ap + d_ap, p_du + d_du
        if max(abs(d_tp), abs(d_bp), abs(d_ap), abs(d_du)) < SETTLED:
            return p_tp, p_bp, p_ap, p_du
    raise ArithmeticError(f"no step of {h:g} s from {base} Pa")


def _flow(k: float, drop: float) -> tuple[float, float]:
    """The flow through an orifice, and its derivative to the pressure drop."""
    size = abs(drop) + 1.0
    part = k / sqrt(size)
    return part * drop, part * (0.5 * abs(drop) + 1.0) / size


def _step(matrix: tuple[float, float, float, float], u: float, v: float) -> tuple[float, float]:
    """The solution of two linear equations."""
    a, b, c, d = matrix
    determinant = a * d - b * c
    return (d * u - b * v) / determinant, (a * v - c * u) / determinant


def reduced(circuit: Circuit, x: State, h: float, speed: float, opening: float) -> State:
    """Runge and Kutta's method for p_ap; all else follows at once from what flows."""
    c = circuit
    out = (c.k_o + opening * c.k_v) ** 2
    share = c.k_f**2 / (c.k_f**2 + out)

    def rise(p: float) -> float:
        q_f = c.k_f * root((1.0 - share) * (p - c.ambient))
        return (c.delivered(speed, c.ambient, p) - q_f - c.lost(p)) / c.compliance(p)

    p = x[2]
    k1 = rise(p)
    k2 = rise(p + 0.5 * h * k1)
    k3 = rise(p + 0.5 * h * k2)
    k4 = rise(p + h * k3)
    p += h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
    q = c.delivered(speed, c.ambient, p)
    p_tp = c.ambient - q * abs(q) / c.k_t**2
    return p_tp, p_tp - q * abs(q) / c.k_p**2, p, c.ambient + share * (p - c.ambient)
