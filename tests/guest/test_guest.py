"""The service on a machine with a real CAN bus and systemd: installed from its wheel, started, and hurt."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from machine import HERE, Guest, NoGuestError, prepared

CUT_S = (4.0, 20.0)
"""The power is cut so long after the first bundle was installed: another one takes some seconds."""
pytestmark = pytest.mark.waits


@pytest.fixture
def guest(tmp_path: Path) -> Guest:
    try:
        return prepared(tmp_path)
    except NoGuestError as error:
        pytest.skip(str(error))


def test_installed_started_and_hurt(guest: Guest) -> None:
    failed = guest.run(HERE / "on_the_vehicle.py", "everything")
    print(guest.said)
    assert not failed, guest.said


def test_a_power_cut_while_bundles_are_installed(guest: Guest) -> None:
    """Whatever was being written: what was installed is there, whole, not older, and the service starts with it."""
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    process = guest.start(HERE / "on_the_vehicle.py", "install")
    told = guest.share / "installed.txt"
    end = time.monotonic() + 120.0
    while not told.exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.1)
    assert told.exists(), guest.said
    time.sleep(float(np.random.default_rng(seed).uniform(*CUT_S)))
    process.kill()
    process.wait()
    acknowledged = int(told.read_text().split()[-1])
    (guest.share / "steps.jsonl").unlink(missing_ok=True)
    failed = guest.run(HERE / "on_the_vehicle.py", "after", str(acknowledged))
    print(guest.said)
    assert not failed, guest.said
