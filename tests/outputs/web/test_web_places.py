"""Where it listens, and a daemon that is away or hangs."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from test_web_api import BEARER, OTHER, codes, problem
from test_web_metrics import one, strictly
from web_daemon import FakeDaemon
from web_server import TOKEN, serving, until


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


@pytest.fixture
def daemon(folder: Path) -> Iterator[FakeDaemon]:
    with FakeDaemon(folder) as made:
        yield made


def test_on_a_unix_socket_under_any_name(daemon: FakeDaemon, folder: Path) -> None:
    path = folder / "http.sock"
    arguments = ("--control", str(daemon.control), "--events", str(daemon.events), "--listen", f"unix:{path}")
    with serving(*arguments, log=folder / "unix.log", orderly=True) as running:
        assert path.stat().st_mode & 0o777 == 0o660
        with running.client() as client:
            assert codes(client) == ["1", "2"]
            answer = client.delete("/v1/components/uds/faults/1", headers=BEARER)
            assert problem(answer) == (403, "not-configured")
            assert "clearing is not configured" in answer.json()["detail"]
    assert not path.exists()


def test_where_other_machines_may_ask_all_need_a_token(daemon: FakeDaemon, folder: Path) -> None:
    settings = folder / "http.toml"
    settings.write_text(
        f'control = "{daemon.control}"\nevents = "{daemon.events}"\nlisten = "127.0.0.1:0"\n'
        f'token_file = "{folder / "tokens"}"\nallow_remote = true\n'
    )
    (folder / "tokens").write_text(f"{TOKEN}\n")
    (folder / "tokens").chmod(0o600)
    with serving("--config", str(settings), log=folder / "remote.log") as running, running.client() as client:
        for path in ("/", "/v1/health", "/metrics", "/v1/events", "/nothing"):
            assert problem(client.get(path))[0] == 401
            assert problem(client.get(path, headers=OTHER))[0] == 403
        assert client.get("/v1/health", headers={**BEARER, "Host": "vehicle.example"}).status_code == 200
        paths = client.get("/v1/openapi.json", headers=BEARER).json()["paths"]
        assert all(each["security"] for path in paths.values() for each in path.values())


def test_the_daemon_away_and_back(folder: Path) -> None:
    (folder / "away").mkdir()
    tokens = folder / "away" / "tokens"
    tokens.write_text(TOKEN)
    tokens.chmod(0o600)
    daemon = FakeDaemon(folder / "away")
    control, events = str(daemon.control), str(daemon.events)
    arguments = ("--control", control, "--events", events, "--listen", "127.0.0.1:0", "--token-file", str(tokens))
    with serving(*arguments, log=folder / "away.log") as running, running.client() as client:
        for path in (
            "/v1/components",
            "/v1/ready",
            "/v1/records",
            "/v1/systems/a",
            "/v1/live/a",
            "/v1/components/a/faults/1",
        ):
            answer = client.get(path)
            assert problem(answer) == (503, "away")
            assert answer.headers["retry-after"] == "1"
        assert problem(client.delete("/v1/components/uds/faults/1", headers=BEARER)) == (503, "away")
        answer = client.get("/v1/health")
        assert (answer.status_code, answer.json()["status"]) == (503, "away")
        figures = strictly(client.get("/metrics").content)
        assert (one(figures, "faultline_up"), one(figures, "faultline_http_subscribed")) == (0, 0)
        with daemon:
            until(lambda: codes(client) == ["1", "2"])
            assert client.get("/v1/health").status_code == 200
        until(lambda: client.get("/v1/ready").status_code == 503)


def test_a_daemon_that_hangs_holds_up_nobody_for_long(folder: Path) -> None:
    (folder / "hangs").mkdir()
    with FakeDaemon(folder / "hangs") as daemon:
        daemon.silent = True
        arguments = ("--control", str(daemon.control), "--events", str(daemon.events), "--listen", "127.0.0.1:0")
        with (
            serving(*arguments, limits={"answer_s": 0.3}, log=folder / "hangs.log") as running,
            running.client() as client,
        ):
            answer = client.get("/v1/ready")
            assert problem(answer) == (503, "away")
            assert "no answer within 0.3 s" in answer.json()["detail"]
            assert client.get("/").status_code == 200
