"""How well a calibration knows its unknowns: the curvature, and at least what a jackknife of blocks shows.

Noise may be worse than thought, and where few blocks of a recording say most of a parameter, as its steps do of a hose,
the scatter between the others says nothing of it. What the fit would be without each block in turn does (the estimator
CR3 of Bell and McCaffrey, Survey Methodology 28, 2002).
"""

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.likelihood import Likelihood, bins_of
from faultline.analysis.calibration.problem import Problem

Array = npt.NDArray[np.float64]

BLOCK = 1.0
"""Settling times. Longer than anything here remembers."""

SHORT_BLOCKS = 10
"""Recordings shorter than two blocks are cut into so many: one block has no scatter."""


def uncertainty(problem: Problem, x: Array, levels: Array) -> tuple[Array, Array]:
    """The data's information (n, n) at a fit `x`, and the covariance (n, n) of that with the priors."""
    blocks: list[tuple[Array, Array]] = []  # each one's information and score
    whole = sum(float(section.t[-1]) for section in problem.sections)
    likelihood = Likelihood(problem, x, levels, [bins_of(section) for section in problem.sections])
    parts = zip(problem.sections, likelihood.weights, problem.slopes(x), problem.left(x), strict=True)
    for section, weight, J, e in parts:
        J, e = weight(J), weight(e)
        length = BLOCK * section.time.settling_s
        if whole < 2 * length:
            length = whole / SHORT_BLOCKS
        block = (weight.bins.t / length).astype(int)
        blocks += [(J[k].T @ J[k], J[k].T @ e[k]) for k in (block == number for number in np.unique(block))]
    information = np.sum([part for part, _ in blocks], axis=0)
    curvature = information + np.eye(len(x))
    covariance = np.linalg.inv(curvature)
    moved = np.array([np.linalg.solve(curvature - part, score) for part, score in blocks])
    scattered = (moved**2).sum(axis=0) * (len(moved) - 1) / len(moved) + (covariance**2).sum(axis=0)
    inflation = np.sqrt(np.maximum(1.0, scattered / np.diag(covariance)))
    return information, covariance * np.outer(inflation, inflation)
