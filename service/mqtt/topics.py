"""Topics of one vehicle, and what may be part of a topic.

Source: MQTT 5.0 (OASIS), 4.7: `/` separates levels, `+` and `#` are wildcards, a first `$` is the broker's own.
"""

import re

from faultline.service.core.errors import InputError

LEVEL = 80
"""Characters of a level at most."""
PREFIX = 200
"""Characters of a prefix at most."""

_ALLOWED = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_NUMBER = re.compile(r"[1-9][0-9]{0,9}")


class TopicError(InputError):
    """A name that must not be part of a topic."""


def level(name: str, what: str) -> str:
    """Return the name, which may stand in a topic and in a URN; errors say `what` it is.

    Raises:
        TopicError: it has other characters than letters, digits, `_`, `.` and `-`, or too many.
    """
    if not _ALLOWED.fullmatch(name):
        raise TopicError(
            f"{what} {_shown(name)} cannot be part of a topic: letters, digits, _ . and - only, a letter or digit first"
        )
    if len(name) > LEVEL:
        raise TopicError(f"{what} {_shown(name)} is longer than {LEVEL} characters; give a shorter one")
    return name


def levels(prefix: str) -> str:
    """Return several levels with `/` between, each checked as by `level`."""
    if len(prefix) > PREFIX:
        raise TopicError(f"prefix {_shown(prefix)} is longer than {PREFIX} characters; give a shorter one")
    for each in prefix.split("/"):
        level(each, "prefix" if each == prefix else f"prefix {_shown(prefix)}: level")
    return prefix


class Topics:
    """Topics of one vehicle.

    >>> Topics("fleet/north", "truck-17").fault(3)
    'fleet/north/truck-17/faults/3'
    """

    def __init__(self, prefix: str, vehicle: str) -> None:
        self.vehicle = level(vehicle, "vehicle")
        base = f"{levels(prefix)}/{vehicle}"
        self.events, self.health = f"{base}/events", f"{base}/health"
        self._faults = f"{base}/faults/"
        self.any_fault = f"{self._faults}+"

    def fault(self, number: int) -> str:
        """Return the topic of a fault's state."""
        return f"{self._faults}{number}"

    def number(self, topic: str) -> int | None:
        """Return the number of the fault whose topic it is; None if it is of none."""
        found = _NUMBER.fullmatch(topic.removeprefix(self._faults)) if topic.startswith(self._faults) else None
        return int(found.group()) if found else None


def _shown(name: str) -> str:
    """Return the name in one short printable line."""
    return ascii(name if len(name) <= LEVEL else f"{name[:LEVEL]}...")
