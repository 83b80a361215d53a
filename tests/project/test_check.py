"""Which tests `make check` chooses, and that what is made once is made once."""

import subprocess
import sys
from pathlib import Path

import check
import pytest
from once import FOLDER, open_folder

HERE = "tests/project/test_check.py"


@pytest.fixture(scope="module")
def tree() -> check.Tree:
    return check.Tree()


@pytest.mark.parametrize(
    ("test", "depends"),
    [
        ("tests/service/core/test_detectors.py", "service/core/manifest.py"),
        ("tests/service/daemon/test_remembering.py", "service/core/memory/fault_memory.py"),  # by several imports
        ("tests/analysis/discrepancy/test_gate.py", "tests/analysis/discrepancy/made_study.py"),
        ("tests/analysis/calibration/test_fit.py", "tests/analysis/calibration/made_drive.py"),
        ("tests/analysis/model/test_shipped_models.py", "systems/uds/model.toml"),  # data of a package
        ("tests/service/mqtt/test_mqtt_page.py", "docs/mqtt.md"),  # named in the test
        ("tests/testbench/test_rig_command.py", "testbench/plant.py"),
    ],
)
def test_knows_what_a_test_depends_on(tree: check.Tree, test: str, depends: str) -> None:
    assert depends in tree.reached(test)


@pytest.mark.parametrize(
    ("test", "other"),
    [
        ("tests/service/core/test_detectors.py", "analysis/model/model.py"),
        ("tests/analysis/structure/test_matrix.py", "testbench/plant.py"),
        ("tests/testbench/test_rig_plant.py", "service/core/errors.py"),
    ],
)
def test_knows_what_it_does_not_depend_on(tree: check.Tree, test: str, other: str) -> None:
    assert other not in tree.reached(test)


def test_a_module_of_every_file_is_known(tree: check.Tree) -> None:
    ours = [path for path in tree.digests if path.endswith(".py") and path.split("/")[0] in ("service", "analysis")]
    assert {*ours} <= {*tree.modules.values()}


def test_the_nearest_are_chosen_within_the_budget() -> None:
    files = [check.TestFile(f"t{k}", "", distance, 2.0) for k, distance in enumerate((3, 0, 1, 2))]
    assert [file.path for file in check.within(files, 4.0)] == ["t1", "t2"]
    assert [file.path for file in check.within(files, 0.5)] == ["t1"]  # or the same files were left for ever


def test_processes_of_a_run_share_what_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_folder() is None  # this run has one
    (tmp_path / "made_here.py").write_text(
        "from pathlib import Path\nfrom once import once\n\n@once\ndef made(k: int) -> int:\n"
        "    with Path('calls').open('a') as file:\n        file.write('.')\n    return 2 * k\n\n"
        "print(made(3), made(3))\n"
    )
    monkeypatch.setenv(FOLDER, str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[1]))
    command = [sys.executable, str(tmp_path / "made_here.py")]
    both = [subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert [process.communicate()[0] for process in both] == ["6 6\n", "6 6\n"]
    assert (tmp_path / "calls").read_text() == "."
