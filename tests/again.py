"""Asks live tests that failed beside others once more, alone: a shared machine stops any process for a while.

Their number is bounded, they are named, and what fails alone has failed (docs/decisions/019-asked-again.md).

python tests/again.py CODE_OF_PYTEST PYTHON
"""

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LAST = ROOT / ".pytest_cache" / "v" / "cache" / "lastfailed"
PURE = ("analysis", "core", "testbench", "training", "dbc", "project", "logs", "cli", "campaigns")
"""Parts of which no test talks to a process of its own: they fail by no chance that is the machine's."""
MOST = 4


def main(code: int, python: str) -> int:
    """0 where tests failed and nothing else (`code` 1 of pytest), all of them live, not many, and they pass alone."""
    failed = sorted(json.loads(LAST.read_text())) if LAST.exists() else []
    pure = [each for each in failed if not is_live(each)]
    if code != 1 or not failed or pure or len(failed) > MOST:
        return code
    print(f"\n{len(failed)} live tests failed beside others; each is asked once more, alone", flush=True)
    ended = subprocess.run([python, "-m", "pytest", "-p", "no:cacheprovider", *failed], check=False, cwd=ROOT)
    if ended.returncode == 0:
        print("\n".join(["these failed beside others and passed alone; mend them:", *failed]), flush=True)
    return ended.returncode


def is_live(name: str) -> bool:
    """Whether the test of this name talks to processes."""
    folders = name.partition("::")[0].split("/")[:-1]
    return folders[0] == "tests" and len(folders) > 1 and not set(folders) & set(PURE)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2]))
