"""Export: what a tuning and its model say becomes a bundle that loads; what does not belong together is refused."""

import errno
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from faultline.analysis.export import main
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import dump_model, load_model
from faultline.analysis.recordings.modes import modes_of
from faultline.analysis.recordings.observe import START_WITHIN_S
from faultline.analysis.tuning.file import SCHEMA, Tuning, model_digest
from faultline.service.bundle.files import SEAL, BundleError, seal
from faultline.service.bundle.load import load_bundle, verify_golden
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "bundle"
DBC = Path(__file__).resolve().parents[2] / "dbc" / "uds.dbc"
CALIBRATED, TUNED = "c" * 64, "7" * 64
A_DU = 1.2e-6  # m2, the datasheet says 1.376e-6


@dataclass(frozen=True)
class Made:
    """A model that was calibrated on one recording and a tuning of it; detectors and evidence are the golden ones."""

    model: Path
    tuning: Path

    def export(self, out: Path, *more: str, dbc: Path = DBC) -> int:
        return main([str(self.model), "--tuning", str(self.tuning), "--dbc", str(dbc), "--out", str(out), *more])


@pytest.fixture
def made(tmp_path: Path) -> Made:
    entry = {"command": "calibrate", "recordings": [CALIBRATED], "blocks": 30}
    text = dump_model(load_model("uds").with_parameters({"A_du": A_DU}, entry))
    golden = load_bundle(GOLDEN)
    tuning = Tuning(
        schema=SCHEMA,
        model_sha256=model_digest(text),
        recordings=[TUNED],
        modes=modes_of(load_model("uds")),
        period_s=0.2,
        start_within_s=START_WITHIN_S,
        calibrated=[],
        zero=[d.offset for d in golden.manifest.detectors],
        detectors=golden.manifest.detectors,
        evidence=golden.manifest.evidence,
        inputs=golden.manifest.inputs,
        golden_z=golden.golden.z[:40],
    )
    made = Made(tmp_path / "calibrated.toml", tmp_path / "tuning.json")
    made.model.write_text(text)
    made.tuning.write_bytes(msgspec.json.encode(tuning))
    return made


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_bundle_loads_computes_and_says_what_it_was_made_from(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "bundle"
    assert made.export(out) == 0
    bundle = load_bundle(out)
    verify_golden(bundle)
    assert f"10 generators, {sum(f.size for f in bundle.manifest.files.values()) / 1024:.0f} KiB" in (
        printed := capsys.readouterr().out
    )
    assert bundle.id[:12] in printed
    tuning = msgspec.json.decode(made.tuning.read_bytes(), type=Tuning)
    origin = bundle.manifest.origin
    assert (origin.calibrate, origin.tune) == ([CALIBRATED], [TUNED])
    assert origin.model_sha256 == hashlib.sha256(made.model.read_bytes()).hexdigest()
    assert (bundle.manifest.detectors, bundle.manifest.evidence) == (tuning.detectors, tuning.evidence)
    assert (bundle.manifest.modes, bundle.manifest.start_within_s) == (tuning.modes, tuning.start_within_s)
    assert {fault.name for fault in bundle.manifest.faults} == set(load_model("uds").faults)
    assert set(contents(out)) == {*bundle.manifest.files, "manifest.json", "manifest.sha256"}
    assert (out / str(bundle.manifest.dbc)).read_bytes() == DBC.read_bytes()
    assert len(bundle.golden.r) == 40


def test_a_full_disk_is_one_line_and_leaves_nothing(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_file: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # of a write, which names no file

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        made.export(tmp_path / "bundle")
    assert Path(caught.value.filename).parent == tmp_path / "bundle"  # what `faultline` says, with exit code 2
    assert not list(tmp_path.glob(".bundle.*"))
    assert not (tmp_path / "bundle").exists()


def test_the_graph_has_the_models_own_parameters(made: Made, tmp_path: Path) -> None:
    """Samples through the bundle give the residuals of the calibrated filter, not those of the datasheet's."""
    made.export(tmp_path / "bundle")
    exported = load_bundle(tmp_path / "bundle").bank()
    z = np.tile([1e5, 9.2e5, 9.1e5, 24.0, 0.4], (30, 1))
    r = np.array([exported.step(sample, np.ones(5, dtype=np.bool_)).r for sample in z])
    bank = build_bank(load_model("uds"))
    expected = bank.simulate([{"A_du": A_DU}, {}], z, bank.start(z[0]))
    np.testing.assert_allclose(r, expected[:, 0], atol=1e-3)
    assert np.abs(r - expected[:, 1]).max() > 100.0


def other_period(manifest: dict[str, Any]) -> None:
    manifest["period_s"] = 0.4


def swapped_inputs(manifest: dict[str, Any]) -> None:
    first, second = manifest["inputs"][:2]
    first["signal"], second["signal"] = second["signal"], first["signal"]


def other_unit(manifest: dict[str, Any]) -> None:
    manifest["inputs"][0]["unit"] = "kPa"


def swapped_generators(manifest: dict[str, Any]) -> None:
    """Two columns of as many states exchange their names."""
    generators, detectors = manifest["generators"], manifest["detectors"]
    one, other = [row for row, generator in enumerate(generators) if len(generator["states"]) == 2][:2]
    for rows, name in ((generators, "name"), (detectors, "generator")):
        rows[one][name], rows[other][name] = rows[other][name], rows[one][name]


def swapped_hypotheses(manifest: dict[str, Any]) -> None:
    rows = manifest["evidence"]["hypotheses"]
    rows[0], rows[1] = rows[1], rows[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            other_period,
            r"ode\.onnx: was exported with period_s 0\.2, not 0\.4 of the manifest; export the bundle again",
        ),
        (swapped_inputs, r"ode\.onnx: was exported with other inputs than those of the manifest; export"),
        (other_unit, r"ode\.onnx: was exported with other inputs than those of the manifest; export"),
        (swapped_generators, r"ode\.onnx: was exported with other generators than those of the manifest; export"),
        (swapped_hypotheses, r"faults\.onnx: was exported with other hypotheses than those of the manifest; export"),
    ],
)
def test_a_manifest_that_golden_vectors_cannot_tell_from_the_exported_one_is_refused(
    made: Made, tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    made.export(tmp_path / "bundle")
    manifest = json.loads((tmp_path / "bundle" / "manifest.json").read_bytes())
    change(manifest)
    raw = json.dumps(manifest).encode()
    (tmp_path / "bundle" / "manifest.json").write_bytes(raw)
    (tmp_path / "bundle" / SEAL).write_bytes(seal(raw))
    with pytest.raises(BundleError, match=message):
        load_bundle(tmp_path / "bundle")


def test_the_same_inputs_give_the_same_bytes(made: Made, tmp_path: Path) -> None:
    made.export(tmp_path / "one")
    made.export(tmp_path / "two")
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_the_tuning_of_another_model_is_refused(made: Made, tmp_path: Path) -> None:
    made.model.write_text(dump_model(load_model(made.model).with_parameters({"A_t": 2.4e-6}, {"command": "by hand"})))
    with pytest.raises(
        InputError, match=r"tuning\.json: was made for another model than .*calibrated\.toml; run `faul"
    ):
        made.export(tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


def test_a_recording_used_for_both_is_refused_and_nothing_is_written(made: Made, tmp_path: Path) -> None:
    tuning = json.loads(made.tuning.read_bytes())
    made.tuning.write_text(json.dumps({**tuning, "recordings": [TUNED, CALIBRATED]}))
    with pytest.raises(BundleError, match=f"origin: data set {CALIBRATED[:12]} was used to calibrate and to tune"):
        made.export(tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_folder_that_is_no_bundle_is_never_touched(made: Made, tmp_path: Path, force: list[str]) -> None:
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter1.tex").write_text("years of work")
    with pytest.raises(InputError, match="thesis: exists and is no bundle, or more than one; give another folder"):
        made.export(out, *force)
    assert contents(out) == {"chapter1.tex": b"years of work"}


def test_a_file_in_the_way_is_never_touched(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    out.write_text("mine")
    with pytest.raises(InputError, match="exists and is no bundle"):
        made.export(out, "--force")
    assert out.read_text() == "mine"


def test_a_bundle_is_replaced_only_when_asked_for(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    made.export(out)
    before = contents(out)
    with pytest.raises(InputError, match="bundle: exists already; give another folder or --force"):
        made.export(out)
    assert contents(out) == before
    (out / "ode.onnx").write_bytes(b"damaged")
    assert made.export(out, "--force") == 0
    assert contents(out) == before


@pytest.mark.parametrize("manifest", [None, "{}", '{"schema": "faultline.bundle/2", "files": {}}', "[1]", "no JSON"])
def test_a_folder_that_holds_more_than_a_bundle_is_never_replaced(
    made: Made, tmp_path: Path, manifest: str | None
) -> None:
    out = tmp_path / "bundle"
    made.export(out)
    if manifest is not None:
        (out / "manifest.json").write_text(manifest)
    (out / "src.js").write_text("mine")
    with pytest.raises(InputError, match="exists and is no bundle, or more than one; give another folder"):
        made.export(out, "--force")
    assert (out / "src.js").read_text() == "mine"


def test_the_folder_one_is_in_and_a_link_are_left_alone(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "bundle"
    made.export(out)
    (tmp_path / "link").symlink_to(out)
    with pytest.raises(InputError, match="link: exists and is no bundle"):
        made.export(tmp_path / "link", "--force")
    monkeypatch.chdir(out)
    with pytest.raises(InputError, match=r"^\.: is the folder you are in"):
        made.export(Path(), "--force")
    assert "manifest.json" in contents(out)


@pytest.mark.parametrize("golden_z", [[], [[0.0, 0.0, 0.0]]])
def test_golden_samples_of_other_signals_are_refused(made: Made, tmp_path: Path, golden_z: list[list[float]]) -> None:
    made.tuning.write_text(json.dumps({**json.loads(made.tuning.read_bytes()), "golden_z": golden_z}))
    with pytest.raises(InputError, match=r"tuning\.json: golden_z: not samples of the model's 5 signals; tune again"):
        made.export(tmp_path / "bundle")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SG_ y_p_tp ", "SG_ y_p_xx ", "no message carries y_p_tp; use the DBC that the bundle was made for"),
        ('[0|321.275] "kPa"', '[0|321.275] "V"', "UDS_SENSORS.y_p_tp: unit 'V' cannot be converted to 'Pa'"),
        ("SG_ y_p_ap :", "SG_ y_p_ap", "not a valid DBC file"),
    ],
)
def test_a_dbc_that_cannot_feed_the_generators_is_refused(
    made: Made, tmp_path: Path, old: str, new: str, message: str
) -> None:
    other = tmp_path / "other.dbc"
    text = DBC.read_text()
    assert old in text
    other.write_text("\n".join(line for line in text.replace(old, new).split("\n") if "CM_ SG_ 2566856953" not in line))
    with pytest.raises(InputError, match=message):
        made.export(tmp_path / "bundle", dbc=other)
    assert not (tmp_path / "bundle").exists()


def test_a_refused_replacement_leaves_the_old_bundle(made: Made, tmp_path: Path) -> None:
    """What is wrong with the inputs must be known before the bundle that works is deleted."""
    out = tmp_path / "bundle"
    made.export(out)
    before = contents(out)
    other = tmp_path / "other.dbc"
    other.write_text('VERSION ""\n\nBS_:\n\nBU_: A\n')
    with pytest.raises(InputError):
        made.export(out, "--force", dbc=other)
    assert out.is_dir()
    assert contents(out) == before


@pytest.mark.parametrize("name", ["our truck.dbc", "golden.json", ".dbc", "manifest.json"])
def test_a_dbc_whose_name_has_no_place_in_a_bundle_is_refused(made: Made, tmp_path: Path, name: str) -> None:
    other = tmp_path / name
    other.write_bytes(DBC.read_bytes())
    with pytest.raises(InputError, match="cannot keep its name in a bundle; rename it"):
        made.export(tmp_path / "bundle", dbc=other)


def test_the_dbc_keeps_its_own_name(made: Made, tmp_path: Path) -> None:
    other = tmp_path / "truck-7.dbc"
    other.write_bytes(DBC.read_bytes())
    assert made.export(tmp_path / "bundle", dbc=other) == 0
    assert load_bundle(tmp_path / "bundle").manifest.dbc == "truck-7.dbc"
    assert "uds.dbc" not in contents(tmp_path / "bundle")


@pytest.mark.parametrize("missing", ["tuning.json", "other.dbc", "calibrated.toml"])
def test_a_missing_input_is_named(made: Made, tmp_path: Path, missing: str) -> None:
    (tmp_path / missing).unlink(missing_ok=True)
    with pytest.raises(InputError, match=missing):
        made.export(tmp_path / "bundle", dbc=tmp_path / missing if missing.endswith("dbc") else DBC)


def test_a_dbc_that_is_no_text_is_refused(made: Made, tmp_path: Path) -> None:
    """Every sequence of bytes is text in Windows-1252; not all are a DBC."""
    other = tmp_path / "other.dbc"
    other.write_bytes(DBC.read_bytes() + b"\xff\xfe")
    line = DBC.read_bytes().count(b"\n") + 1
    with pytest.raises(InputError, match=rf"other\.dbc: not a valid DBC file: Invalid syntax at line {line}"):
        made.export(tmp_path / "bundle", dbc=other)


def test_the_manifest_says_which_sender_of_a_vendors_message_was_chosen(made: Made, tmp_path: Path) -> None:
    other = tmp_path / "vendors.dbc"
    text = DBC.read_text().replace(str(0x98FF103D), str(0x98FF10FE)) + 'CM_ "°C";\n'
    other.write_bytes(text.encode("cp1252"))
    assert made.export(tmp_path / "any", dbc=other) == 0
    assert made.export(tmp_path / "one", "--sender", "UDS_ECU=0x3D", dbc=other) == 0
    bundles = load_bundle(tmp_path / "any"), load_bundle(tmp_path / "one")
    assert [bundle.manifest.senders for bundle in bundles] == [{}, {"UDS_ECU": 0x3D}]
    assert [bundle.table.senders for bundle in bundles] == [{"UDS_ECU": {}}, {}]
    assert b'"senders"' not in (tmp_path / "any" / "manifest.json").read_bytes()
    with pytest.raises(InputError, match=r"vendors\.dbc: a sender is chosen for EEC1"):
        made.export(tmp_path / "other", "--sender", "EEC1=0", dbc=other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "faultline.tuning/0"}, "schema: this is 'faultline.tuning/0', wanted is 'faultline.tuning/6'"),
        ({"extra": 1}, "not a tuning file: Object contains unknown field `extra`"),
        ({"detectors": None}, "not a tuning file: Expected `array`, got `null`"),
    ],
)
def test_a_tuning_of_another_version_is_refused(
    made: Made, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    made.tuning.write_text(json.dumps({**json.loads(made.tuning.read_bytes()), **change}))
    with pytest.raises(InputError, match=message):
        made.export(tmp_path / "bundle")


def test_a_bundle_of_a_recording_carries_the_names_of_its_dbc(made: Made, tmp_path: Path) -> None:
    text = DBC.read_text().replace("y_p_du", "DosingPressure").replace(" n_p", " speed")
    drive, out = tmp_path / "drive", tmp_path / "bundle"
    drive.mkdir()
    log = GOLDEN.parent / "log"
    (drive / "vendor.dbc").write_text(text)
    (drive / "can.log").write_bytes((log / "can.log").read_bytes())
    old = hashlib.sha256(DBC.read_bytes()).hexdigest()
    written = (log / "recording.toml").read_text().replace("uds.dbc", "vendor.dbc")
    written = written.replace(old, hashlib.sha256(text.encode()).hexdigest())
    (drive / "recording.toml").write_text(
        written + '[can.signals]\ny_p_du = "UDS_ECU.DosingPressure"\nn_p = "speed"\nother = "x"\n'
    )
    given = [str(made.model), "--tuning", str(made.tuning), "--out"]
    assert main([*given, str(out), "--recording", str(drive)]) == 0
    bundle = load_bundle(out)
    assert bundle.manifest.signals == {"y_p_du": "UDS_ECU.DosingPressure", "n_p": "speed"}
    main([*given, str(tmp_path / "own"), "--dbc", str(DBC)])
    frames = list(open_log(log).frames())[:500]
    decoded = [[each.table.decode(*frame[1:]) for frame in frames] for each in (bundle, load_bundle(tmp_path / "own"))]
    assert any(decoded[0])
    assert decoded[0] == decoded[1]
    with pytest.raises(InputError, match="no message carries"):
        main([*given, str(tmp_path / "no"), "--dbc", str(drive / "vendor.dbc")])


def test_a_bundle_brings_the_units_of_its_dbc_that_the_vehicle_does_not_know(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign = DBC.read_text().replace('(0.05,0) [0|3212.75] "kPa"', '(0.0072519,0) [0|466] "psi"')
    (tmp_path / "truck.dbc").write_text(foreign)
    assert made.export(tmp_path / "bundle", dbc=tmp_path / "truck.dbc") == 0

    def none(given: str, wanted: str) -> None:
        raise AssertionError(f"{given} to {wanted} was looked up on the vehicle")

    monkeypatch.setattr("faultline.service.logs.units._by_library", none)
    bundle = load_bundle(tmp_path / "bundle")
    [unit] = bundle.manifest.units
    assert unit[:2] == ("psi", "Pa")
    assert unit[2:] == pytest.approx((6894.757293168361, 0.0))
    frame = next(each for each in open_log(GOLDEN.parent / "log").frames() if each.can_id == 0x18FF103D)
    found = {name: value for name, value, _ in bundle.table.decode(*frame[1:])}
    own = {name: value for name, value, _ in load_bundle(GOLDEN).table.decode(*frame[1:])}
    assert found == pytest.approx(own, rel=1e-4)
