"""CPU time of each test: of its process and of the child processes that it waited for, set-up and teardown included.

A fixture that several tests share is counted to the first of them. `--costs FILE` adds one line of JSON for each test;
`python tests/costs.py table NAME FILE [NAME FILE ...]` prints a table of such files by folder, and
`python tests/costs.py keep FILE ...` writes tests/costs.json, by which the costliest tests begin first and `make check`
leaves out those that cost more than `SLOW_S`.
"""

import json
import resource
import sys
from collections.abc import Generator
from functools import cache
from pathlib import Path
from typing import cast

import pytest

START = pytest.StashKey[float]()
PROPERTY = "cpu_s"
SLOW_S = 0.3
"""CPU time from which on a test is left to `make test`."""
OTHERS = "all others"
KEPT = Path(__file__).with_name("costs.json")


class Costs:
    """A pytest plugin that measures in the processes of pytest-xdist and writes in the one that directs them."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._lines: list[str] = []

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, bool | None, bool | None]:
        """Note the CPU time before set-up."""
        item.stash[START] = cpu_s()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Add the test's CPU time to the report of its teardown."""
        report = yield
        if call.when == "teardown":
            report.user_properties.append((PROPERTY, round(cpu_s() - item.stash[START], 3)))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect the CPU times of all processes."""
        cost = cast("float | None", dict(report.user_properties).get(PROPERTY))
        if self._file is not None and report.when == "teardown" and cost is not None:
            self._lines.append(json.dumps({"test": report.nodeid, PROPERTY: cost}))

    def pytest_sessionfinish(self) -> None:
        """Append to the file."""
        if self._file is not None:
            with self._file.open("a") as file:
                file.writelines(f"{line}\n" for line in sorted(self._lines))


def cpu_s() -> float:
    """Return user and system time of this process and of its children that have ended, in seconds."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def table(runs: dict[str, Path]) -> str:
    """Return a Markdown table of tests and CPU seconds by folder, two columns for each of the runs."""
    folders: dict[str, dict[str, list[float]]] = {}
    for name, file in runs.items():
        for line in file.read_text().splitlines():
            test = json.loads(line)
            folder = "/".join(test["test"].partition("::")[0].removeprefix("src/faultline/").split("/")[:-1][:3])
            folders.setdefault(folder, {}).setdefault(name, []).append(test[PROPERTY])
    folders["**all**"] = {name: [each for by in folders.values() for each in by.get(name, [])] for name in runs}
    heads = (f"tests, {name} | CPU s, {name}" for name in runs)
    rows = [f"| folder | {' | '.join(heads)} |", "|---" + "|---:|---:" * len(runs) + "|"]
    for folder, by in sorted(folders.items()):
        cells = (f"{len(by.get(name, []))} | {sum(by.get(name, [])):.1f}" for name in runs)
        rows.append(f"| {folder} | {' | '.join(cells)} |")
    return "\n".join(rows)


def keep(files: list[Path]) -> None:
    """Write `KEPT`: for each test file the CPU time [s] of its slow tests by name, and of all others together."""
    kept: dict[str, dict[str, float]] = {}
    for line in (line for file in files for line in file.read_text().splitlines()):
        row = json.loads(line)
        path, _, name = row["test"].partition("::")
        of = kept.setdefault(path, {OTHERS: 0.0})
        key = name if row[PROPERTY] > SLOW_S else OTHERS
        of[key] = round(of.get(key, 0.0) + row[PROPERTY], 2)
    KEPT.write_text(json.dumps(kept, indent=0, sort_keys=True) + "\n")


@cache
def kept() -> dict[str, dict[str, float]]:
    """Return what `keep` wrote."""
    read: dict[str, dict[str, float]] = json.loads(KEPT.read_text())
    return read


def of_file(path: str) -> float:
    """Return the CPU time of the tests of a file that are not slow, in seconds; 0 where it is not known."""
    return kept().get(path, {}).get(OTHERS, 0.0)


def total_of_file(path: str) -> float:
    """Return the CPU time of all tests of a file in seconds; 0 where it is not known."""
    return sum(kept().get(path, {}).values())


def of_test(path: str, name: str) -> float:
    """Return the CPU time of a slow test in seconds; 0 for the others."""
    return kept().get(path, {}).get(name, 0.0)


if __name__ == "__main__":
    what, *given = sys.argv[1:]
    if what == "keep":
        keep([Path(file) for file in given])
    else:
        print(table(dict(zip(given[::2], map(Path, given[1::2]), strict=True))))
