"""What holds for all tests: order, signals, and that in CI a skipped test is a failure."""

import os
import signal

import pytest

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Shells start jobs in the background, and nohup, with SIGINT ignored, and so would all that tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)


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
