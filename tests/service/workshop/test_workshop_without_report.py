"""The command where the template engine is not installed, as in the vehicle's base: a verdict, and no report."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import msgspec
import pytest
from workshop_service import WHOLE, Service, visits

from faultline.service import pages
from faultline.service.cli import dispatch
from faultline.service.workshop.result import Result

INSTALL = "the report needs jinja2; pip install 'faultline-diagnosis[web]'"


@pytest.fixture(autouse=True)
def _no_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    pages._environment.cache_clear()


def run(folder: Path, *more: str) -> int:
    commands = {"workshop": EntryPoint("workshop", "faultline.service.workshop.command:main", "faultline.commands")}
    return dispatch(["workshop", "--control", str(folder / "c"), "--plain", *more], commands)


def test_the_verdict_is_told_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with Service(tmp_path / "c", visits(WHOLE), stays=True):
        assert run(tmp_path) == 0
    out = capsys.readouterr().out
    assert "NO FAULT FOUND" in out
    assert out.count(f"report: none, {INSTALL}") == 2  # before the test, and after it
    assert not list(tmp_path.glob("*.html"))


def test_programs_are_told_that_there_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Service(tmp_path / "c", visits(["idle"])):
        assert run(tmp_path, "--json") == 2
    assert msgspec.json.decode(capsys.readouterr().out, type=Result).report is None


def test_a_report_that_is_asked_for_is_refused_before_the_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Service(tmp_path / "c", visits(WHOLE)):
        assert run(tmp_path, "--report", str(tmp_path / "r.html")) == 2
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", f"faultline workshop: error: {INSTALL}\n")
