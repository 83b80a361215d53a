"""Write the bundle: graph, manifest, DBC and golden vectors of a calibrated, tuned model."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from faultline.analysis.graph.bank import FAULTS, GRAPH, Bank
from faultline.analysis.graph.networks import GRAPH as NETWORKS
from faultline.analysis.graph.runnable import Runnable, runnable_of
from faultline.analysis.graph.writer import with_metadata
from faultline.analysis.model import dump_model
from faultline.analysis.structure.lint import sound_model
from faultline.analysis.tuning.file import Tuning, load_tuning, model_digest
from faultline.analysis.tuning.manifest import GOLDEN, manifest_of
from faultline.options import Parser, add_buses, add_senders, buses_of, senders_of
from faultline.service.bundle.files import MANIFEST, SEAL, BundleError, decode_manifest, seal
from faultline.service.bundle.load import Golden, graph_metadata, load_bundle, verify_golden
from faultline.service.core.decision.consistency import FILE_NAME
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Unit
from faultline.service.core.signals.dbc import NO_BUSES, NOBODY, OWN_NAMES, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.units import Conversion
from faultline.service.core.signals.units import conversion as by_table
from faultline.service.logs import load_recording
from faultline.service.logs.units import conversion
from faultline.writing import check_folder, write_folder

EXAMPLE = """example:
  faultline export calibrated.toml --tuning tuning.json --dbc logs/bench-training-s1/uds.dbc --out bundle
  faultline export calibrated.toml --tuning tuning.json --recording logs/drive-1 --out bundle  # its DBC and names
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline export", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="the calibrated model file")
    parser.add_argument("--tuning", type=Path, required=True, help="the tuning file")
    parser.add_argument("--networks", type=Path, metavar="DIR", help="the networks that were tuned with the model")
    of_bus = parser.add_mutually_exclusive_group()
    of_bus.add_argument("--dbc", type=Path, help="the vehicle's DBC; without one, signals come in tables of values")
    of_bus.add_argument(
        "--recording", type=Path, help="a recording whose DBC, names of signals, senders and buses are the vehicle's"
    )
    parser.add_argument("--out", type=Path, required=True, help="the bundle folder to write")
    parser.add_argument(
        "--version", type=int, default=0, metavar="N", help="counts up; a vehicle takes none older than one it had (0)"
    )
    add_senders(parser)
    add_buses(parser)
    parser.add_argument("--force", action="store_true", help="replace the folder if it is a bundle")
    options = parser.parse_args(argv)
    if options.version < 0:
        raise InputError(f"--version {options.version}: counts up from 0")
    _check_room(options.out, options.force)
    check_folder(options.out.parent)
    runnable = runnable_of(sound_model(options.model, formulas=options.networks is None), options.networks)
    bank = runnable.bank
    tuning = load_tuning(options.tuning)
    if tuning.model_sha256 != model_digest(dump_model(bank.model)):
        raise InputError(
            f"{options.tuning}: was made for another model than {options.model}; run `faultline tune` again"
        )
    _check_networks(tuning, runnable, options.tuning)
    runnable = runnable.without(tuning.left_out)
    bank = runnable.bank
    path, senders, buses, signals = _of_bus(options.dbc, options.recording)
    chosen = {**senders, **senders_of(options.sender)}, {**buses, **buses_of(options.bus)}, signals
    dbc = None if path is None else (path.name, _dbc(path, bank, *chosen))
    _check_golden(tuning, bank, options.tuning)
    try:
        files = bundle_files(runnable, tuning, dbc, str(options.out), options.version, *chosen)
    except BundleError as error:
        raise BundleError(str(error).replace("export the bundle again", f"tune again: {options.tuning}")) from error
    write_folder(options.out, files, _check_bundle)
    bundle = load_bundle(options.out)
    for line in bank.notes():
        print(line)
    size = sum(file.size for file in bundle.manifest.files.values())
    print(f"wrote {options.out}: {len(runnable.generators)} generators, {size / 1024:.0f} KiB, id {bundle.id[:12]}")
    return 0


def bundle_files(
    runnable: Runnable,
    tuning: Tuning,
    dbc: tuple[str, bytes] | None,
    where: str,
    version: int = 0,
    senders: Mapping[str, int] = NOBODY,
    buses: Mapping[str, str] = NO_BUSES,
    signals: Mapping[str, str] = OWN_NAMES,
) -> dict[str, bytes]:
    """Return the files of the bundle by name; the same arguments give the same.

    The DBC is its name and content; `signals` are its names of the model's signals, where they differ.

    Raises:
        BundleError: the parts contradict each other; `where` is the bundle's name in the message.
    """
    name_of_dbc = None if dbc is None else dbc[0]
    units = [] if dbc is None else uncommon_units(dbc[1], runnable.bank, where, senders, buses, signals)
    described = manifest_of(runnable, tuning, {}, name_of_dbc, version, senders, buses, signals, units)
    graphs = {
        name: with_metadata(raw, graph_metadata(described, name))
        for name, raw in (runnable.graphs | runnable.of_hypotheses(tuning.evidence)).items()
    }
    files = {**({} if dbc is None else dict([dbc])), **graphs, GOLDEN: _golden(runnable, tuning)}
    manifest = manifest_of(runnable, tuning, files, name_of_dbc, version, senders, buses, signals, units)
    raw = msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n"
    decode_manifest(raw, f"{where}: {MANIFEST}")
    return {**files, MANIFEST: raw, SEAL: seal(raw)}


