"""Show the structural analysis of a model: tests, fault signatures, isolability, sensors."""

import argparse
import json
import sys
from pathlib import Path
from typing import get_args

from faultline.analysis.model import Model, dump_model, load_model
from faultline.analysis.model.names import without_formulas
from faultline.analysis.progress import Progress
from faultline.analysis.structure.diagnosability import Interpretation
from faultline.analysis.structure.document import document
from faultline.analysis.structure.explain import why
from faultline.analysis.structure.lint import lint
from faultline.analysis.structure.matrix import load_structure
from faultline.analysis.structure.report import report
from faultline.analysis.structure.sensors import add_sensors, check_unknowns, drop_sensors, with_other_sensors
from faultline.analysis.structure.structure import Structure, structure_of
from faultline.analysis.structure.supports import MOST_SETS, Found, find_all
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.writing import write_files

EXAMPLE = """examples:
  faultline structure uds --tests
  faultline structure uds --without y_p_tp y_p_ap --json analysis.json
  faultline structure calibrated.toml --without y_p_tp y_p_ap --model production.toml    (to tune and export)
  faultline structure uds --why fA_t fA_p --causality integral
  faultline structure model.json --figures figures    (a structural model in matrix form: X, F, Z, names)

It exits with 1 where the model has no test, or where --why asks for two faults that cannot be told apart; with 2 where
it is wrong: its units contradict each other, or a name is unknown.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline structure", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, a structural model (.json), or the name of a shipped model")
    parser.add_argument("--sensors", nargs="+", default=[], metavar="UNKNOWN", help="analyse with sensors of these")
    parser.add_argument("--without", nargs="+", default=[], metavar="SIGNAL", help="analyse without these sensors")
    parser.add_argument(
        "--positions", nargs="+", default=[], metavar="UNKNOWN[=COST]", help="where sensors could be placed"
    )
    parser.add_argument(
        "--most", type=_positive, default=MOST_SETS, metavar="N", help="tests and MSO sets to search for (%(default)s)"
    )
    parser.add_argument("--tests", action="store_true", help="also print how every test is computed")
    parser.add_argument("--why", nargs=2, metavar=("FAULT", "OTHER"), help="whether and why they can be told apart")
    parser.add_argument(
        "--causality", choices=get_args(Interpretation), default="integral", help="which --why is about"
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write everything as JSON (-: to standard output, and only that)"
    )
    parser.add_argument(
        "--model", dest="written", type=Path, metavar="FILE", help="write the model without the sensors"
    )
    parser.add_argument("--without-formulas", action="store_true", help="in that file only the names of variables")
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw the pictures into this folder")
    options = parser.parse_args(argv)
    if options.written and options.sensors:
        parser.error(
            "--model: of sensors that are not there yet neither range nor noise is known; leave --sensors away"
        )
    if options.without_formulas and not options.written:
        parser.error("--without-formulas: is about the file of --model; give that too")
    model = _changed(open_model(options.model), options.without, options.sensors)
    if options.why and (options.json or options.figures or options.tests or options.positions):
        parser.error("--why answers one question; leave --json, --figures, --tests and --positions away")
    if options.why:
        fault, other = options.why
        explanation = why(structure_of(model), fault, other, options.causality)
        print(explanation.text)
        return 0 if explanation.isolable else 1
    positions = _positions(options.positions, model)
    name = model.name if isinstance(model, Model) else Path(options.model).stem
    with Progress(f"analysing {name}") as progress:
        found = find_all(model, options.most, progress.say)
        progress.say("isolability")
        text = (
            "" if options.json == "-" else report(model, computations=options.tests, positions=positions, found=found)
        )
        data = json.dumps(document(model, positions, found), indent=1) if options.json else ""
    print(text or data)
    if found.more_tests or found.more_mso:
        print(_cut(found), file=sys.stderr)
    files = _files(options, model, data if text else "")
    pictures = _pictures(model, options.figures, name, found) if options.figures else {}
    write_files(files | pictures)
    if pictures:
        print(f"wrote {len(pictures)} pictures to {options.figures}", file=sys.stderr)
    wrong = [f for f in lint(model, tests=()) if f.severity == "error"] if isinstance(model, Model) else []
    for finding in wrong:
        print(f"faultline structure: error: {options.model}: {finding.place}: {finding.message}", file=sys.stderr)
    return 2 if wrong else 0 if found.tests else 1


def _positive(text: str) -> int:
    """A number from 1 on."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is no whole number from 1 on")
    return int(text)


def _cut(found: Found) -> str:
    """What was left out, how to have it, and what can be had without it."""
    what = " and ".join(name for name, cut in (("tests", found.more_tests), ("MSO sets", found.more_mso)) if cut)
    remedy = "--most N searches for more, --without SIGNAL leaves fewer, --why FAULT OTHER gives a test for two faults"
    return (
        f"faultline structure: only the first {found.most} {what} were searched for; detectability and isolability are "
        f"of all of them; {remedy}"
    )


def _files(options: argparse.Namespace, model: Model | Structure, data: str) -> dict[Path, bytes]:
    """Content of the files of --json and --model."""
    files = {Path(options.json): data.encode() + b"\n"} if data else {}
    if options.written:
        if not isinstance(model, Model):
            raise InputError(f"{options.model}: a structural model has no formulas to write; give a model file")
        kept = without_formulas(model) if options.without_formulas else model
        files[options.written] = dump_model(kept).encode()
    return files


def _pictures(model: Model | Structure, folder: Path, name: str, found: Found) -> dict[Path, bytes]:
    from faultline.analysis.structure.pictures.all import draw_all  # matplotlib takes a second to import

    with Progress("drawing"):
        return {folder / file: content for file, content in draw_all(model, name, found.tests).items()}


def open_model(path: str) -> Model | Structure:
    """The model in a file, a structural one where its name ends in .json, or the shipped model of that name.

    Raises:
        ModelError: there is none, or it is no valid model.
    """
    if not path.endswith(".json"):
        return load_model(path)
    return load_structure(path)


def _changed(model: Model | Structure, without: list[str], sensors: list[str]) -> Model | Structure:
    if not without and not sensors:
        return model
    if isinstance(model, Model):
        return with_other_sensors(model, without, sensors)
    return add_sensors(drop_sensors(model, without), sensors, faulty=True)


def _positions(words: list[str], model: Model | Structure) -> dict[str, float]:
    """Names with their costs, 1 where none is said."""
    if not words:
        return {}
    structure, costs = structure_of(model), {}
    for word in words:
        name, equals, cost = word.partition("=")
        if name in costs:
            raise InputError(f"--positions {word}: {name} comes twice; name it once, with its cost")
        try:
            costs[name] = float(cost) if equals else 1.0
        except ValueError as error:
            raise InputError(f"--positions {word}: {cost!r} is no cost; write it like p_tp=2.5") from error
    check_unknowns(structure, costs)
    return costs
