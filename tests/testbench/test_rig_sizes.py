"""Small and large faults: frozen in a file, and what the file says is what the rig finds."""

from pathlib import Path

import pytest

from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES
from faultline.testbench.faults import FAULTS, Fault, limit
from faultline.testbench.simulation import Run, simulate
from faultline.testbench.sizes import DURATION, SIGMAS, effect, frozen
from faultline.testbench.undeclared import UNDECLARED
from faultline.testbench.vehicles import BENCH


@pytest.fixture(scope="module")
def healthy() -> Run:
    return simulate(BENCH, CYCLES["validation"], (), 1, DURATION)


def test_every_fault_has_both() -> None:
    assert set(frozen()) == {name for name in FAULTS if not name.startswith("off_")} - {*UNDECLARED}
    assert all(0 < small <= large <= limit(name) for name, (small, large) in frozen().items())


@pytest.mark.parametrize("name", ["fA_du", "fq_pump", "fy_p_tp"])
def test_small_is_three_sigma_and_large_twice_that(healthy: Run, name: str) -> None:
    small, large = frozen()[name]
    assert effect(Fault(name, small, 0.0), healthy) == pytest.approx(SIGMAS, rel=0.05)
    assert effect(Fault(name, large, 0.0), healthy) == pytest.approx(2 * SIGMAS, rel=0.05)
    assert effect(Fault(name, small / 2, 0.0), healthy) < SIGMAS


def test_a_clogged_pump_filter_shows_only_when_the_pump_starves(healthy: Run) -> None:
    small, _ = frozen()["fA_p"]
    assert effect(Fault("fA_p", 0.9 * small, 0.0), healthy) < SIGMAS
    assert effect(Fault("fA_p", 1.01 * small, 0.0), healthy) > 2 * SIGMAS


def test_a_size_may_be_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fault = ["--fault", "fA_t", "--size", "large", "--onset", "30"]
    folders = ["--out", f"{tmp_path}/bench", "--truth", f"{tmp_path}/truth"]
    assert main(["record", "--cycle", "drive", "--duration", "60", "--id", "r", *fault, *folders]) == 0
    assert f"size = {frozen()['fA_t'][1]!r}" in (tmp_path / "truth" / "r.toml").read_text()
    capsys.readouterr()
    assert main(["record", "--cycle", "drive", "--fault", "fA_z", "--size", "small", "--onset", "30", *folders]) == 2
    assert "there is no small or large 'fA_z'" in capsys.readouterr().err
