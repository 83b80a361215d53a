"""Find where a model and recordings disagree, name the missing effect and add it to the model."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from faultline.analysis.calibration.provenance import recordings_of
from faultline.analysis.discrepancy.add.adopt import undone, within_bounds
from faultline.analysis.discrepancy.add.bundle_effect import BundleEffect, Trial, bundle_effect, trial
from faultline.analysis.discrepancy.add.drift import drifts
from faultline.analysis.discrepancy.add.gate import Adoption, adoption
from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.add.structure_change import structure_change
from faultline.analysis.discrepancy.data import Data, load
from faultline.analysis.discrepancy.discover import Discovery, discover
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import is_own, load_library
from faultline.analysis.discrepancy.effects.rewrite import applicable
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.discrepancy.name.experiment import MANY, Plan, propose
from faultline.analysis.discrepancy.name.gauge import Gauge, gauge
from faultline.analysis.discrepancy.name.work import workers
from faultline.analysis.discrepancy.propose.entries import entries_toml
from faultline.analysis.discrepancy.propose.proposal import Proposal, propose_formula
from faultline.analysis.discrepancy.show.build import document_of, origin_of
from faultline.analysis.discrepancy.show.document import encoded
from faultline.analysis.discrepancy.show.extras import Extras
from faultline.analysis.discrepancy.show.proposed import proposal_of
from faultline.analysis.discrepancy.show.report import DOCUMENT, PICTURES, files_of
from faultline.analysis.discrepancy.show.sentences import sentences
from faultline.analysis.model import Model, dump_model
from faultline.analysis.model.file import alike, folder_of
from faultline.analysis.progress import Progress
from faultline.analysis.structure.lint import sound_model
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.pages import check_engine
from faultline.writing import check_folder, write_file, write_files

EXAMPLE = """examples:
  faultline discover calibrated.toml logs/training-s1 --held-out logs/validation-s2 --out found --apply
  faultline discover found/model.toml --undo

DIR gets report.html, discovery.json and summary.md; with --apply model.toml, which every other command takes; and
experiment.toml where an experiment would tell which effect it is: record it, then call this again with that recording
besides; and proposal.toml where something is missing that has no name: formulas for review, which --apply adds only
once they are given back with --library. What is done is kept in DIR/work: an interrupted call goes on there.

Effects and experiments are those of effects.toml and experiments.toml in the system's folder. That is where MODEL lies,
or the shipped system that has a model of its name.

