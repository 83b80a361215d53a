"""Write residual generators of a model as code to read: Python and C99."""

import argparse
from pathlib import Path

from analysis.codegen.build import residual_program
from analysis.codegen.c99 import c99_sources
from analysis.codegen.python import python_source
from analysis.codegen.sequence import ComputationSequence, computation_sequence
from analysis.model import Model, load_model
from analysis.structure import Test, find_tests
from service.core.errors import InputError

PERIOD_S = 0.2

EXAMPLE = """examples:
  faultline code uds4 --out code                                     (every test that can be run)
  faultline code uds4 --test t01 --residual e16 --filter 2 --out code   (one residual of any causality)
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline code", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, or the name of a shipped model")
    parser.add_argument("--out", type=Path, required=True, help="the folder to write into")
    parser.add_argument("--test", help="only this test, such as t02")
    parser.add_argument("--residual", help="with --test: this equation of it is the residual, whatever its causality")
    parser.add_argument(
        "--form",
        choices=["integral", "derivative"],
        default="integral",
        help="how a differential constraint is used that is itself the residual",
    )
    parser.add_argument("--period", type=float, default=PERIOD_S, metavar="S", help="sampling period (default: 0.2)")
    parser.add_argument(
        "--filter", type=float, default=0.0, metavar="S", help="time constant for derivatives of signals"
    )
    options = parser.parse_args(argv)
    if not 0 < options.period < float("inf") or not 0 <= options.filter < float("inf"):
        parser.error("--period must be a number above zero, --filter zero or more")
    if options.residual and not options.test:
        parser.error("--residual needs --test")
    model = load_model(options.model)
    chosen = _chosen(model, options.test, options.residual, options.form)
    written = {}
    for name, sequence in chosen.items():
        program = residual_program(model, sequence, name=name, period=options.period, filter_s=options.filter)
        written[name] = {f"{name}.py": python_source(program), **c99_sources(program)}
    options.out.mkdir(parents=True, exist_ok=True)  # all could be made: nothing is left half written
    for name, files in written.items():
        for file, text in files.items():
            (options.out / file).write_text(text)
        print(f"wrote {', '.join(files)}: residual {chosen[name].residual}, {chosen[name].causality} causality")
    return 0


def _chosen(model: Model, test: str | None, residual: str | None, form: str) -> dict[str, ComputationSequence]:
    """The computation sequences to write, by the names of their files."""
    found = {support.name: support for support in find_tests(model)}
    runnable = {name: support for name, support in found.items() if isinstance(support, Test)}
    if test is None:
        if not runnable:
            raise InputError(f"{model.name}: no test can be run; choose one with --test and --residual")
        return {name: computation_sequence(model, s.equations, s.residual) for name, s in runnable.items()}
    if test not in found:
        raise InputError(f"{model.name}: no test {test}; those are {', '.join(found) or 'none'}")
    if residual is None and test not in runnable:
        raise InputError(f"{model.name}: {test} cannot be run: {found[test].obstacle}; name another with --residual")
    equation = residual or runnable[test].residual
    sequence = computation_sequence(
        model, found[test].equations, equation, form="derivative" if form == "derivative" else "integral"
    )
    return {f"{test}_{equation}" if residual else test: sequence}
