"""A person sees at a glance what an event says; a program sees the event itself."""

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Equation, Fault
from faultline.service.core.records.event import SCHEMA, Diagnosis, Event
from faultline.service.core.records.line import encode
from faultline.service.watch import main
from faultline.service.watching.records import describe, meanings

QUIET = Event(
    schema=SCHEMA,
    id="truck-1",
    seq=1,
    tick=0,
    t_s=0.0,
    wall=None,
    transition="started",
    diagnoses=[],
    alarm=[],
    cannot_tell=[],
    since_tick=None,
    bundle="0" * 64,
)
FAULT = msgspec.structs.replace(
    QUIET,
    id="truck-2",
    seq=2,
    tick=1050,
    t_s=210.0,
    transition="occurred",
    diagnoses=[
        Diagnosis(faults=["fA_du"], rank=1, p=None),
        Diagnosis(faults=["fy_p_du", "fA_t"], rank=2, p=0.125),
    ],
    alarm=["t02", "t08"],
    cannot_tell=["t21"],
    since_tick=1005,
)
NAMES = {"fA_du": Fault(name="fA_du", component="dosing unit", description="filter clogged")}


def test_a_fault_is_told_with_everything_that_speaks_for_it() -> None:
    assert [line.strip() for line in describe(FAULT, NAMES).splitlines()] == [
        "210.0 s  FAULT, evidence since 201.0 s",
        "1. fA_du (dosing unit: filter clogged)",
        "2. fy_p_du and fA_t, p = 0.125",
        "fired: t02 t08",
        "cannot tell: t21",
    ]


def test_of_one_rank_the_more_probable_comes_first_and_what_has_no_description_has_no_colon() -> None:
    found = [Diagnosis(faults=["f_a"], rank=1, p=0.012), Diagnosis(faults=["f_b"], rank=1, p=0.988)]
    names = {"f_a": Fault(name="f_a", component="valve", description="")}
    said = describe(msgspec.structs.replace(FAULT, diagnoses=found), names).splitlines()
    assert [line.strip() for line in said[1:3]] == ["1. f_b, p = 0.988", "1. f_a (valve), p = 0.012"]


def test_no_fault_and_cannot_tell_never_look_alike() -> None:
    quiet = describe(QUIET, {})
    blind = describe(msgspec.structs.replace(QUIET, cannot_tell=["t02"]), {})
    assert "no fault so far: every test is quiet" in quiet
    assert "cannot tell" not in quiet
    assert "every test is quiet" not in blind
    assert "not known to be free of faults" in blind
    assert "cannot tell: t02" in blind


def test_sight_regained_does_not_read_as_sight_lost() -> None:
    event = msgspec.structs.replace(QUIET, transition="cannot_tell")
    assert "cannot tell" not in describe(event, {})
    assert describe(event, {}).splitlines()[0].endswith("all tests can tell")


def test_alarms_without_an_explanation_are_not_no_fault() -> None:
    event = msgspec.structs.replace(FAULT, diagnoses=[])
    assert "not confirmed yet" in describe(event, {})
    assert "no fault" not in describe(event, {})


def test_a_suspicion_without_an_alarm_says_what_raised_it() -> None:
    event = msgspec.structs.replace(QUIET, transition="suspected", suspected=True)
    assert "no test alarms by itself, but the residuals together have changed" in describe(event, {})
    assert "every test is quiet" not in describe(event, {})


def test_what_is_unknown_is_said_to_be_near_the_equations_that_it_breaks() -> None:
    unknown = msgspec.structs.replace(FAULT, diagnoses=[Diagnosis(faults=[], rank=1, p=None, near=["e01", "e02"])])
    said = describe(unknown, {}, {"e01": Equation(name="e01", description="flow of the pump")})
    assert "1. unknown: no fault of the model explains what is seen, near e01 (flow of the pump), e02" in said


def test_a_dismissed_suspicion_does_not_read_as_all_clear_while_tests_cannot_tell() -> None:
    event = msgspec.structs.replace(QUIET, transition="dismissed", cannot_tell=["t02"])
    assert "nothing was confirmed" in describe(event, {})
    assert "no fault" not in describe(event, {})
    standing = msgspec.structs.replace(event, alarm=["t20"])
    assert "taken for the drive's baseline, though a test alarms" in describe(standing, {})


