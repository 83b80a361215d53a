"""The command against a control socket: what is shown, exit codes, the report, what is refused."""

import json
import os
import pty
import signal
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import pytest

from faultline.service.core.errors import InputError
from faultline.service.workshop import command
from faultline.service.workshop.result import SCHEMA, Result
from faultline.service.workshop.screen import SHOW

sys.path.append(str(Path(__file__).parents[2] / "service" / "workshop"))
from workshop_service import BUNDLE, FILTER, SYSTEM, WHOLE, Service, line, remembered, visits

HOSTILE = '<script>alert("1")</script>&\'\x1b[2J'
THERE: dict[str, Any] = {"diagnoses": [FILTER], "alarm": ["t1"], "anomaly": True}


class Strict(HTMLParser):
    """Every element is closed, and nothing comes from elsewhere or runs."""

    VOID = frozenset(("meta", "br"))

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        assert not {name for name, _ in attrs} & {"src", "href", "onload", "onclick", "xlink:href"}
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def parsed(path: Path) -> Strict:
    text = path.read_text()
    parser = Strict()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    assert not parser.tags & {"script", "link", "iframe", "img", "object"}
    assert "url(" not in text
    assert "http" not in text.replace("http-equiv", "")
    return parser


def run(tmp_path: Path, *more: str) -> int:
    return command.main(["--control", str(tmp_path / "c"), "--report", str(tmp_path / "r.html"), "--plain", *more])


def test_no_fault_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Service(tmp_path / "c", visits(WHOLE), stays=True):
        assert run(tmp_path, "--note", "after the filter was changed") == 0
    out = capsys.readouterr().out
    assert "NO FAULT FOUND" in out
    assert "done: idle 1, partial 1, maximum 1, idle 2, partial 2, maximum 2" in out
    assert "\x1b" not in out
    texts = parsed(tmp_path / "r.html").texts
    assert {"NO FAULT FOUND", "after the filter was changed", "truck-17", "No fault is remembered."} <= {*texts}


def test_a_fault_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before, after = [remembered(1)], [remembered(1), remembered(2)]
    answers, later = {"faults": {"faults": before}}, {"faults": {"faults": after}}
    live = [*visits(WHOLE), *visits(["partial"], begin=3000, **THERE)]
    live[100:] = [each | THERE for each in live[100:]]
    with Service(tmp_path / "c", live, stays=True, answers=answers, after=later):
        assert run(tmp_path, "--json") == 1
    printed = capsys.readouterr()
    found = msgspec.json.decode(printed.out, type=Result)
    assert printed.out.count("\n") == 1
    assert (found.schema, found.verdict.kind, found.end) == (SCHEMA, "fault", "complete")
    assert [each.during_test for each in found.remembered] == [False, True]
    assert found.tests[0].verdict == "alarm"
    assert "FAULT: filter" in printed.err
    assert {"filter", "SPN 3362 FMI 7", "in this test", "before this test"} <= {*parsed(tmp_path / "r.html").texts}


def test_a_service_that_ends_cannot_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Service(tmp_path / "c", visits(["idle"])):
        assert run(tmp_path) == 2
    assert "the service has ended" in capsys.readouterr().out
    assert "CANNOT TELL" in parsed(tmp_path / "r.html").texts


def test_patience_with_a_silent_service(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Service(tmp_path / "c", [], stays=True):
        assert run(tmp_path, "--patience", "1") == 2
    out = capsys.readouterr().out
    assert "nothing comes from the service" in out
    assert "not one sample came" in out


def test_conditions_are_said_before_with_a_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = {
        "source": "truck-17",
        "version": "0.1.0",
        "wall": "2026-01-01T00:00:00+00:00",
        "seq": 1,
        "conditions": [{"kind": "bus-down", "of": "can0", "since": None}],
        "systems": [{"name": "uds", "bundle": BUNDLE}],
    }
    with Service(tmp_path / "c", answers={"state": state}):
        assert run(tmp_path) == 2
    assert "first: can0 the interface is down: bring the interface up" in capsys.readouterr().out


def test_other_tests_than_before_end_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Service(tmp_path / "c", [line(0), line(1) | {"usable": [True]}], stays=True):
        assert run(tmp_path) == 2
    assert "taken up another bundle" in capsys.readouterr().out


def test_hostile_names_are_escaped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    system = json.loads(json.dumps(SYSTEM))
    system["faults"][0] |= {"component": HOSTILE.replace("\x1b", ""), "description": "<b>"}
    system["inputs"][0]["signal"] = system["generators"][0]["predicts"] = system["generators"][1]["predicts"] = HOSTILE
    old = remembered(1, component=HOSTILE)
    with Service(tmp_path / "c", visits(["idle"], **THERE), answers={"system": system, "faults": {"faults": [old]}}):
        assert run(tmp_path, "--note", HOSTILE) == 1
    assert any("<script>" in text for text in parsed(tmp_path / "r.html").texts)
    assert "\x1b" not in capsys.readouterr().out


def test_a_report_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "r.html").write_text("mine")
    with Service(tmp_path / "c", visits(["idle"])):
        with pytest.raises(InputError, match="already there"):
            run(tmp_path)
        assert (tmp_path / "r.html").read_text() == "mine"
        assert run(tmp_path, "--force") == 2
    assert "CANNOT TELL" in (tmp_path / "r.html").read_text()


