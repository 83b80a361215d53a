"""The bank of a model without formulas: trained networks are what it has."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank, Trial, gated, started
from faultline.analysis.graph.networks import Networks
from faultline.analysis.model import Model
from faultline.analysis.structure import Test, find_tests
from faultline.service.core.residuals.generators import Graph

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class NetworkBank(Bank):
    """Some of the generators of trained networks, by their `rows` in the graph; it assumes no faults."""

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
        """Return the residuals (K, B, T) over samples `z` (K, B, nz) from the states `x0` (nx,) or (B, nx)."""
        assert not any(trials), "networks have no parameters"
        B = len(trials)
        samples = np.broadcast_to(z.reshape(len(z), -1, z.shape[-1]), (len(z), B, z.shape[-1]))
        x = np.array(np.broadcast_to(x0, (B, x0.shape[-1])))
        r = np.empty((len(z), B, len(self.rows)))
        for k, sample in enumerate(samples):
            every, _, _, _, x = self._run(z=np.ascontiguousarray(sample), x=x)
            r[k] = every[:, list(self.rows)]
        return r

    def start(self, z: Array) -> Array:
        """The states (nx,) of all networks that the samples `z` (nz,) of a tick give."""
        described = self.trained.description
        return started(described.generators, described.signals, z)

    @cached_property
    def _run(self) -> Graph:
        return Graph(self.trained.graph)


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
