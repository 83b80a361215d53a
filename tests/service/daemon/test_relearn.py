"""A person lets a system learn its baseline anew: by the control socket, kept over restarts, reported meanwhile."""

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import numpy as np
import pytest

from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.bus import Bus
from faultline.service.bus.base import Counts
from faultline.service.core.decision import relearning
from faultline.service.core.decision.offsets import shifted
from faultline.service.core.memory.rules import Rules
from faultline.service.core.records.health import Condition
from faultline.service.core.time_scale import Span
from faultline.service.daemon.control_server import ControlServer
from faultline.service.daemon.fault_recorder import BASELINES_S, FaultRecorder
from faultline.service.daemon.pipeline import BusChannel, watched
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.logs import Frame, open_log
from faultline.service.outputs.control import Asker
from faultline.service.protocol.answers import Begun, ServiceState
from faultline.service.protocol.errors import RefusedError
from faultline.service.protocol.questions import Ask, Question
from faultline.service.store.journal import Journal

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
FRAMES = [Frame(t, n, extended, data) for t, n, extended, data in open_log(GOLDEN / "log").relative()]
FAULT_S = 68.0
"""The golden recording is fault-free so long."""
MAY, MAY_NOT = (Asker(user=name, may_clear=name == "workshop") for name in ("workshop", "mallory"))


def repaired() -> Bundle:
    """The golden bundle of a vehicle whose residuals lay 20 kPa lower, before a repair."""
    whole = load_bundle(GOLDEN / "bundle")
    generators, modes = len(whole.manifest.generators), len(whole.manifest.modes.names)
    return whole._replace(manifest=shifted(whole.manifest, np.full((generators, modes), -2e4)))


class Vehicle:
    """A service without a loop."""

    def __init__(self, path: Path, run: str = "1", bundle: Bundle | None = None) -> None:
        self.said: list[str] = []
        self.journal = Journal(path, self.said.append)
        self.watched = watched(bundle or repaired(), "truck", 1.0)
        self.bus = SimpleNamespace(counts=Counts(), dropped=0, trouble=None)
        self.line = BusChannel("can0", cast(Bus, self.bus), [self.watched], self.said.append)
        self.recorder = FaultRecorder(
            *(Sequencer("truck", self.journal.last, run), self.journal, [self.line], Rules(), 10.0, "boot", 0.0),
            self.said.append,
            standing=list,
        )
        self.server = ControlServer(self.recorder, self.journal, lambda: ("truck", None, 0, []))

    def ask(self, ask: Ask, asker: Asker = MAY, name: str | None = None) -> msgspec.Struct:
        answers: list[msgspec.Struct] = []
        self.server.answer(Question(ask=ask, name=name), asker, answers.append)
        [answer] = answers
        return answer

    def drive(self, begin_s: float, end_s: float) -> list[str]:
        """Part of the golden recording, looked at each second; what was told."""
        told: list[str] = []
        looked = begin_s
        for frame in FRAMES:
            if begin_s <= frame.t < end_s:
                if frame.t >= looked:
                    self.conditions = self.watched.look(looked)
                    self.recorder.look(looked)
                    looked += 1.0
                events = [*self.watched.hear([frame])]
                told += [event.transition for event in events]
                self.recorder.take(self.watched, events)
        return told

    def end(self) -> None:
        self.journal.finish(5.0)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The golden recording is short: a visit of each mode that lasts two seconds is enough."""
    monkeypatch.setattr(relearning, "VISITS", 1)
    monkeypatch.setattr(relearning, "SEEN", Span(seconds=2.0))


def test_a_repair_is_a_fault_until_its_baseline_has_been_learnt(tmp_path: Path, quick: None) -> None:
    vehicle = Vehicle(tmp_path / "store.sqlite")
    assert "suspected" in vehicle.drive(0.0, FAULT_S)
    vehicle.end()
    again = Vehicle(tmp_path / "store.sqlite", run="2")
    answer = again.ask("relearn")
    assert isinstance(answer, Begun)
    assert (answer.system, answer.baseline.by, answer.baseline.learnt) == ("uds", "workshop", False)
    assert again.drive(0.0, FAULT_S)[:1] == ["started"]
    assert again.said == ["uds: workshop lets it learn its baseline anew; until then it finds no fault"]
    again.end()


def test_meanwhile_no_test_can_tell_and_that_is_reported(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "store.sqlite")
    vehicle.ask("relearn")
    assert vehicle.drive(0.0, FAULT_S) == ["started"]
    assert Condition("relearning", "uds") in vehicle.conditions
    state = vehicle.ask("state")
    assert isinstance(state, ServiceState)
    [system] = state.systems
    assert len(system.cannot_tell) == 10
    latest = vehicle.recorder.systems["uds"].recorder.latest
    assert latest is not None
    assert not latest.usable.any(), "silence of what cannot tell would heal a remembered fault"
    assert system.baseline is not None
    assert not system.baseline.learnt
    assert "maximum" in system.baseline.wanting
    vehicle.end()


def test_it_goes_on_after_a_restart_and_with_another_bundle_it_is_forgotten(tmp_path: Path, quick: None) -> None:
    path = tmp_path / "store.sqlite"
    vehicle = Vehicle(path)
    vehicle.ask("relearn")
    vehicle.drive(0.0, 45.0)
    vehicle.recorder.look(45.0 + BASELINES_S)
    wanting, kept = vehicle.watched.wanting, vehicle.watched.baseline
    vehicle.end()
    again = Vehicle(path, run="2")
    assert again.watched.baseline == kept
    assert again.watched.wanting == wanting
    again.drive(0.0, 127.0)
    again.watched.look(128.0)
    again.recorder.look(128.0 + BASELINES_S)
    baseline = again.watched.baseline
    assert baseline is not None
    assert baseline.moved is not None
    assert np.median(np.array(baseline.moved)[:, 1:]) == pytest.approx(2e4, abs=3e3)
    again.end()
    last = Vehicle(path, run="3")
    assert last.watched.baseline == baseline
    assert last.drive(0.0, FAULT_S) == ["started", "cannot_tell"]
    last.end()
    other = Vehicle(path, run="4", bundle=repaired()._replace(id="0" * 64))
    assert other.watched.baseline is None
    assert "is of bundle" in other.said[0]
    other.end()
    assert Vehicle(path, run="5").watched.baseline is None


def test_only_who_may_can_ask_for_it(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "store.sqlite")
    with pytest.raises(RefusedError, match="mallory may not let it relearn"):
        vehicle.ask("relearn", MAY_NOT)
    with pytest.raises(RefusedError, match="there is no system 'other'"):
        vehicle.ask("relearn", name="other")
    assert vehicle.watched.baseline is None
    vehicle.end()


@pytest.mark.parametrize(
    "row",
    [
        b'{"bundle":3}',
        b'{"bundle":"b","begun":null,"by":"x","moved":[[1.0]]}',
        b'{"bundle":"b","begun":null,"by":"x","moved":[[1e999]]}',
        b'{"bundle":"b","begun":null,"by":"x","moved":[[1.0],[1.0,2.0]]}',
    ],
)
def test_a_row_that_makes_no_sense_is_set_aside(tmp_path: Path, row: bytes) -> None:
    vehicle = Vehicle(tmp_path / "store.sqlite")
    vehicle.journal.remember({"baseline/uds": row})
    vehicle.end()
    again = Vehicle(tmp_path / "store.sqlite", run="2")
    assert again.watched.baseline is None
    assert "baseline/uds cannot be read" in again.said[0]
    again.end()
