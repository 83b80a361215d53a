"""The vehicle's name in topics."""

from faultline.service.mqtt.topics import TopicError, level


class Naming:
    """The vehicle's name: as `configured`, or the daemon's; until that says it, as it was before or is in records."""

    def __init__(self, configured: str | None, remembered: str | None) -> None:
        self._is_fixed, self._is_answered = configured is not None, False
        self.name = configured if configured is not None else _usable(remembered)

    @property
    def is_fixed(self) -> bool:
        """Return True if the name is configured."""
        return self._is_fixed

    def answered(self, source: str) -> None:
        """Take the name that the daemon gives.

        Raises:
            TopicError: it cannot be part of a topic; then there is no name until another comes.
        """
        if not self._is_fixed:
            self.name, self._is_answered = None, True
            self.name = level(source, "the daemon's name (`source`)")

    def seen(self, vehicle: str) -> None:
        """Take the name in a record's id if none is known; raises as `answered`."""
        if self.name is None and not self._is_answered:
            self.name = level(vehicle, "the vehicle's name in a record's id")


def _usable(name: str | None) -> str | None:
    """Return the name that was kept, if it is valid now."""
    try:
        return level(name, "vehicle") if name is not None else None
    except TopicError:
        return None
