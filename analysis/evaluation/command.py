"""Compare diagnoses with the truth of a recording, and draw them."""

import argparse
import sys
from functools import partial
from pathlib import Path

import msgspec

from analysis.evaluation.judge import Verdict, judge
from analysis.evaluation.story import Story, tell
from analysis.evaluation.truth import load_truth
from analysis.progress import Progress
from analysis.recordings.observe import open_known
from service.bundle import load_bundle
from service.core.errors import InputError
from service.core.events import Event, decode

EXAMPLE = """example:
  faultline evaluate out/logs/bench-validation-s7-fA_du --bundle out/bundle \\
      --truth out/truth/bench-validation-s7-fA_du.toml --picture out/fA_du.png
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns 0 where the true faults are in the isolated set and nothing alarmed without cause."""
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
    bundle = load_bundle(options.bundle)
    log = open_known(options.recording, partial(print, file=sys.stderr))
    if log.sha256 in [*bundle.manifest.origin.calibrate, *bundle.manifest.origin.tune]:
        raise InputError(
            f"{options.recording}: the bundle was made from this recording; evaluate on one it has not seen"
        )
    truth = load_truth(options.truth, log.id)
    with Progress(f"evaluating {log.id}") as progress:
        story = tell(bundle, log)
        events = _events(options.events) if options.events else story.events
        verdict = judge(truth, events, story.origin_s)
        if options.picture:
            progress.say("drawing")
            _draw(story, events, verdict, options.picture)
    print(msgspec.json.encode(verdict).decode() if options.json else _sentence(verdict))
    return 0 if verdict.false_alarms == 0 and verdict.contained == bool(verdict.faults) else 1


def _draw(story: Story, events: list[Event], verdict: Verdict, path: Path) -> None:
    from analysis.evaluation.picture import draw  # matplotlib takes a second to import

    draw(story, events, verdict, path)


def _events(path: Path) -> list[Event]:
    if not path.is_file():
        raise InputError(f"{path}: not found; `faultline watch --json` writes events")
    events = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        try:
            events.append(decode(line))
        except (msgspec.DecodeError, msgspec.ValidationError) as error:
            raise InputError(f"{path}: line {number}: not an event: {error}") from error
    return events


def _sentence(v: Verdict) -> str:
    if not v.faults:
        return f"{v.recording}: fault-free, {v.false_alarms} false alarms"
    if not v.detected:
        missed = f"{', '.join(v.faults)} from {v.onset_s:g} s was not detected"
        return f"{v.recording}: {missed}; {v.false_alarms} false alarms before"
    return (
        f"{v.recording}: {', '.join(v.faults)} from {v.onset_s:g} s, detected after {v.delay_s:g} s, "
        f"isolated {{{', '.join(v.isolated)}}}, first {', '.join(v.first)}; {v.false_alarms} false alarms before"
    )
