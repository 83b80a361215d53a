"""A bundle folder is whole or refused: nothing changed, missing, added or of another version gets past."""

import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from made_bundle import GOLDEN, check_line, copied, edit, put, refused, write

from faultline.service.bundle import command as bundles
from faultline.service.bundle.files import BundleError, seal
from faultline.service.bundle.live import check_live, tick_cost_s
from faultline.service.bundle.load import load_bundle, verify_golden

FILES = ["ode.onnx", "faults.onnx", "uds.dbc", "golden.json"]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return copied(tmp_path)


def test_the_golden_bundle_loads_and_computes_what_was_exported(bundle: Path) -> None:
    loaded = load_bundle(bundle)
    verify_golden(loaded)
    assert loaded.id == hashlib.sha256((bundle / "manifest.json").read_bytes()).hexdigest()
    names = [generator.test for generator in loaded.manifest.generators]
    assert names == ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20", "t21"]


def test_the_seal_is_what_sha256sum_writes_and_checks(bundle: Path) -> None:
    made = subprocess.run(["sha256sum", "manifest.json"], cwd=bundle, capture_output=True, check=True).stdout
    assert (bundle / "manifest.sha256").read_bytes() == seal((bundle / "manifest.json").read_bytes()) == made
    subprocess.run(["sha256sum", "--check", "--strict", "manifest.sha256"], cwd=bundle, check=True)


@pytest.mark.parametrize("name", FILES)
def test_a_changed_byte_in_any_file_is_refused(bundle: Path, name: str) -> None:
    content = bytearray((bundle / name).read_bytes())
    content[len(content) // 2] ^= 1
    (bundle / name).write_bytes(content)
    refused(bundle, rf"{name}: its bytes differ from the manifest's SHA-256; copy the bundle again")


def test_a_changed_byte_in_the_manifest_is_refused_though_it_still_makes_sense(bundle: Path) -> None:
    """The threshold of the first detector begins with a 9: nothing but the seal could tell."""
    raw = (bundle / "manifest.json").read_bytes()
    (bundle / "manifest.json").write_bytes(re.sub(rb'"J": \d', b'"J": 9', raw, count=1))
    assert (bundle / "manifest.json").read_bytes() != raw
    refused(bundle, r"manifest\.sha256: the bytes of manifest\.json differ from it; copy the bundle again")


def test_the_seal_is_looked_at_before_the_manifest_is_parsed(bundle: Path) -> None:
    (bundle / "manifest.json").write_bytes(b"{")
    refused(bundle, r"manifest\.sha256: the bytes of manifest\.json differ")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"a" * 64,
        b"a" * 63 + b"  manifest.json\n",
        b"A" * 64 + b"  manifest.json\n",
        b"a" * 64 + b"  other.json\n",
        b"a" * 64 + b"  manifest.json\r\n",
        b"a" * 64 + b"  manifest.json\n" + b"a" * 64 + b"  uds.dbc\n",
        b"\xff\xfe\x00",
    ],
)
def test_a_malformed_seal_is_refused(bundle: Path, content: bytes) -> None:
    (bundle / "manifest.sha256").write_bytes(content)
    refused(bundle, r"manifest\.sha256: not one line of `sha256sum manifest\.json`; copy the bundle again")


@pytest.mark.parametrize("name", [*FILES, "manifest.json", "manifest.sha256"])
def test_a_missing_file_is_named(bundle: Path, name: str) -> None:
    (bundle / name).unlink()
    refused(bundle, f"{name}: not found; ")


def test_what_the_manifest_does_not_list_is_refused_by_name(bundle: Path) -> None:
    (bundle / ".hidden").touch()
    (bundle / "old").mkdir()
    refused(bundle, r"the manifest does not list '\.hidden', 'old'; remove what is not part of the bundle")


def test_many_files_too_many_are_told_in_one_short_line(bundle: Path) -> None:
    for number in range(300):
        (bundle / f"copy {number:03}\nof it").touch()
    refused(bundle, r"does not list 'copy 000\\nof it', .* 'copy 004\\nof it', \.\.\.; remove")


def test_a_folder_in_the_place_of_a_file_is_refused(bundle: Path) -> None:
    (bundle / "ode.onnx").unlink()
    (bundle / "ode.onnx").mkdir()
    refused(bundle, r"ode\.onnx: is no plain file; the manifest lists it")


@pytest.mark.parametrize("name", [*FILES, "manifest.json", "manifest.sha256"])
def test_a_file_of_absurd_size_is_not_even_read(bundle: Path, name: str) -> None:
    with (bundle / name).open("r+b") as file:
        file.truncate(100 * 2**30)  # sparse
    refused(bundle, f"{name}: larger than 67108864 bytes")


@pytest.mark.parametrize("name", [*FILES, "manifest.json"])
def test_a_link_is_not_followed(bundle: Path, name: str) -> None:
    """Nobody has looked at the folder yet: the link may lead to what its sender may not read."""
    (bundle / name).rename(bundle.parent / "elsewhere")
    (bundle / name).symlink_to(bundle.parent / "elsewhere")
    refused(bundle, f"{name}: is a link")


