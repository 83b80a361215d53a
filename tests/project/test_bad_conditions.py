"""Every command on a full disk, without permission, into a closed pipe, interrupted and killed (docs/exit-codes.md)."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest
from bad_conditions import (
    COMMANDS,
    Condition,
    Done,
    Interrupted,
    Killed,
    closed_pipe,
    full_disk,
    full_output,
    no_permission,
    nothing,
    run,
)
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from ports import multicast

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden"
BUNDLE = GOLDEN / "bundle"
SHORT = "--cycle drive --duration 60"


class Writes(NamedTuple):
    """A call that writes below {out}.

    `old` is one of its files, which is there before with another content. A `lasting` call computes for minutes before
    it writes; here it waits for its input instead, after it has looked at its outputs.
    """

    words: str
    old: str
    content: str = "old"
    lasting: bool = False


class Row(NamedTuple):
    """A command: a call that answers on standard output in a moment, calls that write, and its code after Ctrl-C."""

    answers: str
    writes: tuple[Writes, ...] = ()
    interrupted: int = 130


EMPTY_BUNDLE = '{"schema": "faultline.bundle/7", "files": {}}'
LOG = f"{GOLDEN}/log"
TRUTH = f"--truth {GOLDEN}/truth.toml"

ROWS = {
    "bundle": Row(
        f"show {BUNDLE}",
        (
            Writes("public {in}/key.pem --out {out}/k.pub", "k.pub"),
            Writes("sign {in}/signed --key {in}/key.pem", ""),
            Writes("install {in}/bundle --into {out} --allow-unsigned", ""),
        ),
    ),
    "calibrate": Row(
        "--help", (Writes(f"{{in}}/pipe {LOG} --out {{out}}/m.toml --report {{out}}/r", "m.toml", lasting=True),)
    ),
    "code": Row("--help", (Writes("rc --out {out}", "rc_t01.py"),)),
    "convert": Row("--help", (Writes(f"{LOG} --to candump --out {{out}}/c.log", "c.log"),)),
    "demo": Row("--out {out}/demo", (Writes("--out {out}/demo", "", lasting=True),)),
    "diagnose": Row(f"{LOG} --bundle {BUNDLE}"),
    "discover": Row(
        "--help", (Writes(f"{{in}}/pipe {LOG} --held-out {LOG} --out {{out}}", "summary.md", lasting=True),)
    ),
    "evaluate": Row(
        "--help",
        (
            Writes(f"{BUNDLE} {LOG} {TRUTH} --picture {{out}}/p.png", "p.png"),
            Writes(f"{BUNDLE} {LOG} {TRUTH} --report {{out}}", "report.html"),
        ),
    ),
    "export": Row(
        "--help",
        (
            Writes(
                f"{{in}}/pipe --tuning t.json --dbc {LOG}/uds.dbc --out {{out}}/b --force",
                "b/manifest.json",
                EMPTY_BUNDLE,
                lasting=True,
            ),
        ),
    ),
    "faults": Row("list --control {in}/control"),
    "fleet": Row("--help"),
    "install": Row(
        "--dry-run --prefix /opt/faultline --base /usr",
        (Writes("--root {out} --prefix /opt/faultline --base /usr", "etc/faultline/old"),),
    ),
    "ingest": Row("--help", (Writes("{in}/bench/drive --offset 0.1 --out {out} --force", "drive/recording.toml"),)),
    "j1939": Row("--help", interrupted=0),
    "limit": Row(
        f"{BUNDLE} {LOG} --within 40", (Writes(f"{BUNDLE} {LOG} --within 40 --picture {{out}}/p.png", "p.png"),)
    ),
    "log": Row(f"{LOG} --json"),
    "mqtt": Row("--help", interrupted=0),
    "new": Row(
        "--help", (Writes(f"system n --from {LOG} --dbc {LOG}/uds.dbc --out {{out}}/n --force", "n/model.toml"),)
    ),
    "replay": Row(f"{LOG} --bus {{bus}} --speed 1000 --json"),
    "rig": Row(
        "list",
        (
            Writes(f"record {SHORT} --id d --out {{out}}/o --truth {{out}}/t --force", "o/d/recording.toml"),
            Writes("picture {in}/bench/drive --out {out}/p.png", "p.png"),
            Writes(f"play {SHORT} --bus {{bus}} --speed 100 --truth {{out}}/t.toml", ""),
        ),
    ),
    "run": Row("--help", interrupted=0),
    "serve": Row("--help", interrupted=0),
    "structure": Row(
        "rc",
        (
            Writes("rc --json {out}/s.json --model {out}/m.toml", "s.json"),
            Writes("rc --figures {out}", "structure.svg"),
        ),
    ),
    "train": Row("--help", (Writes(f"{{in}}/pipe {LOG} --out {{out}}", "networks.json", lasting=True),)),
    "tune": Row("--help", (Writes(f"{{in}}/pipe {LOG} --out {{out}}/t.json", "t.json", lasting=True),)),
    "watch": Row("--socket {in}/events --after 0 --once"),
    "workshop": Row(
        "--help", (Writes("--control {in}/control --report {out}/r.html --patience 1 --hold 1 --force", "r.html"),)
    ),
}

SERVICES = {
    "j1939": "--config {in}/j1939.toml",
    "mqtt": "--config {in}/mqtt.toml",
    "run": f"--bundle {BUNDLE} --bus {{bus}} --socket {{out}}/e",
    "serve": "--control {in}/control --events {in}/events --listen unix:{out}/http",
}
"""Calls of those that run until they are stopped."""

J1939 = """
[j1939]
interface = "{bus}"
control = "{folder}/control"
events = "{folder}/events"
addresses = [144]
transmit = true
[j1939.name]
identity_number = 1
manufacturer_code = 2
function = 3
"""
MQTT = """
[mqtt]
host = "127.0.0.1"
port = 9
events = "{folder}/events"
control = "{folder}/control"
cursor = "{folder}/cursor"
"""

WRITES = [
    pytest.param(name, each, id=f"{name}-{number}")
    for name, row in ROWS.items()
    for number, each in enumerate(row.writes)
]
SHORT_WRITES = [param for param in WRITES if not ROWS[str(param.values[0])].writes[0].lasting]


@pytest.fixture(scope="module")
def inputs() -> Iterator[Path]:
    """What commands read, for everybody: a pipe in which nothing comes, and a service that has told something."""
    with TemporaryDirectory() as place:
        folder, bus = Path(place), multicast()
        folder.chmod(0o755)
        key = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
        pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        (folder / "key.pem").write_bytes(pem)
        for name in ("bundle", "signed"):
            copytree(BUNDLE, folder / name)
        os.mkfifo(folder / "pipe")
        (folder / "j1939.toml").write_text(J1939.format(bus=bus, folder=folder))
        (folder / "mqtt.toml").write_text(MQTT.format(folder=folder))
        words = f"rig record {SHORT} --id drive --out {folder}/bench --truth {folder}/truth"
        assert run(words.split(), nothing).code == 0
        with _service(folder, bus):
            yield folder


@contextmanager
def _service(folder: Path, bus: str) -> Iterator[None]:
    script = "import sys; from faultline.service.cli import main; sys.exit(main())"
    options = f"--bundle {BUNDLE} --bus {bus} --socket {folder}/events --control {folder}/control"
    with subprocess.Popen(
        [sys.executable, "-c", script, "run", *options.split()], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as service:
        assert service.stdout is not None
        while not (folder / "control").exists():
            assert service.poll() is None
        assert run(f"replay {LOG} --bus {bus} --speed 1000".split(), nothing).code == 0
        assert b'"started"' in service.stdout.readline()
        for socket in ("control", "events"):
            (folder / socket).chmod(0o666)
        yield
        service.send_signal(signal.SIGTERM)
    assert service.returncode == 0


def _call(name: str, words: str, inputs: Path, out: Path, condition: Condition) -> Done:
    filled = words.replace("{in}", str(inputs)).replace("{out}", str(out)).replace("{bus}", multicast())
    return run([name, *filled.split()], condition)


def _content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _filled(out: Path, writes: Writes) -> dict[str, bytes]:
    if writes.old:
        (out / writes.old).parent.mkdir(parents=True, exist_ok=True)
        (out / writes.old).write_text(writes.content)
    return _content(out)


def test_every_command_has_a_row() -> None:
    assert sorted(ROWS) == sorted(COMMANDS)


@pytest.mark.parametrize("name", sorted(ROWS))
def test_a_full_output_is_said(name: str, inputs: Path, tmp_path: Path) -> None:
    done = _call(name, ROWS[name].answers, inputs, tmp_path, full_output)
    assert done.code == 3, done.said
    why = "the output cannot be written: No space left on device; free some space, or send it elsewhere"
    assert done.said.splitlines()[-1] == f"faultline {name}: error: {why}"
    assert "Traceback" not in done.said


@pytest.mark.parametrize("name", sorted(ROWS))
def test_a_closed_pipe_ends_quietly(name: str, inputs: Path, tmp_path: Path) -> None:
    done = _call(name, ROWS[name].answers, inputs, tmp_path, closed_pipe)
    assert done.code == 141, done.said
    assert "rror" not in done.said


@pytest.mark.parametrize(("name", "writes"), WRITES)
def test_a_full_disk_is_said_and_leaves_what_was_there(name: str, writes: Writes, inputs: Path, tmp_path: Path) -> None:
    before = _filled(tmp_path, writes), _content(inputs)
    done = _call(name, writes.words, inputs, tmp_path, full_disk)
    assert done.code == 2, done.said
    *_, last = done.said.splitlines()
    assert last.startswith((f"faultline {name}: error: {tmp_path}", f"faultline {name}: error: {inputs}/signed"))
    assert ": File too large; free some space at " in last
    assert "Traceback" not in done.said
    assert ".partial-" not in last
    assert (_content(tmp_path) | {"lock": b""}, _content(inputs)) == (before[0] | {"lock": b""}, before[1])


@pytest.mark.parametrize(("name", "writes"), WRITES)
def test_a_folder_that_may_not_be_written_is_said(name: str, writes: Writes, inputs: Path) -> None:
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o555)
        done = _call(name, writes.words, inputs, Path(folder), no_permission)
        assert done.code == 2, done.said
        *_, last = done.said.splitlines()
        assert last.startswith((f"faultline {name}: error: {folder}", f"faultline {name}: error: {inputs}/signed"))
        assert "Permission denied; " in last
        assert "Traceback" not in done.said
        Path(folder).chmod(0o755)


@pytest.mark.parametrize("name", sorted(ROWS))
def test_an_interrupt_is_one_line(name: str, inputs: Path, tmp_path: Path) -> None:
    row = ROWS[name]
    words = SERVICES.get(name) or (row.writes[0].words if row.writes else row.answers)
    done = _call(name, words, inputs, tmp_path, Interrupted(0.1, once_handled=name in SERVICES))
    assert done.code == row.interrupted, done.said
    assert "Traceback" not in done.said
    if row.interrupted == 130:
        assert done.said.splitlines()[-1] == f"faultline {name}: interrupted"
    assert not [*tmp_path.rglob("*.partial-*")]


@pytest.mark.parametrize(("name", "writes"), SHORT_WRITES)
def test_a_kill_leaves_what_was_there(name: str, writes: Writes, inputs: Path, tmp_path: Path) -> None:
    before = _filled(tmp_path, writes)
    done = _call(name, writes.words, inputs, tmp_path, Killed(0))
    assert done.code == -signal.SIGKILL, done.said
    after = {path: raw for path, raw in _content(tmp_path).items() if ".partial-" not in path and path != "lock"}
    assert after == before
