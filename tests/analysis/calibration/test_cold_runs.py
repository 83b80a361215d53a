"""A free run far from what is expected, without another one near: it is approached in steps."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from made_drive import Errors, drawn, frames, log_sections

from faultline.analysis.calibration import problem as module
from faultline.analysis.calibration.problem import Problem, runs
from faultline.analysis.calibration.sections import Section
from faultline.analysis.model import load_model
from faultline.analysis.simulation import System, Trajectory, system_of
from faultline.service.core.errors import InputError

UDS1 = load_model("uds/production")


def made() -> Problem:
    system = system_of(UDS1, UDS1.calibrated)
    return Problem(system, log_sections(UDS1, system, frames(UDS1, drawn(UDS1, 1), 1, delay_s=0.0, errors=Errors())))


class Narrow:
    """Finds no run whose first parameter is further from that of the last one, or from the usual, than `reach`."""

    def __init__(self, usual: float, reach: float) -> None:
        self.last, self.reach = usual, reach

    def __call__(
        self,
        system: System,
        sections: Sequence[Section],
        theta: Sequence[Mapping[str, float]],
        delay: Mapping[str, float],
        near: Sequence[Trajectory] = (),
    ) -> list[Trajectory]:
        value = next(iter(theta[0].values()))
        if abs(value - self.last) > self.reach * abs(self.last):
            raise InputError("no free run is found")
        found = runs(system, sections, theta, delay, near)
        self.last = value
        return found


def test_a_run_that_is_not_found_at_once_is_approached(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = made()
    x = np.full(problem.unknowns.size, 0.5)
    wanted = problem.trajectories(x)[0].w
    usual = next(iter(problem.parameters(0.0 * x)[0].values()))
    far = next(iter(problem.parameters(x)[0].values()))
    monkeypatch.setattr(module, "runs", Narrow(usual, 0.4 * abs(far / usual - 1.0)))
    assert made().trajectories(x)[0].w == pytest.approx(wanted, rel=1e-6)
    monkeypatch.setattr(module, "runs", Narrow(usual, 0.0))
    with pytest.raises(InputError, match="no free run is found"):
        made().trajectories(x)
