"""A finished recording answers as the service would have, and has all its ticks besides."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError
from faultline.service.recorded.command import served
from faultline.service.recorded.service import MOST_TICKS, Recording, Serving

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
EVENTS = [json.loads(line) for line in (GOLDEN / "events.jsonl").read_text().splitlines()]
SYSTEM = load_bundle(GOLDEN / "bundle").manifest.name


@pytest.fixture(scope="module")
def recording() -> Recording:
    log, bundle = open_log(GOLDEN / "log"), load_bundle(GOLDEN / "bundle")
    done: list[float] = []
    made = Recording(log, GOLDEN / "log", bundle, print, done.append)
    assert done == sorted(done)
    assert done[-1] == pytest.approx(log.duration_s)
    return made


@pytest.fixture
def control(recording: Recording, tmp_path: Path) -> Iterator[ControlClient]:
    with Serving(tmp_path, recording) as serving, ControlClient(serving.control) as asked:
        yield asked


def test_tells_what_diagnose_tells(recording: Recording) -> None:
    told = [json.loads(record.line) for record in recording.records]
    assert [each["seq"] for each in told] == [*range(1, len(told) + 1)]
    numbered = ("id", "seq")
    events = [each for each in told if each["schema"] == "faultline.event/1"]
    assert [{k: v for k, v in each.items() if k not in numbered} for each in events] == [
        {k: v for k, v in each.items() if k not in numbered} for each in EVENTS
    ]
    assert {each["wall"] for each in told} == {None}
    assert "confirmed" in [each.get("change") for each in told]


def test_remembers_with_freeze_frames_what_it_told(control: ControlClient) -> None:
    [fault] = control.ask_json("faults")["faults"]
    assert [each["faults"] for each in fault["diagnoses"]] == [each["faults"] for each in EVENTS[-1]["diagnoses"]]
    frame = control.ask_json("fault", number=fault["number"])["frames"]["first"]
    occurred = next(each for each in EVENTS if each["transition"] == "occurred")
    assert (frame["tick"], frame["complete"]) == (occurred["tick"], True)


def test_says_that_it_is_a_recording(control: ControlClient) -> None:
    state = control.ask_json("state")
    assert state["is_recording"] is True
    assert state["seq"] == len(control.ask_json("records", count=500)["records"])
    last = control.ask_json("history", name=SYSTEM)["stands"][-1]
    assert state["systems"][0]["alarm"] == last["alarm"]
    assert set(last["alarm"]) >= set(EVENTS[-1]["alarm"])
    assert state["buses"][0]["frames"] == len(list(open_log(GOLDEN / "log").frames()))


def test_nothing_of_it_can_be_erased(control: ControlClient) -> None:
    with pytest.raises(ProtocolError, match="this is a recording: nothing of it can be erased"):
        control.ask_json("clear")
    assert control.ask_json("faults")["faults"]


def test_gives_its_records_in_pages(control: ControlClient) -> None:
    everything = [each["seq"] for each in control.ask_json("records", count=500)["records"]]
    assert [each["seq"] for each in control.ask_json("records", after=2, count=2)["records"]] == [3, 4]
    assert [each["seq"] for each in control.ask_json("records", before=4, count=2)["records"]] == [2, 3]
    assert [each["seq"] for each in control.ask_json("records", count=1)["records"]] == everything[-1:]
    with pytest.raises(ProtocolError, match="`count` must be"):
        control.ask_json("records", count=501)


def test_events_are_heard_from_the_first(recording: Recording, tmp_path: Path) -> None:
    with Serving(tmp_path, recording) as serving, socket.socket(socket.AF_UNIX) as client:
        client.settimeout(20.0)
        client.connect(str(serving.events))
        client.sendall(b'{"after": 0}\n')
        with client.makefile("rb") as lines:
            heard = [lines.readline() for _ in recording.records]
    assert heard == [record.line for record in recording.records]


def test_the_history_is_each_tick_as_columns(recording: Recording, control: ControlClient) -> None:
    latest = recording.history.latest
    assert latest is not None
    part = control.ask_json("history", name=SYSTEM, count=MOST_TICKS)
    assert part["every"] == 1
    assert part["tick"] == [*range(part["tick"][0], latest + 1)]
    columns = [each for name in ("z", "quality", "y_hat", "r", "sigma", "sums") for each in part[name].values()]
    assert {len(each) for each in [*columns, part["t_s"], part["mode"]]} == {len(part["tick"])}
    rows = range(len(part["tick"]))
    for name, residuals in part["r"].items():
        predicts = next(
            g["predicts"] for g in control.ask_json("system", name=SYSTEM)["generators"] if g["name"] == name
        )
        could = [k for k in rows if residuals[k] is not None]
        assert could
        for k in could[::37]:
            assert part["z"][predicts][k] - part["y_hat"][name][k] == pytest.approx(residuals[k], rel=1e-3, abs=10.0)


@pytest.mark.parametrize("most", [1, 7, 100])
def test_few_points_still_show_every_alarm(control: ControlClient, most: int) -> None:
    whole = control.ask_json("history", name=SYSTEM, count=MOST_TICKS)
    few = control.ask_json("history", name=SYSTEM, count=most)
    assert 1 <= len(few["tick"]) <= most
    assert set(few["tick"]) <= set(whole["tick"])

    def largest(part: dict[str, Any]) -> float:
        return max(abs(float(value)) for sums in part["sums"].values() for value in sums if value is not None)

    assert largest(few) == largest(whole) > 1.0
    assert few["every"] == -(-len(whole["tick"]) // most)


def test_what_stands_is_that_of_the_events(control: ControlClient) -> None:
    occurred = next(each for each in EVENTS if each["transition"] == "occurred")
    part = control.ask_json("history", name=SYSTEM, after=occurred["tick"] - 1, before=occurred["tick"] + 1)
    assert part["tick"] == [occurred["tick"]]
    [stand] = part["stands"]
    assert stand["tick"] <= occurred["tick"]
    assert stand["alarm"] == occurred["alarm"]
    assert [each["faults"] for each in stand["diagnoses"]] == [each["faults"] for each in occurred["diagnoses"]]
    assert len(stand["separating"]) == len(stand["diagnoses"]) * (len(stand["diagnoses"]) - 1) // 2


def test_no_ticks_are_no_error(control: ControlClient) -> None:
    part = control.ask_json("history", name=SYSTEM, after=2**53 - 1)
    assert (part["tick"], part["stands"]) == ([], [])


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"name": "doors"}, "no system 'doors'"),
        ({"name": SYSTEM, "count": 0}, "`count` must be 1 to 5000"),
        ({"name": SYSTEM, "after": -2}, "a tick is a number from 0"),
        ({"name": SYSTEM, "before": -1}, "a tick is a number from 0"),
    ],
)
def test_questions_that_make_no_sense(control: ControlClient, asked: dict[str, Any], message: str) -> None:
    with pytest.raises(ProtocolError, match=message):
        control.ask_json("history", **asked)


def test_a_log_of_another_vehicle_is_said(tmp_path: Path) -> None:
    log = tmp_path / "other.log"
    log.write_text("(1.000000) can0 123#0011\n(2.000000) can0 123#0012\n")
    with pytest.raises(InputError, match=r"never has all of y_p_tp, .*; give a log of this bundle's vehicle"):  # noqa: SIM117
        with served(log, GOLDEN / "bundle", print):
            pass
