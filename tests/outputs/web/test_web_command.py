"""The command: what it refuses to do, what it tells systemd, and how it ends."""

import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from web_daemon import FakeDaemon
from web_server import COMMAND, PATIENCE_S, ROOT, TOKEN, Sse, serving, until

from faultline.service.core.errors import InputError
from faultline.service.web.command import main

PLACES = ("--control", "/nowhere/control.sock", "--events", "/nowhere/events.sock")


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[FakeDaemon]:
    with FakeDaemon(tmp_path) as made:
        yield made


def places(daemon: FakeDaemon) -> tuple[str, ...]:
    return "--control", str(daemon.control), "--events", str(daemon.events)


def refused(*arguments: str) -> str:
    with pytest.raises(InputError) as caught:
        main([*arguments])
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("listen", ["0.0.0.0:8080", "[::]:8080", "192.168.1.2:8080"])
def test_other_machines_are_not_listened_to(listen: str) -> None:
    assert "can be reached from other machines" in refused(*PLACES, "--listen", listen)


def test_not_in_a_configuration_without_tokens_either(tmp_path: Path) -> None:
    settings = tmp_path / "http.toml"
    text = 'control = "/c"\nevents = "/e"\nlisten = "0.0.0.0:0"\n'
    settings.write_text(text)
    assert refused("--config", str(settings)).startswith(f"{settings}:3: listen:")
    settings.write_text(text + "allow_remote = true\n")
    assert "every request needs a token" in refused("--config", str(settings))


def test_tokens_that_others_may_read_are_refused(tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text(TOKEN)
    tokens.chmod(0o644)
    message = refused(*PLACES, "--listen", "127.0.0.1:0", "--token-file", str(tokens))
    assert message.startswith(f"{tokens}: others may read or write it; `chmod o= {tokens}`")


def test_a_port_that_is_taken(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert refused(*PLACES, "--listen", address).startswith(f"listen: {address}: Address already in use")


def test_a_unix_socket_that_is_taken_or_no_socket(tmp_path: Path) -> None:
    path = tmp_path / "http.sock"
    path.touch()
    assert "is no socket" in refused(*PLACES, "--listen", f"unix:{path}")
    path.unlink()
    with socket.socket(socket.AF_UNIX) as taken:
        taken.bind(str(path))
        taken.listen()
        assert "another process listens there" in refused(*PLACES, "--listen", f"unix:{path}")
    assert "cannot listen there" in refused(*PLACES, "--listen", f"unix:{tmp_path / 'none' / 'a'}")
    assert "cannot listen there" in refused(*PLACES, "--listen", f"unix:{tmp_path / ('a' * 200)}")


def test_what_a_dead_process_left_is_replaced(daemon: FakeDaemon, tmp_path: Path) -> None:
    path = tmp_path / "http.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    with (
        serving(*places(daemon), "--listen", f"unix:{path}", log=tmp_path / "log") as server,
        server.client() as client,
    ):
        assert client.get("/v1/ready").status_code == 200


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give --config or --recording, or --control, --events, --listen too"),
        (["--control", "/c", "--listen", "unix:/x"], "give --config or --recording, or --events too"),
        (["--config", "/x", "--control", "/c", "--token-file", "/t"], "leave out --control, --token-file"),
        (["--recording", "/log"], "--recording needs --bundle too"),
        (["--recording", "/log", "--bundle", "/b", "--events", "/e"], "needs no service: leave out --events"),
        (["--bundle", "/b"], "--bundle goes with --recording"),
    ],
)
def test_options_that_make_no_sense(capsys: pytest.CaptureFixture[str], arguments: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["starlette", "uvicorn"])
def test_an_installation_without_the_extra_says_so(missing: str) -> None:
    code = f"""
import sys
from importlib.metadata import EntryPoint
sys.modules[{missing!r}] = None
from faultline.service.cli import dispatch
command = EntryPoint("serve", "faultline.service.web.command:main", "faultline.commands")
sys.exit(dispatch(sys.argv[1:], {{"serve": command}}))
"""
    arguments = ["serve", *PLACES, "--listen", "127.0.0.1:0"]
    ended = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == f"faultline serve: error: needs {missing}; pip install 'faultline-diagnosis[web]'\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_within_three_seconds_whoever_listens(
    daemon: FakeDaemon, tmp_path: Path, number: signal.Signals
) -> None:
    """Streams end in an orderly way; one that takes nothing holds up nothing."""
    daemon.tell(*range(1, 2001), padding=1000)
    assert any(_ended_in(daemon, tmp_path, number) < 3 for _ in range(3)), "of three tries, on a machine that is busy"


