"""Logs that are given as bytes."""

from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.service.logs import Frame, LogError, LogReport, read_log


def parse_log(content: bytes, path: Path) -> tuple[list[Frame], LogReport]:
    """As `read_log` of a file of this name with this content; an error names `path`."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_bytes(content)
        try:
            return read_log(file)
        except LogError as error:
            raise LogError(str(error).replace(str(file), str(path))) from error
