"""`make check`: lint, and the tests that the changes since their last success reach, nearest first, within a minute.

A test file depends on the modules that it and its helpers import, on what those import, on the commands that it names,
on the data in the folders of all these, and on the files and folders of the repository that it names. It need not run
where a digest of all this is that of its last success (`.pytest_cache/checked.json`). Tests that cost more than
`SLOW_S` by tests/costs.json, or want a machine of their own, are left to `make test`.
"""

import argparse
import ast
import hashlib
import json
import subprocess
import sys
import time
import tomllib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import grimp
from costs import of_file

ROOT = Path(__file__).resolve().parents[1]
LINKS = ROOT / "src" / "faultline"
CHECKED = ROOT / ".pytest_cache" / "checked.json"
BUDGET_S = 40.0
"""CPU time of the tests of one check by their last measurement; starting, collecting and lint take as much again."""
FILE_S = 0.15
"""CPU time of importing a test file."""
LINT = (
    ["ruff", "check", "--quiet"],
    ["ruff", "format", "--check", "--quiet"],
    ["lint-imports", "--no-logo"],
    ["mypy", "--no-error-summary"],
)


@dataclass(frozen=True)
class TestFile:
    """A file with tests, a digest of all that it depends on, and its distance from what has changed, in imports."""

    path: str
    digest: str
    distance: int
    cost_s: float


def main() -> int:
    """Exit code 0 where lint and all tests that ran succeeded."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--all", action="store_true", help="every test that is not slow, whatever has changed")
    everything = parser.parse_args().all
    start = time.monotonic()
    lint = [subprocess.Popen([str(Path(sys.executable).with_name(c[0])), *c[1:]], cwd=ROOT) for c in LINT]
    done: dict[str, str] = json.loads(CHECKED.read_text()) if CHECKED.exists() else {}
    files = test_files()
    wanted = files if everything else [file for file in files if done.get(file.path) != file.digest]
    chosen = wanted if everything or not done else within(wanted, BUDGET_S)
    code = run(chosen) if chosen else 0
    if code == 0:
        CHECKED.parent.mkdir(exist_ok=True)
        CHECKED.write_text(json.dumps(done | {file.path: file.digest for file in chosen}, indent=0, sort_keys=True))
    failed = [" ".join(command) for command, process in zip(LINT, lint, strict=True) if process.wait()]
    print(f"{len(chosen)} of {len(files)} test files, {time.monotonic() - start:.0f} s", end="")
    left = len(wanted) - len(chosen)
    print(f"; {left} that the change reaches from further away are left: make check again" if left else "")
    print("".join(f"failed: {command}\n" for command in failed), end="")
    return code or len(failed)


def within(files: list[TestFile], budget_s: float) -> list[TestFile]:
    """Return the nearest files whose tests cost no more together; at least one."""
    chosen: list[TestFile] = []
    spent_s = 0.0
    for file in sorted(files, key=lambda file: (file.distance, file.cost_s, file.path)):
        spent_s += file.cost_s
        if chosen and spent_s > budget_s:
            break
        chosen.append(file)
    return chosen


def run(files: list[TestFile]) -> int:
    """Run the tests of the files that are not slow; return pytest's exit code, 0 where all of them are slow."""
    workers = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"] if sum(f.cost_s for f in files) > 4.0 else []
    code = subprocess.run(
        [sys.executable, "-m", "pytest", "--quick", "-q", *workers, *(f.path for f in files)],
        cwd=ROOT,
        check=False,
    ).returncode
    return 0 if code == 5 else code  # 5: no tests


def test_files() -> list[TestFile]:
    """Return every file with tests or doctests."""
    tree, changed = Tree(), changed_files()
    paths = [path for path in tree.digests if path.startswith("tests/") and Path(path).name.startswith("test_")]
    paths += [path for path in tree.modules.values() if ">>>" in (ROOT / path).read_text()]
    found = []
    for path in sorted(paths):
        distances = tree.reached(path)
        digest = hashlib.sha256("".join(f"{each}{tree.digests[each]}" for each in sorted(distances)).encode())
        near = [distance for each, distance in distances.items() if each in changed]
        shown = path if path.startswith("tests/") else f"src/faultline/{path.removeprefix('src/faultline/')}"
        cost_s = FILE_S + of_file(shown)
        found.append(TestFile(shown, digest.hexdigest(), min(near, default=len(distances)), cost_s))
    return found