It exits with 0 where nothing is missing or what is missing has one name, with 1 where it has several names or none,
where it looks like a fault, and where --apply is refused.
"""


MODEL, EXPERIMENT, WORK = "model.toml", "experiment.toml", "work"
FORMULA = "proposal.toml"


SEARCHES = (
    "apply", "held_out", "library", "without", "same_conditions", "tune", "evaluate", "truth", "scheduler", "processes",
    "json",
)  # fmt: skip
"""Options that mean nothing to --undo."""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline discover", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("model", help="a model file, or the name of a shipped model")
    add("recording", type=Path, nargs="*", help="an instrumented, fault-free recording to fit")
    add("--held-out", type=Path, nargs="+", default=[], help="others, on which the evidence is checked")
    add("--out", type=Path, default=Path("discovery"), metavar="DIR", help="folder to write (default: discovery)")
    add(
        "--library",
        type=Path,
        metavar="FILE",
        help="effects of your own, besides those of the system",
    )
    add(
        "--without",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="effects that it is not, as a gauge has shown",
    )
    add(
        "--same-conditions",
        action="store_true",
        help="all recordings were made one after the other: nothing with a drift in the model changed in between",
    )
    add("--apply", action="store_true", help="write the model with what was found, unless there is a reason against")
    add("--undo", action="store_true", help="take the last discovery out of MODEL again; writes DIR/model.toml")
    add("--tune", type=Path, nargs="+", default=[], help="fault-free recordings to tune both models' bundles on")
    add("--evaluate", type=Path, nargs="+", default=[], help="recordings to judge both bundles by")
    add("--truth", type=Path, nargs="+", default=[], help="their truth files, in the same order")
    add("--scheduler", metavar="ADDRESS", help="work on a Dask scheduler, such as tcp://127.0.0.1:8786")
    add("--processes", type=int, help="how many at once (default: one a core)")
    add("--json", action="store_true", help="print the result as JSON")
    options = parser.parse_args(argv)
    if options.undo:
        given = [name for name in SEARCHES if getattr(options, name)]
        if given:
            parser.error(f"--undo takes MODEL and --out only; leave out --{given[0].replace('_', '-')}")
        return _undo(options.model, options.recording, options.out)
    if not options.recording or not options.held_out:
        parser.error("give recordings to fit, and others with --held-out")
    if options.evaluate and not options.tune:
        parser.error("--evaluate judges bundles, and those are tuned: give fault-free recordings with --tune")
    if options.scheduler and options.processes:
        parser.error("--processes are of this machine; the cluster at --scheduler has its own")
    if options.truth and len(options.truth) != len(options.evaluate):
        parser.error("give as many --truth as --evaluate, in the same order")
    return _discover(options)


def _undo(model: str, recordings: Sequence[Path], out: Path) -> int:
    if recordings:
        raise InputError("--undo takes a model only; leave the recordings away")
    before = undone(sound_model(model))
    _not_over(model, out)
    write_file(out / MODEL, dump_model(before))
    print(f"wrote {out / MODEL}: {before.name} as it was before its last discovery")
    return 0


def _discover(options: argparse.Namespace) -> int:
    check_engine()
    _not_over(options.model, options.out)
    check_folder(options.out)
    model = sound_model(options.model)
    own = folder_of(options.model, model.name)
    system = own or alike(model)
    library, experiments = _library(system, options.library, options.without), load_experiments(system)
    with Progress(f"discovering what {model.name} misses") as progress, _resumable(options.out):
        data = load(model, options.recording, options.held_out, progress.note, same_conditions=options.same_conditions)
        for gap in data.gaps():
            progress.note(gap)
        for gap in _without_place(model, library):
            progress.note(gap)
        if own is None and system is not None:
            progress.note(
                f"{model.name}: effects and experiments of the shipped system {system.name}, which it is like"
            )
        if not library:
            progress.note(f"{model.name}: neither effects.toml of its system nor --library, so nothing gets a name")
        recordings = _trial(options, data, progress)
        with workers(options.scheduler, options.processes) as executor:
            clock = _Clock(progress.say)
            found = discover(data, library, executor, options.out / WORK, clock)
            set_in = found.onset([log.id for log in data.training], [log.id for log in data.held])
            proposal = propose_formula(found, executor, options.out / WORK, clock) if set_in is None else None
        progress.say("free runs, structure, experiments")
        runs = shown(found.study, found.baseline, found.outcome.nominal, found.outcome.chosen)
        new = adoption(data, found, runs)
        rivals = found.rivals if set_in is None else ()
        planned = experiments.planned
        plans = propose(found.study, found.baseline, rivals, planned, progress.note) if rivals else []
        extras = Extras(
            drifts=drifts(model, found.outcome.nominal, found.outcome.chosen) if new.model else None,
            structure=structure_change(model, new.model, found.outcome.chosen) if new.model else None,
            bundle=_bundles(model, recordings, found, new, progress),
            plans=plans,
            experiments=experiments,
            gauge=_gauge(found, rivals, plans, experiments.gauges),
            proposal=proposal_of(found, proposal) if proposal else None,
            onset=set_in,
            refused=new.reasons,
            applied=options.apply and new.model is not None and not new.reasons and set_in is None,
        )
        document = document_of(found, runs, origin_of(data, options.without), extras)
        progress.say("report")
        written = _written(options.out, files_of(found, document, runs) | _results(new, extras, proposal))
    if options.json:
        print(encoded(document).decode())
    else:
        print("\n".join([*sentences(document), f"wrote {', '.join(str(path) for path in written)}"]))
    good = found.verdict.kind in ("nothing missing", "named") and extras.onset is None
    return 0 if good and not (options.apply and new.reasons) else 1


def _library(system: Path | None, own: Path | None, without: Sequence[str]) -> dict[str, Effect]:
    """The effects of the system and those in the user's file, but for what the user knows that it is not."""
    library = load_library(system, own)
    for name in without:
        if name not in library:
            raise InputError(f"--without {name}: the library has no such effect; `discovery.json` lists them")
    return {name: effect for name, effect in library.items() if name not in without}