def test_a_fault_that_comes_and_goes_is_said_to() -> None:
    assert ", comes and goes" in describe(msgspec.structs.replace(FAULT, intermittent=True), {}).splitlines()[0]
    assert "comes and goes" not in describe(FAULT, {})


def test_what_may_disturb_an_equation_is_said_with_its_probability() -> None:
    manifest = load_bundle(Path(__file__).parents[2] / "golden" / "bundle").manifest
    leak = msgspec.structs.replace(FAULT, diagnoses=[Diagnosis(faults=[], rank=1, p=0.49, near=["e10"])])
    said = describe(leak, *meanings(manifest))
    assert "near e10 (balance after the pump (4.15): leak between pump and dosing unit?), p = 0.490" in said


@pytest.mark.parametrize("transition", ["started", "occurred", "refined", "healed", "cannot_tell"])
def test_every_transition_has_words(transition: str) -> None:
    event = msgspec.convert({**msgspec.to_builtins(QUIET), "transition": transition}, Event)
    assert "0.0 s  " in describe(event, {}).splitlines()[0]


Serve = Callable[[bytes], Path]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Serves some bytes to one client, after its request, which it keeps beside the socket."""
    threads: list[threading.Thread] = []

    def start(content: bytes) -> Path:
        path = tmp_path / "e.sock"
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(path))
        listener.listen()

        def answer() -> None:
            with listener, listener.accept()[0] as client:
                (tmp_path / "request").write_bytes(client.recv(100))
                client.sendall(content)

        threads.append(threading.Thread(target=answer))
        threads[-1].start()
        return path

    yield start
    for thread in threads:
        thread.join(5)
        assert not thread.is_alive()


def test_prints_events_until_the_service_ends(serve: Serve, capsys: pytest.CaptureFixture[str]) -> None:
    path = serve(encode(QUIET) + encode(FAULT))
    assert main(["--socket", str(path)]) == 0
    assert capsys.readouterr().out == f"{describe(QUIET, {})}\n{describe(FAULT, {})}\n"
    assert (path.parent / "request").read_bytes() == b"{}\n"


def test_json_passes_the_lines_through_and_not_half_a_one(
    serve: Serve, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    path = serve(encode(QUIET) + encode(FAULT) + encode(FAULT)[:30])
    assert main(["--socket", str(path), "--json", "--after", "0"]) == 0
    assert capfdbinary.readouterr().out == encode(QUIET) + encode(FAULT)
    assert (path.parent / "request").read_bytes() == b'{"after":0}\n'


def test_once_ends_after_one_event(serve: Serve, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--socket", str(serve(encode(QUIET) + encode(FAULT))), "--once"]) == 0
    assert capsys.readouterr().out == f"{describe(QUIET, {})}\n"


def test_once_without_an_event_is_a_no(serve: Serve) -> None:
    assert main(["--socket", str(serve(b"")), "--once"]) == 1


def test_waits_for_the_socket_to_appear(serve: Serve, tmp_path: Path) -> None:
    timer = threading.Timer(0.2, lambda: serve(encode(QUIET)))
    timer.start()
    assert main(["--socket", str(tmp_path / "e.sock"), "--wait", "10"]) == 0
    timer.join()


@pytest.mark.parametrize("name", ["absent.sock", "x" * 200])
def test_a_service_that_is_not_there_is_bad_input(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"is `faultline run --socket .*` running"):
        main(["--socket", str(tmp_path / name)])


@pytest.mark.parametrize("line", [b"hello\n", b'{"error":"too many clients"}\n', b"\xff\n"])
def test_what_is_no_event_is_said(serve: Serve, line: bytes) -> None:
    with pytest.raises(InputError, match="sent no event"):
        main(["--socket", str(serve(line))])


def test_names_need_a_bundle_that_is_one(serve: Serve, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"manifest\.json"):
        main(["--socket", str(tmp_path / "e.sock"), "--bundle", str(tmp_path)])
