"""The bank of a model without formulas: trained networks are what it has.

What a fault does to the residuals needs a formula, but for one: the bias of a signal. Where a fault enters an equation
of one signal and one unknown (a sensor's, or a command's), networks that are fed with the signal less a bias have the
residuals that a vehicle without that bias would show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank, Trial, gated, started
from faultline.analysis.graph.corrected import corrected
from faultline.analysis.graph.networks import Networks
from faultline.analysis.model import Model
from faultline.analysis.structure import Test, find_tests
from faultline.service.core.residuals.generators import Graph

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class NetworkBank(Bank):
    """Some of the generators of trained networks, by their `rows` in the graph. A trial is a bias by each fault."""

    trained: Networks
    rows: tuple[int, ...]

    @property
    def has_equations(self) -> bool:
        """Return False: its graph is that of the networks."""
        return False

    def only(self, rows: Sequence[int]) -> "NetworkBank":
        """The bank of these tests alone."""
        return replace(
            self,
            tests=tuple(self.tests[k] for k in rows),
            generators=tuple(self.generators[k] for k in rows),
            sigma=self.sigma[list(rows)],
            rows=tuple(self.rows[k] for k in rows),
        )

    def simulate(self, trials: Sequence[Trial], z: Array, x0: Array) -> Array:
        """Return the residuals (K, B, T) for B trials side by side, as `Bank.simulate` does."""
        B = len(trials)
        samples = np.broadcast_to(z.reshape(len(z), -1, z.shape[-1]), (len(z), B, z.shape[-1])) - self._biases(trials)
        x = np.array(np.broadcast_to(x0, (B, x0.shape[-1])))
        r = np.empty((len(z), B, len(self.rows)))
        for k, sample in enumerate(samples):
            every, _, _, x = self._run(z=np.ascontiguousarray(sample), x=x)
            r[k] = every[:, list(self.rows)]
        return r

    def start(self, z: Array) -> Array:
        """The states (nx,) of all networks that the samples `z` (nz,) of a tick give."""
        described = self.trained.description
        return started(described.generators, described.signals, z)

    def graph_of(self, trials: Sequence[Trial]) -> bytes:
        """The ONNX graph of these tests with each trial's biases built in: as many rows of a batch as trials."""
        counts = [len(each.states) for each in self.trained.description.generators]
        first = np.cumsum([0, *counts])
        columns = np.concatenate([np.arange(first[row], first[row + 1]) for row in self.rows])
        return corrected(self.trained.graph, self._biases(trials), self.rows, columns, int(first[-1]))

    def _biases(self, trials: Sequence[Trial]) -> Array:
        """The biases (B, nz) of the signals in each trial."""
        signals, of = self.trained.description.signals, biased_signals(self.model)
        biases = np.zeros((len(trials), len(signals)))
        for row, trial in enumerate(trials):
            for fault, bias in trial.items():
                biases[row, signals.index(of[fault])] = bias
        return biases

    @cached_property
    def _run(self) -> Graph:
        return Graph(self.trained.graph)


def biased_signals(model: Model) -> dict[str, str]:
    """Return the faults that are a bias of a signal, as far as structure says it, with that signal."""
    found = {}
    for equation in model.equations.values():
        known = [name for name in equation.variables if name in model.known]
        if equation.fault is not None and len(equation.variables) == 2 and len(known) == 1:
            found[equation.fault.name] = known[0]
    return found


def network_bank(model: Model, networks: Networks) -> NetworkBank:
    """The bank of all networks that were trained for a model."""
    by_name = {test.name: test for test in find_tests(model) if isinstance(test, Test)}
    generators = tuple(networks.description.generators)
    tests = tuple(by_name[each.test] for each in generators)
    return NetworkBank(
        model=model,
        tests=tests,
        inputs=gated(model, tests),
        generators=generators,
        networks=(),
        sigma=np.array([model.known[test.predicts].noise for test in tests]),
        trained=networks,
        rows=tuple(range(len(generators))),
    )
