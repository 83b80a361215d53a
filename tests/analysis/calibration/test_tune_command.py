"""Several vehicles, a target, and adaptation in the workshop, by the commands alone; vehicles are the model itself."""

import contextlib
import dataclasses
import hashlib
import io
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from made_drive import DBC, ECU, HOLD_S, UDS4, frames, freed, write_recording

from faultline.analysis.export import main as export
from faultline.analysis.model import Model, dump_model
from faultline.analysis.tuning.adapt import LEAST
from faultline.analysis.tuning.command import main as tune
from faultline.analysis.tuning.file import Tuning, load_tuning
from faultline.analysis.tuning.thresholds import MARGIN
from faultline.service.bundle.command import main as show
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import CusumDetector
from faultline.service.logs import open_log

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge


Array = npt.NDArray[np.float64]

ZERO = {"y_p_ap": 0.0}


def of(vehicle: str, recordings: tuple[str, ...] = ()) -> Model:
    """The model as if it had been calibrated for a vehicle."""
    entry: Mapping[str, object] = {"command": "calibrate", "recordings": [*recordings], "vehicle": vehicle}
    return dataclasses.replace(freed(UDS4, ()), provenance=(entry,))


@dataclass(frozen=True)
class Fleet:
    """Models of vehicles `a` and `b`, two drives of each, and a base tuned on those of `a`."""

    folder: Path
    a: Path
    b: Path
    drives: dict[str, Path]
    base: Path

    def tune(self, *words: str | Path) -> Tuning:
        out = self.folder / "out.json"
        with contextlib.redirect_stdout(io.StringIO()):
            assert tune([*map(str, words), "--out", str(out)]) == 0
        return load_tuning(out)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    folder = tmp_path_factory.mktemp("fleet")
    drives = {}
    for seed, name in enumerate(("a1", "a2", "b1", "b2"), 30):
        drives[name] = write_recording(folder / name, frames(UDS4, {}, seed, zero=ZERO), name[0])
    models = {name: folder / f"{name}.toml" for name in "ab"}
    for name, path in models.items():
        path.write_text(dump_model(of(name)))
    base = folder / "base.json"
    with contextlib.redirect_stdout(io.StringIO()):
        assert tune([str(models["a"]), str(drives["a1"]), str(drives["a2"]), "--out", str(base)]) == 0
    return Fleet(folder, models["a"], models["b"], drives, base)


def test_tuning_says_what_it_can_claim(fleet: Fleet) -> None:
    claim = load_tuning(fleet.base).claim
    assert claim is not None
    assert (claim.vehicles, claim.drives, claim.left_out, claim.target, claim.result) == (1, 2, 2, None, None)
    assert claim.suspicions.upper is not None
    assert claim.suspicions.upper >= 3.0 / claim.suspicions.hours - 0.1
    assert claim.said.startswith("false alarms: 2 fault-free drives of 1 vehicle, 2 left out of tuning in turn")


