"""Compare diagnoses with the truth of a recording, and draw them."""

import argparse
import sys
from functools import partial
from pathlib import Path

import msgspec

from analysis.evaluation.judge import Verdict, apart, judge
from analysis.evaluation.story import Story, tell
from analysis.evaluation.truth import load_truth
from analysis.progress import Progress
from analysis.recordings.observe import open_known
from service.bundle import Bundle, load_bundle
from service.core.errors import InputError
from service.core.events import Event, decode
from service.logs import Log

EXAMPLE = """example:
  faultline evaluate out/demo/logs/validation-7-fA_t --bundle out/demo/bundle \\
      --truth out/demo/truth/validation-7-fA_t.toml --picture out/fA_t.png

Times are log time after the first frame, as in the truth; an event's own count from the first tick, some seconds later.
It exits with 1 where a true fault is not in the isolated set, something alarmed before, or a test could never tell.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns 0 where the verdict is good, 1 where not."""
    parser = argparse.ArgumentParser(
        "faultline evaluate", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="an instrumented recording, not used for calibration or tuning")
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True, help="its truth.toml")
    parser.add_argument("--events", type=Path, help="judge these events (JSON lines of a live run) instead of its own")
    parser.add_argument("--picture", type=Path, help="draw pressures, residuals, CUSUM and alarms into this PNG")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    if options.picture and options.picture.suffix != ".png":
        raise InputError(f"{options.picture}: no name of a picture; give one that ends in .png")
    bundle = load_bundle(options.bundle)
    log = open_known(options.recording, partial(print, file=sys.stderr))
    log.check_dbc(bundle.manifest.files[bundle.manifest.dbc].sha256)
    origin = bundle.manifest.origin
    if log.sha256 in [*origin.calibrate, *origin.train, *origin.tune]:
        raise InputError(
            f"{options.recording}: the bundle was made from this recording; evaluate on one it has not seen"
        )
    truth = load_truth(options.truth, log.id)
    live = _events(options.events, bundle, log) if options.events else None
    with Progress(f"evaluating {log.id}") as progress:
        story = tell(bundle, log)
        tests = list(dict.fromkeys(generator.test for generator in bundle.manifest.generators))
        events = story.events if live is None else live
        verdict = judge(truth, events, tests, story.origin_s, story.end_s)
        if live is not None:
            off = apart(live, story.events, len(story.t_s) - 1)
            verdict = msgspec.structs.replace(verdict, apart_ticks=off)
        if options.picture:
            progress.say("drawing")
            _draw(story, live, verdict, options.picture)
    print(msgspec.json.encode(verdict).decode() if options.json else _sentence(verdict))
    return 0 if verdict.good else 1


def _draw(story: Story, live: list[Event] | None, verdict: Verdict, path: Path) -> None:
    from analysis.evaluation.picture import draw  # matplotlib takes a second to import

    draw(story, live, verdict, path)


def _events(path: Path, bundle: Bundle, log: Log) -> list[Event]:
    """The events in a file, which must be about this log and from this bundle."""
    if not path.is_file():
        raise InputError(f"{path}: not found; `faultline watch --json` writes events")
    events = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        try:
            events.append(decode(line))
        except (msgspec.DecodeError, msgspec.ValidationError) as error:
            raise InputError(f"{path}: line {number}: not an event: {error}") from error
        if events[-1].bundle != bundle.id:
            raise InputError(
                f"{path}: line {number}: told by bundle {events[-1].bundle[:12]}, not by {bundle.id[:12]}; "
                "give the bundle that the service ran"
            )
        if (source := events[-1].id.rpartition("-")[0]) != log.id:
            raise InputError(
                f"{path}: line {number}: is about {source!r}, not about {log.id!r}; "
                f"give the events of this recording (faultline run --source {log.id})"
            )
    if not events:
        raise InputError(f"{path}: holds no event, not even that the service started; was it running?")
    return events


def _sentence(v: Verdict) -> str:
    blind = f"; {', '.join(v.blind)} could never tell" if v.blind else ""
    if not v.faults:
        return f"{v.recording}: fault-free, {v.false_alarms} false alarms{blind}"
    found = (
        f"detected after {v.delay_s:g} s, isolated {{{', '.join(v.isolated)}}}, first {', '.join(v.first)}"
        if v.detected
        else "not detected"
    )
    fault = f"{', '.join(v.faults)} from {v.onset_s:g} s"
    return f"{v.recording}: {fault}, {found}; {v.false_alarms} false alarms before{blind}"