def test_the_report_is_named_after_vehicle_system_and_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with Service(tmp_path / "c", []):
        command.main(["--control", "c", "--plain"])
    [report] = tmp_path.glob("faultline-workshop-truck-17-uds-*.html")
    parsed(report)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--system", "brakes"], "no system 'brakes'; give --system one of uds"),
        (["--report", "/nowhere/r.html"], "/nowhere/r.html: cannot be written"),
    ],
)
def test_what_cannot_be_is_refused_before_the_test(tmp_path: Path, more: list[str], words: str) -> None:
    with Service(tmp_path / "c"), pytest.raises(InputError, match=words):
        run(tmp_path, *more)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"systems": []}, "watches no system"),
        ({"systems": [{"name": each, "bundle": BUNDLE} for each in ("a", "b")]}, "watches a, b; say which"),
        ({"is_recording": True}, "serves a recording"),
        ({"systems": 1}, "another version of faultline"),
    ],
)
def test_a_service_that_will_not_do_is_refused(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    with Service(tmp_path / "c") as service:
        service.answers["state"] |= change
        with pytest.raises(InputError, match=words):
            run(tmp_path)


def test_nobody_answers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is the service running"):
        run(tmp_path)


def test_garbled_ticks_are_an_error(tmp_path: Path) -> None:
    with Service(tmp_path / "c", [{"tick": "x"}], stays=True), pytest.raises(InputError, match="another version"):
        run(tmp_path)


@pytest.mark.parametrize("text", ["0", "nan", "x", "1e9"])
def test_times_that_make_no_sense_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(SystemExit) as refused:
        run(tmp_path, "--hold", text)
    assert refused.value.code == 2


def begun(tmp_path: Path, **how: Any) -> "subprocess.Popen[bytes]":
    arguments = ["workshop", "--control", str(tmp_path / "c"), "--report", str(tmp_path / "r.html")]
    main = f"import sys; from faultline.service.cli import main; sys.exit(main({arguments!r}))"
    environment = {**os.environ, "TERM": "xterm"}
    environment.pop("NO_COLOR", None)
    return subprocess.Popen([sys.executable, "-c", main], env=environment, **how)


def test_ctrl_c_writes_the_report_first(tmp_path: Path) -> None:
    with Service(tmp_path / "c", visits(["idle"], seconds=30.0), stays=True):
        process = begun(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        assert process.stdout is not None
        for shown in process.stdout:
            if b"go on: hold the pressure" in shown:
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err.decode()
    assert b"CANNOT TELL" in out
    assert any("broken off by hand" in text for text in parsed(tmp_path / "r.html").texts)


def test_on_a_terminal_one_screen_is_drawn_in_place(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with Service(tmp_path / "c", visits(WHOLE), stays=True):
        process = begun(tmp_path, stdout=theirs, stderr=theirs, stdin=theirs)
        os.close(theirs)
        shown = b""
        while True:
            try:
                some = os.read(ours, 4096)
            except OSError:  # EIO: the last process has closed the terminal
                break
            if not some:
                break
            shown += some
        os.close(ours)
        assert process.wait(60) == 0
    text = shown.decode()
    assert text.index("\x1b[H") < text.index(SHOW) < text.index("NO FAULT FOUND")
    assert "########################" in text
    assert "10.000 bar" in text
