"""docs/your-system.md, as a reader follows it: from logs of three tanks to a leak that the service names from a bus."""

import contextlib
import json
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ports import free_port, multicast

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "your-system.md").read_text()
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
LEAK = "f_leak2"


def commands(marked: bool) -> list[list[str]]:
    """The commands of the page, those in the background (`# `) or the others; a remark behind one is cut."""
    lines = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL) for line in block.splitlines()]
    return [shlex.split(line.removeprefix("# "), comments=True) for line in lines if line.startswith("# ") == marked]


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all commands of the page have run, but for those in the background."""
    folder = tmp_path_factory.mktemp("reader")
    for name in ("systems", "testbench"):
        (folder / name).symlink_to(ROOT / name)
    for program, *arguments in commands(marked=False):
        assert program in (".venv/bin/faultline", "cp")
        call = [FAULTLINE if program != "cp" else program, *arguments]
        done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode == (1 if arguments[0] == "diagnose" else 0), (arguments, done.stdout, done.stderr)
        (folder / f"{Path(arguments[0]).name}.txt").write_text(done.stdout)  # not into the linked folders
    return folder


def test_the_page_ends_with_the_leak_named(followed: Path) -> None:
    assert f"1. {LEAK} (tank 2: leak)" in (followed / "diagnose.txt").read_text()
    assert "cannot be told apart" not in (followed / "structure.txt").read_text()


@contextlib.contextmanager
def running(call: list[str], folder: Path) -> Iterator[Path]:
    """A command that runs until the end; it prints into the file."""
    said = folder / f"{call[1]}.txt"
    with said.open("wb") as out:
        process = subprocess.Popen(call, cwd=folder, stdout=out)
        try:
            yield said
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(30)


def waited_for(condition: Callable[[], bool], what: str) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError(f"within a minute there was no {what}")


def named(said: Path) -> bool:
    """Whether a line of the service has the leak as its only first explanation."""
    lines = [json.loads(line) for line in said.read_bytes().splitlines(keepends=True) if line.endswith(b"\n")]
    return any([d["faults"] for d in line.get("diagnoses", []) if d["rank"] == 1] == [[LEAK]] for line in lines)


def is_listening(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


def fetched(port: int, path: str) -> Any:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=30) as answer:
        return json.loads(answer.read())


@pytest.mark.alone
def test_the_service_names_it_from_a_bus(followed: Path) -> None:
    bus, place = multicast(), followed / "s"
    told = {words[1]: words[1:] for words in commands(marked=True)}
    subprocess.run([FAULTLINE, *told["rig"]], cwd=followed, check=True, capture_output=True)
    run, replay = ([bus if word.startswith("udp") else word for word in told[name]] for name in ("run", "replay"))
    run[run.index("--socket") + 1] = str(place)
    with running([FAULTLINE, *run], followed) as said:
        waited_for(place.exists, "socket")
        subprocess.run([FAULTLINE, *replay], cwd=followed, check=True)
        waited_for(lambda: named(said), f"{LEAK} in {said}")


@pytest.mark.alone
def test_the_page_in_a_browser_has_the_tanks_own_words(followed: Path) -> None:
    port = free_port()
    serve = next(words[1:] for words in commands(marked=True) if words[1] == "serve")
    serve = [word for word in serve if word != "--open"]
    with running([FAULTLINE, *serve, "--listen", f"127.0.0.1:{port}"], followed):
        waited_for(lambda: is_listening(port), "page")
        system = fetched(port, "v1/systems/three_tank")
        assert [channel["signal"] for channel in system["inputs"]] == ["u", "y1", "y2", "y3"]
        assert not re.search("dose|dosing|urea|DEF", json.dumps(system))
        faults = fetched(port, "v1/components/three_tank/faults")
        assert LEAK in json.dumps(faults)
