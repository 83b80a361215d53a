"""In CI a skipped test is a failure: what can run there must have run."""

import os

import pytest


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Counts the skipped tests of the session; any is too many where `CI` is set."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    skipped = len(reporter.stats.get("skipped", [])) if reporter else 0
    if skipped and os.environ.get("CI"):
        print(f"\n{skipped} tests were skipped; in CI each must run")
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
