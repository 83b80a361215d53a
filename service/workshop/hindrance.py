"""Causes why tests cannot tell: signals that cannot be used, or are outside the operating region."""

from typing import NamedTuple

from faultline.service.core.display import display_of, titled
from faultline.service.core.records.health import KINDS
from faultline.service.protocol.live import LiveTick, SystemDescription

QUALITIES = {
    "missing": "has never come",
    "not_available": "is not available, says its sender",
    "error": "has an error, says its sender",
    "reserved": "has a reserved value",
    "out_of_range": "is outside the range of the DBC",
    "late": "does not come any more",
    "frozen": "does not change",
    "jump": "jumps further than a sensor can",
    "doubted": "is sent by more than one",
}
"""How a quality reads."""

REMEDIES: dict[str, str] = {
    "bus-down": "bring the interface up",
    "bus-removed": "plug the interface in again",
    "bus-off": "check wiring, termination and bit rate",
    "error-passive": "check wiring, termination and bit rate",
    "frames-lost": "end what else loads this machine or bus",
    "no-traffic": "turn the ignition on, and check bus and bit rate",
    "missing": "check the sensor's plug and the control unit that sends it",
    "not-available": "check the control unit that sends it",
    "error": "check the sensor and its plug",
    "out-of-range": "check the sensor and its plug",
    "frozen": "check the sensor, and whether the system runs",
    "jump": "check the sensor's plug and cable",
    "second-sender": "unplug other testers that send",
    "address-claim": "unplug other devices that claim the address",
    "short-frames": "check that the DBC is of this vehicle",
    "unknown-selector": "check that the DBC is of this vehicle",
    "incomplete": "check what else loads the bus, and the control unit that sends it",
    "bundle-failed": "wait a minute; then see the service's log",
    "bundle-refused": "install a bundle that is signed and whole",
    "store-failed": "make room on the disk, or mend it; the test can go on",
    "store-reset": "nothing for this test; what was remembered before is gone",
    "clients-refused": "close screens and pages that nobody looks at",
    "store-removed": "nothing for this test; keep other programs away from the store",
    "relearning": "operate the vehicle in each mode, several times, until this ends",
    "rows-set-aside": "nothing for this test; see the service's log for what was set aside",
    "memory-failed": "see the service's log; the test can go on",
}
"""What a technician can do about a condition."""

assert set(REMEDIES) == set(KINDS)


def remedy(kind: str) -> str:
    """Return what to do about a condition, one of a newer version too."""
    return REMEDIES.get(kind, "see the service's log")


class Hindrance(NamedTuple):
    """A signal, as titled, that keeps tests from telling: its quality, or where it should be (`region`, in words)."""

    signal: str
    quality: str | None
    value: str
    region: str

    def __str__(self) -> str:
        if self.quality is not None:
            return f"{self.signal} {QUALITIES.get(self.quality, self.quality)} ({self.quality})"
        return f"{self.signal} is {self.value}, tests hold from {self.region}"


def hindrances(system: SystemDescription, tick: LiveTick) -> list[Hindrance]:
    """Return each signal that cannot be used, or lies outside the operating region."""
    found = []
    for channel, value, quality in zip(system.inputs, tick.z, tick.quality, strict=True):
        shown = display_of(channel)
        region = f"{shown.text(channel.lower)} to {shown.text(channel.upper)}"
        if quality != "good":
            found.append(Hindrance(titled(channel), quality, "", region))
        elif value is not None and not channel.lower <= value <= channel.upper:
            found.append(Hindrance(titled(channel), None, shown.text(value), region))
    return found


def instead(hindrance: Hindrance) -> str:
    """Return what to do about it."""
    if hindrance.quality is None:
        return "bring the system into that range"
    if hindrance.quality in ("missing", "late"):
        return "check ignition, the sensor's plug and the control unit that sends it"
    if hindrance.quality == "doubted":
        return REMEDIES["second-sender"]
    return "check the sensor, its plug and its control unit"
