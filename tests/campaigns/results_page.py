"""What every page of results says: shares with their confidence, and where the figures come from."""

import hashlib
import math
import os
import platform
import subprocess
from pathlib import Path

from scipy.stats import beta, chi2


def wilson(found: int, of: int) -> tuple[float, float]:
    """95 % confidence interval of a share (Wilson 1927)."""
    if not of:
        return 0.0, 1.0
    z, p = 1.96, found / of
    middle, half = p + z**2 / (2 * of), z * math.sqrt(p * (1 - p) / of + z**2 / (4 * of**2))
    return (middle - half) / (1 + z**2 / of), (middle + half) / (1 + z**2 / of)


def share(found: int, of: int) -> str:
    """A share in words."""
    low, high = wilson(found, of)
    return f"{found} of {of}, {100 * found / of:.1f} % (95 % Wilson interval {100 * low:.1f} to {100 * high:.1f} %)"


def exact(found: int, of: int) -> tuple[float, float]:
    """95 % confidence interval of a share (Clopper and Pearson 1934)."""
    low = beta.ppf(0.025, found, of - found + 1) if found else 0.0
    high = beta.ppf(0.975, found + 1, of - found) if found < of else 1.0
    return float(low), float(high)


def exact_share(found: int, of: int) -> str:
    """A share in words, with that interval."""
    if not of:
        return "none"
    low, high = exact(found, of)
    return f"{found} of {of}, {100 * found / of:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"


def poisson(count: int) -> tuple[float, float]:
    """95 % confidence interval of an expected count (Garwood 1936); that of none is one-sided, from 0 to 3.0."""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return float(low), float(chi2.ppf(0.975 if count else 0.95, 2 * count + 2) / 2)


def exact_rate(count: int, hours: float) -> str:
    """Events an hour in words: "at most" is the one-sided bound of none, from-to the two-sided interval."""
    if not hours:
        return "none"
    low, high = (limit / hours for limit in poisson(count))
    if not count:
        return f"0 in {hours:.1f} h, at most {high:.2g} an hour"
    return f"{count} in {hours:.1f} h, {count / hours:.3g} ({low:.2g} to {high:.2g}) an hour"


def head_commit() -> str:
    """The commit of the working tree: to be asked when a campaign starts, it may move on."""
    asked = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
    return asked.stdout.strip()


def digest(*places: str) -> str:
    """A hash of what the files of these folders and these files say: results with the same one are of the same code."""
    files = sorted(
        file
        for place in map(Path, places)
        for file in ([place] if place.is_file() else place.rglob("*"))
        if file.suffix in (".py", ".toml", ".json")
    )
    found = hashlib.sha256()
    for file in files:
        found.update(f"{file.as_posix()}\0".encode() + file.read_bytes())
    return found.hexdigest()[:12]


def provenance(commit: str, seconds: float) -> str:
    """Commit, machine and duration."""
    return (
        f"Commit {commit}, {platform.machine()} with {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"{seconds / 60:.0f} minutes."
    )
