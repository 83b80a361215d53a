"""The limit: information of signatures, what the best detector does on data drawn from the model, and the command."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from faultline.analysis.limit.command import main
from faultline.analysis.limit.information import against, delays, information, rates, signatures, smallest
from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel
from faultline.service.core.decision.blocks import Block
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Evidence, Hypothesis
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale

GOLDEN = Path(__file__).parents[2] / "golden"
TIME = TimeScale(period_s=0.2, settling_s=20.0)
BLOCK_S, TICKS = 3.0, 15
SHIFT = np.array([[0.02, -0.01], [0.04, -0.02], [0.02, 0.02]])
"""Of fA in two sizes, and of fB, in every mode."""


def evidence(**changed: Any) -> Evidence:
    """Two generators, two modes."""
    given: dict[str, Any] = {
        "generators": ["t1", "t3"],
        "offset": [[0.0, 0.0]] * 3,
        "spread": [[0.1, 0.1]] * 3,
        "noise": [[[0.01, 0.002], [0.002, 0.02]]] * 3,
        "visit": [[[1e-5, 0.0], [0.0, 1e-5]]] * 3,
        "allowance": [[0.002, 0.002]] * 3,
        "drifts": [],
        "operation": [[0.0, 0.0]] * 3,
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault=fault, size=size) for fault, size in (("fA", 1.0), ("fA", 2.0), ("fB", 1.0))],
    }
    return Evidence(**(given | changed))


def block(k: int, mean: FloatArray, logs: int = 1) -> Block:
    """The k-th of a drive whose mode changes every ten blocks."""
    return Block(
        end_s=np.full(logs, (k + 1) * BLOCK_S),
        mode=np.full(logs, 1 + k // 10 % 2),
        begins=np.full(logs, k % 10 == 0),
        ticks=np.full((logs, 2), float(TICKS)),
        mean=mean,
        part=np.full((logs, 2, 2), 1.0 / TICKS),
        shift=np.repeat(SHIFT[None], logs, axis=0),
        excess=np.zeros((logs, 2)),
    )


def drive(blocks: int) -> list[Block]:
    return [block(k, np.zeros((1, 2))) for k in range(blocks)]


def since_s(blocks: int, onset: int) -> FloatArray:
    return np.asarray((np.arange(blocks) + 1.0 - onset) * BLOCK_S)[None]


def test_the_best_detector_on_data_of_the_model_meets_the_limit() -> None:
    """500 drives drawn from the model: the ratio of the true fault, size and onset has J as its mean, 2 J as variance,
    and crosses a threshold when the limit says, within a tenth."""
    rng, model, onset, blocks, logs = np.random.default_rng(5), BaselineModel(evidence(), TIME), 30, 160, 500
    g = signatures(drive(blocks), model, np.array([onset]))[0, :, 0]  # of fA, size 1
    J = information(signatures(drive(blocks), model, np.array([onset])))
    tracked, ratio = BaselineFilter(model, logs), np.zeros((logs, blocks))
    factor = [np.linalg.cholesky(np.array(each)) for each in evidence().noise]
    state = rng.standard_normal((logs, model.states)) * np.sqrt(model.stationary[1].diagonal())
    for k in range(blocks):
        mode = 1 + k // 10 % 2
        F = np.exp(-BLOCK_S / model.tau)
        F[model.visit] *= k % 10 != 0
        spread = np.sqrt(model.stationary[mode].diagonal() * (1.0 - F**2))
        state = F * state + spread * rng.standard_normal(state.shape)
        noise = rng.standard_normal((logs, 2)) @ factor[mode].T / np.sqrt(TICKS)
        y = state @ model.observe[mode].T + noise + SHIFT[0] * (k >= onset)
        white = tracked.step(block(k, y, logs)).white
        gained = white @ g[k] - (g[k] ** 2).sum() / 2.0 if k >= onset else 0.0
        ratio[:, k] = (ratio[:, k - 1] if k else 0.0) + gained
    end = J[0, -1, 0]
    assert ratio[:, -1].mean() == pytest.approx(end, rel=0.1)
    assert ratio[:, -1].var() == pytest.approx(2.0 * end, rel=0.2)
    nats = 10.0
    limit = delays(J, since_s(blocks, onset), nats)[0, 0]
    crossed = (ratio >= nats).argmax(axis=1) + 1 - onset
    assert (ratio[:, -1] >= nats).mean() > 0.99
    assert (crossed * BLOCK_S).mean() == pytest.approx(limit, rel=0.1)


def test_information_grows_with_the_square_of_a_size_and_waits_for_the_onset() -> None:
    model = BaselineModel(evidence(), TIME)
    J = information(signatures(drive(60), model, np.array([0, 20])))
    assert J.shape == (2, 60, 3)
    assert (J[1, :20] == 0.0).all()
    assert J[:, -1, 1] == pytest.approx(4.0 * J[:, -1, 0])
    assert J[1, -1, 0] > J[0, 39, 0], "what was seen before tells the drive's baseline"


def test_a_size_that_no_time_shows_has_no_delay() -> None:
    model = BaselineModel(evidence(), TIME)
    J = information(signatures(drive(60), model, np.array([20])))
    found = delays(J, since_s(60, 20), 1e6)
    assert np.isinf(found).all()
    assert np.isinf(smallest(J[:, -1, :2], np.array([1.0, 2.0]), 1e6)).all()


def test_the_smallest_size_has_the_information_that_is_asked_for() -> None:
    model = BaselineModel(evidence(), TIME)
    J = information(signatures(drive(60), model, np.array([20])))[:, -1, :2]
    [size] = smallest(J, np.array([1.0, 2.0]), 2.0 * float(J[0, 0]))
    assert size == pytest.approx(np.sqrt(2.0))


def test_a_fault_is_none_against_itself_and_some_against_another() -> None:
    of = evidence()
    model, segments = BaselineModel(of, TIME), Hypotheses(of).segments
    g = signatures(drive(80), model, np.array([20]))[0, 20:]
    table = against(g, segments)
    own = [name == "fA" for name in segments.faults]
    assert table[0][own].min() == pytest.approx(0.0, abs=1e-9)
    other = table[0][[not each for each in own]].min()
    tried = [(((g[:, 0] - s * g[:, 2]) ** 2).sum() / 2.0) for s in np.linspace(0.0, 1.0, 1001)]
    assert other == pytest.approx(min(tried), rel=1e-4)


def test_a_rate_is_of_the_mode_in_which_a_fault_shows() -> None:
    model, blocks = BaselineModel(evidence(), TIME), drive(60)
    for each in blocks:
        each.shift[:, 0] *= float(each.mode[0] == 2)
    J = information(signatures(blocks, model, np.array([20])))
    rate = rates(J, blocks, since_s(60, 20), 300.0, 4)
    assert rate[2, 0] > 20.0 * rate[1, 0]
    assert np.isnan(rate[3]).all(), "that mode was not seen"


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What the command says of the golden recording's operation, as JSON; and its picture."""
    picture = tmp_path_factory.mktemp("limit") / "limit.png"
    with redirect_stdout(StringIO()) as out:
        assert main([f"{GOLDEN}/bundle", f"{GOLDEN}/log", "--within", "40", "--json", "--picture", str(picture)]) == 0
    return json.loads(out.getvalue()), picture


