"""Pieces of a text, cut anywhere, to whole lines."""

from faultline.service.logs.report import LogReport

LONGEST_LINE = 16384
"""A line of more bytes is no frame's, and is rejected unread."""
BEFORE, BEHIND = bytes(7) + b"\n", bytes(LONGEST_LINE)
"""Bytes around the lines of a text, so that any line may be taken with some before it and behind it."""
_ENDLESS = 1 << 26


class WholeLines:
    """State: what is there of the last line, of which no more than needed to reject it is kept."""

    def __init__(self, report: LogReport) -> None:
        self._report = report
        self.rest = b""
        self._dropped = 0

    @property
    def is_endless(self) -> bool:
        """True if no line's end came for so long that none will."""
        return self._dropped > _ENDLESS

    def take(self, piece: bytes) -> bytes:
        """The lines that end within this piece, between `BEFORE` and `BEHIND`; empty where none does."""
        end = piece.rfind(b"\n") + 1
        if not end:
            self._keep(self.rest + piece)
            return b""
        text = b"".join((BEFORE, self.rest, memoryview(piece)[:end], BEHIND))
        self._report.lost_bytes += self._dropped
        self.rest, self._dropped = b"", 0
        self._keep(piece[end:])
        return text

    def _keep(self, rest: bytes) -> None:
        self.rest = rest[: LONGEST_LINE + 1] if rest.strip(b"\0") else rest[:1]
        self._dropped += len(rest) - len(self.rest)
