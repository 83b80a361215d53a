"""The shape of the project: what the wheel holds, who may import whom, what the folders are."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from service import distribution

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    source = out / "source"  # a build writes beside its sources: not into the checkout
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(source)], check=True)
    pip = [sys.executable, "-m", "pip", "--quiet", "wheel", "--no-deps", "--wheel-dir", str(out), str(source)]
    subprocess.run(pip, check=True)
    [built] = out.glob("*.whl")
    return built


def test_every_package_folder_is_in_the_package_list() -> None:
    folders = {
        str(path.parent.relative_to(ROOT)).replace("/", ".")
        for top in ("service", "analysis", "training", "testbench", "dbc")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert folders == set(PROJECT["tool"]["setuptools"]["packages"])


@pytest.mark.parametrize(
    ("importer", "may"),
    [
        ("service.core", set()),
        ("analysis", {"core", "logs", "bundle", "bundle_files"}),
        ("training", {"core", "logs", "bundle", "bundle_files"}),
    ],
)
def test_the_import_contracts_name_every_part_of_the_service(importer: str, may: set[str]) -> None:
    """They are lists of what is forbidden: a new module of the service must not slip past them."""
    contracts = PROJECT["tool"]["importlinter"]["contracts"]
    ours = [c for c in contracts if c.get("source_modules") == [importer]]
    forbidden = {name for c in ours for name in c["forbidden_modules"]}
    parts = {
        path.stem for path in (ROOT / "service").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    missing = {f"service.{part}" for part in parts - may - {"core", "__init__"}} - forbidden
    assert missing == set()


def test_the_wheels_top_level_is_the_five_packages(wheel: Path) -> None:
    names = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    ours = {name for name in names if not name.endswith(".dist-info")}
    assert ours == {"service", "analysis", "training", "testbench", "dbc"}
    data = [name for name in zipfile.ZipFile(wheel).namelist() if name.endswith((".dbc", ".toml"))]
    assert "dbc/uds.dbc" in data
    page = {"index.html", "main.js", "page.css", "icon.svg", "vendor/uPlot.js", "vendor/LICENSE"}
    assert {f"service/web/page/{name}" for name in page} <= set(zipfile.ZipFile(wheel).namelist())
    assert "analysis/model/uds4.toml" in data


def test_every_text_that_says_what_to_install_names_our_distribution() -> None:
    """`faultline` is somebody else's on the public index; `faultline-diagnosis` was free."""
    assert PROJECT["project"]["name"] == distribution.NAME
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    texts = {name: ROOT / name for name in tracked if name.endswith((".py", ".md", ".toml", "Makefile", "Dockerfile"))}
    wrong = [name for name, path in texts.items() if path.exists() and re.search(r"faultline\[\w", path.read_text())]
    assert wrong == []