def _ended_in(daemon: FakeDaemon, tmp_path: Path, number: signal.Signals) -> float:
    """How long it takes [s]."""
    path = tmp_path / "http.sock"
    with serving(*places(daemon), "--listen", f"unix:{path}", log=tmp_path / "log", orderly=True) as server:
        listening = [Sse(server, place) for place in ("/v1/events", "/v1/live/uds", "/v1/events")]
        for stream in listening:
            next(stream.events())
        stalled, silent = server.connect(), server.connect()
        stalled.sendall(b"GET /v1/events?after=0 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        silent.sendall(b"GET /v1/re")
        assert stalled.recv(10)
        begun = time.monotonic()
        server.process.send_signal(number)
        for stream in listening:
            assert [event for event in stream.events() if "data" in event] == []
            assert stream.ended, "its last chunk came"
        assert server.process.wait(PATIENCE_S) == 0
        took = time.monotonic() - begun
    assert not path.exists()
    return took


def test_what_systemd_is_told(daemon: FakeDaemon, tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(PATIENCE_S)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "3000000"}
        arguments = (*places(daemon), "--listen", "127.0.0.1:0")
        with serving(*arguments, environment=environment, log=tmp_path / "log", orderly=True) as server:
            assert manager.recv(4096).splitlines() == [b"READY=1", b"STATUS=serving"]
            with server.client() as client:
                assert client.get("/v1/ready").status_code == 200
            assert manager.recv(4096) == b"WATCHDOG=1"
            assert manager.recv(4096) == b"WATCHDOG=1"
        said = [manager.recv(4096)]
        while said[-1] == b"WATCHDOG=1":
            said.append(manager.recv(4096))
        assert said[-1] == b"STOPPING=1"


def test_tokens_from_systemd(daemon: FakeDaemon, tmp_path: Path) -> None:
    (tmp_path / "http-tokens").write_text(TOKEN)
    (tmp_path / "http-tokens").chmod(0o400)
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
    arguments = (*places(daemon), "--listen", "127.0.0.1:0")
    with serving(*arguments, environment=environment, log=tmp_path / "log") as server, server.client() as client:
        answer = client.delete("/v1/components/uds/faults/1", headers={"Authorization": f"Bearer {TOKEN}"})
        assert answer.status_code == 204
        assert TOKEN not in (tmp_path / "log").read_text()


def test_a_failure_of_its_own_ends_it_and_is_told(daemon: FakeDaemon) -> None:
    """It must not serve on without hearing events, or ticks: systemd starts it anew."""
    assert "ZeroDivisionError: of the test\n" in _failing("events.Hub.run = run", PLACES)
    watching = """
import threading, time, urllib.request
original = live._Feed.take
live._Feed.take = lambda self, line: 1 / 0
def watch():
    while "url" not in said: time.sleep(0.01)
    urllib.request.urlopen(said["url"] + "/v1/live/uds").read()
said = {}
from faultline.service.web import command
command._say = lambda text: said.setdefault("url", text.split()[2].rstrip(","))
threading.Thread(target=watch, daemon=True).start()
"""

    def tick() -> None:
        until(lambda: daemon.watchers)
        daemon.tick(1)

    ticking = threading.Thread(target=tick)
    ticking.start()
    assert "ZeroDivisionError: division by zero\n" in _failing(watching, places(daemon))
    ticking.join()


def _failing(change: str, arguments: tuple[str, ...]) -> str:
    """What a server says at its end that fails by this change."""
    code = f"""
from faultline.service.web import events, live
async def run(self): raise ZeroDivisionError("of the test")
{change}
{COMMAND}
"""
    command = [sys.executable, "-c", code, *arguments, "--listen", "127.0.0.1:0"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 1
    return ended.stderr


def test_what_is_served_needs_little_memory_and_nothing_of_the_design(daemon: FakeDaemon, tmp_path: Path) -> None:
    daemon.tell(*range(1, 4097), padding=500)
    with serving(*places(daemon), "--listen", "127.0.0.1:0", log=tmp_path / "log") as server, server.client() as client:
        until(lambda: client.get("/v1/events?after=x%20").status_code == 400)
        stream = Sse(server, "/v1/events?after=1")
        next(stream.events())
        mapped = Path(f"/proc/{server.process.pid}/maps").read_text()
        assert "numpy" not in mapped
        assert "onnxruntime" not in mapped
        status = Path(f"/proc/{server.process.pid}/status").read_text()
        peak_kib = int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
        assert peak_kib < 80 * 1024
