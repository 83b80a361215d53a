"""Commands that write files say in one line which one could not be written, and exit with 2."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MOST = 1024  # bytes that a file may have: an error that names no file, as on a full disk


@pytest.mark.parametrize(
    "words",
    [
        ("code", "uds4", "--out", "{}/code"),
        ("structure", "rc", "--figures", "{}/figures"),
        ("rig", "record", "--cycle", "drive", "--duration", "60", "--out", "{}/logs", "--truth", "{}/truth"),
    ],
    ids=lambda words: words[0],
)
def test_a_file_that_cannot_be_written_is_named(tmp_path: Path, words: tuple[str, ...]) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, MOST))

    script = "import sys; from faultline.service.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", script, *(word.format(tmp_path) for word in words)],
        cwd=ROOT,
        env={**os.environ, "MPLCONFIGDIR": str(Path("~/.config/matplotlib").expanduser())},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
    )
    assert done.returncode == 2, done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"faultline {words[0]}: error: {tmp_path}/")
    assert ": File too large; " in last
    assert "Traceback" not in done.stderr
    assert "None" not in last
