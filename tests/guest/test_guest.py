"""The service on a machine with a real CAN bus and systemd: installed from its wheel, started, and hurt."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from machine import HERE, ROOT, Guest, environment

from service.bundle_files import SEAL, seal

GOLDEN = ROOT / "tests" / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
FROM_S, UNTIL_S = 48.0, 95.0
"""The part of the golden recording that is played in real time: the fault begins at 70 s."""
VERSIONS = 8
CUT_S = (4.0, 20.0)
"""The power is cut so long after the first bundle was installed: another one takes some seconds."""
pytestmark = pytest.mark.waits


@pytest.fixture
def guest(tmp_path: Path) -> Guest:
    """It is given bundles of several versions, signed, the key, and a recording."""
    done = subprocess.run([str(HERE / "install.sh")], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(done.stderr.strip())
    share = tmp_path / "share"
    share.mkdir()
    key = tmp_path / "fleet.pem"
    subprocess.run(["openssl", "genpkey", "-algorithm", "ed25519", "-out", str(key)], check=True)
    subprocess.run([FAULTLINE, "bundle", "public", str(key), "--out", str(share / "fleet.pub")], check=True)
    for version in range(VERSIONS):
        bundle = Path(shutil.copytree(GOLDEN / "bundle", share / f"version-{version}"))
        manifest = json.loads((bundle / "manifest.json").read_bytes())
        raw = json.dumps({**manifest, "version": version}).encode()
        (bundle / "manifest.json").write_bytes(raw)
        (bundle / SEAL).write_bytes(seal(raw))
        subprocess.run([FAULTLINE, "bundle", "sign", str(bundle), "--key", str(key)], check=True)
    lines = (GOLDEN / "log" / "can.log").read_text().splitlines()
    first = float(lines[0].split()[0].strip("()"))
    inside = [line for line in lines if FROM_S <= float(line.split()[0].strip("()")) - first <= UNTIL_S]
    (share / "can.log").write_text("\n".join(inside) + "\n")
    return Guest(share, environment(ROOT / "out" / "vehicle-environment"), tmp_path / "disk.ext4")


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
