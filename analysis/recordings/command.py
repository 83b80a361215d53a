"""Turn a bench recording (two loggers, two clocks) into an instrumented log."""

import argparse
import shutil
import tempfile
from pathlib import Path

import msgspec

from analysis.progress import Progress
from analysis.recordings.ingest import Report, ingest
from service.core.errors import InputError

EXAMPLE = """example:
  faultline ingest recordings/bench-training-s1 --out logs
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline ingest", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="folder of the bench recording")
    parser.add_argument("--out", type=Path, required=True, help="writes OUT/<id>, the instrumented recording")
    parser.add_argument("--force", action="store_true", help="replace what is already there")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    options = parser.parse_args(argv)
    with Progress(f"ingesting {options.recording}") as progress:
        result = ingest(options.recording, progress.say)
        folder = _write(result.files, options.out / result.report.id, options.recording, force=options.force)
    print(msgspec.json.encode(result.report).decode() if options.json else _sentences(result.report, folder))
    return 0


def _write(files: dict[str, bytes], folder: Path, bench: Path, *, force: bool) -> Path:
    """The recording appears whole or not at all."""
    if folder.resolve() == bench.resolve():
        raise InputError(f"{folder}: would replace the bench recording itself; give another --out")
    if folder.exists() and not force:
        raise InputError(f"{folder}: exists; remove it or use --force")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".ingest-") as temporary:
            whole = Path(temporary) / folder.name
            whole.mkdir()
            for name, content in files.items():
                (whole / name).write_bytes(content)
            if folder.exists():
                shutil.rmtree(folder)
            whole.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    return folder


def _sentences(report: Report, folder: Path) -> str:
    zero = ", ".join(
        f"{signal} {error / 100:+.1f} mbar" if error is not None else f"{signal} not calibrated (datasheet)"
        for signal, error in report.zero_pa.items()
    )
    lines = [
        f"wrote {folder}: {report.can_frames} CAN frames, {report.samples - report.outside} sensor frames",
        f"clock: offset {report.offset_s:+.3f} s, drift {report.drift_ppm:+.1f} ppm "
        f"({report.clock_windows} windows, correlation {report.correlation:.3f})",
        f"zero ({report.standstill_s:.1f} s standstill): {zero}",
    ]
    if not report.standstill_s:
        lines.append("no standstill at atmospheric pressure at the start: the sensors keep their datasheet's zero")
    if report.bad_rows or report.bad_cells:
        first = f" (first: {report.first_bad_row})" if report.first_bad_row else ""
        lines.append(f"second logger: {report.bad_rows} bad rows{first}, {report.bad_cells} cells without a value")
    if report.can_lost:
        lines.append(f"CAN log: {report.can_lost}")
    return "\n".join(lines)
