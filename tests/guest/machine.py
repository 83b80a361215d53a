"""A guest machine with a CAN bus and systemd, where this kernel has neither: User-Mode Linux, a kernel as a process.

Its root is this machine's, seen read-only; what it writes is gone when it ends, but for the shared folder and the disk.
"""

import fcntl
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import venv
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.service.bundle.command import main as bundle_command
from faultline.service.bundle.files import SEAL, seal

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PYTHON = Path("/opt/python")
"""Where the guest sees this Python: a service that sees no home could not run one that is in a home."""
PREFIX = Path("/opt/faultline")
"""Where the guest sees the vehicle's environment."""
PACKAGES = ("src", "service", "analysis", "training", "testbench", "dbc", "systems")

GOLDEN = ROOT / "tests" / "golden"
FROM_S = 48.0
"""The golden recording is played in real time from here: its fault begins at 70 s, its alarm comes some 20 s later.

It is played to its end, some 40 s after that: a frame that a busy machine sends late is doubted, which holds up alarms.
"""
VERSIONS = 8


class NoGuestError(Exception):
    """This machine cannot have a guest."""


@dataclass(frozen=True)
class Guest:
    """`share` is /vm in the guest, `environment` the vehicle's; `disk` lasts: its bundles and the service's state.

    `preloaded` is a library that its kernel needs on this processor, if it needs one.
    """

    share: Path
    environment: Path
    disk: Path
    preloaded: Path | None = None

    def run(self, script: Path, *arguments: str, limit_s: float = 1200.0) -> int:
        """Boots, runs the script with the guest's Python, and powers off; the script's exit code, -1 where it hangs."""
        process = self.start(script, *arguments)
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            cut_power(process)
        code = self.share / "rc"
        return int(code.read_text()) if code.exists() else -1

    @property
    def said(self) -> str:
        """What the script wrote, and where that is nothing, the end of what the machine did."""
        for name in ("steps.jsonl", "output.txt", "journal.txt", "console.txt"):
            path = self.share / name
            if path.exists() and (told := path.read_text()):
                return told[-6000:]
        return "nothing"

    def start(self, script: Path, *arguments: str) -> "subprocess.Popen[bytes]":
        """Boots it and lets it run, until `cut_power` at the latest."""
        for name in ("rc", "output.txt", "journal.txt", "steps.jsonl"):
            (self.share / name).unlink(missing_ok=True)
        shutil.copy(HERE / "init.sh", self.share / "init.sh")
        shutil.copy(script, self.share / script.name)
        words = " ".join([str(PYTHON / "bin" / "python3"), f"/vm/{script.name}", *arguments])
        (self.share / "cmd").write_text(f"PYTHONUNBUFFERED=1 exec {words}\n")
        if not self.disk.exists():
            with self.disk.open("wb") as file:
                file.truncate(64 * 1024 * 1024)
            subprocess.run(["mkfs.ext4", "-q", "-F", str(self.disk)], check=True)
        binds = f"{self.environment}:{PREFIX},{sys.base_prefix}:{PYTHON}"
        command = ["linux.uml", "mem=1G", f"ubd0={self.disk}", "root=none", "rootfstype=hostfs", "rootflags=/", "ro"]
        command += [f"init={self.share / 'init.sh'}", f"share={self.share}", f"bind={binds}"]
        command += ["con=null", "con0=null,fd:2", "ssl=null"]
        around = {**os.environ, "LD_PRELOAD": str(self.preloaded)} if self.preloaded else None
        nothing = subprocess.DEVNULL
        with (self.share / "console.txt").open("wb") as console:
            return subprocess.Popen(
                command, stdin=nothing, stdout=nothing, stderr=console, env=around, start_new_session=True
            )


def cut_power(process: "subprocess.Popen[bytes]") -> None:
    """Kill a guest at once, with the processes that its kernel has made of its own.

    None is left when this returns: one that outlives the first holds the lock of the disk, and the next boot fails.
    """
    process.send_signal(signal.SIGSTOP)  # so that it makes no further one
    others = _made_by(process.pid)
    process.kill()
    process.wait()
    for each in others:
        with suppress(ProcessLookupError):
            os.kill(each, signal.SIGKILL)
    end = time.monotonic() + 20.0
    while any(_runs(each) for each in others):
        assert time.monotonic() < end, "processes of the guest are left"
        time.sleep(0.01)