def test_several_vehicles_and_a_target_travel_into_the_bundle(
    fleet: Fleet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    d, out, bundle = fleet.drives, tmp_path / "tuning.json", tmp_path / "bundle"
    also = ["--also", str(fleet.b), str(d["b1"]), str(d["b2"])]
    given = [str(fleet.a), str(d["a1"]), str(d["a2"]), *also, "--target", "0.01", "--out", str(out)]
    assert tune(given) == 0
    printed = capsys.readouterr().out
    tuning = load_tuning(out)
    claim = tuning.claim
    assert claim is not None
    assert claim.said in printed
    assert (claim.vehicles, claim.drives, claim.left_out, claim.target, claim.extrapolated) == (2, 4, 4, 0.01, True)
    assert claim.result in {"kept", "missed"}
    assert "to show it needs 300 h without one" in claim.said
    assert tuning.recordings == [open_log(d[name]).sha256 for name in ("a1", "a2", "b1", "b2")]
    usual = load_tuning(fleet.base)
    assert all(t.J > u.J for t, u in zip(tuning.detectors, usual.detectors, strict=True))
    dbc = tmp_path / "uds.dbc"
    dbc.write_bytes(DBC)
    assert export([str(fleet.a), "--tuning", str(out), "--dbc", str(dbc), "--out", str(bundle)]) == 0
    assert load_bundle(bundle).manifest.claim == claim


def test_without_a_target_other_vehicles_are_pooled_by_the_usual_rule(fleet: Fleet) -> None:
    """Each centred on its own offsets: the pooled spread is that of one, the offsets are the first one's."""
    d = fleet.drives
    both = fleet.tune(fleet.a, d["a1"], d["a2"], "--also", fleet.b, d["b1"], d["b2"])
    one = load_tuning(fleet.base)
    for pooled, own in zip(both.detectors, one.detectors, strict=True):
        assert pooled.offset == own.offset
        assert pooled.J >= 0.5 * own.J / MARGIN
    for name in {*both.evidence.generators} & {*one.evidence.generators}:
        pooled_one, own_one = (
            [row[e.generators.index(name)] for row in e.spread] for e in (both.evidence, one.evidence)
        )
        np.testing.assert_allclose(pooled_one, own_one, rtol=0.5)


@pytest.mark.parametrize(("kind", "count"), [("one-sided", 20), ("threshold", 10), ("low-pass", 10), ("adaptive", 10)])
def test_every_detector_can_be_asked_for_and_exported(fleet: Fleet, kind: str, count: int, tmp_path: Path) -> None:
    tuning = fleet.tune(fleet.a, fleet.drives["a1"], "--detector", kind, "--spread")
    assert len(tuning.detectors) == count + 10
    dbc, bundle = tmp_path / "uds.dbc", tmp_path / "bundle"
    dbc.write_bytes(DBC)
    assert (
        export([str(fleet.a), "--tuning", str(fleet.folder / "out.json"), "--dbc", str(dbc), "--out", str(bundle)]) == 0
    )
    assert load_bundle(bundle).manifest.detectors == tuning.detectors


def test_adapting_keeps_the_base_and_brings_the_offsets(
    fleet: Fleet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base, drive = load_tuning(fleet.base), fleet.drives["b1"]
    adapted = fleet.tune(fleet.b, drive, "--adapt", fleet.base)
    own = fleet.tune(fleet.b, drive)
    for mine, theirs, alone in zip(adapted.detectors, base.detectors, own.detectors, strict=True):
        assert isinstance(mine, CusumDetector)
        assert isinstance(theirs, CusumDetector)
        assert (mine.nu, mine.J, mine.scale) == (theirs.nu, theirs.J, theirs.scale)
        np.testing.assert_allclose(mine.offset, alone.offset)
        assert mine.offset != theirs.offset
    for part in ("noise", "visit"):  # no surer than the base, nor than this vehicle's own drive
        more = np.array(getattr(adapted.evidence, part)) - np.array(getattr(base.evidence, part))
        for mode in more:
            assert np.linalg.eigvalsh(mode).min() > -1e-6 * np.abs(getattr(base.evidence, part)).max()
    assert adapted.evidence.spread == base.evidence.spread
    assert adapted.evidence.allowance == base.evidence.allowance
    assert adapted.base == hashlib.sha256(fleet.base.read_bytes()).hexdigest()
    assert adapted.claim is None  # the base's is of drives of one vehicle
    assert adapted.statistics == own.statistics, "of this vehicle's drive"
    adapted_file = tmp_path / "adapted.json"
    adapted_file.write_bytes(msgspec.json.encode(adapted))
    dbc, bundle = tmp_path / "uds.dbc", tmp_path / "bundle"
    dbc.write_bytes(DBC)
    assert export([str(fleet.b), "--tuning", str(adapted_file), "--dbc", str(dbc), "--out", str(bundle)]) == 0
    assert load_bundle(bundle).manifest.origin.base == adapted.base
    assert adapted.base is not None
    assert show(["show", str(bundle)]) == 0
    told = capsys.readouterr().out
    assert "\nfalse alarms: nothing is claimed of them\nadapted to this vehicle from the tuning " in told
    assert f"{adapted.base[:12]} of others\n" in told


def drifts_of(tuning: Tuning) -> dict[str, Array]:
    """By generator, those that are no evidence too: how far each drift moves it (drift, mode)."""
    evidence = tuning.evidence
    own = {name: np.array(evidence.drifts)[..., column] for column, name in enumerate(evidence.generators)}
    return own | {follower.generator: np.array(follower.drifts) for follower in evidence.followers}


@pytest.fixture(scope="module")
def leaky(fleet: Fleet) -> tuple[Path, Path]:
    """A vehicle `c` whose pump leaks three times as much, so that viscosity moves its flow by more: model and drive."""
    leak = {"C_v": 3.0 * UDS4.parameters["C_v"].value}
    model = fleet.folder / "c.toml"
    model.write_text(dump_model(of("c").with_parameters(leak, {"command": "by hand"})))
    return model, write_recording(fleet.folder / "c1", frames(UDS4, leak, 50, zero=ZERO), "c")


def test_drifts_of_an_adapted_vehicle_are_those_of_its_own_model(fleet: Fleet, leaky: tuple[Path, Path]) -> None:
    base = drifts_of(load_tuning(fleet.base))
    adapted, own = (drifts_of(fleet.tune(*leaky, *more)) for more in (("--adapt", fleet.base), ()))
    assert {*adapted} == {*own} == {*base}
    for name in own:
        np.testing.assert_allclose(adapted[name], own[name], rtol=1e-9, atol=1e-6)
    viscosity = np.array([np.linalg.norm(drifts["t12.ode"][0]) for drifts in (base, adapted)])
    assert viscosity[1] > 2.0 * viscosity[0] > 1000.0


def test_how_large_drifts_are_is_the_bases_and_what_no_model_names_stays(
    fleet: Fleet, leaky: tuple[Path, Path], tmp_path: Path
) -> None:
    base = load_tuning(fleet.base)
    assert base.drift_sizes == [1.0] * 5  # eight drives are too few to see it
    K, sizes, unnamed = len(base.evidence.generators), [0.5, 1.0, 1.5, 1.0, 2.0], [7.0] * len(UDS4.modes.names)
    evidence = msgspec.structs.replace(
        base.evidence,
        drifts=[*base.evidence.drifts, [[5.0] * K] * len(UDS4.modes.names)],
        followers=[msgspec.structs.replace(f, drifts=[*f.drifts, unnamed]) for f in base.evidence.followers],
    )
    path = tmp_path / "base.json"
    path.write_bytes(msgspec.json.encode(msgspec.structs.replace(base, evidence=evidence, drift_sizes=sizes)))
    adapted, own = (fleet.tune(*leaky, *more) for more in (("--adapt", path), ()))
    for name, drifts in drifts_of(adapted).items():
        wanted = np.array(sizes)[:, None] * drifts_of(own)[name]
        np.testing.assert_allclose(drifts[:5], wanted, rtol=1e-9, atol=1e-6)
        np.testing.assert_array_equal(drifts[5], 5.0 if name in evidence.generators else 7.0)
    assert adapted.drift_sizes == sizes


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        (None, "does not say how large its drifts are; run `faultline tune` for it again"),
        ([1.0] * 4, "its drifts are not the model's; adapt a base of the same model"),
        ([1.0] * 6, "its drifts are not the model's; adapt a base of the same model"),
    ],
)
def test_a_base_whose_drifts_are_not_known_is_refused(
    fleet: Fleet, leaky: tuple[Path, Path], tmp_path: Path, sizes: list[float] | None, message: str
) -> None:
    path = tmp_path / "base.json"
    path.write_bytes(msgspec.json.encode(msgspec.structs.replace(load_tuning(fleet.base), drift_sizes=sizes)))
    with pytest.raises(InputError, match=f"{path}: {message}"):
        fleet.tune(*leaky, "--adapt", path)


