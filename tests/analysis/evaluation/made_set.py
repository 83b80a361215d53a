"""A small set of recordings cut from the golden one, whose filter clogs at 70 s: a fault-free part, and the whole."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
BUNDLE = GOLDEN / "bundle"
START_S = 1767225600.0


@dataclass(frozen=True)
class Made:
    """Folders of recordings and of their truths."""

    logs: Path
    truths: Path

    def recording(self, name: str, start_s: float = 0.0, stop_s: float = 1e9, fault: str = "") -> Path:
        """The golden log from `start_s` to `stop_s` as recording `name`; `fault` is a line of its truth's [[fault]]."""
        log = Path(shutil.copytree(GOLDEN / "log", self.logs / name))
        lines = (log / "can.log").read_text().splitlines(keepends=True)
        kept = [line for line in lines if start_s <= float(line[1 : line.index(")")]) - START_S < stop_s]
        (log / "can.log").write_text("".join(kept))
        described = (log / "recording.toml").read_text().replace('id = "golden"', f'id = "{name}"')
        described = re.sub(r'bench_sha256 = ".*"\n', "", described)  # each is a drive of its own
        (log / "recording.toml").write_text(described)
        self.truths.mkdir(exist_ok=True)
        entry = f"\n[[fault]]\n{fault}\n" if fault else ""
        (self.truths / f"{name}.toml").write_text(f'schema = 1\nrecording = "{name}"\n{entry}')
        return log


def clogged(onset_s: float = 70.0, size: float = 0.65, name: str = "fA_du") -> str:
    """The lines of a fault."""
    return f'name = "{name}"\nsize = {size}\nonset_s = {onset_s}\nprofile = "abrupt"'


def edited(log: Path, old: str, new: str) -> Path:
    """The recording with another description."""
    path = log / "recording.toml"
    assert re.search(old, path.read_text())
    path.write_text(re.sub(old, new, path.read_text()))
    return log
