"""The hydraulics: four control volumes in a row, solved implicitly at a fixed step.

    tank -[tank filter]- p_tp -[pump filter]- p_bp -(pump)- p_ap -[dosing unit filter]- p_du -[return orifice]- tank
                                                                                           +--[dosing valve]--- exhaust

    C dp/dt = sum of flows in,     restrictions: dp = R q + K q |q|  (see `restriction`)

State: the four absolute pressures [Pa]. Inputs of a step: pump speed [rev/s] and the part of the step that the dosing
valve is open [0..1]. Backward Euler; each restriction is linearised in its *flow*, where it is smooth, instead of in
its pressure, where it has a root:

    q+ = g (dp+ + K q |q|),    g = 1 / (R + 2 K |q|)

and the pressures follow from two linear equations on either side of the pump, repeated until the flows stand still. The
flows of a step satisfy the balance of every volume exactly, converged or not. (Nagel 1975, SPICE2: companion models.)
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from testbench.pump import PumpParameters
from testbench.restriction import Restriction

Array = npt.NDArray[np.float64]

ATMOSPHERE = 101_325.0  # Pa, ISO 2533; tank and exhaust are vented to it
BAR = 1e5  # Pa
ML = 1e-6  # m^3
SYSTEM_PRESSURE = 10 * BAR  # Pa absolute, at which return orifice and dosing valve are rated

FLOW_TOLERANCE = 1e-12  # m^3/s, a millionth of a millilitre a second
MAXIMUM_SWEEPS = (
    50  # a restriction's flow is monotone and convex in its drop: 2 or 3 sweeps, about 10 after an abrupt fault
)


@dataclass(frozen=True, kw_only=True)
class PlantParameters:
    """Restrictions of the circuit and compliances [m^3/Pa] of its volumes."""

    tank_filter: Restriction
    pump_filter: Restriction
    du_filter: Restriction
    return_orifice: Restriction
    dosing_valve: Restriction
    compliance_tp: float
    compliance_bp: float
    compliance_ap: float
    compliance_du: float


class Plant:
    """The circuit's state; starts at rest at atmospheric pressure. Flows [m^3/s] are those of the last step.

    Replacing one of the five restrictions (`tank_filter` ...) or `pump_loss` takes effect at the next step.
    """

    def __init__(self, parameters: PlantParameters, pump: PumpParameters) -> None:
        self.tank_filter = parameters.tank_filter
        self.pump_filter = parameters.pump_filter
        self.du_filter = parameters.du_filter
        self.return_orifice = parameters.return_orifice
        self.dosing_valve = parameters.dosing_valve
        self.pump_loss = 0.0  # fraction of the displaced flow that is lost
        self.p_tp = self.p_bp = self.p_ap = self.p_du = ATMOSPHERE
        self.q_tank = self.q_pump_filter = self.q_pump = self.q_du = self.q_return = self.q_dose = 0.0
        self._q_open = 0.0  # what the dosing valve would pass if it were open
        self._parameters = parameters
        self._pump = pump

    def step(self, h: float, speed: float, opening: float) -> None:
        """Advances by `h` [s] at pump speed `speed` [rev/s], the dosing valve open for the part `opening` of it."""
        self._suction(h, self._pump.displacement * speed * (1.0 - self.pump_loss))
        self._pressure(h, opening)

    def _suction(self, h: float, displaced: float) -> None:
        """p_tp and p_bp, drawn by a pump that would displace `displaced` [m^3/s] if its chambers filled."""
        pump = self._pump
        # The leak is evaluated at the step's start: h * leakage / C is below 0.01, and it uncouples the two sides.
        leak = pump.leakage * (self.p_ap - self.p_bp)
        c_tp, c_bp = self._parameters.compliance_tp / h, self._parameters.compliance_bp / h
        Rt, Kt, Rp, Kp = self.tank_filter.R, self.tank_filter.K, self.pump_filter.R, self.pump_filter.K
        p_tp, p_bp, qt, qp = self.p_tp, self.p_bp, self.q_tank, self.q_pump_filter
        x, y = p_tp, p_bp
        for _ in range(MAXIMUM_SWEEPS):
            drawn, slope = pump.drawn(displaced, y)
            drawn -= leak
            gt, gp = 1.0 / (Rt + 2.0 * Kt * abs(qt)), 1.0 / (Rp + 2.0 * Kp * abs(qp))
            et, ep = Kt * qt * abs(qt), Kp * qp * abs(qp)
            a, b = c_tp + gt + gp, c_bp + gp + slope
            u, v = c_tp * p_tp + gt * (ATMOSPHERE + et) - gp * ep, c_bp * p_bp + gp * ep - drawn
            determinant = a * b - gp * gp
            x, y = (u * b + gp * v) / determinant, (a * v + gp * u) / determinant
            last_t, last_p = qt, qp
            qt, qp = gt * (ATMOSPHERE - x + et), gp * (x - y + ep)
            if abs(qt - last_t) + abs(qp - last_p) < FLOW_TOLERANCE:
                break
        else:
            raise ArithmeticError(f"suction side does not converge at p_bp = {y:.0f} Pa")
        self.p_tp, self.p_bp, self.q_tank, self.q_pump_filter, self.q_pump = x, y, qt, qp, drawn + slope * y

    def _pressure(self, h: float, opening: float) -> None:
        """p_ap and p_du, fed by `q_pump`."""
        c_ap, c_du = self._parameters.compliance_ap / h, self._parameters.compliance_du / h
        Rd, Kd, Ro, Ko = self.du_filter.R, self.du_filter.K, self.return_orifice.R, self.return_orifice.K
        Rv, Kv = self.dosing_valve.R, self.dosing_valve.K
        qd, qo, qv = self.q_du, self.q_return, self._q_open
        fed, held = c_ap * self.p_ap + self.q_pump, c_du * self.p_du
        for _ in range(MAXIMUM_SWEEPS):
            gd, go, gv = (
                1.0 / (Rd + 2.0 * Kd * abs(qd)),
                1.0 / (Ro + 2.0 * Ko * abs(qo)),
                1.0 / (Rv + 2.0 * Kv * abs(qv)),
            )
            ed, eo, ev = Kd * qd * abs(qd), Ko * qo * abs(qo), Kv * qv * abs(qv)
            a, b = c_ap + gd, c_du + gd + go + opening * gv
            u = fed - gd * ed
            v = held + gd * ed + go * (ATMOSPHERE - eo) + opening * gv * (ATMOSPHERE - ev)
            determinant = a * b - gd * gd
            x, y = (u * b + gd * v) / determinant, (a * v + gd * u) / determinant
            last_d, last_o, last_v = qd, qo, qv
            qd, qo, qv = gd * (x - y + ed), go * (y - ATMOSPHERE + eo), gv * (y - ATMOSPHERE + ev)
            if abs(qd - last_d) + abs(qo - last_o) + abs(qv - last_v) < FLOW_TOLERANCE:
                break
        else:
            raise ArithmeticError(f"pressure side does not converge at p_du = {y:.0f} Pa")
        self.p_ap, self.p_du, self.q_du, self.q_return, self._q_open = x, y, qd, qo, qv
        self.q_dose = opening * qv
