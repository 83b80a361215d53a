"""A folder of trained networks: `rnn.onnx`, and `networks.json` with what a manifest says of them.

`faultline train` writes it; `tune` and `export` take it besides a model. It holds for any calibration of that model:
the networks know its structure and the recordings, not its parameters.
"""

import hashlib
from collections.abc import Collection
from pathlib import Path
from typing import Final, Literal

import msgspec
import numpy as np

from faultline.analysis.graph.corrected import corrected
from faultline.analysis.model import Model
from faultline.analysis.structure import Test, find_tests
from faultline.service.bundle.load import GRAPH_ERRORS
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Generator, Sha256
from faultline.service.core.residuals.generators import Graph

FILE, GRAPH = "networks.json", "rnn.onnx"
SCHEMA: Final = "faultline.networks/1"

TOLERANCE = 1e-3
"""Of sigma, for golden vectors: the graph is float32 inside."""


class Description(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What networks are: their `generators` in the graph's order, `recordings` by the SHA-256 of their logs.

    `signals` are the columns of z, `error` [unit of y] is each test's free-run error (RMS) in what was held out.
    """

    schema: Literal["faultline.networks/1"]
    model: str
    signals: list[str]
    period_s: float
    recipe: str
    members: int
    seed: int
    recordings: list[Sha256]
    vehicle: str | None
    graph_sha256: Sha256
    generators: list[Generator]
    error: list[float]


class Networks(msgspec.Struct, frozen=True):
    """A folder's content."""

    description: Description
    graph: bytes

    def without(self, names: Collection[str]) -> "Networks":
        """Return those of the other generators alone; the hash stays that of the whole graph, which is the folder's."""
        d = self.description
        rows = [row for row, generator in enumerate(d.generators) if generator.name not in names]
        if len(rows) == len(d.generators):
            return self
        first = np.cumsum([0, *(len(generator.states) for generator in d.generators)])
        columns = np.concatenate([np.arange(first[row], first[row + 1]) for row in rows])
        graph = corrected(self.graph, np.zeros((1, len(d.signals))), rows, columns, int(first[-1]))
        kept = {"generators": [d.generators[row] for row in rows], "error": [d.error[row] for row in rows]}
        return Networks(msgspec.structs.replace(d, **kept), graph)


def files_of(networks: Networks) -> dict[str, bytes]:
    """Content of the folder's two files, the description last."""
    raw = msgspec.json.format(msgspec.json.encode(networks.description), indent=1)
    return {GRAPH: networks.graph, FILE: raw + b"\n"}


def load_networks(folder: Path, model: Model) -> Networks:
    """The networks in a folder, for this model.

    Raises:
        InputError: the folder is none, or was changed; the networks are of another model's tests.
    """
    try:
        raw, graph = (folder / FILE).read_bytes(), (folder / GRAPH).read_bytes()
    except OSError as error:
        raise InputError(
            f"{folder}: no networks: {error.filename}: {error.strerror}; `faultline train` writes them"
        ) from error
    try:
        found = msgspec.json.decode(raw, type=Description)
    except msgspec.DecodeError as error:
        raise InputError(f"{folder / FILE}: not of this version: {error}; train again") from error
    if hashlib.sha256(graph).hexdigest() != found.graph_sha256:
        raise InputError(f"{folder / GRAPH}: is not the graph that {FILE} is of; copy the whole folder, or train again")
    _check(found, model, folder)
    _check_shapes(found, graph, folder)
    return Networks(found, graph)


def _check(found: Description, model: Model, folder: Path) -> None:
    if found.signals != [*model.known] or found.period_s != model.period_s:
        raise InputError(
            f"{folder}: was trained on the signals {', '.join(found.signals)} every {found.period_s:g} s; "
            f"train for {model.name} anew"
        )
    tests = {test.name: test for test in find_tests(model) if isinstance(test, Test)}
    for generator in found.generators:
        test = tests.get(generator.test)
        if test is None or (test.predicts, [*test.known]) != (generator.predicts, generator.inputs):
            raise InputError(f"{folder}: {model.name} has no test {generator.test} like its own; train anew")
        if sorted(test.faults) != sorted(generator.faults):
            raise InputError(f"{folder}: {generator.test} has other faults in {model.name}; train anew")


def _check_shapes(found: Description, graph: bytes, folder: Path) -> None:
    """Whether the graph has the generators and states that are described."""
    states = sum(len(generator.states) for generator in found.generators)
    try:
        r, *_, x = Graph(graph)(z=np.ones((1, len(found.signals))), x=np.ones((1, states)))
    except GRAPH_ERRORS as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"{folder / FILE}: describes another graph than {GRAPH}: {reason}; train anew") from error
    if r.shape != (1, len(found.generators)) or x.shape != (1, states):
        told = f"describes {len(found.generators)} generators, {GRAPH} has {r.shape[1]}"
        raise InputError(f"{folder / FILE}: {told}; train anew")
