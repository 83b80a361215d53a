"""The golden bundle on an emulated 64-bit ARM processor: the same events? `make campaign-aarch64`.

User-mode emulation of a Cortex-A72 by QEMU, Debian's Python and the vehicle's libraries for arm64, as
`tests/campaigns/aarch64.sh` fetches them. Times are the emulator's and say nothing of a processor.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from results_page import head_commit, provenance

HERE = Path(__file__).resolve()
PROJECT, GOLDEN = HERE.parents[2], HERE.parents[1] / "golden"
MACHINE = PROJECT / "out" / "aarch64"
PAGE = PROJECT / "docs" / "results" / "aarch64.md"
TOLERANCE = 1e-6
"""Of numbers in events, relative."""
RUN = "import sys; from faultline.service.cli import main; sys.exit(main())"
WHICH = "import platform, onnxruntime, numpy; print(platform.machine(), onnxruntime.__version__, numpy.__version__)"


def emulated(*arguments: str) -> str:
    """What Python prints there."""
    emulator = MACHINE / "qemu" / "usr" / "bin" / "qemu-aarch64-static"
    command = [
        str(emulator),
        "-cpu",
        "cortex-a72",
        "-L",
        str(MACHINE / "root"),
        str(MACHINE / "root/usr/bin/python3.11"),
    ]
    path = os.pathsep.join([str(MACHINE / "site"), str(PROJECT / "src")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run([*command, *arguments], env=environment, capture_output=True, text=True, check=False)
    if run.returncode not in (0, 1):  # 1: a fault was found
        raise SystemExit(run.stderr)
    return run.stdout


def differences(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Where two decoded lines differ by more than the tolerance."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for key in one:
            yield from differences(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, pair in enumerate(zip(one, other, strict=True)):
            yield from differences(*pair, f"{where}[{k}]")
    elif isinstance(one, float) and isinstance(other, float):
        if abs(one - other) > TOLERANCE * max(abs(one), abs(other)):
            yield f"{where}: {one!r}, {other!r}"
    elif one != other:
        yield f"{where}: {one!r}, {other!r}"


def main() -> int:
    """Make the machine, run it, compare, write the page."""
    began, commit = time.monotonic(), head_commit()
    script = HERE.with_suffix(".sh")
    made = [str(script), str(MACHINE), str(Path(sys.executable).with_name("pip")), str(PROJECT / "constraints.txt")]
    subprocess.run(["bash", *made], check=True, cwd=PROJECT)
    which = emulated("-c", WHICH).strip()
    words = ["diagnose", str(GOLDEN / "log"), "--bundle", str(GOLDEN / "bundle"), "--json"]
    told = emulated("-c", RUN, *words).splitlines()
    wanted = (GOLDEN / "events.jsonl").read_text().splitlines()
    same = sum(a == b for a, b in zip(told, wanted, strict=False))
    found = list(differences([json.loads(line) for line in wanted], [json.loads(line) for line in told]))
    lines = [
        "# The golden bundle on 64-bit ARM",
        "",
        "Made by `make campaign-aarch64`; the log is **simulated**. A Cortex-A72 in user-mode emulation (QEMU), Debian",
        "12's Python and the vehicle's libraries for arm64; the bundle's golden vectors are verified there as well.",
        "",
        provenance(commit, time.monotonic() - began),
        "",
        f"There: {which} (machine, ONNX Runtime, NumPy).",
        "",
        f"**{same} of {len(wanted)} events are those of x86-64 in every byte**, and {len(told)} were written.",
        f"Numbers that differ by more than {TOLERANCE:g} of themselves, or other values: {len(found)}.",
        "",
        *(f"- `{each}`" for each in found),
    ]
    PAGE.write_text("\n".join(lines).rstrip() + "\n")
    print(PAGE.read_text())
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
