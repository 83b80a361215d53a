"""Compare what a bundle tells of recordings with the truth: verdicts, and a report for a review of the bundle."""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec

from faultline.analysis.evaluation.given import Given, check_reportable, given, learnt_from
from faultline.analysis.evaluation.judge import Verdict, apart, judge
from faultline.analysis.evaluation.live import live_events
from faultline.analysis.evaluation.measure.facts import Facts, facts, labelled
from faultline.analysis.evaluation.report.document import isolating
from faultline.analysis.evaluation.sentence import sentence, summary
from faultline.analysis.evaluation.story import Array, Story, tell
from faultline.analysis.model.display import units_of_inputs
from faultline.analysis.progress import Progress
from faultline.options import Parser
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.records.event import Event
from faultline.service.pages import check_engine
from faultline.writing import check_file, check_folder

EXAMPLE = """example:
  faultline evaluate out/demo/bundle out/demo/logs/validation-7-fA_t \\
      --truth out/demo/truth/validation-7-fA_t.toml --picture out/fA_t.png
  faultline evaluate out/demo/bundle out/demo/logs/validation-* --truth out/demo/truth --report out/report

Times are log time after the first frame, as in the truth; an event's own count from the first tick, some seconds later.
It exits with 1 where a true fault is not in the isolated set, something alarmed before, a test could never tell, or no
generator does what --require asks for.
--json prints a verdict a line. --report writes DIR/report.html, DIR/figures.html (every test in pictures) and
DIR/report.json; docs/evaluation.md says how to read them.
"""

DETAILED = 12
"""Recordings of which the report shows residuals and detectors over time, unless others are chosen."""


def main(argv: list[str]) -> int:
    """Runs the command; returns 0 where all verdicts are good, 1 where not."""
    options = _options(argv)
    bundle = load_bundle(options.bundle)
    chosen = given(bundle, options.recording, options.truth, options.fault)
    shown = detailed(options.detail, chosen)
    if options.picture:
        check_file(options.picture)
    if options.report:
        _check_required(options.require, bundle, chosen)
        check_folder(options.report)
        check_reportable(chosen, bundle)
    others = {str(path): load_bundle(path) for path in options.beside}
    for other in others.values():
        given(other, options.recording, options.truth)  # made from none of them either
    made_from = learnt_from(bundle, options.made_from)
    judged: list[Facts] = []
    stories: list[Story] = []
    beside: dict[str, list[Story]] = {name: [] for name in others}
    with Progress("evaluating") as progress:
        for one, story, events, verdict in _judged(options, bundle, chosen, progress):
            print(msgspec.json.encode(verdict).decode() if options.json else sentence(verdict), flush=True)
            judged.append(facts(one, verdict, events, story))
            if options.report and one.recording.id in shown:
                stories.append(replace(story, events=events))  # of a bus, where those are judged
                for name, other in others.items():
                    progress.say(f"{one.recording.id} by {name}")
                    beside[name].append(tell(other, one.open(other, lambda _: None)))
        judged = labelled(judged, units_of_inputs(bundle.manifest.inputs))
        if len(chosen) > 1:
            print(summary(judged), file=sys.stderr if options.json else sys.stdout)
        unmet: list[str] = []
        if options.report:
            progress.say("drawing the report")
            required = [*map(_pair, options.require)]
            unmet = _report(options.report, bundle, judged, stories, required, made_from, beside)
            for what in unmet:
                progress.note(f"--require: {what}: by no generator in these recordings; the report chooses without it")
    return 0 if all(one.verdict.good for one in judged) and not unmet else 1