def test_larger_sizes_are_found_sooner(told: tuple[dict[str, Any], Path]) -> None:
    found, picture = told
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert found["nats"] == pytest.approx(np.log(500 * 3600 / 3.0))
    for fault in ("fA_t", "fA_du", "fA_dos"):
        by_size = sorted((limit for limit in found["limits"] if limit["fault"] == fault), key=lambda o: abs(o["size"]))
        delay = [np.inf if limit["delay_s"][1] is None else limit["delay_s"][1] for limit in by_size]
        assert delay == sorted(delay, reverse=True)
    for each in found["smallest"]:
        sizes = [np.inf if of[1] is None else abs(of[1]) for of in each["size"]]
        assert sizes == sorted(sizes, reverse=True), "more time shows smaller ones"
        assert len(sizes) == len(found["times_s"])


def test_the_tables_name_every_fault_in_its_unit(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([f"{GOLDEN}/bundle", f"{GOLDEN}/log", "--within", "40"]) == 0
    said = capsys.readouterr().out
    assert "one alarm in 500 h without a fault, 13.3 nats" in said
    assert "fA_du -97 %" in said
    assert "fy_p_tp 0.05 bar" in said
    assert "fq_pump (eps_p)" in said


def test_a_picture_of_another_kind_is_refused() -> None:
    with pytest.raises(InputError, match=r"x\.jpg: no name of a picture; give one that ends in \.png"):
        main([f"{GOLDEN}/bundle", f"{GOLDEN}/log", "--picture", "x.jpg"])


def test_no_more_is_said_than_the_drive_lasts() -> None:
    with pytest.raises(
        InputError, match=r"golden: no onset has 300 s of drive behind it; give a longer drive or --within"
    ):
        main([f"{GOLDEN}/bundle", f"{GOLDEN}/log"])


@pytest.mark.parametrize(("hours", "error"), [("0", "0 is not above zero"), ("x", "'x' is no number")])
def test_no_time_between_alarms_is_refused(hours: str, error: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([f"{GOLDEN}/bundle", f"{GOLDEN}/log", "--every", hours])
    assert error in capsys.readouterr().err
