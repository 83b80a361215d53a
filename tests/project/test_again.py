"""Which failed tests are asked again."""

import json
from pathlib import Path

import again
import pytest


@pytest.mark.parametrize(
    ("name", "live"),
    [
        ("tests/service/mqtt/test_mqtt_told.py::test_a[1/2]", True),
        ("tests/outputs/web/test_web_api.py::test_a", True),
        ("tests/thread/test_kept.py::test_a", True),
        ("tests/guest/test_guest.py::test_a", True),
        ("tests/service/core/test_cusum.py::test_a", False),
        ("tests/analysis/structure/test_engine.py::test_a", False),
        ("service/core/separating.py::service.core.separating", False),
        ("tests/test_a.py::test_a", False),
    ],
)
def test_knows_live_tests(name: str, live: bool) -> None:
    assert again.is_live(name) is live


LIVE = "tests/thread/test_a.py::test_{}"


@pytest.mark.parametrize(
    "failed",
    [[], [LIVE.format(k) for k in range(5)], [LIVE.format(0), "tests/analysis/test_a.py::test_a"]],
    ids=["none that is known", "many", "one that is pure"],
)
def test_what_is_not_asked_again_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failed: list[str]) -> None:
    monkeypatch.setattr(again, "LAST", tmp_path / "lastfailed")
    again.LAST.write_text(json.dumps(dict.fromkeys(failed, True)))
    assert again.main(1, "/no/python") == 1


@pytest.mark.parametrize("code", [0, 1])
def test_what_fails_alone_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/asked\nexit {code}\n')
    python.chmod(0o755)
    monkeypatch.setattr(again, "LAST", tmp_path / "lastfailed")
    again.LAST.write_text(json.dumps({LIVE.format(1): True}))
    assert again.main(1, str(python)) == code
    assert (tmp_path / "asked").read_text().split()[-1] == LIVE.format(1)


@pytest.mark.parametrize("code", [2, 3, 4, 5])
def test_a_run_that_did_not_come_to_its_end_is_not_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    monkeypatch.setattr(again, "LAST", tmp_path / "lastfailed")
    again.LAST.write_text(json.dumps({LIVE.format(1): True}))
    assert again.main(code, "/no/python") == code
