"""A recording read back and drawn: every signal on its logger's clock, faults shaded where the truth says."""

import shutil
from collections.abc import Callable
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from faultline.testbench.bus import Knowledge
from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES
from faultline.testbench.recorded import read_recording
from faultline.testbench.simulation import simulate
from faultline.testbench.vehicles import VEHICLES

DURATION = 70.0
FAULT = ["--fault", "off_p_du", "--size", "1", "--onset", "60"]
SIGNALS = {"y_p_tp", "y_p_ap", "y_p_du", "n_p", "dc_dose"}


def made(folder: Path, *options: str) -> tuple[Path, Path]:
    common = ["--cycle", "validation", "--seed", "3", "--duration", str(DURATION), "--id", "r"]
    out, truth = folder / "out", folder / "truth"
    assert main(["record", *common, *options, "--out", str(out), "--truth", str(truth)]) == 0
    return out / "r", truth / "r.toml"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return made(tmp_path_factory.mktemp("rig"), *FAULT, "--logger", "starts_s=-20")


def test_a_bench_has_two_clocks(bench: tuple[Path, Path]) -> None:
    read = read_recording(bench[0])
    assert set(read.external) == {"y_p_tp", "y_p_ap"}
    assert set(read.bus) >= SIGNALS - set(read.external)
    run = simulate(VEHICLES["bench"], CYCLES["validation"], (), 3, DURATION)
    t, p_ap = read.external["y_p_ap"]
    inside = (t > 20.1) & (t < 78.0)
    error = p_ap[inside] - np.interp(t[inside] - 20.0, run.t, run.pressures[:, 2])
    assert np.abs(error - np.median(error)).max() < 8e3  # 10 sd of the noise


@pytest.mark.parametrize("form", ["asc", "blf", "csv", "trc"])
def test_every_format_reads_the_same(tmp_path: Path, bench: tuple[Path, Path], form: str) -> None:
    folder, _ = made(tmp_path, *FAULT, "--logger", "starts_s=-20", "--format", form)
    read, plain = read_recording(folder), read_recording(bench[0])
    for name in SIGNALS - set(plain.external):
        np.testing.assert_allclose(read.bus[name].t, plain.bus[name].t, atol=2e-4)
        np.testing.assert_array_equal(read.bus[name].value, plain.bus[name].value)


def test_an_instrumented_vehicle_has_one_clock_and_silence_is_no_number(tmp_path: Path) -> None:
    read = read_recording(made(tmp_path, *FAULT, "--kind", "instrumented")[0])
    assert read.external == {}
    assert set(read.bus) >= SIGNALS
    t, p_du = read.bus["y_p_du"]
    assert np.isnan(p_du[t > 60.1]).all()
    assert np.isfinite(p_du[t < 60.0]).all()
    run = simulate(VEHICLES["bench"], CYCLES["validation"], (), 3, DURATION)
    n_p = run.ecu[:, Knowledge._fields.index("n_p")]
    assert read.bus["n_p"].value[t < 60.0].max() == pytest.approx(n_p[run.ecu_t < 60.0].max(), abs=0.5)


def reddish(picture: Path) -> float:
    """The share of pixels in which red clearly prevails, as in the shading."""
    pixels = matplotlib.image.imread(picture)
    return float((pixels[..., 0] - pixels[..., 2] > 0.04).mean())


def test_faults_are_shaded_where_the_truth_says(tmp_path: Path, bench: tuple[Path, Path]) -> None:
    folder, truth = bench
    plain, shaded = tmp_path / "p" / "plain.png", tmp_path / "shaded.png"
    assert main(["picture", str(folder), "--out", str(plain)]) == 0
    assert main(["picture", str(folder), "--truth", str(truth), "--out", str(shaded)]) == 0
    assert reddish(shaded) - reddish(plain) == pytest.approx(
        0.7 * 10 / 90, abs=0.03
    )  # 10 s of 90; panels are 0.7 of it


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "recording.toml").unlink(), "recording.toml: cannot be read: No such file"),
        (lambda folder: (folder / "recording.toml").write_text("id = 3"), "recording.toml: 'can' is missing"),
        (lambda folder: (folder / "can.log").unlink(), "can.log: No such file or directory"),
        (lambda folder: (folder / "can.log").write_text("what is this\n"), "can.log: cannot be decoded"),
        (lambda folder: (folder / "uds.dbc").write_text("what is this\n"), "cannot be decoded with uds.dbc"),
        (lambda folder: (folder / "external.csv").write_text("a,b\n1\n"), "external.csv: cannot be read"),
        (lambda folder: (folder / "can.log").write_text(""), "can.log: holds no frame of uds.dbc"),
    ],
)
def test_what_cannot_be_read_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    bench: tuple[Path, Path],
    spoil: Callable[[Path], object],
    said: str,
) -> None:
    folder = Path(shutil.copytree(bench[0], tmp_path / "r"))
    spoil(folder)
    assert main(["picture", str(folder), "--out", str(tmp_path / "p.png")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "p.png").exists()


def test_the_truth_must_be_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bench: tuple[Path, Path]
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(bench[1].read_text().replace('recording = "r"', 'recording = "other"'))
    assert main(["picture", str(bench[0]), "--truth", str(other), "--out", str(tmp_path / "p.png")]) == 2
    assert "is about 'other', not about 'r'; give its own truth" in capsys.readouterr().err
