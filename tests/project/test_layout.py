"""The shape of the project: what the wheel holds, who may import whom, what the folders are."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from faultline.service import distribution

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("service", "analysis", "training", "testbench", "dbc", "systems")
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


def test_the_package_links_to_the_folders_at_the_top() -> None:
    links = {path.name: path.readlink() for path in (ROOT / "src/faultline").iterdir() if path.is_symlink()}
    assert links == {name: Path("../..") / name for name in FOLDERS}


def test_no_folder_of_the_user_hides_ours(tmp_path: Path) -> None:
    for name in FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise AssertionError('the folder of the user was imported')")
    code = "import faultline." + ", faultline.".join(FOLDERS)
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_the_wheel_holds_faultline_alone_and_all_of_it(wheel: Path) -> None:
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {name.partition("/")[0] for name in names} == {"faultline"}
    tracked = subprocess.run(["git", "ls-files", *FOLDERS], cwd=ROOT, capture_output=True, text=True, check=True)
    product = {f"faultline/{name}" for name in tracked.stdout.split() if not name.endswith(".md")}
    own = {f"faultline/{path.name}" for path in (ROOT / "src/faultline").iterdir() if path.is_file()}
    assert names == product | own


def test_the_templates_in_the_wheel_are_whole(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    code = """
from pathlib import Path
from faultline.service import pages
found = sorted(Path(pages.__file__).parents[2].rglob("*.j2"))
for template in found:
    pages._environment(template.parent).get_template(template.name)
(Path("x.html.j2")).write_text('{% extends "base.html.j2" %}')
assert "prefers-color-scheme" in pages.render(Path("x.html.j2"), title="t")
print(*(template.name for template in found))
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    tracked = subprocess.run(["git", "ls-files", "*.j2"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert sorted(done.stdout.split()) == sorted(Path(name).name for name in tracked.stdout.split())


def test_every_text_that_says_what_to_install_names_our_distribution() -> None:
    """`faultline` is somebody else's on the public index; `faultline-diagnosis` was free."""
    assert PROJECT["project"]["name"] == distribution.NAME
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    texts = {name: ROOT / name for name in tracked if name.endswith((".py", ".md", ".toml", "Makefile", "Dockerfile"))}
    wrong = [name for name, path in texts.items() if path.exists() and re.search(r"faultline\[\w", path.read_text())]
    assert wrong == []
