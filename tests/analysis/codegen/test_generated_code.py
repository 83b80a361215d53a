"""Generated Python and C99: equal to the ONNX graph over the golden log, equal to each other, and clean C."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from generated import golden_samples, needs_compiler, python_class, run_c99, run_python

from faultline.analysis.codegen import Program, c99_sources, computation_sequence, python_source, residual_program
from faultline.analysis.graph.bank import Bank, build_bank
from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import parse_model
from faultline.analysis.structure import mso_sets, mtes_sets, structure_of
from faultline.service.core.errors import InputError


@pytest.fixture(scope="module")
def bank() -> Bank:
    return build_bank(load_model("uds"))


@pytest.fixture(scope="module")
def programs(bank: Bank) -> list[Program]:
    return [
        residual_program(
            bank.model, computation_sequence(bank.model, test.equations, test.residual), name=f"uds_{test.name}"
        )
        for test in bank.tests
    ]


def choices(name: str, every: int) -> Iterator[Program]:
    """Programs of a model's residual choices, of every causality; each with a low-pass or without."""
    model = load_model(name)
    structure = structure_of(model)
    found = [(k, equations, e) for k, equations in enumerate(mtes_sets(structure), start=1) for e in equations]
    for k, equations, residual in found[::every]:
        sequence = computation_sequence(model, equations, residual, form="derivative" if k % 2 else "integral")
        yield residual_program(
            model, sequence, name=f"{model.name}_t{k:02d}_{residual}", filter_s=0.0 if k % 3 else 0.5
        )


def test_the_python_code_equals_the_onnx_graph_over_the_golden_log(bank: Bank, programs: list[Program]) -> None:
    signals, z = golden_samples()
    graph = bank.simulate([{}], z, bank.start(z[0]))[:, 0]
    for row, (test, program) in enumerate(zip(bank.tests, programs, strict=True)):
        largest = np.abs(z[:, signals.index(test.predicts)]).max()
        worst = np.abs(run_python(program, signals, z) - graph[:, row]).max()
        assert worst <= 1e-12 * largest, (test.name, worst)


@needs_compiler
def test_the_c_code_equals_the_onnx_graph_over_the_golden_log(
    bank: Bank, programs: list[Program], tmp_path: Path
) -> None:
    signals, z = golden_samples()
    graph = bank.simulate([{}], z, bank.start(z[0]))[:, 0]
    compiled = run_c99(programs, signals, z, tmp_path)
    largest = np.array([np.abs(z[:, signals.index(test.predicts)]).max() for test in bank.tests])
    assert len(bank.tests) == 10
    assert (np.abs(compiled - graph).max(axis=0) <= 1e-12 * largest).all()


@needs_compiler
@pytest.mark.parametrize(("name", "every"), [("uds", 7), ("three-tank", 9), ("rc", 1)])
def test_c_and_python_agree_to_the_last_bit_in_every_causality(name: str, every: int, tmp_path: Path) -> None:
    signals, z = golden_samples()
    if name != "uds":
        signals = tuple(load_model(name).known)
        z = np.random.default_rng(6).uniform(0.2, 1.0, (60, len(signals)))
        z[20, 0] = z[30, 1] = math.nan
        z[40] = 0.0
    programs = list(choices(name, every))
    assert {"derivative", "integral"} <= {program.notes[2].split()[1].rstrip(".") for program in programs}
    compiled = run_c99(programs, signals, z, tmp_path)
    for column, program in enumerate(programs):
        np.testing.assert_array_equal(compiled[:, column], run_python(program, signals, z), program.name)


def test_three_tanks_equal_their_onnx_graph_too() -> None:
    bank = build_bank(load_model("three-tank"))
    signals = tuple(channel.signal for channel in bank.inputs)
    levels = 0.1 + np.abs(np.cumsum(np.random.default_rng(7).normal(0.0, 0.01, (300, 4)), axis=0))
    graph = bank.simulate([{}], levels, bank.start(levels[0]))[:, 0]
    for row, test in enumerate(bank.tests):
        sequence = computation_sequence(bank.model, test.equations, test.residual)
        r = run_python(residual_program(bank.model, sequence, name=test.name), signals, levels)
        np.testing.assert_allclose(r, graph[:, row], rtol=0, atol=1e-12 * levels.max())


