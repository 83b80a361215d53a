"""What holds for all tests: order, signals, and that in CI a skipped test is a failure."""

import os
import signal
from pathlib import Path

import pytest
from costs import Costs

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Shells start jobs in the background, and nohup, with SIGINT ignored, and so would all that tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds `--costs FILE`."""
    parser.addoption("--costs", type=Path, help="append the CPU seconds of each test to this file, one JSON line each")


def pytest_configure(config: pytest.Config) -> None:
    """Measures each test; the processes of pytest-xdist measure, and the one that directs them writes."""
    file = None if hasattr(config, "workerinput") else config.getoption("--costs")
    config.pluginmanager.register(Costs(file and file.absolute()))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What waits for real time begins first: the others are done meanwhile, and nobody waits for it at the end."""
    items.sort(key=lambda item: item.get_closest_marker("waits") is None)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Counts the skipped tests of the session; any is too many where `CI` is set: what can run there must have run."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = len(reporter.stats.get("skipped", [])) if reporter else 0
    if skipped and os.environ.get("CI"):
        print(f"\n{skipped} tests were skipped; in CI each must run")
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
