"""The CAN logger: the bus as candump's text, or in another format of python-can's."""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.testbench.traffic import Frame

START = (
    1_767_225_600  # 2026-01-01T00:00:00Z in Unix time: when every recording starts, so that equal runs give equal files
)
START_TEXT = "2026-01-01T00:00:00Z"
CHANNEL = "can0"
FORMATS = ("log", "asc", "blf", "csv", "trc")
"""Of the CAN log: candump's text, and what python-can writes."""


def candump(frames: Iterable[Frame]) -> str:
    """The frames as candump's text."""
    lines = []
    for t, frame_id, data in frames:
        seconds, micros = divmod(round(t * 1e6), 1_000_000)
        lines.append(f"({START + seconds}.{micros:06d}) {CHANNEL} {frame_id:08X}#{data.hex().upper()}\n")
    return "".join(lines)


def in_format(text: str, wanted: str) -> bytes:
    """A log in candump's text as a file of one of `FORMATS`, written by python-can."""
    if wanted == "log":
        return text.encode()
    import can  # a quarter of a second, and only these formats need it

    with TemporaryDirectory() as folder:
        plain, path = Path(folder) / "can.log", Path(folder) / f"can.{wanted}"
        plain.write_text(text)
        with can.LogReader(plain) as reader, can.Logger(path) as logger:
            for message in reader:
                logger(message)
        return path.read_bytes()
