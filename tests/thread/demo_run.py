"""What a finished demo leaves behind."""

import sys
from dataclasses import dataclass
from pathlib import Path

FAULTLINE = str(Path(sys.executable).with_name("faultline"))


@dataclass(frozen=True)
class Ran:
    """The folder it ran in, its exit code and what it printed."""

    folder: Path
    code: int
    out: str
    err: str