def test_what_an_adapted_tuning_claims_is_said(
    fleet: Fleet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = load_tuning(fleet.base)
    assert base.claim is not None
    several = tmp_path / "several.json"
    several.write_bytes(
        msgspec.json.encode(msgspec.structs.replace(base, claim=msgspec.structs.replace(base.claim, vehicles=2)))
    )
    for path, said in ((fleet.base, "nothing is claimed of this vehicle: the base has no"), (several, base.claim.said)):
        given = [fleet.b, fleet.drives["b1"], "--adapt", path, "--out", tmp_path / "out.json"]
        assert tune([*map(str, given)]) == 0
        assert said in capsys.readouterr().out


@pytest.mark.parametrize("bias", [20_000.0, -20_000.0])
def test_a_fault_that_is_there_is_not_adapted_away(fleet: Fleet, bias: float, tmp_path: Path) -> None:
    biased = write_recording(tmp_path / "biased", frames(UDS4, {}, 40, zero={"y_p_du": bias}), "b")
    message = r"biased: t\d\d.ode lies .* off in mode '\w+', [\d.]+ standard deviations of what .*base.json makes plaus"
    with pytest.raises(InputError, match=message):
        fleet.tune(fleet.b, biased, "--adapt", fleet.base)


def test_a_fault_in_a_drive_to_tune_on_is_told(
    fleet: Fleet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is no error: a day may be like that, and only the user knows."""
    biased = write_recording(tmp_path / "biased", frames(UDS4, {}, 40, zero={"y_p_du": 20_000.0}), "a")
    fleet.tune(fleet.a, fleet.drives["a1"], fleet.drives["a2"], biased)
    told = [line for line in capsys.readouterr().err.splitlines() if "from the other drives" in line]
    assert len(told) == 1
    assert re.match(
        r"biased: t\d\d.ode lies [\d.]+ standard deviations from the other drives in mode '\w+' \(4", told[0]
    )


def test_adapting_needs_every_mode_for_long_enough(fleet: Fleet, tmp_path: Path) -> None:
    log = [frame for frame in frames(UDS4, {}, 41, zero=ZERO) if frame.t < 3 * HOLD_S + 15.0]
    short = write_recording(tmp_path / "short", log, "b")
    with pytest.raises(
        InputError, match=rf"short: saw mode .*'maximum' for \d+ s.*, {LEAST * UDS4.settling_s:.0f} s are needed; add"
    ):
        fleet.tune(fleet.b, short, "--adapt", fleet.base)


def test_nobody_is_told_to_stay_at_an_edge(fleet: Fleet, tmp_path: Path) -> None:
    """A long drive of few steps: the added sensors are lost until some seconds after each of them."""
    log = [f for f in frames(UDS4, {}, 42, zero=ZERO) if f.can_id == ECU or f.t % HOLD_S > 8.0 or f.t > 4 * HOLD_S]
    calm = write_recording(tmp_path / "calm", log, "b")
    with pytest.raises(InputError) as caught:
        fleet.tune(fleet.b, calm, "--adapt", fleet.base)
    assert re.search(r"calm: saw mode .*'edge' for \d+ s, 20 s are needed; add a fault-free drive", str(caught.value))
    assert str(caught.value).endswith("with more steps of the inputs, or lower those of [edges]")


def test_adapting_refuses_recordings_of_base_or_calibration(fleet: Fleet, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a1: this recording is used in the base; tune on"):
        fleet.tune(fleet.a, fleet.drives["a1"], "--adapt", fleet.base)
    seen = open_log(fleet.drives["b1"]).sha256
    model = tmp_path / "b.toml"
    model.write_text(dump_model(of("b", recordings=(seen,))))
    with pytest.raises(InputError, match=r"b1: this recording is used to make the model; tune on"):
        fleet.tune(model, fleet.drives["b1"], "--adapt", fleet.base)
    model.write_text(dump_model(of("b", recordings=(load_tuning(fleet.base).recordings[0],))))
    with pytest.raises(InputError, match=r"base.json: its recording [0-9a-f]{12} has made the model; take a base with"):
        fleet.tune(model, fleet.drives["b1"], "--adapt", fleet.base)


def test_a_drive_that_made_the_model_is_refused_when_ingested_again(fleet: Fleet, tmp_path: Path) -> None:
    """With another clock its log is another one; the drive is known by the bench's own."""
    again = write_recording(tmp_path / "again", frames(UDS4, {}, 32, zero=ZERO), "b")
    with (again / "recording.toml").open("a") as described:
        described.write(f'bench_sha256 = "{"0" * 64}"\n')
    model = tmp_path / "b.toml"
    model.write_text(dump_model(of("b", recordings=("0" * 64,))))
    with pytest.raises(InputError, match=r"again: this recording is used to make the model; tune on"):
        fleet.tune(model, again)
    assert fleet.tune(fleet.b, again).recordings == ["0" * 64]


def test_adapting_refuses_a_base_of_other_tests_modes_or_schema(fleet: Fleet, tmp_path: Path) -> None:
    base = load_tuning(fleet.base)
    given: list[str | Path] = [fleet.b, fleet.drives["b1"], "--adapt", tmp_path / "base.json"]

    def written(changed: Tuning) -> None:
        (tmp_path / "base.json").write_bytes(msgspec.json.encode(changed))

    written(msgspec.structs.replace(base, detectors=base.detectors[1:]))
    with pytest.raises(InputError, match=r"base.json: its tests are t06.ode, .* those of uds t02.ode, .*; adapt a ba"):
        fleet.tune(*given)
    written(msgspec.structs.replace(base, modes=msgspec.structs.replace(base.modes, settle_s=3)))
    with pytest.raises(InputError, match=r"base.json: its operating modes or period are not the model's; adapt a"):
        fleet.tune(*given)
    written(msgspec.structs.replace(base, networks_sha256="0" * 64))
    with pytest.raises(InputError, match=r"base.json: has networks, which are of one vehicle only; adapt a base witho"):
        fleet.tune(*given)
    written(msgspec.structs.replace(base, schema="faultline.tuning/1"))
    with pytest.raises(InputError, match=r"base.json: schema: this is 'faultline.tuning/1', wanted is .*; run `faultl"):
        fleet.tune(*given)


@pytest.mark.parametrize("more", [(), ("--adapt",)])
def test_a_recording_of_too_few_sensors_is_refused(fleet: Fleet, more: tuple[str, ...], tmp_path: Path) -> None:
    few = Path(shutil.copytree(fleet.drives["b1"], tmp_path / "few"))
    described = (few / "recording.toml").read_text()
    (few / "recording.toml").write_text(described.replace('sensor_set = "instrumented"', 'sensor_set = "production"'))
    message = r"few/recording.toml: sensor_set is 'production', the model uds needs 'instrumented'; give recordings of"
    with pytest.raises(InputError, match=message):
        fleet.tune(fleet.b, few, *more, *([fleet.base] if more else []))


def test_a_model_that_was_never_calibrated_is_tuned_and_that_is_said(
    fleet: Fleet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = tmp_path / "raw.toml"
    raw.write_text(dump_model(dataclasses.replace(freed(UDS4, ()), provenance=())))
    fleet.tune(fleet.a, fleet.drives["a1"])
    assert "calibrated on no recording" not in capsys.readouterr().err
    fleet.tune(raw, fleet.drives["a1"])
    assert f"{raw}: calibrated on no recording: its residuals are off by as much as its" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_told_before_any_work(fleet: Fleet, tmp_path: Path) -> None:
    """Before the model is even looked at."""
    (tmp_path / "file").touch()
    for out, words in (
        (tmp_path, f"Is a directory: '{tmp_path}'"),
        (tmp_path / "file/x", f"Not a directory: '{tmp_path}/file'"),
    ):
        with pytest.raises(OSError, match=words):
            tune(["no-model.toml", str(fleet.drives["a1"]), "--out", str(out)])


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_a_target_that_is_no_rate_is_refused(fleet: Fleet, rate: str) -> None:
    with pytest.raises(InputError, match=r"--target .*: a rate is a positive number of suspicions per hour; give one"):
        fleet.tune(fleet.a, fleet.drives["a1"], f"--target={rate}")


def test_also_refuses_what_is_no_other_vehicle_of_the_kind(fleet: Fleet, tmp_path: Path) -> None:
    d = fleet.drives
    with pytest.raises(InputError, match=r"--also .*b.toml: no recording of that vehicle; give its model file and its"):
        fleet.tune(fleet.a, d["a1"], "--also", fleet.b)
    with pytest.raises(InputError, match=r"a2: recorded on vehicle 'a', the calibration of uds is of 'b'"):
        fleet.tune(fleet.a, d["a1"], "--also", fleet.b, d["a2"])
    with pytest.raises(InputError, match=r"--also 1: its model is of 'a' again; name the drives of a vehicle together"):
        fleet.tune(fleet.a, d["a1"], "--also", fleet.a, d["a2"])
    other = tmp_path / "other.toml"
    other.write_text(dump_model(dataclasses.replace(of("b"), warm_up_s=5.0)))
    with pytest.raises(
        InputError, match=r"--also 1: .*: its tests are not those of uds \(.*\); give vehicles that wer"
    ):
        fleet.tune(fleet.a, d["a1"], "--also", other, d["b1"])
    with pytest.raises(InputError, match=r"b1: this recording is used twice; tune on"):
        fleet.tune(fleet.a, d["a1"], "--also", fleet.b, d["b1"], d["b1"])
    with pytest.raises(
        InputError, match=r"--also with --networks: networks are of one vehicle only; leave one of them"
    ):
        fleet.tune(fleet.a, d["a1"], "--also", fleet.b, d["b1"], "--networks", tmp_path)
    with pytest.raises(InputError, match=r"--adapt with --target: the base says that; leave it out, or tune the base"):
        fleet.tune(fleet.b, d["b1"], "--adapt", fleet.base, "--target", "1")


def test_also_refuses_a_vehicle_that_hardly_shows_a_mode(fleet: Fleet, tmp_path: Path) -> None:
    """Whatever the first one shows: how this one's residuals lie there is unknown."""
    partial = write_recording(tmp_path / "partial", [f for f in frames(UDS4, {}, 6, zero=ZERO) if f.t < 90.0], "b")
    with pytest.raises(InputError, match=r"tuning data \(partial\): t02.ode saw mode 'maximum' for 0 ticks only; add"):
        fleet.tune(fleet.a, fleet.drives["a1"], "--also", fleet.b, partial)


def test_the_base_says_how_far_from_zero_offsets_lie(fleet: Fleet) -> None:
    """Of one vehicle: its own."""
    base = load_tuning(fleet.base)
    own = [abs(detector.offset[IDLE]) for detector in base.detectors]
    np.testing.assert_allclose([of_generator[IDLE] for of_generator in base.zero], own)
