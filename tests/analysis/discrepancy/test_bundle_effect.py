"""Both bundles, of a model that is wrong and of the shipped one, on recordings of the rig and on the golden log."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from faultline.analysis.calibration.provenance import recordings_of
from faultline.analysis.discrepancy.add.bundle_effect import BundleEffect, bundle_effect, trial
from faultline.analysis.model import Model, load_model
from faultline.analysis.progress import Progress
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.vehicles import vehicle

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
GOLDEN_RUN = GOLDEN / "log", GOLDEN / "truth.toml"
UDS4 = load_model("uds")
WRONG = UDS4.with_parameters({"A_dos": 0.4 * UDS4.parameters["A_dos"].value}, {})
ONSET_S = 70.0


@dataclass(frozen=True)
class Runs:
    """Fault-free recordings: to tune on and to evaluate."""

    tuning: Path
    quiet: Path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    folder = tmp_path_factory.mktemp("rig")
    return Runs(recorded(folder, "tuning", 11, 180.0), recorded(folder, "quiet", 12, 60.0))


def recorded(folder: Path, name: str, seed: int, duration_s: float) -> Path:
    asked = Request(name, vehicle("bench"), CYCLES["validation"], (), seed, duration_s, kind="instrumented")
    path, _ = record(asked, load_dbc(), folder / "out", folder / "truth", force=False, progress=lambda _: None)
    return path


def effect(before: Model, after: Model, tuning: list[Path], *evaluation: tuple[Path, Path | None]) -> BundleEffect:
    with Progress("bundles") as progress:
        used = {
            sha: "calibrate the model or to discover its effects"
            for model in (before, after)
            for sha in recordings_of(model)
        }
        return bundle_effect(before, after, trial(used, tuning, evaluation, progress.note), progress)


@pytest.fixture(scope="module")
def corrected(runs: Runs) -> BundleEffect:
    return effect(WRONG, UDS4, [runs.tuning], GOLDEN_RUN, (runs.quiet, None))


def test_the_better_model_tolerates_less_where_the_wrong_flow_mattered(corrected: BundleEffect) -> None:
    shares = corrected.tolerances
    assert set(shares) == {g.test for g in corrected.after.generators}
    assert shares["t12"] < 0.5  # predicts the pressure after the pump from the flow out of the dosing unit
    assert shares["t08"] == pytest.approx(1.0, abs=0.1)  # it has no dosing valve; its day is known by the others too
    sentence = corrected.sentences()[2]
    assert sentence.startswith("lasting deviation that is tolerated: t")
    assert sentence.endswith(" times, the others as much as before")
    assert f"t12 {shares['t12']:.2g} times, " in sentence


def test_both_are_judged_on_the_same_recordings_by_their_truths(corrected: BundleEffect, runs: Runs) -> None:
    for bundled in (corrected.before, corrected.after):
        assert bundled.reason is None
        assert [g.test for g in bundled.generators][:2] == ["t02", "t06"]
        assert set(bundled.judged) == {"golden", "quiet"}
        assert bundled.judged["golden"].verdict.faults == ["fA_du"]
        assert bundled.judged["golden"].hours == pytest.approx(ONSET_S / 3600.0, rel=0.05)
        assert bundled.hours == pytest.approx((ONSET_S + 60.0) / 3600.0, rel=0.05)
    after = corrected.after.judged["golden"].verdict
    assert (after.detected, after.contained, after.false_alarms) == (True, True, 0)
    last = corrected.sentences()[-1]
    assert last.startswith("golden, fA_du: ")
    told = last.rpartition(" without the effect, ")[2]
    assert told.startswith(f"detected after {after.delay_s:g} s, ranked first {', '.join(after.first)}")
    assert all(name in told for name in after.isolated)
    assert msgspec.json.decode(msgspec.json.encode(corrected), type=BundleEffect) == corrected


def test_a_model_that_cannot_become_a_bundle_says_why(runs: Runs) -> None:
    """Here without a pressure sensor."""
    sensors = {"y_p_tp", "y_p_ap", "y_p_du"}
    bare = dataclasses.replace(
        UDS4,
        known={name: known for name, known in UDS4.known.items() if name not in sensors},
        unknown={
            name: dataclasses.replace(u, initial=u.initial[-1:], initial_text=u.initial_text[-1:])
            for name, u in UDS4.unknown.items()
        },
        equations={
            name: e for name, e in UDS4.equations.items() if not sensors & {s.name for s in e.expression.free_symbols}
        },
    )
    found = effect(bare, bare, [runs.tuning])
    assert str(found.after.reason).startswith("uds: no test can be run (there is no redundancy); add a sensor")
    assert found.tolerances == {}
    assert found.sentences() == [
        f"without the effect: there is no bundle: {found.before.reason}",
        f"with it: there is no bundle: {found.after.reason}",
    ]


def test_a_recording_that_shows_too_little_to_tune_on_is_the_models_reason(runs: Runs) -> None:
    found = effect(UDS4, UDS4, [runs.quiet])
    assert found.before.reason is not None
    assert "add a fault-free recording" in found.before.reason


def test_without_a_truth_a_recording_is_taken_as_fault_free_and_that_is_said(corrected: BundleEffect) -> None:
    assert corrected.after.judged["quiet"].assumed
    assert not corrected.after.judged["golden"].assumed
    for sentence in corrected.sentences()[:2]:
        assert sentence.endswith(" min without a fault (quiet taken as fault-free: no truth was given)")


def test_recordings_that_were_used_are_refused(runs: Runs) -> None:
    for command, key in (("calibrate", "recordings"), ("discover", "recordings"), ("discover", "held_out")):
        entry = {"command": command, key: [open_log(runs.tuning).sha256]}
        with pytest.raises(InputError, match=r"tuning: this recording was used to calibrate the model or to discover"):
            effect(UDS4, UDS4.with_parameters({}, entry), [runs.tuning])
    with pytest.raises(
        InputError, match=r"tuning: this recording was used to tune; give one of its own to evaluate on"
    ):
        effect(UDS4, UDS4, [runs.tuning], (runs.tuning, None))
    with pytest.raises(InputError, match=r"^no recording to tune on; give fault-free recordings"):
        effect(UDS4, UDS4, [])


def test_the_truth_of_another_recording_is_refused(runs: Runs) -> None:
    with pytest.raises(InputError, match=r"truth.toml: is about 'golden', not about 'quiet'; give the truth of that"):
        effect(UDS4, UDS4, [runs.tuning], (runs.quiet, GOLDEN / "truth.toml"))
