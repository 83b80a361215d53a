"""Sigma follows the operating point, and its band holds what it says on data that nobody has seen."""

import numpy as np
import torch
from made_samples import circuit, rc

from faultline.analysis.model import load_model
from faultline.training.free_run import Course
from faultline.training.layout import layout_of
from faultline.training.reckoned import Equations, reckoned
from faultline.training.scaling import scaling_of
from faultline.training.variance import Variances, variance_columns, variances
from faultline.training.windows import Windows

MEMBERS = 3


def made(seed: int, folds: int, ticks: int = 6000) -> tuple[Windows, Course, torch.Tensor]:
    """A perfect model with noise that grows with the voltage, up to tenfold; and the true deviation."""
    layout, samples = rc(), circuit(seed, ticks)
    examples = reckoned(layout, samples, Equations(layout))
    windows = Windows(layout, examples, [], scaling_of(examples, "spread"), folds, 0)
    truth = 0.1 * torch.exp(0.7 * windows.z[:, 0])
    noise = truth * torch.tensor(np.random.default_rng(seed).normal(size=ticks), dtype=torch.float32)
    y = (windows.z[:, 1] - noise)[None, None].repeat(MEMBERS, 1, 1)
    x = windows.known.T[None].repeat(MEMBERS, 1, 1)
    return windows, Course(torch.arange(ticks), y, x, x), truth


def sigma(of: Variances, windows: Windows, course: Course) -> torch.Tensor:
    parts = [course.x.mean(dim=0), course.before.mean(dim=0), windows.u.T]
    with torch.no_grad():
        log_v: torch.Tensor = of.stack(torch.cat(parts)[None])[0, 0]
        return of.factor * (0.5 * log_v).exp()


def test_sigma_is_that_of_the_operating_point() -> None:
    windows, course, _ = made(1, MEMBERS)
    found = variances(rc(), windows, course, 0)
    other, again, true = made(2, MEMBERS)
    told = sigma(found, other, again)
    for chosen in (true < 0.08, true > 0.2):
        assert 0.85 < float((told / true)[chosen].median()) < 1.15
    left = again.y[0, 0] - other.z[:, 1]
    covered = float((left.abs() < 2.576 * told).to(torch.float32).mean())
    assert 0.98 < covered < 0.995


def test_the_predicted_signal_takes_no_part() -> None:
    """The wound: beside the state that predicts it, it told the residual, and sigma grew with a fault."""
    layout = layout_of(load_model("uds"))
    size = len(layout.states)
    for t, row in enumerate(variance_columns(layout)):
        signals = {int(c) - 2 * size for c in row if c >= 2 * size}
        assert layout.predicts[t] not in signals
        assert layout.predicts[t] + len(layout.signals) not in signals
        assert {*layout.driven(t)} < signals
