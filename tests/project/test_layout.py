"""The shape of the project: what the wheel holds, who may import whom, what the folders are."""

import os
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


ONCE = [f"--ignore={ROOT}/tests/service/mqtt/test_mqtt_{what}.py" for what in ("trouble", "refused", "tls")]
"""A broker that fails in many ways is the same for both: the others show that the process runs with these libraries."""
BRIEFLY = ("--hypothesis-profile=brief",)
"""Chance has its turn in the run that this is part of."""


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


def test_the_service_passes_its_tests_with_the_vehicles_libraries_alone(wheel: Path, tmp_path: Path) -> None:
    """No scipy, sympy, networkx, onnx, matplotlib, rich or torch: the base dependencies and the test runner."""
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt"]
    subprocess.run([*map(str, install), str(wheel), "pytest", "hypothesis"], check=True)
    names = ["scipy", "sympy", "networkx", "onnx", "matplotlib", "rich", "torch"]
    absent = f"import importlib.util as u; assert not any(map(u.find_spec, {names}))"
    subprocess.run([str(python), "-c", absent], check=True)
    folder = ROOT / "tests" / "service"
    tests = subprocess.run(
        [str(python), "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder), *BRIEFLY, *ONCE],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "SEEDS": "40"},
    )
    assert tests.returncode == 0, tests.stdout[-3000:]