def _gauge(
    found: Discovery, rivals: Sequence[Attempt], plans: Sequence[Plan], precision: Mapping[str, float]
) -> Gauge | None:
    """The reading that tells what no experiment does."""
    pairs = plans[0].unresolved if plans else [*combinations((rival.effects[-1] for rival in rivals[:MANY]), 2)]
    return gauge(found.study, rivals, pairs, precision)


def _without_place(model: Model, library: Mapping[str, Effect]) -> Iterator[str]:
    """Why entries of the user's file have no place in the model: a shipped one may well have none, theirs was meant."""
    for effect in library.values():
        reason = applicable(model, effect)
        if reason is not None and is_own(effect):
            yield f"{effect.place}: {reason}; the entry is left away"


def _trial(options: argparse.Namespace, data: Data, progress: Progress) -> Trial | None:
    """What the bundles are made and judged with, if that was asked for: what is wrong with it is said at once."""
    if not options.tune:
        return None
    seen = [*recordings_of(data.model), *(log.drive for log in (*data.training, *data.held))]
    truths = options.truth or [None] * len(options.evaluate)
    used = dict.fromkeys(seen, "calibrate the model or to discover its effects")
    return trial(used, options.tune, list(zip(options.evaluate, truths, strict=True)), progress.note, data.vehicle)


def _bundles(
    model: Model, recordings: Trial | None, found: Discovery, new: Adoption, progress: Progress
) -> BundleEffect | None:
    if recordings is None:
        return None
    if new.model is None:
        progress.note("nothing is added to the model, so there are no bundles to compare: --tune is not used")
        return None
    progress.say("bundles before and after")
    before = model.with_parameters(within_bounds(model, found.outcome.nominal.values), new.model.provenance[-1])
    return bundle_effect(before, new.model, recordings, progress)


def _results(new: Adoption, extras: Extras, proposal: Proposal | None) -> dict[str, bytes]:
    """The model, if that is asked for and nothing speaks against it, an experiment and a formula, if there are any."""
    files = {}
    if proposal is not None:
        files[FORMULA] = entries_toml(proposal.study.model.name, proposal.terms, proposal.rivals).encode()
    if extras.applied and new.model is not None:
        files[MODEL] = dump_model(new.model).encode()
    if extras.plans and extras.plans[0].resolved:
        files[EXPERIMENT] = extras.plans[0].experiment.cycle().encode()
    return files


def _written(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """The paths written; what an earlier call has left and is not of this one goes."""
    ours = (folder / DOCUMENT).exists()
    write_files({folder / name: content for name, content in files.items()})
    for name in ({MODEL, EXPERIMENT, FORMULA, *(f"{each}.png" for each in PICTURES)} if ours else set()) - {*files}:
        (folder / name).unlink(missing_ok=True)
    return [folder / name for name in files]


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        if (folder / WORK).exists():
            print(f"call it again to go on: the fits that are done are kept in {folder / WORK}", file=sys.stderr)
        raise


def _not_over(model: str, folder: Path) -> None:
    if Path(model).resolve() == (folder / MODEL).resolve():
        raise InputError(f"{model}: --out {folder} would write over it; give --out another place")


@dataclass
class _Clock:
    """What is going on, how far it is and how long it will take."""

    say: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic
    title: str = ""
    since: float = 0.0
    first: int = 0
    last: int = 0

    def __call__(self, title: str, done: int, of: int) -> None:
        """`done` of `of` steps of what `title` says; those that were there at its first call took no time now."""
        now = self.clock()
        if title != self.title or done < self.last:
            self.title, self.since, self.first = title, now, done
        self.last = done
        left = (now - self.since) / (done - self.first) * (of - done) if done > self.first else None
        told = f", {left:.0f} s left" if left is not None and done < of else ""
        self.say(f"{title}: {done} of {of}{told}" if of > 1 else title)
