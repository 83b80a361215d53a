"""The jitter that the senders of a recording show goes into the bundle, and is borne on the vehicle."""

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

from faultline.analysis.recordings.observe import open_known, trusted
from faultline.analysis.tuning.numbers import limited, widest
from faultline.service.bundle.load import load_bundle
from faultline.service.core.signals.values import Quality

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
SENSORS = "18FF20F9"
"""The identifier of the message with y_p_tp and y_p_ap, sent every 100 ms."""


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The golden log, whose sensors' frames come up to 40 ms before or after their time."""
    log = Path(shutil.copytree(GOLDEN / "log", tmp_path_factory.mktemp("shaken") / "log"))
    rng = np.random.default_rng(1)
    rows = []
    for line in (log / "can.log").read_text().splitlines():
        t = float(line[1 : line.index(")")])
        at = t + (rng.uniform(-0.04, 0.04) if SENSORS in line else 0.0)
        rows.append((at, f"({at:.6f}){line[line.index(')') + 1 :]}"))
    (log / "can.log").write_text("\n".join(row for _, row in sorted(rows)) + "\n")
    return log


def doubted(log: Path, jitter_s: dict[str, float] | None = None) -> float:
    """The share of y_p_tp's values that are doubted."""
    bundle = load_bundle(GOLDEN / "bundle")
    bundle.table.bear(jitter_s or {})
    pieces = open_known(log, lambda _: None).signals(bundle.table).pieces()
    quality = np.concatenate([piece.columns["y_p_tp"].quality for piece in pieces if "y_p_tp" in piece.columns])
    return float((quality == Quality.DOUBTED).mean())


def test_what_drives_show_is_borne(shaken: Path) -> None:
    bundle = load_bundle(GOLDEN / "bundle")
    units = {channel.signal: channel.unit for channel in bundle.manifest.inputs}
    signals, jitter_s = trusted(open_known(shaken, lambda _: None), units, "here")
    assert {*jitter_s} == {"y_p_tp", "y_p_ap"}
    assert doubted(shaken) > 0.0
    assert doubted(shaken, jitter_s) == 0.0
    inputs = limited(bundle.manifest.inputs, signals, (), jitter_s)
    assert {channel.signal: channel.jitter_s for channel in inputs if channel.jitter_s} == jitter_s
    calm = [msgspec.structs.replace(channel, jitter_s=None) for channel in inputs]
    assert widest([calm, inputs]) == inputs


def test_the_golden_log_shows_no_jitter_to_speak_of() -> None:
    bundle = load_bundle(GOLDEN / "bundle")
    units = {channel.signal: channel.unit for channel in bundle.manifest.inputs}
    assert trusted(open_known(GOLDEN / "log", lambda _: None), units, "here")[1] == {}
