"""The CAN logger: the bus as candump's text, or in another format of python-can's."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from testbench.bus import Knowledge, Sender
from testbench.simulation import Run

START = (
    1_767_225_600  # 2026-01-01T00:00:00Z in Unix time: when every recording starts, so that equal runs give equal files
)
START_TEXT = "2026-01-01T00:00:00Z"
CHANNEL = "can0"
FORMATS = ("log", "asc", "blf", "csv", "trc")
"""Of the CAN log: candump's text, and what python-can writes."""
FRAME_TIME = 0.00027  # s on the bus: 29-bit identifier, 8 bytes and some stuffing at 500 kbit/s


def can_log(run: Run, senders: Sequence[Sender], duration: float, rng: np.random.Generator, delay: float = 0.0) -> str:
    """The bus over `duration` [s] as candump text: the first frame at time 0, each waiting for the one before.

    What is sent is `delay` [s] old.
    """
    due: list[tuple[float, int, Sender]] = []
    for sender in senders:
        count = int(duration / sender.period) + 1
        jitter = np.clip(rng.normal(0.0, sender.jitter, count), -3 * sender.jitter, 3 * sender.jitter)
        times = rng.uniform(0.1, 1.0) * sender.period + np.arange(count) * sender.period + jitter
        due += [(t, sender.message.frame_id, sender) for t in times.tolist()]
    due.sort(key=lambda frame: frame[:2])
    lines, first, free = [], due[0][0], 0.0
    for t, frame_id, sender in due:
        now = max(t - first, free)
        if now > duration:
            break
        free = now + FRAME_TIME
        known = Knowledge(*run.ecu[np.searchsorted(run.ecu_t, now - delay, side="right") - 1].tolist())
        seconds, micros = divmod(round(now * 1e6), 1_000_000)
        data = sender.encode(known).hex().upper()
        lines.append(f"({START + seconds}.{micros:06d}) {CHANNEL} {frame_id:08X}#{data}\n")
    return "".join(lines)


def in_format(candump: str, wanted: str) -> bytes:
    """A log in candump's text as a file of one of `FORMATS`, written by python-can."""
    if wanted == "log":
        return candump.encode()
    import can  # a quarter of a second, and only these formats need it

    with TemporaryDirectory() as folder:
        text, path = Path(folder) / "can.log", Path(folder) / f"can.{wanted}"
        text.write_text(candump)
        with can.LogReader(text) as reader, can.Logger(path) as logger:
            for message in reader:
                logger(message)
        return path.read_bytes()
