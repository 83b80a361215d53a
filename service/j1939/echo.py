"""Transmission check: each frame that is sent comes back once it was really transmitted.

On SocketCAN that is CAN_RAW_RECV_OWN_MSGS: a driver that echoes (IFF_ECHO) hands a frame back when its controller has
transmitted it and somebody has acknowledged it. A controller that listens only, is bus-off or alone never does. A
multicast group gives every sender its own datagrams.
"""

from collections import deque

from faultline.service.logs import Frame

PATIENCE_S = 1.0
"""A frame that was not transmitted in that time, with none after it, is one on a bus that takes nothing."""
_MOST = 1024  # frames that are looked for


class Echo:
    """Frames that were sent and have not come back."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, int, bytes]] = deque(maxlen=_MOST)
        self._heard = float("-inf")

    def clear(self) -> None:
        """Forget all frames that were sent."""
        self._sent.clear()

    def sent(self, frame: Frame, now: float) -> None:
        """Note a frame that was sent."""
        self._sent.append((now, frame.can_id, frame.data))

    def heard(self, frame: Frame, now: float) -> bool:
        """Return True if a received frame is one of ours."""
        for k, (_, can_id, data) in enumerate(self._sent):
            if can_id == frame.can_id and data == frame.data:
                del self._sent[k]
                self._heard = now
                return True
        return False

    @property
    def due(self) -> float | None:
        """Return the time when the oldest frame will be overdue [s]."""
        return self._sent[0][0] + PATIENCE_S if self._sent else None

    def is_overdue(self, now: float) -> bool:
        """Return True if no frame has come back within `PATIENCE_S`, though one should have."""
        while self._sent and now >= self._sent[0][0] + PATIENCE_S:
            if self._heard < self._sent[0][0]:
                return True
            self._sent.popleft()  # others came back after it: it was lost on its way to us
        return False
