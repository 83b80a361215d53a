"""The service on a machine with a real CAN bus and systemd: installed from its wheel, started, and hurt."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from machine import HERE, Guest, NoGuestError, cut_power, prepared

CUT_S = (4.0, 20.0)
"""The power is cut so long after the first bundle was installed: another one takes some seconds."""
pytestmark = pytest.mark.waits


@pytest.fixture
def guest(tmp_path: Path) -> Guest:
    try:
        return prepared(tmp_path)
    except NoGuestError as error:
        pytest.skip(str(error))


@pytest.mark.alone  # a frame that a busy machine sends 0.1 s late or early may be another sender's, and is doubted
def test_installed_started_and_hurt(guest: Guest) -> None:
    failed = guest.run(HERE / "on_the_vehicle.py", "everything")
    print(guest.said)
    assert not failed, guest.said


def test_a_power_cut(guest: Guest) -> None:
    """Whatever was being written: bundles that were installed are there, whole, and what any subscriber has seen."""
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    process = guest.start(HERE / "on_the_vehicle.py", "cut")
    written = [guest.share / name for name in ("installed.txt", "seen.jsonl")]
    end = time.monotonic() + 180.0
    while not all(path.exists() and path.stat().st_size for path in written):
        assert process.poll() is None, guest.said
        assert time.monotonic() < end, guest.said
        time.sleep(0.1)
    time.sleep(float(np.random.default_rng(seed).uniform(*CUT_S)))
    cut_power(process)
    acknowledged = int(written[0].read_text().split()[-1])
    (guest.share / "steps.jsonl").unlink(missing_ok=True)
    failed = guest.run(HERE / "on_the_vehicle.py", "after", str(acknowledged))
    print(guest.said)
    assert not failed, guest.said
