"""can-j1939, which others read J1939 with, reads what we send, over python-can's virtual bus."""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import j1939  # type: ignore[import-untyped]
import pytest

from faultline.service.bus.pythoncan import PythonCan
from faultline.service.core.j1939.dm1 import Code
from faultline.service.j1939.dtcs import Known
from faultline.service.j1939.name import name_of
from faultline.service.j1939.node import Node

US, TOOL = 144, 0xF9
NAME = name_of(identity_number=17, manufacturer_code=2, function=3, industry_group=1)


class OnTheBus:
    """A node on python-can's bus, in a thread; the virtual bus does not give back what was sent, so this does."""

    def __init__(self, channel: str) -> None:
        self.node = Node(NAME, [US])
        self._bus = PythonCan("virtual", channel, None)
        self._known: queue.Queue[Known] = queue.Queue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "OnTheBus":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.close()

    def know(self, known: Known) -> None:
        self._known.put(known)

    def _run(self) -> None:
        self.node.begin(time.monotonic())
        while not self._ended.is_set():
            now = time.monotonic()
            while not self._known.empty():
                self.node.know(self._known.get(), now)
            for frame in self._bus.receive():
                self.node.hear(frame, now)
            for frame in self.node.frames(now):
                self._bus.send(frame)
                self.node.hear(frame, now)
            time.sleep(0.001)


@pytest.fixture
def others(request: pytest.FixtureRequest) -> Iterator[tuple[Any, Any]]:
    """Its control unit, and a controller application of it at the tool's address."""
    unit = j1939.ElectronicControlUnit(max_cmdt_packets=getattr(request, "param", 1))
    unit.connect(interface="virtual", channel="j1939", ignore_config=True)
    tool = j1939.ControllerApplication(j1939.Name(identity_number=1), TOOL, bypass_address_claim=True)
    unit.add_ca(controller_application=tool)
    tool.start()
    yield unit, tool
    tool.stop()
    unit.stop()
    unit.disconnect()


def until(condition: Callable[[], bool], limit_s: float = 30.0) -> None:
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def asked(tool: Any, group: int, heard: Callable[[], bool]) -> None:
    """Asks until it has heard: an answer in parts is given up where a busy machine holds one of the two up."""
    for _ in range(10):
        tool.send_request(0, group, US)
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            if heard():
                return
            time.sleep(0.005)
    raise AssertionError(f"nothing was heard of {group}")


@pytest.mark.parametrize("number", [0, 1, 3, 20])
def test_dm1_is_read(others: tuple[Any, Any], number: int) -> None:
    _, tool = others
    told: list[tuple[int, dict[str, int], list[dict[str, int]]]] = []
    reader = j1939.Dm1(tool)
    reader.subscribe(lambda source, lamps, codes, _time: told.append((source, lamps, codes)))
    codes = tuple(Code(516_000 + 7 * k, k % 32, k + 1) for k in range(number))
    with OnTheBus("j1939") as ours:
        ours.know(Known(codes, (), amber=bool(number)))
        until(lambda: len(told) >= 2)
    source, lamps, read = told[-1]
    assert source == US
    assert [(each["spn"], each["fmi"], each["oc"]) for each in read if each["spn"]] == [code[:3] for code in codes]
    lamp = j1939.DtcLamp
    assert lamps == {"pl": lamp.OFF, "awl": lamp.ON if number else lamp.OFF, "rsl": lamp.OFF, "mil": lamp.NA}


@pytest.mark.parametrize("others", [1, 16, 255], indirect=True)
def test_dm2_is_sent_to_who_asks(others: tuple[Any, Any]) -> None:
    """By RTS and CTS, so many parts at once as it asks for."""
    _, tool = others
    heard: list[tuple[int, int, bytes]] = []
    tool.subscribe(lambda _priority, pgn, source, _time, data: heard.append((pgn, source, bytes(data))))
    codes = tuple(Code(1000 + k, 1, 1) for k in range(40))
    with OnTheBus("j1939") as ours:
        ours.know(Known((), codes, amber=False))
        until(lambda: ours.node.status == "claimed")
        asked(tool, 65227, lambda: any(pgn == 65227 for pgn, _, _ in heard))
    (_, source, data), *_ = (each for each in heard if each[0] == 65227)
    assert (source, len(data)) == (US, 162)
    assert [int.from_bytes(data[k : k + 2], "little") for k in range(2, 162, 4)] == [code.spn for code in codes]


def test_a_refusal_is_read(others: tuple[Any, Any]) -> None:
    _, tool = others
    heard: list[tuple[int, int, bytes]] = []
    tool.subscribe(lambda _priority, pgn, source, _time, data: heard.append((pgn, source, bytes(data))))
    with OnTheBus("j1939") as ours:
        until(lambda: ours.node.status == "claimed")
        tool.send_request(0, 65228, US)
        until(lambda: bool(heard))
    assert [each for each in heard if each[0] == 59392] == [(59392, US, bytes.fromhex("01fffffff9ccfe00"))]


def test_our_name_is_read() -> None:
    with can.Bus(interface="virtual", channel="j1939", ignore_config=True) as bus, OnTheBus("j1939"):
        message = bus.recv(30.0)
    assert message is not None
    assert message.arbitration_id == 0x18EEFF90
    read = j1939.Name(bytes=message.data)
    assert (read.identity_number, read.manufacturer_code, read.function, read.industry_group) == (17, 2, 3, 1)
    assert not read.arbitrary_address_capable


@pytest.mark.parametrize("lower", [True, False])
def test_an_address_is_contended_with_theirs(lower: bool) -> None:
    """Their NAME is lower, or ours is; both want 144, and they begin half a second later."""
    unit = j1939.ElectronicControlUnit()
    unit.connect(interface="virtual", channel="j1939", ignore_config=True)
    theirs = j1939.Name(
        arbitrary_address_capable=0,
        industry_group=0 if lower else 2,
        vehicle_system_instance=0,
        vehicle_system=0,
        function=3,
        function_instance=0,
        ecu_instance=0,
        manufacturer_code=2,
        identity_number=18,
    )
    other = j1939.ControllerApplication(theirs, US)
    try:
        with OnTheBus("j1939") as ours:
            until(lambda: ours.node.status == "claimed")
            unit.add_ca(controller_application=other)
            other.start()
            wanted = "cannot" if lower else "claimed"
            state = other.State.NORMAL if lower else other.State.CANNOT_CLAIM
            until(lambda: other.state == state)
            until(lambda: ours.node.status == wanted)
    finally:
        other.stop()
        unit.stop()
        unit.disconnect()
