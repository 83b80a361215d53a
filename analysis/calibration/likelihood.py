"""How likely the measurements are under a model that runs freely: what makes models comparable.

Samples are averaged over bins of `BIN`. What is faster than that, the valve's pulses as they alias into pump speed
and pressures, is neither noise nor physics that a model of mean flows could have: left in, a slow sensor that smoothes
it gets dozens of nats in data in which nothing is hidden. The weights are those of `analysis.calibration.noise`, the
same for every model that is compared: a bin's own level, and the errors of inputs that the run integrates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.noise import Whitening, disturbances, errors_of
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.sections import Section
from faultline.analysis.model import Model

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

BIN = 5.0
"""Periods: some of an actuator's pulses, and a fraction of what a state takes to settle."""

FEW = 10
"""With fewer pairs of neighbours than this a mode's level is that of all modes."""


@dataclass(frozen=True)
class Bins:
    """How the samples of a section, all outputs one after the other (N,), make bins (M,).

    `number` (N,) is each sample's bin and `share` (N,) its weight in the mean; of each bin: its `output` by number, its
    `mode`, the time `t` [s] of its middle, whether the bin before is its `neighbour`, and how much `larger` its
    standard deviation is than that of a full one.
    """

    number: Ints
    share: Array
    output: Ints
    mode: Ints
    t: Array
    neighbour: npt.NDArray[np.bool_]
    larger: Array

    def mean(self, values: Array) -> Array:
        """The means (M, ...) of values (N, ...)."""
        weighted = (values.T * self.share).T
        first = np.flatnonzero(np.diff(self.number, prepend=-1))
        return np.asarray(np.add.reduceat(weighted, first, axis=0))


def bins_of(section: Section) -> Bins:
    """The bins of a section: samples of one output and mode, without a gap, within `BIN`."""
    t, bin_s = np.concatenate([s.t for s in section.samples.values()]), BIN * section.time.period_s
    mode = np.concatenate([s.mode for s in section.samples.values()])
    output = np.repeat(np.arange(len(section.samples)), [len(s.t) for s in section.samples.values()])
    period = np.array([np.median(np.diff(s.t)) for s in section.samples.values()])[output]
    same = (np.diff(output, prepend=-1) == 0) & (np.diff(mode, prepend=-1) == 0)
    whole = same & (np.diff(t, prepend=0.0) < 2 * period)
    run = np.cumsum(~whole)
    begin = t[np.flatnonzero(~whole)][run - 1]
    piece = ((t - begin) / bin_s + 1e-6).astype(np.int64)
    fresh = ~whole | (np.diff(piece, prepend=-1) != 0)
    number = np.cumsum(fresh) - 1
    first = np.flatnonzero(fresh)
    count = np.bincount(number).astype(np.float64)
    middle = np.add.reduceat(t, first) / count
    return Bins(
        number=number,
        share=1.0 / count[number],
        output=output[first],
        mode=mode[first],
        t=middle,
        neighbour=whole[first],
        larger=np.sqrt(np.maximum(bin_s / period[first] / count, 1.0)),
    )


def levels_of(model: Model, outputs: Sequence[str], bins: Sequence[Bins], left: Sequence[Array]) -> Array:
    """The standard deviation (outputs, modes) of a full bin that the differences `left` (M,) of each section show.

    It shows between neighbours, as what is missing in a model is slower; it is at least what the sensor's noise leaves.
    """
    modes = model.modes.names
    changes: list[list[list[Array]]] = [[[] for _ in modes] for _ in outputs]
    for section, e in zip(bins, left, strict=True):
        change = np.diff(e, prepend=0.0) / np.hypot(section.larger, np.roll(section.larger, 1))
        for o in range(len(outputs)):
            for k in range(len(modes)):
                changes[o][k].append(change[section.neighbour & (section.output == o) & (section.mode == k)])
    found = np.zeros((len(outputs), len(modes)))
    for o, name in enumerate(outputs):
        every = np.concatenate([part for by_mode in changes[o] for part in by_mode])
        for k in range(len(modes)):
            some = np.concatenate(changes[o][k])
            found[o, k] = max(_deviation(some if len(some) >= FEW else every), LEAST_SHARE * model.known[name].noise)
    return found


