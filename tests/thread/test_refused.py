"""A daemon whose bundle is damaged: the other slot runs, or nothing does, and it is up and says why."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ports import multicast

from faultline.service.bundle.slots import CURRENT, Slots

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
WITHIN_S = 30.0


class Service:
    """The daemon by its configuration, with two slots that hold the golden bundle."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.slots = folder, folder / "slots"
        for _ in range(2):
            Slots(self.slots).install(GOLDEN / "bundle", None, lambda _: None)
        (folder / "faultline.toml").write_text(
            f'source = "truck"\n[[bus]]\nname = "bus"\ninterface = "{multicast()}"\n'
            f'[[bundle]]\npath = "{self.slots / CURRENT}"\nbus = "bus"\n[trust]\nallow_unsigned = true\n'
            f'[events]\nsocket = "{folder / "e.sock"}"\n[control]\nsocket = "{folder / "c.sock"}"\n'
        )
        self.process: subprocess.Popen[bytes] | None = None

    def damage(self, slot: str) -> None:
        file = self.slots / slot / "ode.onnx"
        raw = bytearray(file.read_bytes())
        raw[len(raw) // 2] ^= 1
        file.write_bytes(raw)

    def repair(self, slot: str) -> None:
        shutil.copy(GOLDEN / "bundle" / "ode.onnx", self.slots / slot / "ode.onnx")

    def start(self) -> None:
        with (self.folder / "log").open("ab") as log:
            command = [FAULTLINE, "run", "--config", str(self.folder / "faultline.toml")]
            self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
        self.until("the control socket", (self.folder / "c.sock").exists)

    def ask(self) -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as client, client.makefile("rwb") as stream:
            client.connect(str(self.folder / "c.sock"))
            stream.write(b'{"ask":"state"}\n')
            stream.flush()
            answer: dict[str, Any] = json.loads(stream.readline())
        return answer

    def until(self, what: str, check: Callable[[], object]) -> None:
        end = time.monotonic() + WITHIN_S
        while not check():
            assert self.process is not None
            assert self.process.poll() is None, (self.folder / "log").read_text()
            assert time.monotonic() < end, what
            time.sleep(0.05)

    @property
    def refused(self) -> list[str]:
        return [each["of"] for each in self.ask()["conditions"] if each["kind"] == "bundle-refused"]


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    made = Service(tmp_path)
    yield made
    if made.process is not None:
        made.process.kill()
        made.process.wait()


def test_the_other_slot_runs_and_why_is_a_condition(service: Service) -> None:
    service.damage("b")
    service.start()
    assert [system["name"] for system in service.ask()["systems"]] == ["uds"]
    service.until("the condition", lambda: service.refused)
    assert "current/ode.onnx: its bytes differ" in service.refused[0]


def test_with_no_bundle_it_is_up_and_runs_one_once_it_is_whole(service: Service) -> None:
    service.damage("a")
    service.damage("b")
    service.start()
    assert service.ask()["systems"] == []
    service.until("the condition", lambda: service.refused)
    service.repair("b")
    assert service.process is not None
    service.process.send_signal(signal.SIGHUP)
    service.until("the bundle", lambda: service.ask()["systems"])
    service.until("the end of the condition", lambda: not service.refused)
    assert "runs now" in (service.folder / "log").read_text()
