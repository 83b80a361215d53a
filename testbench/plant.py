"""The hydraulics: four control volumes in a row, solved implicitly at a fixed step.

    tank -[tank filter]- p_tp -[pump filter]- p_bp -(pump)- p_ap -[dosing unit filter]- p_du -[return orifice]- tank
                                                                                           +--[dosing valve]--- exhaust

    C dp/dt = sum of flows in,     restrictions: dp = R q + K q |q|  (see `restriction`)

Whatever else hangs on the hose after the pump (a leak, a relief valve, rubber that creeps) is a *branch*: it takes the
flow a + b p_ap (`branches`).

State: the four absolute pressures [Pa]. Inputs of a step: pump speed [rev/s] and the part of the step that the dosing
valve is open [0..1]. Backward Euler; each restriction is linearised in its *flow*, where it is smooth, instead of in
its pressure, where it has a root:

    q+ = g (dp+ + K q |q|),    g = 1 / (R + 2 K |q|)

and the pressures follow from two linear equations on either side of the pump, repeated until the flows stand still. The
flows of a step satisfy the balance of every volume exactly, converged or not. (Nagel 1975, SPICE2: companion models.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.testbench.branches import Branch
from faultline.testbench.hose import Hose
from faultline.testbench.pump import PumpParameters
from faultline.testbench.restriction import Restriction
from faultline.testbench.units import ATMOSPHERE, BAR

Array = npt.NDArray[np.float64]

SYSTEM_PRESSURE = 10 * BAR  # Pa absolute, at which return orifice and dosing valve are rated

SLIGHT_FLOW = 0.05e-6  # m^3/s: a spring-loaded valve opens between no flow and this
FLOW_TOLERANCE = 1e-12  # m^3/s, a millionth of a millilitre a second
MAXIMUM_SWEEPS = (
    50  # a restriction's flow is monotone and convex in its drop: 2 or 3 sweeps, about 10 after an abrupt fault
)


@dataclass(frozen=True, kw_only=True)
class PlantParameters:
    """Restrictions of the circuit, compliances [m^3/Pa] of its volumes, and the hose after the pump."""

    tank_filter: Restriction
    pump_filter: Restriction
    du_filter: Restriction
    return_orifice: Restriction
    dosing_valve: Restriction
    compliance_tp: float
    compliance_bp: float
    hose: Hose
    compliance_du: float


class Plant:
    """The circuit's state; starts at rest at atmospheric pressure. Flows [m^3/s] are those of the last step.

    What may be replaced at any time takes effect at the next step: the five restrictions (`tank_filter` ...), `hose`,
    `pump_loss`, `air_hole` (where air is drawn in between the filters, None where it is tight), and what surrounds the
    circuit: `viscosity` and `density` (factors of all laminar and turbulent parts), `p_tank`, `p_return` and `p_nozzle`
    (absolute pressure [Pa] at the suction pipe's foot, behind the return orifice and behind the dosing valve),
    `inlet_spring` [Pa] (what it takes to open the dosing unit's inlet valve).
    """

    def __init__(self, parameters: PlantParameters, pump: PumpParameters, branches: Sequence[Branch] = ()) -> None:
        self.tank_filter = parameters.tank_filter
        self.pump_filter = parameters.pump_filter
        self.du_filter = parameters.du_filter
        self.return_orifice = parameters.return_orifice
        self.dosing_valve = parameters.dosing_valve
        self.pump_loss = 0.0  # fraction of the displaced flow that is lost
        self.hose = parameters.hose
        self.air_hole: Restriction | None = None
        self.viscosity = self.density = 1.0
        self.p_tank = self.p_return = self.p_nozzle = ATMOSPHERE
        self.inlet_spring = 0.0
        self.branches = list(branches)
        self.p_tp = self.p_bp = self.p_ap = self.p_du = ATMOSPHERE
        self.q_tank = self.q_pump_filter = self.q_pump = self.q_du = self.q_return = self.q_dose = 0.0
        self.q_branches = 0.0
        self._q_open = 0.0  # what the dosing valve would pass if it were open
        self._parameters = parameters
        self._pump = pump

    def step(self, h: float, speed: float, opening: float) -> None:
        """Advances by `h` [s] at pump speed `speed` [rev/s], the dosing valve open for the part `opening` of it."""
        self._suction(h, self._pump.displaced(speed) * (1.0 - self.pump_loss))
        self._pressure(h, opening)

    def _suction(self, h: float, displaced: float) -> None:
        """p_tp and p_bp, drawn by a pump that would displace `displaced` [m^3/s] if its chambers filled."""
        pump = self._pump
        # Taken at the step's start, which uncouples the two sides: h / C times its slope is below 0.04.
        back = pump.back(self.p_bp, self.p_ap, self.viscosity)
        c_tp, c_bp = self._parameters.compliance_tp / h, self._parameters.compliance_bp / h
        Rt, Rp = self.viscosity * self.tank_filter.R, self.viscosity * self.pump_filter.R
        Kt, Kp, p_tank = self.density * self.tank_filter.K, self.density * self.pump_filter.K, self.p_tank
        qt, qp, y = self.q_tank, self.q_pump_filter, self.p_bp
        air = self._air()
        held_tp, held_bp = c_tp * self.p_tp + air, c_bp * self.p_bp
        for _ in range(MAXIMUM_SWEEPS):
            drawn, slope = pump.drawn(displaced, y)
            drawn -= back
            kt, kp = Kt * abs(qt), Kp * abs(qp)
            gt, gp = 1.0 / (Rt + 2.0 * kt), 1.0 / (Rp + 2.0 * kp)
            et, ep = kt * qt, kp * qp
            a, b = c_tp + gt + gp, c_bp + gp + slope
            u, v = held_tp + gt * (p_tank + et) - gp * ep, held_bp + gp * ep - drawn
            determinant = a * b - gp * gp
            x, y = (u * b + gp * v) / determinant, (a * v + gp * u) / determinant
            last_t, last_p = qt, qp
            qt, qp = gt * (p_tank - x + et), gp * (x - y + ep)
            if abs(qt - last_t) + abs(qp - last_p) < FLOW_TOLERANCE:
                break
        else:
            raise ArithmeticError(f"suction side does not converge at p_bp = {y:.0f} Pa")
        self.p_tp, self.p_bp, self.q_tank, self.q_pump_filter = x, y, qt, qp
        pressed = 1.0 - ATMOSPHERE / max(self.p_ap, ATMOSPHERE)  # the part of the air's volume that the pump takes away
        self.q_pump = drawn + slope * y - air * pressed

    def _air(self) -> float:
        """What is drawn in through the hole between the filters [m^3/s], by the suction at the step's start."""
        suction = ATMOSPHERE - self.p_tp
        if self.air_hole is None or suction <= 0.0:
            return 0.0
        R, K = self.air_hole.R, self.air_hole.K
        return float(((R * R + 4.0 * K * suction) ** 0.5 - R) / (2.0 * K))

    def _pressure(self, h: float, opening: float) -> None:
        """p_ap and p_du, fed by `q_pump`."""
        c_ap, c_du = self.hose.compliance(self.p_ap) / h, self._parameters.compliance_du / h
        viscosity, spring = self.viscosity, self.inlet_spring
        p_return, p_nozzle = self.p_return, self.p_nozzle
        density, laminar = self.density, viscosity * self.du_filter.R
        Kd = density * self.du_filter.K
        Ro, Ko = viscosity * self.return_orifice.R, density * self.return_orifice.K
        Rv, Kv = viscosity * self.dosing_valve.R, density * self.dosing_valve.K
        qd, qo, qv = self.q_du, self.q_return, self._q_open
        taken = [(branch, *branch.linear(h, self.p_ap)) for branch in self.branches]
        q_branches, g_branches = 0.0, 0.0
        for _, q, g in taken:
            q_branches, g_branches = q_branches + q, g_branches + g
        fed, held = c_ap * self.p_ap + self.q_pump - q_branches, c_du * self.p_du
        for _ in range(MAXIMUM_SWEEPS):
            Rd = laminar + spring / (abs(qd) + SLIGHT_FLOW) if spring else laminar
            kd, ko, kv = Kd * abs(qd), Ko * abs(qo), Kv * abs(qv)
            gd, go, gv = 1.0 / (Rd + 2.0 * kd), 1.0 / (Ro + 2.0 * ko), 1.0 / (Rv + 2.0 * kv)
            ed, eo, ev = kd * qd, ko * qo, kv * qv
            a, b = c_ap + gd + g_branches, c_du + gd + go + opening * gv
            u = fed - gd * ed
            v = held + gd * ed + go * (p_return - eo) + opening * gv * (p_nozzle - ev)
            determinant = a * b - gd * gd
            x, y = (u * b + gd * v) / determinant, (a * v + gd * u) / determinant
            last_d, last_o, last_v = qd, qo, qv
            qd, qo, qv = gd * (x - y + ed), go * (y - p_return + eo), gv * (y - p_nozzle + ev)
            if abs(qd - last_d) + abs(qo - last_o) + abs(qv - last_v) < FLOW_TOLERANCE:
                break
        else:
            raise ArithmeticError(f"pressure side does not converge at p_du = {y:.0f} Pa")
        self.p_ap, self.p_du, self.q_du, self.q_return, self._q_open = x, y, qd, qo, qv
        self.q_dose = opening * qv
        self.q_branches = q_branches + g_branches * x
        for branch, q, g in taken:
            branch.took(h, q + g * x)