LEAST_SHARE = 0.3
"""Of a sample's noise: what is left of it in the mean of ten."""


def _deviation(change: Array) -> float:
    """From (N,) changes, mostly by their median: a transient that the model misses is no noise."""
    return 1.4826 * float(np.median(np.abs(change))) if len(change) else 0.0


class Likelihood:
    """Weights for one set of sections that hold near x, where `problem` had been fitted.

    `besides` are columns of B (N, D) of each section more than the inputs' and readings' own.
    """

    def __init__(
        self, problem: Problem, x: Array, levels: Array, bins: Sequence[Bins], besides: Sequence[Array] = ()
    ) -> None:
        columns = _disturbances(problem, x)
        if besides:
            columns = [np.hstack(pair) for pair in zip(columns, besides, strict=True)]
        self._parts = [
            Weight(part, Whitening(levels[part.output, part.mode] * part.larger, part.mean(B)))
            for part, B in zip(bins, columns, strict=True)
        ]

    @property
    def weights(self) -> list["Weight"]:
        """Those of each section, from differences (N, ...) to unit independent noise (M, ...)."""
        return self._parts

    def weighed(self, values: Sequence[Array]) -> Array:
        """Differences (N, ...) of each section as unit independent noise (M, ...) of all."""
        return np.concatenate([w(part) for w, part in zip(self._parts, values, strict=True)])

    def left(self, problem: Problem, x: Array) -> Array:
        """What a model leaves of all sections, whitened, (M,)."""
        return self.weighed(problem.left(x))

    def slopes(self, problem: Problem, x: Array) -> Array:
        """The derivatives of that, (M, n)."""
        return self.weighed(problem.slopes(x))


@dataclass(frozen=True)
class Weight:
    """Averages and whitens the differences of a section."""

    bins: Bins
    whitening: Whitening

    def __call__(self, e: Array) -> Array:
        """Of (N, ...), (M, ...)."""
        return self.whitening(self.bins.mean(e))


def corrected(problem: Problem, x: Array, levels: Array, bins: Sequence[Bins]) -> list[Section]:
    """The sections with their measured inputs as the outputs make them likely, at a fit `x`.

    Derivatives at an input with errors in it are correlated with what the errors do to the outputs, which flattens what
    is fitted (errors in variables: Fuller, Measurement Error Models, 1987). At the most likely input they are not. What
    the correction does to the outputs is added to the samples, so that it costs what it did.
    """
    found = []
    for part, section, run, e in zip(bins, problem.sections, problem.trajectories(x), problem.left(x), strict=True):
        errors = errors_of(section, run, problem.commands)
        B = disturbances(section, run, problem.commands)
        level = levels[part.output, part.mode] * part.larger
        C = (part.mean(B).T / level).T
        w = np.linalg.solve(np.eye(C.shape[1]) + C.T @ C, C.T @ (part.mean(e) / level))
        inputs, place = section.drive.inputs.copy(), 0
        measured = np.zeros(len(w))
        for k, (name, error) in enumerate(errors.items()):
            its = slice(place, place + error.shape[1])
            place = its.stop
            if name not in problem.commands:
                inputs[:, k] += error @ w[its]
                measured[its] = w[its]
        shift = np.split(B @ measured, np.cumsum([len(s.t) for s in section.samples.values()])[:-1])
        samples = {
            name: replace(s, value=s.value + y) for (name, s), y in zip(section.samples.items(), shift, strict=True)
        }
        found.append(replace(section, drive=replace(section.drive, inputs=inputs), samples=samples))
    return found


def _disturbances(problem: Problem, x: Array) -> list[Array]:
    pairs = zip(problem.sections, problem.trajectories(x), strict=True)
    return [disturbances(section, trajectory, problem.commands) for section, trajectory in pairs]


def blocks(bins: Sequence[Bins], length_s: float) -> Ints:
    """The number (M,) of the block of so many seconds in which each bin of all sections lies, from zero on."""
    found: list[Ints] = []
    before = 0
    for part in bins:
        number = np.unique((part.t / length_s).astype(np.int64), return_inverse=True)[1]
        found.append(before + number)
        before += int(number.max()) + 1
    return np.concatenate(found)
