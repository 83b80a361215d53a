"""One run of the demo, in a folder of its own, for every test that looks at what it made."""

import subprocess

import pytest
from demo_run import FAULTLINE, Ran


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    folder = tmp_path_factory.mktemp("demo")
    done = subprocess.run([FAULTLINE, "demo"], cwd=folder, capture_output=True, text=True, check=False, timeout=600)
    return Ran(folder, done.returncode, done.stdout, done.stderr)