def test_a_lost_sample_costs_its_residual_and_no_more_than_the_start_anew(bank: Bank, programs: list[Program]) -> None:
    signals, z = golden_samples()
    broken = z[:200].copy()
    broken[100, signals.index("y_p_ap")] = math.nan
    [t02] = [program for program in programs if program.name == "uds_t02"]
    r = run_python(t02, signals, broken)
    assert np.flatnonzero(np.isnan(r)).tolist() == [100]
    assert abs(r[150] - run_python(t02, signals, z[:200])[150]) < 1e-3  # Pa


def test_every_line_names_its_equation(programs: list[Program]) -> None:
    [t02] = [program for program in programs if program.name == "uds_t02"]
    for text in (python_source(t02), *c99_sources(t02).values()):
        assert "Residual equation: e16" in text
    noted = {line.note.split(":")[0] for line in t02.lines}
    assert {"e03", "e04", "e07"} <= noted


HOSTILE = """
schema = 1
name = "hostile"
description = "names that mean something in C or in Python, and a comment that ends */ in the middle ??/"
source = "made up"
[known.int]
unit = "1"
description = "*/ int main(void) { return 1; } /* \\"\\"\\" \\\\ "
min = -1.0
max = 1.0
noise = 0.1
[known.u]
unit = "1"
description = "as the argument of step"
min = -1.0
max = 1.0
noise = 0.1
[unknown.double]
unit = "1"
description = "a keyword"
initial = ["int"]
[unknown.ddouble]
unit = "1/s"
[unknown.step]
unit = "1"
description = "as the method"
[unknown.y0]
unit = "1"
description = "a Bessel function"
[parameter.NAN]
unit = "1"
description = "a macro"
value = 2.0
source = "made up"
[parameter.divide]
unit = "1/s"
description = "a helper"
value = 3.0
source = "made up"
[[equation]]
name = "e1"
description = "*/ ??/"
expr = "ddouble - divide*(step - double)"
[[equation]]
name = "e2"
expr = "step - NAN*y0/u"
[[equation]]
name = "e3"
expr = "y0 - u**3"
[[equation]]
name = "e4"
expr = "int - double"
[[differential]]
name = "e5"
state = "double"
derivative = "ddouble"
"""


@pytest.fixture
def hostile() -> Model:
    return parse_model(HOSTILE, "hostile.toml")


@needs_compiler
def test_names_that_are_words_of_a_language_do_no_harm(hostile: Model, tmp_path: Path) -> None:
    [equations] = mso_sets(structure_of(hostile))
    z = np.random.default_rng(8).uniform(-1.0, 1.0, (50, 2))
    z[10, 1] = 0.0  # a division by zero: no exception, and the same in both
    programs = [
        residual_program(hostile, computation_sequence(hostile, equations, e), name=f"hostile_{e}")
        for e in ("e1", "e2", "e4")
    ]
    compiled = run_c99(programs, ("int", "u"), z, tmp_path)
    for column, program in enumerate(programs):
        np.testing.assert_array_equal(compiled[:, column], run_python(program, ("int", "u"), z))
        assert np.isfinite(compiled[20:, column]).all()
    assert python_class(programs[0]).INPUTS == ("int", "u")


@needs_compiler
def test_a_program_may_have_the_name_of_a_parameter(tmp_path: Path) -> None:
    """The class of `c` is `C`, as the capacity of the circuit is."""
    model = load_model("rc")
    [equations] = mso_sets(structure_of(model))
    program = residual_program(model, computation_sequence(model, equations, "e3"), name="c")
    z = np.array([[5.0, 0.01], [5.0, 0.02]])
    r = run_python(program, ("u", "y_i"), z)
    np.testing.assert_array_equal(run_c99([program], ("u", "y_i"), z, tmp_path)[:, 0], r)
    assert r[0] == pytest.approx(0.01)  # it starts with the capacitor at the source's voltage


def test_what_cannot_be_generated_is_refused_with_the_reason(hostile: Model) -> None:
    [equations] = mso_sets(structure_of(hostile))
    sequence = computation_sequence(hostile, equations, "e4")
    with pytest.raises(InputError, match="is no identifier"):
        residual_program(hostile, sequence, name="double")
    with pytest.raises(InputError, match="give a positive period"):
        residual_program(hostile, sequence, name="fine", period=0.0)