_OfBus = tuple[Path | None, Mapping[str, int], Mapping[str, str], Mapping[str, str]]


def _of_bus(dbc: Path | None, recording: Path | None) -> _OfBus:
    """The DBC, and senders, buses and names of signals that a recording says."""
    if recording is None:
        return dbc, NOBODY, NO_BUSES, OWN_NAMES
    can = load_recording(recording).can_log
    return recording / can.dbc, can.senders, can.messages, can.signals


def _dbc(
    path: Path, bank: Bank, senders: Mapping[str, int], buses: Mapping[str, str], signals: Mapping[str, str]
) -> bytes:
    if not path.is_file():
        raise InputError(f"{path}: no file; give the DBC that the recordings were made with")
    if FILE_NAME.fullmatch(path.name) is None or path.name in (GRAPH, NETWORKS, FAULTS, GOLDEN, MANIFEST, SEAL):
        raise InputError(
            f"{path}: cannot keep its name in a bundle; rename it: letters, digits, _, - and ., ending in .dbc"
        )
    raw = path.read_bytes()
    uncommon_units(raw, bank, str(path), senders, buses, signals)
    return raw


def uncommon_units(
    dbc: bytes,
    bank: Bank,
    where: str,
    senders: Mapping[str, int],
    buses: Mapping[str, str],
    signals: Mapping[str, str],
) -> list[Unit]:
    """Return the units of a DBC's signals that the vehicle's table does not have.

    Raises:
        InputError: the DBC cannot feed the generators; the message starts with `where`.
    """
    found: dict[tuple[str, str], Unit] = {}

    def noted(given: str, wanted: str) -> Conversion | None:
        how = conversion(given, wanted)
        if how is not None and by_table(given, wanted) is None:
            found[given, wanted] = given, wanted, *how
        return how

    units = {channel.signal: channel.unit for channel in bank.inputs}
    compile_dbc(dbc_text(dbc), units, where, senders, buses, signals, noted)
    return list(found.values())


def _golden(runnable: Runnable, tuning: Tuning) -> bytes:
    generators = runnable.fresh(tuning.evidence)
    usable = np.ones(len(runnable.bank.inputs), dtype=np.bool_)
    residuals = [generators.step(np.array(z), usable) for z in tuning.golden_z]
    r = [residual.r.tolist() for residual in residuals]
    return msgspec.json.encode(Golden(z=tuning.golden_z, r=r, shift=residuals[-1].shift.tolist()))


def _check_bundle(folder: Path) -> None:
    verify_golden(load_bundle(folder))


def _check_networks(tuning: Tuning, runnable: Runnable, where: Path) -> None:
    given = runnable.networks.description.graph_sha256 if runnable.networks else None
    if tuning.networks_sha256 != given:
        had = "without networks" if tuning.networks_sha256 is None else "with networks that are not those of --networks"
        raise InputError(
            f"{where}: was made {had}; give both commands the same --networks, or run `faultline tune` again"
        )


def _check_golden(tuning: Tuning, bank: Bank, where: Path) -> None:
    told: dict[str, object] = {"frozen_s": None, "largest_step": None, "jitter_s": None, "label": "", "display": []}
    own = [msgspec.structs.replace(channel, **told) for channel in tuning.inputs]
    if own != list(bank.inputs):
        raise InputError(f"{where}: inputs: not the model's signals; tune again")
    if not tuning.golden_z or any(len(z) != len(bank.inputs) for z in tuning.golden_z):
        raise InputError(f"{where}: golden_z: not samples of the model's {len(bank.inputs)} signals; tune again")


def _check_room(out: Path, force: bool) -> None:
    """An existing bundle is replaced when asked for; any other folder, and one that holds more, is left alone."""
    if not out.exists() and not out.is_symlink():
        return
    if out.is_symlink() or not _is_bundle(out):
        raise InputError(f"{out}: exists and is no bundle, or more than one; give another folder")
    if Path.cwd().is_relative_to(out.resolve()):
        raise InputError(f"{out}: is the folder you are in; go to another one")
    if not force:
        raise InputError(f"{out}: exists already; give another folder or --force")


def _is_bundle(folder: Path) -> bool:
    """Whether the folder holds the files of a bundle, of whatever version and however damaged, and nothing else."""
    try:
        manifest = json.loads((folder / MANIFEST).read_bytes())
        listed = {MANIFEST, SEAL, *manifest["files"]}
        return str(manifest["schema"]).startswith("faultline.bundle/") and listed.issuperset(
            path.name for path in folder.iterdir()
        )
    except (OSError, ValueError, TypeError, KeyError):
        return False
