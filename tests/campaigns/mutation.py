"""Which changes of the code no test notices: `make campaign-mutation`, with mutmut, in a copy of the repository.

What survives is listed with the reason that `mutation_reasons.toml` gives for it, by the line that was changed and what
it was changed to: a change that makes no difference to anybody, or a test that is missing.
"""

import argparse
import re
import shutil
import subprocess
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from results_page import head_commit, provenance

ROOT = Path(__file__).resolve().parents[2]
REASONS = Path(__file__).with_name("mutation_reasons.toml")
MUTMUT = ROOT / ".venv-mutation" / "bin" / "mutmut"
CODE = (
    "signals/decode.py",
    "signals/layout.py",
    "signals/senders.py",
    "signals/arrivals.py",
    "signals/sampling.py",
    "signals/latest.py",
    "signals/values.py",
    "j1939/transport.py",
    "decision/isolation.py",
    "detectors/",
)
TESTS = (
    "sampling",
    "decode",
    "decoded_columns",
    "dbc",
    "context",
    "senders",
    "reassembly",
    "arrivals",
    "detectors",
    "detector_family",
    "isolation",
    "health",
)
COPIED = (
    "src",
    "service",
    "analysis",
    "training",
    "testbench",
    "dbc",
    "systems",
    "tests",
    "pyproject.toml",
    "README.md",
)


class Mutant(NamedTuple):
    """A change that survived: the file, what a line was, and what it became."""

    file: str
    was: str
    became: str


def survivors(folder: Path, code: Sequence[str] = CODE) -> tuple[int, list[Mutant]]:
    """How many mutants there were, and those that no test noticed; `folder` is a copy of the repository."""
    given = "\n".join(
        [
            "[tool.mutmut]",
            f"paths_to_mutate = {[f'src/faultline/service/core/{name}' for name in code]}",
            f"tests_dir = {[f'tests/service/core/test_{name}.py' for name in TESTS]}",
            f"also_copy = {[name for name in COPIED if '.' not in name]}",
        ]
    )
    with (folder / "pyproject.toml").open("a") as file:
        file.write(f"\n{given}\n")
    done = subprocess.run([str(MUTMUT), "run"], cwd=folder, capture_output=True, text=True, check=False)
    counts = re.findall(r"(\d+)/(\d+)  ", done.stdout)
    if not counts:
        raise RuntimeError(f"mutmut: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    names = subprocess.run([str(MUTMUT), "results"], cwd=folder, capture_output=True, text=True, check=True).stdout
    found = [line.split(":")[0].strip() for line in names.splitlines() if line.endswith((": survived", ": no tests"))]
    return int(counts[-1][1]), [_shown(name, folder) for name in found]


def _shown(name: str, folder: Path) -> Mutant:
    text = subprocess.run([str(MUTMUT), "show", name], cwd=folder, capture_output=True, text=True, check=True).stdout
    file = next(line.split()[1] for line in text.splitlines() if line.startswith("--- "))
    was = [line[1:].strip() for line in text.splitlines() if line.startswith("-") and not line.startswith("---")]
    became = [line[1:].strip() for line in text.splitlines() if line.startswith("+") and not line.startswith("+++")]
    return Mutant(file, " ".join(was), " ".join(became))


def reasons() -> list[tuple[re.Pattern[str], re.Pattern[str], str]]:
    """Patterns of what was and became, and why that is no matter."""
    given = tomllib.loads(REASONS.read_text())["reason"]
    return [(re.compile(each["was"]), re.compile(each["became"]), each["why"]) for each in given]


def page(total: int, survived: Sequence[Mutant], seconds: float, commit: str) -> str:
    """The results."""
    known = reasons()
    rows, open_ones = [], 0
    for mutant in survived:
        why = next((why for was, became, why in known if was.search(mutant.was) and became.search(mutant.became)), "")
        open_ones += not why
        rows.append(f"| {mutant.file} | `{_cell(mutant.was)}` | `{_cell(mutant.became)}` | {why or '**none yet**'} |")
    lines = [
        "# What no test notices",
        "",
        "Made by `make campaign-mutation` with mutmut, of decoding, sampling, detectors and isolation by their tests.",
        provenance(commit, seconds),
        "",
        f"{total} mutants, {total - len(survived)} noticed. {len(survived)} survived, {open_ones} without a reason.",
        "",
        "| file | was | became | why that is no matter |",
        "|---|---|---|---|",
        *rows,
    ]
    return "\n".join([*lines, ""])


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("`", "'")


def copied(folder: Path) -> Path:
    """The repository's files as they are now; copies in place of the package's links, as mutants are imported there."""
    names = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", *COPIED], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in names.stdout.splitlines():
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes((ROOT / name).read_bytes())
    for link in (ROOT / "src" / "faultline").iterdir():
        if link.is_symlink():
            shutil.copytree(folder / link.name, folder / "src" / "faultline" / link.name)
    return folder


def main() -> None:
    """Runs it and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/results/mutation.md"))
    options = parser.parse_args()
    start, commit = time.monotonic(), head_commit()
    with TemporaryDirectory() as folder:
        total, survived = survivors(copied(Path(folder)))
    text = page(total, survived, time.monotonic() - start, commit)
    options.out.write_text(text)
    print(text.split("| file")[0])


if __name__ == "__main__":
    main()
