"""Strict loading: nothing changed, unknown, missing or contradictory gets past; errors name the path."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from service import show
from service.bundle import BundleError, load_bundle, verify_golden

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "bundle"


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return Path(shutil.copytree(GOLDEN, tmp_path / "bundle"))


def edit(bundle: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Changes the manifest as an exporter could have written it."""
    path = bundle / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def test_the_golden_bundle_loads_and_computes_what_was_exported(bundle: Path) -> None:
    loaded = load_bundle(bundle)
    verify_golden(loaded)
    assert loaded.id == hashlib.sha256((bundle / "manifest.json").read_bytes()).hexdigest()
    names = [generator.test for generator in loaded.manifest.generators]
    assert names == ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20", "t21"]


@pytest.mark.parametrize("name", ["ode.onnx", "uds.dbc", "golden.json"])
def test_a_changed_byte_in_any_file_is_refused(bundle: Path, name: str) -> None:
    content = bytearray((bundle / name).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / name).write_bytes(content)
    with pytest.raises(BundleError, match=rf"{name}: its bytes differ from the manifest's SHA-256"):
        load_bundle(bundle)


@pytest.mark.parametrize("name", ["ode.onnx", "uds.dbc", "golden.json", "manifest.json"])
def test_a_missing_file_is_named(bundle: Path, name: str) -> None:
    (bundle / name).unlink()
    with pytest.raises(BundleError, match=f"{name}: not found"):
        load_bundle(bundle)


@pytest.mark.parametrize("schema", ["faultline.bundle/2", "faultline.bundle/0", "other/1"])
def test_an_unknown_version_is_refused_before_anything_else(bundle: Path, schema: str) -> None:
    def change(manifest: dict[str, Any]) -> None:
        manifest.update(schema=schema, something_new=1)

    edit(bundle, change)
    with pytest.raises(BundleError, match=f"schema: this is '{schema}', this faultline runs 'faultline.bundle/1'"):
        load_bundle(bundle)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(extra=1), "unknown field `extra`"),
        (lambda m: m.pop("period_s"), "period_s"),
        (lambda m: m["generators"][2].update(warm_up_ticks="many"), r"generators\[2\].warm_up_ticks: Expected `int`"),
        (lambda m: m["inputs"][0].update(unit=5), r"inputs\[0\].unit: Expected `str`"),
        (lambda m: m["generators"][1]["inputs"].append("y_x"), r"generators\[1\].inputs: unknown signal 'y_x'"),
        (lambda m: m["generators"][0]["faults"].append("fX"), r"generators\[0\].faults: unknown fault 'fX'"),
        (lambda m: m["generators"][0]["states"][0]["gain"].update(y_x=1.0), r"states\[0\].gain: unknown signal 'y_x'"),
        (lambda m: m["detectors"].reverse(), "detectors: not one for each generator"),
        (lambda m: m["evidence"]["generators"].append("t99"), "evidence.generators: unknown generator 't99'"),
        (lambda m: m["modes"].update(signal="y_x"), "modes.signal: unknown signal 'y_x'"),
        (
            lambda m: m["origin"]["tune"].extend(m["origin"]["calibrate"]),
            "origin: data set .* used to calibrate and to",
        ),
        (lambda m: m.update(graph="other.onnx"), "graph: 'other.onnx' is not in files"),
        (lambda m: m["files"].update({"../x": {"sha256": "0", "size": 1}}), "files: '../x' is not a plain file name"),
    ],
)
def test_what_the_manifest_cannot_mean_is_named_by_its_path(
    bundle: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    edit(bundle, change)
    with pytest.raises(BundleError, match=message) as caught:
        load_bundle(bundle)
    assert str(bundle) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_manifest_that_is_not_json_is_refused(bundle: Path) -> None:
    (bundle / "manifest.json").write_bytes(b'{"schema": "faultline.bundle/1", ')
    with pytest.raises(BundleError, match="not JSON"):
        load_bundle(bundle)


def test_golden_vectors_catch_a_machine_that_computes_something_else(bundle: Path) -> None:
    loaded = load_bundle(bundle)
    loaded.golden.r[30][4] += 0.01
    with pytest.raises(BundleError, match=r"golden vector 30: t10.ode is off by 0.01"):
        verify_golden(loaded)


def test_show_and_verify(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert show.main(["verify", str(bundle)]) == 0
    assert "golden vectors agree" in capsys.readouterr().out
    assert show.main(["show", str(bundle)]) == 0
    out = capsys.readouterr().out
    assert "t21.ode" in out
    assert "fA_du" in out
    assert show.main(["show", "--json", str(bundle)]) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "faultline.bundle/1"
