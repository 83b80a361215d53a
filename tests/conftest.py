"""What holds for all tests: order, signals, and that in CI a skipped test is a failure."""

import os
import signal
from pathlib import Path
from shutil import rmtree

import pytest
from costs import Costs, of_test, total_of_file
from once import open_folder

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Shells start jobs in the background, and nohup, with SIGINT ignored, and so would all that tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds `--costs FILE` and `--quick`."""
    parser.addoption("--costs", type=Path, help="append the CPU seconds of each test to this file, one JSON line each")
    parser.addoption("--quick", action="store_true", help="leave out slow tests and those that are alone, long or wait")


def pytest_configure(config: pytest.Config) -> None:
    """Measures each test; the processes of pytest-xdist measure, and the one that directs them writes."""
    if (made := open_folder()) is not None:
        config.add_cleanup(lambda: rmtree(made))
    file = None if hasattr(config, "workerinput") else config.getoption("--costs")
    config.pluginmanager.register(Costs(file and file.absolute()))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The file whose tests cost most begins first: none is waited for by processes that have nothing left to do.

    What waits for real time begins before all, as others are done meanwhile. A file stays together, as its tests
    share what is made for them.
    """
    if config.getoption("--quick"):
        left = [item for item in items if not is_quick(item)]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if is_quick(item)]
    waits = {item.path for item in items if item.get_closest_marker("waits")}
    items.sort(key=lambda item: (item.path not in waits, -total_of_file(file_of(item)), file_of(item)))


def is_quick(item: pytest.Item) -> bool:
    """Whether `make check` runs the test."""
    if any(item.get_closest_marker(name) for name in ("alone", "long", "waits")):
        return False
    path, _, name = item.nodeid.partition("::")
    return of_test(path, name) == 0.0


def file_of(item: pytest.Item) -> str:
    """The test's file, as in the names that pytest prints."""
    return item.nodeid.partition("::")[0]


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Counts the skipped tests of the session; any is too many where `CI` is set: what can run there must have run."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = len(reporter.stats.get("skipped", [])) if reporter else 0
    if skipped and os.environ.get("CI"):
        print(f"\n{skipped} tests were skipped; in CI each must run")
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
