"""Runs of the bench of three tanks (`testbench.tanks`) as instrumented recordings on CAN."""

import hashlib
from pathlib import Path

from faultline.testbench import tanks


def record(folder: Path, seed: int, duration_s: float, fault: tanks.Fault | None = None) -> Path:
    """A run with a random sequence of pump commands."""
    return write(folder, tanks.run(seed, duration_s, fault))


def write(folder: Path, run: tanks.Run) -> Path:
    tanks.write(folder, run, can=True)
    (folder / "recording.toml").write_text(
        f'schema = 1\nid = "{folder.name}"\nkind = "instrumented"\nsource = "simulated"\nvehicle = "bench"\n'
        'cycle = "steps"\nsensor_set = "instrumented"\n\n[can]\nfile = "can.log"\ndbc = "tanks.dbc"\n'
        f'dbc_sha256 = "{hashlib.sha256(tanks.DBC.encode()).hexdigest()}"\n'
    )
    return folder
