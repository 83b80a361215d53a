"""Loading of a bundle: its files are complete (`service.bundle.files`), its graphs as the manifest says."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
import onnxruntime as ort
from onnxruntime.capi import onnxruntime_pybind11_state

from faultline.service.bundle.files import BundleError, Trust, Whole, decode_json, one_line, whole
from faultline.service.core.decision.consistency import uneven
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Generator, Manifest
from faultline.service.core.residuals.generators import GeneratorBank, Residuals
from faultline.service.core.residuals.graph_file import GraphError, check_graph_file
from faultline.service.core.signals.dbc import NO_BUSES, NOBODY, OWN_NAMES, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.units import with_units
from faultline.service.core.signals.values import FloatArray
from faultline.service.logs import Log, open_log

T = TypeVar("T")

GRAPH_ERRORS: tuple[type[Exception], ...] = (
    *(e for e in vars(onnxruntime_pybind11_state).values() if isinstance(e, type) and issubclass(e, Exception)),
    *(RuntimeError, ValueError, IndexError, OverflowError, MemoryError),
)
"""What onnxruntime raises: its own exceptions, which have no base in common, and what pybind11 makes of C++'s."""


class Golden(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Golden vectors: samples `z` (K, nz) of a recording's beginning and the residuals `r` (K, T) they must give.

    `shift` (H, generators of the evidence) is what every hypothesis shifts them by at the last one.
    """

    z: list[list[float]]
    r: list[list[float]]
    shift: list[list[float]]


class Bundle(NamedTuple):
    """A verified bundle. `id` is the SHA-256 of the manifest's bytes, `where` its folder, for messages."""

    id: str
    where: str
    manifest: Manifest
    graphs: Mapping[str, bytes]
    table: DecodeTable
    golden: Golden

    @property
    def dbc_sha256(self) -> str | None:
        """The hash of the DBC that its signals are decoded with; None where they come in tables."""
        dbc = self.manifest.dbc
        return None if dbc is None else self.manifest.files[dbc].sha256

    def bank(self) -> GeneratorBank:
        """Return fresh generators."""
        return GeneratorBank(
            self.graphs,
            self.manifest.generators,
            self.manifest.inputs,
            self.manifest.period_s,
            self.manifest.evidence,
        )


def load_bundle(
    folder: Path,
    trust: Trust | None = None,
    senders: Mapping[str, int] = NOBODY,
    signals: Mapping[str, str] = OWN_NAMES,
) -> Bundle:
    """Load the bundle in `folder`; the signatures that `trust` demands are checked before anything else.

    `senders` are source addresses of messages by name, and `signals` the DBC's names of signals, in place of those that
    the bundle has.

    Raises:
        BundleError: it is incomplete, of an unknown version, changed, or inconsistent.
        SignatureError: it is not signed by enough of those who are trusted.
    """
    return bundle_of(whole(folder, trust), folder, senders, signals)


def load_with_log(
    folder: Path,
    path: Path,
    channel: str | None,
    senders: Mapping[str, int] = NOBODY,
    buses: Mapping[str, str] = NO_BUSES,
) -> tuple[Bundle, Log]:
    """Load the bundle in `folder` and the log at `path`, of one channel if that is given, that it can diagnose.

    `senders` are source addresses of messages by name, and `buses` the channels of buses by name, in place of those
    that the log's recording has.

    Raises:
        InputError: one of them cannot be read, or they do not fit together.
    """
    log = open_log(path, channel, buses)
    bundle = load_bundle(folder, senders={**log.senders, **senders}, signals=log.signals_of_dbc)
    verify_golden(bundle)
    check_fits(bundle, log, folder, path, buses)
    return bundle, log


def check_fits(bundle: Bundle, log: Log, folder: Path, path: Path, buses: Mapping[str, str] = NO_BUSES) -> None:
    """Check that the bundle of `folder` can diagnose the log at `path`; `buses` are as in `load_with_log`.

    Raises:
        InputError: they do not fit together.
    """
    log.check_signals(bundle.table.units)
    log.check_channels(bundle.table.carries)
    for bus in buses:
        if bus not in bundle.table.buses:
            there = ", ".join(bundle.table.buses) or "no bus"
            raise InputError(f"--channel {bus}={buses[bus]}: the bundle {folder} names {there}")
    log.check_senders(bundle.table)
    log.check_dbc(bundle.dbc_sha256)
    if log.recording is not None:
        log.recording.check_sensors(path, bundle.manifest.sensor_set, f"the bundle {folder}")


def bundle_of(
    given: Whole, folder: Path, senders: Mapping[str, int] = NOBODY, signals: Mapping[str, str] = OWN_NAMES
) -> Bundle:
    """Return the bundle of these files of a folder; raises as `load_bundle` does, and reads nothing more."""
    bundle_id, manifest, contents = given
    dbc = None if manifest.dbc is None else contents[manifest.dbc]
    chosen = {**manifest.senders, **senders}, {**manifest.signals, **signals}
    table = _table(dbc, manifest, *chosen, str(folder / (manifest.dbc or "")))
    graphs = {graph.file: contents[graph.file] for graph in manifest.graphs}
    for name in graphs:
        _check_graph(contents[name], manifest, name, None, str(folder / name))
    if (faults := manifest.evidence.graph) is not None:
        graphs[faults] = contents[faults]
        _check_graph(contents[faults], manifest, faults, len(manifest.evidence.hypotheses), str(folder / faults))
    golden = _golden(contents[manifest.golden], manifest, str(folder / manifest.golden))
    return Bundle(bundle_id, str(folder), manifest, graphs, table, golden)


def graph_metadata(manifest: Manifest, graph: str) -> dict[str, str]:
    """Return the ONNX metadata of a graph by file name: what the manifest says of its step, columns and rows, as JSON.

    Export writes it into the graph and loading compares: golden vectors have columns without names, and no time.
    """
    entries: dict[str, object] = {
        "period_s": manifest.period_s,
        "inputs": [(channel.signal, channel.unit) for channel in manifest.inputs],
        "generators": [(generator.name, generator.predicts) for generator in _columns(manifest, graph)],
    }
    if graph == manifest.evidence.graph:
        entries["hypotheses"] = [(h.fault, h.size, h.share_of, h.brought) for h in manifest.evidence.hypotheses]
    return {field: msgspec.json.encode(value).decode() for field, value in entries.items()}


def verify_golden(bundle: Bundle) -> None:
    """Run the golden vectors through fresh generators.

    Raises:
        BundleError: a residual differs by more than its graph's tolerance: this machine does not compute what was
            exported.
    """
    bank = bundle.bank()
    tolerances = {graph.file: graph.tolerance for graph in bundle.manifest.graphs}
    tolerance = np.array([tolerances[generator.graph] for generator in bundle.manifest.generators])
    usable = np.ones(len(bundle.manifest.inputs), dtype=np.bool_)
    units = {channel.signal: channel.unit for channel in bundle.manifest.inputs}
    for tick, (z, expected) in enumerate(zip(bundle.golden.z, bundle.golden.r, strict=True)):
        try:
            residuals = bank.step(np.array(z), usable)
        except GRAPH_ERRORS as error:
            raise BundleError(
                f"{bundle.where}: golden vector {tick}: {one_line(error)}; export the bundle again"
            ) from error
        difference = np.abs(residuals.r - np.array(expected))
        agrees = (difference <= tolerance * residuals.sigma) & np.isfinite(residuals.sigma)
        if not agrees.all():
            row = int(np.argmin(agrees))
            generator = bundle.manifest.generators[row]
            unit = units[generator.predicts]
            raise BundleError(
                f"{bundle.where}: golden vector {tick}: {generator.name} is off by {difference[row]:g} {unit}; "
                "this machine's onnxruntime computes something else than the exporter's: install the same version"
            )
    _verify_shift(bundle, residuals, tolerance)


def _verify_shift(bundle: Bundle, residuals: Residuals, tolerance: FloatArray) -> None:
    """Check the shifts of the hypotheses: `residuals` are those after the last golden vector."""
    if not bundle.manifest.evidence.hypotheses:
        return
    names = [generator.name for generator in bundle.manifest.generators]
    rows = [names.index(name) for name in bundle.manifest.evidence.generators]
    difference = np.abs(residuals.shift - np.array(bundle.golden.shift).reshape(residuals.shift.shape))
    agrees = difference <= (tolerance * residuals.sigma)[rows]
    if not agrees.all():
        hypothesis = bundle.manifest.evidence.hypotheses[int(np.argmin(agrees.all(axis=1)))]
        raise BundleError(
            f"{bundle.where}: golden vectors: {hypothesis.fault} of size {hypothesis.size:g} is off by "
            f"{difference.max():g}; this machine's onnxruntime computes something else than the exporter's: "
            "install the same version"
        )


def _table(
    raw: bytes | None, manifest: Manifest, senders: Mapping[str, int], signals: Mapping[str, str], where: str
) -> DecodeTable:
    units = {channel.signal: channel.unit for channel in manifest.inputs}
    if raw is None:
        return DecodeTable({}, units)
    try:
        table = compile_dbc(dbc_text(raw), units, where, senders, manifest.buses, signals, with_units(manifest.units))
    except InputError as error:
        raise BundleError(str(error)) from error
    table.bear({channel.signal: channel.jitter_s for channel in manifest.inputs if channel.jitter_s is not None})
    return table


def _columns(manifest: Manifest, graph: str) -> list[Generator]:
    """Return the generators that are the columns of a graph's outputs."""
    if graph == manifest.evidence.graph:
        known = {generator.name: generator for generator in manifest.generators}
        return [known[generator] for generator in manifest.evidence.generators]
    return [generator for generator in manifest.generators if generator.graph == graph]


def _check_graph(raw: bytes, manifest: Manifest, graph: str, rows: int | None, where: str) -> None:
    """Raise BundleError unless the graph's inputs, outputs and metadata are those that the manifest implies.

    Inputs are z (B, nz) and x (B, nx); B is open, or `rows` where that is given.
    """
    own, nz = _columns(manifest, graph), len(manifest.inputs)
    try:
        check_graph_file(raw, where)
    except GraphError as error:
        raise BundleError(str(error)) from error
    nx, tests = sum(len(generator.states) for generator in own), len(own)
    inputs = {"z": nz, "x": nx}
    outputs = {"r": tests, "y_hat": tests, "sigma": tests, "x_next": nx}
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong is said once, by the exception
    try:
        session = ort.InferenceSession(raw, options, providers=["CPUExecutionProvider"], enable_fallback=0)
        metadata = session.get_modelmeta().custom_metadata_map
    except GRAPH_ERRORS as error:
        raise BundleError(
            f"{where}: no graph that onnxruntime {ort.__version__} runs: {one_line(error)}; export the bundle again"
        ) from error
    for kind, wanted, nodes in (("input", inputs, session.get_inputs()), ("output", outputs, session.get_outputs())):
        if sorted(node.name for node in nodes) != sorted(wanted):
            names = ", ".join(repr(node.name) for node in nodes)
            raise BundleError(f"{where}: its {kind}s are {names}, not {', '.join(wanted)}; export the bundle again")
        for node in nodes:
            batch, *width = node.shape or [1]
            closed, B = isinstance(batch, int) and batch != rows, rows or "'B'"
            if node.type != "tensor(double)" or closed or width != [wanted[node.name]]:
                raise BundleError(
                    f"{where}: {kind} {node.name} is a {node.type} of shape {node.shape}, the manifest needs "
                    f"a tensor(double) of shape [{B}, {wanted[node.name]}]; export the bundle again"
                )
    _check_metadata(metadata, graph_metadata(manifest, graph), where)


def _check_metadata(found: Mapping[str, str], wanted: Mapping[str, str], where: str) -> None:
    """Raise BundleError where a graph was exported with another period, order of columns or hypotheses."""
    for field, value in wanted.items():
        if (own := found.get(field, "missing")) != value:
            what = f"period_s {own[:20]}, not {value}" if field == "period_s" else f"other {field} than those"
            raise BundleError(f"{where}: was exported with {what} of the manifest; export the bundle again")


def _golden(raw: bytes, manifest: Manifest, where: str) -> Golden:
    golden = decode_json(raw, Golden, where)
    if not golden.z or len(golden.z) != len(golden.r):
        raise BundleError(
            f"{where}: {len(golden.z)} z and {len(golden.r)} r, not as many, at least one; export the bundle again"
        )
    for problem in (
        *uneven(golden.z, len(manifest.inputs), "z", "inputs"),
        *uneven(golden.r, len(manifest.generators), "r", "generators"),
        *uneven(golden.shift, len(manifest.evidence.generators), "shift", "evidence generators"),
    ):
        raise BundleError(f"{where}: {problem}; export the bundle again")
    if len(golden.shift) != len(manifest.evidence.hypotheses):
        raise BundleError(
            f"{where}: {len(golden.shift)} shift, not one for each hypothesis of the manifest; export the bundle again"
        )
    return golden
