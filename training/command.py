"""Train grey-box RNN residual generators on fault-free recordings."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from faultline.analysis.graph.bank import inputs_of
from faultline.analysis.graph.networks import Networks, files_of
from faultline.analysis.model import Model
from faultline.analysis.structure.lint import sound_model
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Generator
from faultline.training.adaptation import trained_anew
from faultline.training.bank import HELD, networks_of
from faultline.training.checkpoint import drop_checkpoint, key_of, load_checkpoint, save_checkpoint
from faultline.training.device import device_of
from faultline.training.excitation import Unexcited, unexcited
from faultline.training.layout import Layout, layout_of
from faultline.training.loop import Training
from faultline.training.picture import picture
from faultline.training.progress import Progress
from faultline.training.recipe import RECIPES, Recipe
from faultline.training.samples import load_samples
from faultline.training.saved import FILE as WEIGHTS
from faultline.training.saved import load_weights, weights_of
from faultline.writing import check_folder, write_files

EXAMPLE = """example:
  faultline train uds logs/bench-training-s1 --out networks

then give `--networks networks` to `faultline tune` and `faultline export`.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline train", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "model",
        help="a model file, with formulas or of names only, a structural model (.json), or a shipped model's name",
    )
    parser.add_argument("recording", type=Path, nargs="+", help="instrumented and fault-free")
    parser.add_argument("--recipe", choices=[*RECIPES], help="how to train (default: default)")
    parser.add_argument("--members", type=int, help="networks of an ensemble (default: the recipe's)")
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="only these (default: all that can be networks)")
    parser.add_argument("--epochs", type=int, help="iterations of the last phase (default: the recipe's)")
    parser.add_argument("--seed", type=int, default=0, help="of weights and windows (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("networks"), help="folder to write (default: %(default)s)")
    parser.add_argument(
        "--from",
        type=Path,
        metavar="DIR",
        dest="begin",
        help="adapt these networks to a short recording",
    )
    parser.add_argument("--resume", action="store_true", help="go on where an interrupted call with the same --out was")
    parser.add_argument("--device", choices=["cpu", "cuda"], help="default: CUDA when there is one")
    parser.add_argument("--json", action="store_true", help="print the description as JSON")
    options = parser.parse_args(argv)
    for name, value in (("members", options.members), ("epochs", options.epochs), ("recipe", options.recipe)):
        if isinstance(value, int) and value < 1:
            raise InputError(f"--{name} {value}: at least 1")
        if value is not None and options.begin:
            raise InputError(f"--{name}: networks that are adapted have their own; leave it out")
    check_folder(options.out)
    model = sound_model(options.model, formulas=False)
    networks = _trained(options, model)
    described = msgspec.json.encode(networks.description).decode()
    print(described if options.json else _table(networks, model, options.out))
    return 0


def _trained(options: argparse.Namespace, model: Model) -> Networks:
    device = device_of(options.device)
    layout = layout_of(model, options.tests)
    begin = load_weights(options.begin, layout) if options.begin else None
    recipe = begin.adapting() if begin else _recipe(options)
    with Progress(f"training {model.name}") as progress:
        samples = load_samples(model, inputs_of(model), options.recording, progress.note)
        if begin:  # what they have seen before is no evidence either
            samples = replace(samples, digests=tuple(dict.fromkeys([*begin.recordings, *samples.digests])))
        training = Training(layout, samples, recipe, options.seed, begin, device)
        key = key_of(layout, samples, recipe, options.seed, begin)
        if options.resume and load_checkpoint(options.out, key, training):
            progress.note(f"goes on after {training.done} of {training.iterations} iterations")
        elif options.resume:
            progress.note(f"{options.out}: no checkpoint there; begins anew")
        training.run(progress.tell, lambda: save_checkpoint(options.out, key, training))
        if begin:
            anew = trained_anew(training, layout, samples, begin, options.seed, progress.tell, device)
            progress.note(
                "adapted, but for what was trained anew as it errs less or hardly more: " + (", ".join(anew) or "none")
            )
        if training.stopped:
            progress.note(
                f"stopped after {training.done} of {training.iterations} iterations: {training.stopped}; "
                "the best weights until then are kept"
            )
        networks = networks_of(training, samples, options.seed)
        if model.without_formula:  # else equations have said what a loop hides
            for line in _lacking(unexcited(layout, samples, networks), layout):
                progress.note(line)
    files = {WEIGHTS: weights_of(training, networks.description), "training.png": picture(training)}
    files |= files_of(networks)
    write_files({options.out / name: content for name, content in files.items()})
    drop_checkpoint(options.out)
    return networks


def _lacking(found: Sequence[Unexcited], layout: Layout) -> list[str]:
    """Lines on what the recordings do not excite, and which would."""
    predicts = {test.name: test.predicts for test in layout.tests}
    lines = []
    for signal in dict.fromkeys(each.signal for each in found):
        of_signal = [each for each in found if each.signal == signal]
        tests = ", ".join(f"{each.test} ({each.times:.1f})" for each in of_signal)
        outputs = " and ".join(dict.fromkeys(predicts[each.test] for each in of_signal))
        lines.append(
            f"{signal} never moves alone: what it does to {outputs} by itself is not seen, and under another "
            f"controller these err: {tests} (times as unsure there)"
        )
    if lines:
        lines.append(
            "record with set points that move at random, as the inputs do (`faultline rig record --cycle excite`), or "
            "the same cycle under a second controller"
        )
    return lines


def _recipe(options: argparse.Namespace) -> Recipe:
    recipe = RECIPES[options.recipe or "default"]
    recipe = replace(recipe, members=options.members) if options.members else recipe
    if options.epochs:
        recipe = replace(recipe, phases=(*recipe.phases[:-1], replace(recipe.phases[-1], iterations=options.epochs)))
    return recipe


def _states(generator: Generator) -> int:
    """Those of the members: what all of them hold of the tick before is none."""
    return sum(not state.name.endswith(HELD) for state in generator.states)


def _table(networks: Networks, model: Model, out: Path) -> str:
    d = networks.description
    where = "where it was held out" if RECIPES[d.recipe].folds else "where it was trained"
    wide = max(len("predicts"), *(len(g.predicts) for g in d.generators)) + 2
    lines = [f"{'generator':<12}{'predicts':<{wide}}{'states':>7}   free run, RMS error {where}"]
    for g, error in zip(d.generators, d.error, strict=True):
        unit = model.known[g.predicts].unit
        lines.append(f"{g.name:<12}{g.predicts:<{wide}}{_states(g) // d.members:>7}   {error:.4g} {unit}".rstrip())
    size = len(networks.graph) / 1024
    lines.append(f"wrote {out}: {len(d.generators)} generators of {d.members} members, {size:.0f} KiB")
    return "\n".join(lines)