def _options(argv: list[str]) -> argparse.Namespace:
    parser = Parser(
        "faultline evaluate", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bundle", type=Path, help="a bundle's folder, of `faultline export`")
    add("recording", type=Path, nargs="+", help="instrumented, not used for calibration, training or tuning")
    add("--truth", type=Path, nargs="+", required=True, help="truth files, or folders of <recording>.toml")
    add("--report", type=Path, metavar="DIR", help="write report.html and report.json into this folder")
    add("--fault", action="append", default=[], metavar="NAME", help="judge only recordings with it, and fault-free")
    add("--detail", nargs="+", default=[], metavar="ID", help="recordings that the report shows over time")
    add(
        "--require",
        action="append",
        default=[],
        metavar="FAULT[:OTHER]",
        help="generators to keep must detect this fault, or isolate it from the other (default: all that they can)",
    )
    add(
        "--made-from",
        type=Path,
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="recordings that the bundle was made from: their operating points are drawn",
    )
    add(
        "--beside",
        type=Path,
        nargs="+",
        default=[],
        metavar="BUNDLE",
        help="other bundles, whose predictions of the recordings shown over time are drawn beside",
    )
    add("--events", type=Path, help="judge these events (JSON lines of a live run) instead of its own; one recording")
    add("--picture", type=Path, help="draw signals, residuals, CUSUM and alarms into this PNG; one recording")
    add("--json", action="store_true", help="print verdicts as JSON, one a line")
    options = parser.parse_args(argv)
    if options.picture and options.picture.suffix != ".png":
        raise InputError(f"{options.picture}: no name of a picture; give one that ends in .png")
    for name in ("require", "detail", "made_from", "beside"):
        if getattr(options, name) and not options.report:
            raise InputError(f"--{name.replace('_', '-')}: is about the report; give --report DIR too")
    for name in ("picture", "events"):
        if getattr(options, name) and len(options.recording) > 1:
            raise InputError(f"--{name}: of one recording, here are {len(options.recording)}; give one, or --report")
    if options.report:
        check_engine()
    return options


def _check_required(required: list[str], bundle: Bundle, chosen: list[Given]) -> None:
    """Whether what is required may be met: its faults are known and recorded, and some generator tells by structure."""
    known = [fault.name for fault in bundle.manifest.faults]
    for words in required:
        for name in words.split(":"):
            if name not in known:
                raise InputError(f"--require {words}: {name!r} is no fault of the bundle; those are {', '.join(known)}")
        fault, other = _pair(words)
        if not any([each.name for each in one.truth.fault] == [fault] for one in chosen):
            raise InputError(f"--require {words}: no recording has {fault} alone; add one, or leave it out")
        sees = [fault in generator.faults for generator in bundle.manifest.generators]
        clears = [
            c and other not in g.faults for c, g in zip(isolating(bundle), bundle.manifest.generators, strict=True)
        ]
        if not any(s and (other is None or c) for s, c in zip(sees, clears, strict=True)):
            what = f"isolates {fault} from {other}" if other else f"detects {fault}"
            raise InputError(f"--require {words}: no generator {what} by structure, in any recording; leave it out")


def _pair(words: str) -> tuple[str, str | None]:
    fault, _, other = words.partition(":")
    return fault, other or None


def detailed(wanted: list[str], chosen: list[Given]) -> list[str]:
    """Ids of the recordings shown over time: the first without a fault, and the first of the largest size of each.

    Raises:
        InputError: one is `wanted` that is not among the recordings.
    """
    ids = [one.recording.id for one in chosen]
    for name in wanted:
        if name not in ids:
            raise InputError(f"--detail {name}: is none of the recordings; those are {', '.join(ids)}")
    largest: dict[tuple[str, ...], Given] = {}
    for one in chosen:
        faults = tuple(sorted(fault.name for fault in one.truth.fault))
        if faults not in largest or _size(one) > _size(largest[faults]):
            largest[faults] = one
    return wanted or [one.recording.id for one in largest.values()][:DETAILED]


def _size(one: Given) -> float:
    return sum(abs(fault.size) for fault in one.truth.fault)


def _judged(
    options: argparse.Namespace, bundle: Bundle, chosen: list[Given], progress: Progress
) -> Iterator[tuple[Given, Story, list[Event], Verdict]]:
    """Each recording run and judged, one at a time, with the truth of what began before its log ends."""
    tests = list(dict.fromkeys(generator.test for generator in bundle.manifest.generators))
    known = [fault.name for fault in bundle.manifest.faults]
    for number, one in enumerate(chosen, start=1):
        progress.say(f"{one.recording.id}, {number} of {len(chosen)}")
        log = one.open(bundle, partial(print, file=sys.stderr))
        live = live_events(options.events, bundle, log) if options.events else None
        story = tell(bundle, log)
        events = story.events if live is None else live
        truth = one.truth.until(story.end_s)
        for fault in one.truth.fault:
            if fault not in truth.fault:
                progress.note(f"{one.path}: {fault.name} begins at {fault.onset_s:g} s, the log ends before; left out")
        verdict = judge(truth, events, tests, story.origin_s, story.end_s, known)
        if live is not None:
            off = apart(live, story.events, len(story.t_s) - 1)
            verdict = msgspec.structs.replace(verdict, apart_ticks=off)
        if options.picture:
            progress.say("drawing")
            _draw(story, live, verdict, options.picture)
        yield one._replace(truth=truth), story, events, verdict


def _draw(story: Story, live: list[Event] | None, verdict: Verdict, path: Path) -> None:
    from faultline.analysis.evaluation.picture import draw  # matplotlib takes a second to import

    draw(story, live, verdict, path)


def _report(
    folder: Path,
    bundle: Bundle,
    judged: list[Facts],
    stories: list[Story],
    required: list[tuple[str, str | None]],
    made_from: list[tuple[str, Array]],
    beside: dict[str, list[Story]],
) -> list[str]:
    """Writes the report; returns what is required and no generator does."""
    from faultline.analysis.evaluation.report.write import write  # matplotlib takes a second to import

    chosen = write(folder, bundle, judged, stories, required, made_from, beside).selection
    return chosen.unmet if chosen else []