class Tree:
    """The files of the repository, their digests, and which of them a file depends on."""

    def __init__(self) -> None:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout.split("\0")  # fmt: skip
        files = [path for path in listed if (ROOT / path).is_file()]
        self.digests = {path: hashlib.sha256((ROOT / path).read_bytes()).hexdigest() for path in files}
        self.graph = grimp.build_graph("faultline", cache_dir=str(ROOT / ".pytest_cache" / "grimp"))
        self.modules = {name: path for name in self.graph.modules if (path := self._file(name)) in self.digests}
        self.data = self._data()
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        points = project["entry-points"]["faultline.commands"]
        self.commands = {name: target.partition(":")[0] for name, target in points.items()}
        self.helpers = {Path(path).stem: path for path in files if path.startswith("tests/") and path.endswith(".py")}
        self.tops = {path.split("/")[0] for path in files} - {"tests"}

    def _file(self, module: str) -> str:
        stem = module.removeprefix("faultline").lstrip(".").replace(".", "/")
        for path in (f"{stem}.py", f"{stem}/__init__.py".lstrip("/")):
            for place in (path, f"src/faultline/{path}"):
                if place in self.digests:
                    return place
        return ""

    def _data(self) -> dict[str, list[str]]:
        """Return, for each folder that is a package, the other files in it and in those below that are none."""
        packages = {str(Path(path).parent) for path in self.modules.values()}
        data: dict[str, list[str]] = {}
        for path in self.digests:
            folder = next((str(up) for up in Path(path).parents if str(up) in packages), None)
            if folder is not None and folder != "." and not path.endswith(".py"):
                data.setdefault(folder, []).append(path)
        return data

    def reached(self, path: str) -> dict[str, int]:
        """Return all files that a file depends on, with their distance in imports."""
        distances = {path: 0}
        queue = deque([path])
        while queue:
            file = queue.popleft()
            for other in self._next(file):
                if other not in distances:
                    distances[other] = distances[file] + 1
                    queue.append(other)
        return distances

    @cache  # noqa: B019  one tree lives as long as the program
    def _next(self, path: str) -> tuple[str, ...]:
        if path.startswith("tests/"):
            return tuple(self._next_of_test(path)) if path.endswith(".py") else ()
        if (module := self._of_file.get(path)) is None:
            return ()
        imported = self.graph.find_modules_directly_imported_by(module)
        files = [self.modules[name] for name in imported if name in self.modules]
        return (*files, *self.data.get(str(Path(path).parent), ()))

    @cached_property
    def _of_file(self) -> dict[str, str]:
        return {file: name for name, file in self.modules.items()}

    def _next_of_test(self, path: str) -> Iterable[str]:
        yield "tests/conftest.py"
        folder = str(Path(path).parent) + "/"
        yield from (each for each in self.digests if each.startswith(folder) and not each.endswith(".py"))
        for node in ast.walk(ast.parse((ROOT / path).read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                yield from self._imported(node)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield from self._named(node.value)

    def _imported(self, node: ast.Import | ast.ImportFrom) -> Iterable[str]:
        names = [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{name}" for name in names] + [str(node.module)]
        for name in names:
            if (file := self.modules.get(name) or self.helpers.get(name)) is not None:
                yield file

    def _named(self, text: str) -> Iterable[str]:
        """Yield the module of a command, or the files of a folder at the top, or one file, that a text names."""
        if text in self.commands:
            yield self.modules[self.commands[text]]
        if text in self.tops:
            yield from (path for path in self.digests if path == text or path.startswith(f"{text}/"))
        elif text == "golden":
            yield from (path for path in self.digests if path.startswith("tests/golden/"))


def changed_files() -> set[str]:
    """Return the files that differ from the last commit, and where there are none, from the one before."""
    for since in ("HEAD", "HEAD~1"):
        names = subprocess.run(
            ["git", "diff", "--name-only", since], cwd=ROOT, capture_output=True, text=True, check=True
        )
        if found := set(names.stdout.split()):
            return found
    return set()


if __name__ == "__main__":
    sys.exit(main())
