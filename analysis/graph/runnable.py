"""The generators of a bundle to be: those of the model's equations, and trained networks besides."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph import networks as trained
from faultline.analysis.graph.bank import GRAPH, Bank, Trial, build_bank
from faultline.analysis.graph.network_bank import network_bank
from faultline.analysis.graph.networks import Networks, load_networks
from faultline.analysis.model import Model
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Evidence, Generator, GraphFile, Hypothesis
from faultline.service.core.residuals.generators import GeneratorBank

TOLERANCE = 1e-6
"""Of sigma, for golden vectors of the equations, which are float64."""


@dataclass(frozen=True)
class Runnable:
    """A bank, and `networks` that are of the same model; where this has no formulas they are all that there is."""

    bank: Bank
    networks: Networks | None = None

    @property
    def generators(self) -> tuple[Generator, ...]:
        """Of both, in the order of the manifest: those of the equations first."""
        beside = self.networks.description.generators if self.networks and self.bank.has_equations else ()
        return (*self.bank.generators, *beside)

    @cached_property
    def graphs(self) -> dict[str, bytes]:
        """The ONNX graphs by file name.

        Raises:
            InputError: the model divides by parameters that are zero.
        """
        of_networks = {trained.GRAPH: self.networks.graph} if self.networks else {}
        return {GRAPH: self.bank.graph(), **of_networks} if self.bank.has_equations else of_networks

    @property
    def files(self) -> list[GraphFile]:
        """What a manifest says of the graphs."""
        tolerances = {GRAPH: TOLERANCE, trained.GRAPH: trained.TOLERANCE}
        return [GraphFile(file=name, tolerance=tolerances[name]) for name in self.graphs]

    @property
    def trained_on(self) -> list[str]:
        """The recordings that the networks have seen, by the SHA-256 of their logs."""
        return list(self.networks.description.recordings) if self.networks else []

    @property
    def sigma(self) -> npt.NDArray[np.float64]:
        """The spread (T,) [unit of y] that the sensors alone give each residual."""
        return np.array([self.bank.model.known[generator.predicts].noise for generator in self.generators])

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of every residual: that of the signal it predicts."""
        return tuple(self.bank.model.known[generator.predicts].unit for generator in self.generators)

    def without(self, names: Collection[str]) -> "Runnable":
        """Return the same without some of the networks.

        Raises:
            InputError: nothing is left.
        """
        if not names or self.networks is None:
            return self
        left = self.networks.without(names) if len(names) < len(self.networks.description.generators) else None
        if self.bank.has_equations:
            return Runnable(self.bank, left)
        if left is None:
            raise InputError(
                f"{self.bank.model.name}: no network errs little enough; train on recordings that excite more"
            )
        return Runnable(network_bank(self.bank.model, left), left)

    def fresh(self, evidence: Evidence | None = None) -> GeneratorBank:
        """The generators as the vehicle starts them, with the hypotheses of the `evidence` beside them if it is given.

        Raises:
            InputError: the model divides by parameters that are zero.
        """
        return GeneratorBank(
            self.graphs | self.of_hypotheses(evidence),
            self.generators,
            self.bank.inputs,
            self.bank.model.period_s,
            evidence,
        )

    def of_hypotheses(self, evidence: Evidence | None) -> dict[str, bytes]:
        """The graph of the evidence's hypotheses by file name; none where it has none."""
        if evidence is None or evidence.graph is None:
            return {}
        names = [generator.name for generator in self.bank.generators]
        model = self.bank.model
        trials = [trial_of(h, model) for h in evidence.hypotheses]
        return {evidence.graph: self.bank.only([names.index(name) for name in evidence.generators]).graph_of(trials)}


def runnable_of(model: Model, folder: Path | None) -> Runnable:
    """The generators of a model's equations, and of the networks in a folder: of these alone where it has no formulas.

    Raises:
        InputError: no test of the model can be run; the folder has no networks, or those of another model.
    """
    networks = load_networks(folder, model) if folder else None
    if networks is not None and model.without_formula:
        return Runnable(network_bank(model, networks), networks)
    return Runnable(build_bank(model), networks)


def trial_of(h: Hypothesis, model: Model) -> Trial:
    """Return the value of the fault variable, or of the parameter that loses a share."""
    if h.brought is not None:
        consequence = model.faults[h.fault].consequence
        assert consequence is not None
        of = consequence.fault
        brought = Hypothesis(fault=of, size=h.brought, share_of=model.faults[of].share_of)
        return {**trial_of(Hypothesis(fault=h.fault, size=h.size), model), **trial_of(brought, model)}
    if h.share_of is None:
        return {h.fault: model.assumable[h.fault].absolute(h.size, model)}
    return {h.share_of: model.parameters[h.share_of].value * (1.0 + h.size)}
