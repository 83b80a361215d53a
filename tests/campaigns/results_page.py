"""What every page of results says: shares with their confidence, and where the figures come from."""

import math
import os
import platform
import subprocess


def wilson(found: int, of: int) -> tuple[float, float]:
    """95 % confidence interval of a share (Wilson 1927)."""
    if not of:
        return 0.0, 1.0
    z, p = 1.96, found / of
    middle, half = p + z**2 / (2 * of), z * math.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    return (middle - half) / (1 + z**2 / of), (middle + half) / (1 + z**2 / of)


def provenance(seconds: float) -> str:
    """Commit, machine and duration."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
    return (
        f"Commit {commit.stdout.strip()}, {platform.machine()} with {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, {seconds / 60:.0f} minutes."
    )