def test_what_never_ends_is_not_waited_for(bundle: Path) -> None:
    (bundle / "manifest.json").unlink()
    os.mkfifo(bundle / "manifest.json")
    refused(bundle, "is no plain file")


def test_signatures_are_few_and_small(bundle: Path) -> None:
    for number in range(17):
        (bundle / f"manifest.{number:016X}.minisig").write_bytes(b"x")
    refused(bundle, "17 signatures, 16 are the most")
    for number in range(1, 17):
        (bundle / f"manifest.{number:016X}.minisig").unlink()
    (bundle / f"manifest.{0:016X}.minisig").write_bytes(bytes(5000))
    refused(bundle, "larger than 4096 bytes")


def test_a_file_that_cannot_be_read_is_refused(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path, _flags: int) -> int:
        raise OSError(5, "Input/output error", str(path))

    monkeypatch.setattr("os.open", broken)
    refused(bundle, r"manifest\.json: cannot be read: Input/output error; check the folder's permissions")


@pytest.mark.parametrize("schema", ["faultline.bundle/6", "faultline.bundle/8", "other/1"])
def test_an_unknown_version_is_refused_before_anything_else(bundle: Path, schema: str) -> None:
    edit(bundle, lambda manifest: manifest.update(schema=schema, something_new=1))
    refused(bundle, f"schema: this is '{schema}', this faultline runs 'faultline.bundle/7'")


@pytest.mark.parametrize(
    "raw",
    [b"", b'{"schema": "faultline.bundle/7", ', b'{"a": ' + b"[" * 100_000, b'{"schema": "\\ud800"}', b"\xff\xfe{"],
)
def test_a_manifest_that_is_not_json_is_refused(bundle: Path, raw: bytes) -> None:
    write(bundle, raw)
    refused(bundle, r"manifest\.json: (not JSON|top level|schema)")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe", r"uds\.dbc: not a valid DBC file: "),
        (b"BO_ 1 A: x", r"uds\.dbc: not a valid DBC file: "),
        (b'VERSION ""\n\nBS_:\n\nBU_: A\n', r"uds\.dbc: no message carries y_p_tp, y_p_ap"),
    ],
)
def test_a_dbc_that_cannot_feed_the_generators_is_refused(bundle: Path, content: bytes, message: str) -> None:
    put(bundle, "uds.dbc", content)
    refused(bundle, message)


@pytest.mark.parametrize("content", [b"", b"garbage" * 100, (GOLDEN / "ode.onnx").read_bytes()[:10_000]])
def test_a_graph_that_is_none_is_refused(bundle: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    put(bundle, "ode.onnx", content)
    refused(bundle, r"ode\.onnx: .*; only graphs that `faultline export` wrote are run")
    assert capfd.readouterr() == ("", "")


def test_a_graph_with_other_outputs_is_refused(bundle: Path) -> None:
    put(bundle, "ode.onnx", (bundle / "ode.onnx").read_bytes().replace(b"sigma", b"sigmb"))
    refused(bundle, r"ode\.onnx: its outputs are 'r', .*'sigmb', 'x_next', not r, y_hat, sigma, x_next; ")


def test_a_period_that_graphs_were_not_exported_with_is_refused(bundle: Path) -> None:
    edit(bundle, lambda manifest: manifest.update(period_s=0.4))
    refused(bundle, r"ode\.onnx: was exported with period_s 0\.2, not 0\.4 of the manifest; export the bundle again")


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ({b"period_s": b"0.4"}, r"was exported with period_s 0\.4, not 0\.2 of the manifest; export"),
        ({b"other": b"1"}, r"was exported with period_s missing, not 0\.2 of the manifest; export"),
        ({b"period_s": b"0.2"}, r"was exported with other inputs than those of the manifest; export"),
        ({b"period_s": b"\xff" * 300}, r"ode\.onnx: .*; export"),
    ],
)
def test_a_graph_of_another_period_is_refused(bundle: Path, metadata: dict[bytes, bytes], message: str) -> None:
    """Metadata are `metadata_props` of a model, field 14: entries of a key, field 1, and a value, field 2."""
    raw = without_metadata((bundle / "ode.onnx").read_bytes())
    for key, value in metadata.items():
        entry = b"\x0a" + varint(len(key)) + key + b"\x12" + varint(len(value)) + value
        raw += b"\x72" + varint(len(entry)) + entry
    put(bundle, "ode.onnx", raw)
    refused(bundle, message)


def without_metadata(model: bytes) -> bytes:
    """The model without its fields 14; all others are of a number (wire type 0) or of a length (2)."""
    kept, at = b"", 0
    while at < len(model):
        start = at
        tag, at = model[at], at + 1
        number, at = read_varint(model, at)
        at += number if tag & 7 == 2 else 0
        kept += model[start:at] if tag >> 3 != 14 else b""
    return kept


