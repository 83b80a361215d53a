r"""Metrics for Prometheus, text format 0.0.4: pure.

Source: the exposition format of Prometheus: `\`, `"` and newlines are escaped in label values, `\` and newlines in
help texts; one HELP and one TYPE line a family, all its samples together.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeVar

from faultline.service.core.records.fault import Fault
from faultline.service.protocol.answers import BusStatus, ServiceState, SystemStatus

Kind = Literal["gauge", "counter"]
T = TypeVar("T")

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Sample(NamedTuple):
    """A value with its labels."""

    labels: Mapping[str, str]
    value: float


class Family(NamedTuple):
    """All samples of one name."""

    name: str
    kind: Kind
    help: str
    samples: Sequence[Sample]


class Counts:
    """Counters of this server.

    `streams` are the open ones by kind (events, live), `requests` answered ones by method and code, `turned_away`
    connections that had to make room or were too slow, by reason, `unread` lines of the daemon that are no record.
    """

    def __init__(self) -> None:
        self.requests = Counter[tuple[str, int]]()
        self.streams = Counter[str](events=0, live=0)
        self.turned_away = Counter[str]()
        self.connections = 0
        self.unread = 0


def render(families: Iterable[Family]) -> bytes:
    """Return the text; families without a sample are left out."""
    lines = []
    for family in families:
        if family.samples:
            lines.append(f"# HELP {family.name} {family.help.translate(_HELP)}")
            lines.append(f"# TYPE {family.name} {family.kind}")
            lines += [f"{family.name}{_labels(sample.labels)} {_number(sample.value)}" for sample in family.samples]
    return "".join(f"{line}\n" for line in lines).encode()


def of_daemon(state: ServiceState | None, faults: Sequence[Fault]) -> list[Family]:
    """Return the metrics of the daemon, None for `state` if it does not answer."""
    up = _gauge("faultline_up", "whether the daemon answers", [({}, state is not None)])
    if state is None:
        return [up]
    info = {"source": state.source, "version": state.version}
    return [
        up,
        _gauge("faultline_info", "the vehicle and the version of the daemon", [(info, 1)]),
        _gauge("faultline_cycle", "number of the operation cycle", [({}, state.cycle)]),
        _counter("faultline_records_total", "number of the last record that was told", [({}, state.seq)]),
        _gauge(
            "faultline_condition",
            "1 for each condition that keeps the daemon from telling",
            [({"kind": each.kind, "of": each.of}, 1) for each in state.conditions],
        ),
        *_store(state),
        *_buses(state.buses),
        *_systems(state.systems),
        *_faults(faults),
    ]


def of_server(counts: Counts, *, subscribed: bool) -> list[Family]:
    """Return the metrics of this server; `subscribed`: it receives the daemon's events."""
    requests = [
        ({"method": method, "code": str(code)}, count) for (method, code), count in sorted(counts.requests.items())
    ]
    streams = [({"stream": name}, count) for name, count in sorted(counts.streams.items())]
    away = [({"reason": reason}, count) for reason, count in sorted(counts.turned_away.items())]
    return [
        _gauge("faultline_http_subscribed", "whether this server hears the daemon's events", [({}, subscribed)]),
        _gauge("faultline_http_connections", "open connections", [({}, counts.connections)]),
        _gauge("faultline_http_sse_clients", "open streams", streams),
        _counter("faultline_http_requests_total", "answered requests", requests),
        _counter("faultline_http_turned_away_total", "connections ended by this server", away),
        _counter("faultline_http_unread_lines_total", "lines of the daemon that are no record", [({}, counts.unread)]),
    ]


def _store(state: ServiceState) -> list[Family]:
    store = state.store
    if store is None:
        return []
    return [
        _gauge("faultline_store_kept", "number of the last record that is kept", [({}, store.kept)]),
        _gauge("faultline_store_failing", "whether the disk takes nothing now", [({}, store.failing)]),
    ]


def _buses(buses: Sequence[BusStatus]) -> list[Family]:
    named = [({"bus": bus.name}, bus) for bus in buses]
    return [
        _each("counter", "faultline_bus_frames_total", "frames received", named, lambda bus: bus.frames),
        _each("counter", "faultline_bus_dropped_total", "frames lost", named, lambda bus: bus.dropped),
        _each("counter", "faultline_bus_errors_total", "error frames", named, lambda bus: bus.errors),
        _each("gauge", "faultline_bus_trouble", "whether it cannot be used", named, lambda bus: bool(bus.trouble)),
    ]


def _systems(systems: Sequence[SystemStatus]) -> list[Family]:
    named = [({"system": system.name}, system) for system in systems]
    known = [({**labels, "bundle": system.bundle}, system) for labels, system in named]
    return [
        _each("gauge", "faultline_system_info", "the manifest that watches it", known, lambda _: 1),
        _each("gauge", "faultline_system_alarms", "tests that alarm", named, lambda one: len(one.alarm)),
        _each("gauge", "faultline_system_cannot_tell", "tests that cannot", named, lambda one: len(one.cannot_tell)),
        _each("gauge", "faultline_system_suspected", "whether anything is", named, lambda one: one.suspected),
        _each("gauge", "faultline_system_anomaly", "the same, confirmed or not", named, lambda one: one.anomaly),
    ]


def _faults(faults: Sequence[Fault]) -> list[Family]:
    named = [({"system": fault.system, "number": str(fault.number)}, fault) for fault in faults]
    known = [({**labels, "component": ", ".join(fault.components) or "unknown"}, fault) for labels, fault in named]
    return [
        _each("gauge", "faultline_fault_active", "whether it is there", known, lambda one: one.status.test_failed),
        _each("gauge", "faultline_fault_confirmed", "whether it is", named, lambda one: one.status.confirmed),
        _each("gauge", "faultline_fault_warning", "whether it is warned of", named, lambda one: one.status.warning),
        _each(
            "counter", "faultline_fault_occurrences_total", "how often it failed", named, lambda one: one.occurrences
        ),
    ]


def _each(
    kind: Kind, name: str, text: str, named: Iterable[tuple[Mapping[str, str], T]], value: Callable[[T], float]
) -> Family:
    return Family(name, kind, text, [Sample(labels, value(one)) for labels, one in named])


def _gauge(name: str, text: str, samples: Iterable[tuple[Mapping[str, str], float]]) -> Family:
    return Family(name, "gauge", text, [Sample(*each) for each in samples])


def _counter(name: str, text: str, samples: Iterable[tuple[Mapping[str, str], float]]) -> Family:
    return Family(name, "counter", text, [Sample(*each) for each in samples])


_HELP = str.maketrans({"\\": r"\\", "\n": r"\n"})
_LABEL = str.maketrans({"\\": r"\\", "\n": r"\n", '"': r"\""})


def _labels(labels: Mapping[str, str]) -> str:
    inside = ",".join(f'{name}="{value.translate(_LABEL)}"' for name, value in labels.items())
    return f"{{{inside}}}" if inside else ""


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) else repr(value)
