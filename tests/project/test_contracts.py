"""The import contracts refuse what they are there for: imports planted in a copy of the repository."""

import os
import subprocess
import sys
from pathlib import Path
from shutil import copy2

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("src", "service", "analysis", "training", "testbench", "dbc", "systems", "pyproject.toml")

PLANTS = {
    "a gateway of another one": ("service/mqtt/daemon.py", "from faultline.service.web.asking import SharedControl"),
    "a command of another one": ("service/replay.py", "from faultline.service.bundle.command import main"),
    "a cycle of the steps of analysis": (
        "analysis/model/units.py",
        "from faultline.analysis.tuning.command import main",
    ),
    "a cycle inside a folder": ("service/j1939/name.py", "from faultline.service.j1939.claim import Claim"),
    "the rig in the analysis": ("analysis/progress.py", "from faultline.testbench.units import ATMOSPHERE"),
    "the service in the rig": ("testbench/units.py", "from faultline.service.core.records.freeze_frame import Frame"),
    "a socket in the core": ("service/core/records/freeze_frame.py", "import socket"),
    "the daemon in the core": ("service/core/records/freeze_frame.py", "from faultline.service.strict import Table"),
    "the store in the analysis": ("analysis/progress.py", "from faultline.service.store.file import StoreFile"),
    "torch in the analysis": ("analysis/progress.py", "import torch"),
    "the store in a gateway": ("service/web/health.py", "from faultline.service.store.file import StoreFile"),
    "the template engine beside the pages": ("service/workshop/svg.py", "import jinja2"),
    "a module in no layer": ("service/newcomer.py", ""),
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The product's files, links as links, linted once: what is imported is not read anew for each plant."""
    folder = tmp_path_factory.mktemp("contracts")
    names = subprocess.run(["git", "ls-files", *FOLDERS], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(lambda each: (ROOT / each).exists(), names.splitlines()):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        copy2(ROOT / name, folder / name, follow_symlinks=False)
    assert "0 broken" in _lint(folder)
    return folder


def _lint(folder: Path) -> str:
    lint = [str(Path(sys.executable).with_name("lint-imports"))]
    paths = {**os.environ, "PYTHONPATH": str(folder / "src")}
    return subprocess.run(lint, cwd=folder, env=paths, capture_output=True, text=True, check=False).stdout


@pytest.mark.parametrize("planted", PLANTS)
def test_what_is_planted_is_refused(copy: Path, planted: str) -> None:
    name, line = PLANTS[planted]
    file = copy / name
    before = file.read_text() if file.exists() else None
    file.write_text(f"{before or ''}\n{line}\n")
    said = _lint(copy)
    if before is None:
        file.unlink()
    else:
        file.write_text(before)
    assert "BROKEN" in said or "newcomer" in said, said[-2000:]