def read_varint(raw: bytes, at: int) -> tuple[int, int]:
    number, shift = 0, 0
    while True:
        number |= (raw[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if raw[at - 1] < 0x80:
            return number, at


def varint(number: int) -> bytes:
    return bytes([number]) if number < 0x80 else bytes([number & 0x7F | 0x80, number >> 7])


def test_a_graph_that_breaks_while_it_runs_is_refused(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from onnxruntime.capi.onnxruntime_pybind11_state import InvalidArgument

    def broken(*_: object, **__: object) -> None:
        raise InvalidArgument("[ONNXRuntimeError] : 2 :\nno such shape")

    loaded = load_bundle(bundle)
    monkeypatch.setattr("faultline.service.core.residuals.generators.GeneratorBank.step", broken)
    with pytest.raises(BundleError, match=r"golden vector 0: \[ONNXRuntimeError\] : 2 : no such shape;") as caught:
        verify_golden(loaded)
    check_line(bundle, caught.value)


@pytest.mark.parametrize(
    ("z", "r", "message"),
    [
        ([], [], "0 z and 0 r, not as many, at least one"),
        ([[0.0] * 5] * 2, [[0.0] * 10], "2 z and 1 r, not as many"),
        ([[0.0] * 5, [0.0] * 4], [[0.0] * 10] * 2, r"z\[1\]: has length 4, but there are 5 inputs"),
        ([[0.0] * 5], [[0.0] * 11], r"r\[0\]: has length 11, but there are 10 generators"),
        ([[0.0] * 5], [[None] * 10], r"r\[0\]\[0\]: Expected `float`, got `null`"),
        ({}, [], r"z: Expected `array`, got `object`"),
    ],
)
def test_golden_vectors_of_another_shape_are_refused(bundle: Path, z: object, r: object, message: str) -> None:
    put(bundle, "golden.json", json.dumps({"z": z, "r": r, "shift": []}).encode())
    refused(bundle, rf"golden\.json: {message}")


@pytest.mark.parametrize(
    ("shift", "message"),
    [
        ([], "0 shift, not one for each hypothesis"),
        ([[0.0] * 2] * 41, r"shift\[0\]: has length 2, but there are \d evidence generators"),
    ],
)
def test_golden_shifts_of_another_shape_are_refused(bundle: Path, shift: object, message: str) -> None:
    golden = json.loads((bundle / "golden.json").read_bytes())
    put(bundle, "golden.json", json.dumps(golden | {"shift": shift}).encode())
    refused(bundle, rf"golden\.json: {message}")


def test_golden_shifts_catch_a_machine_that_computes_hypotheses_otherwise(bundle: Path) -> None:
    loaded = load_bundle(bundle)
    loaded.golden.shift[12][1] += 0.01
    name = loaded.manifest.evidence.hypotheses[12].fault
    with pytest.raises(BundleError, match=rf"golden vectors: {name} of size .* is off by 0.01"):
        verify_golden(loaded)


def test_golden_vectors_catch_a_machine_that_computes_something_else(bundle: Path) -> None:
    loaded = load_bundle(bundle)
    loaded.golden.r[30][4] += 0.01
    with pytest.raises(BundleError, match=r"golden vector 30: t10.ode is off by 0.01") as caught:
        verify_golden(loaded)
    check_line(bundle, caught.value)


def test_show_and_verify(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert bundles.main(["verify", str(bundle)]) == 0
    assert "the seal holds, 4 files are whole, 150 golden vectors agree" in capsys.readouterr().out
    assert bundles.main(["show", str(bundle)]) == 0
    out = capsys.readouterr().out
    assert "t21.ode" in out
    assert "fA_du" in out
    assert bundles.main(["show", "--json", str(bundle)]) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "faultline.bundle/7"


def test_nothing_is_left_in_the_home_folder_and_nobody_is_called(tmp_path: Path) -> None:
    """onnxruntime would keep a device id there, and look up its maker's server: the first in no time at all."""
    clean = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    verify = [str(Path(sys.executable).with_name("faultline")), "bundle", "verify", str(GOLDEN)]
    subprocess.run(verify, check=True, env={**clean, "HOME": str(tmp_path)}, stdout=subprocess.DEVNULL)
    assert list(tmp_path.rglob("*")) == []


def test_a_tick_that_costs_more_than_a_tenth_of_its_period_is_no_tick_for_the_vehicle(
    bundle: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_live(load_bundle(bundle))
    monkeypatch.setattr("faultline.service.bundle.live.tick_cost_s", lambda _: 0.021)
    with pytest.raises(BundleError, match="a tick costs 21 ms on this machine, more than a tenth of its period"):
        check_live(load_bundle(bundle))


def test_the_cost_of_a_tick_is_measured(bundle: Path) -> None:
    assert tick_cost_s(load_bundle(bundle)) > 0.0