def _made_by(first: int) -> list[int]:
    """All of its session, those that have lost their parent too, and the descendants of all."""
    found, parents = [first], {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            _, parent, _, session, *_ = path.read_text().rpartition(")")[2].split()
            process = int(path.parent.name)
            parents[process] = int(parent)
            if int(session) == first != process:
                found.append(process)
    for each in found:
        found += [child for child, parent in parents.items() if parent == each and child not in found]
    return found[1:]


def _runs(process: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def prepared(folder: Path) -> Guest:
    """A guest that is given bundles of several versions, signed, the key, and a recording; raises NoGuestError."""
    done = subprocess.run([str(HERE / "install.sh")], capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoGuestError(done.stderr.strip())
    share, key = folder / "share", folder / "fleet.pem"
    share.mkdir()
    _must(["openssl", "genpkey", "-algorithm", "ed25519", "-out", str(key)])
    _bundle("public", key, "--out", share / "fleet.pub")
    for version in range(VERSIONS):
        bundle = Path(shutil.copytree(GOLDEN / "bundle", share / f"version-{version}"))
        manifest = json.loads((bundle / "manifest.json").read_bytes())
        raw = json.dumps({**manifest, "version": version}).encode()
        (bundle / "manifest.json").write_bytes(raw)
        (bundle / SEAL).write_bytes(seal(raw))
        _bundle("sign", bundle, "--key", key)
    lines = (GOLDEN / "log" / "can.log").read_text().splitlines()
    first = float(lines[0].split()[0].strip("()"))
    inside = [line for line in lines if float(line.split()[0].strip("()")) - first >= FROM_S]
    (share / "can.log").write_text("\n".join(inside) + "\n")
    made = environment(ROOT / "out" / "vehicle-environment")
    return Guest(share, made, folder / "disk.ext4", _preloaded(folder))


def _preloaded(folder: Path) -> Path | None:
    """What makes room for the registers of AMX, where this processor has them; raises NoGuestError."""
    if " amx_tile" not in Path("/proc/cpuinfo").read_text():
        return None
    library = folder / "xstate.so"
    try:
        _must(["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(HERE / "xstate.c"), "-ldl"])
    except FileNotFoundError as error:
        raise NoGuestError("on this processor the guest needs a C compiler: apt-get install gcc libc6-dev") from error
    return library


def environment(folder: Path) -> Path:
    """The vehicle's environment in a folder, as docs/service.md has it made: its libraries, and ours from a wheel.

    Made once, and again where the sources have changed; a guest that runs must not see it change.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stamp, now = folder / "made", _digest()
    with (folder.parent / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another test may be making it
        if not (stamp.exists() and stamp.read_text() == now):
            _make(folder, fresh=not stamp.exists())
            stamp.write_text(now)
    return folder


def _make(folder: Path, *, fresh: bool) -> None:
    if fresh:
        venv.create(folder, clear=True, symlinks=False, with_pip=True)
    settings = folder / "pyvenv.cfg"
    _home(settings, Path(sys.base_prefix))
    with TemporaryDirectory() as sources:
        for name in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / name, sources)
        for name in PACKAGES:
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, Path(sources) / name, symlinks=True, ignore=ignored)
        pip = [str(folder / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]
        _must([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", sources, sources])
        (wheel,) = Path(sources).glob("*.whl")
        _must([*pip, "install", "--quiet", "--constraint", str(ROOT / "constraints.txt"), str(wheel)])
        _must([*pip, "install", "--quiet", "--no-deps", "--force-reinstall", str(wheel)])
    _home(settings, PYTHON)


def _digest() -> str:
    """Of what the environment is made from."""
    found = hashlib.sha256()
    files = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*")) if "__pycache__" not in path.parts]
    for path in [ROOT / "pyproject.toml", ROOT / "constraints.txt", *files]:
        if path.is_file():
            found.update(str(path).encode() + path.read_bytes())
    return found.hexdigest()


def _home(settings: Path, base: Path) -> None:
    """Where the environment finds the Python that it was made of: another place here than in the guest."""
    lines = settings.read_text().splitlines()
    settings.write_text("".join(f"{f'home = {base}/bin' if line.startswith('home') else line}\n" for line in lines))


def _bundle(*arguments: str | Path) -> None:
    """The command in this process: a process of its own takes most of a second to start."""
    if code := bundle_command([*map(str, arguments)]):
        raise RuntimeError(f"faultline bundle {arguments[0]}: {code}")


def _must(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stdout}{done.stderr}")
