"""What `system.toml` says of the models beside it."""

from pathlib import Path

import pytest

from faultline.analysis.model import ModelError, dump_model, load_model, parse_model
from faultline.analysis.model.display import units_of

MODEL = """
schema = 1
name = "tank"

[known.y]
unit = "m"
min = 0.0
max = 2.0
noise = 0.01

[unknown.h]
unit = "m"

[[equation]]
name = "e1"
expr = "y - h"
[equation.fault]
name = "f_pipe"
component = "pipe"
description = "clogged"
enters = "h -> h + f_pipe"
sizes = [0.1]
"""
SYSTEM = """
schema = 1
period_s = 2.5

[signal.y]
maximum_age_s = 40.0

[[mode]]
name = "filling"
where = {y = {above = 0.5}}

[[mode]]
name = "rest"
"""


def folder(at: Path, model: str = MODEL, system: str = SYSTEM, file: str = "model.toml") -> Path:
    (at / file).write_text(model)
    (at / "system.toml").write_text(system)
    return at if file == "model.toml" else at / file


def test_a_system_says_period_ages_and_modes_of_its_models(tmp_path: Path) -> None:
    model = load_model(folder(tmp_path))
    assert (model.period_s, model.maximum_age_s("y"), model.modes.names) == (2.5, 40.0, ("edge", "filling", "rest"))
    assert load_model(tmp_path / "model.toml") == model
    assert parse_model(dump_model(model), "written") == model


@pytest.mark.parametrize("own", ["period_s = 1.0\n", '[[mode]]\nname = "always"\n'])
def test_a_model_that_says_it_itself_is_asked_alone(own: str, tmp_path: Path) -> None:
    model = load_model(folder(tmp_path, MODEL.replace("\n[known", f"\n{own}\n[known", 1)))
    assert model.known["y"].maximum_age_s is None
    assert "filling" not in model.modes.names


@pytest.mark.parametrize(
    ("system", "told"),
    [
        ("schema = 2", "system.toml: schema: readable is 1; use the faultline that wrote the file"),
        (
            "schema = 1\nperiods = 1",
            "system.toml: periods: unknown key; allowed here are schema, signal, fault, component, period_s, mode",
        ),
        ("schema = 1\n[signal.x]\nmaximum_age_s = 1.0", "has no known signal x; those are y"),
        ("schema = 1\n[signal.y]\nmaximum_ages = 1.0", "known.y.maximum_ages: unknown key"),
        ("schema = ", "system.toml: not read: Invalid value"),
        (
            'schema = 1\n[display]\nm = "bar"',
            "display.m: bar is no unit for values in m; give one of the same dimension",
        ),
        ('schema = 1\n[display]\nm = ["cm", "ell"]', "display.m: `ell` is no unit"),
        ('schema = 1\n[signal.y]\ndisplay = "s"', "known.y.display: s is no unit for values in m"),
        ("schema = 1\n[display]\nm = 3", "display.m: must be a list, not 3"),
        ("schema = 1\n[fault.f]\nspn = 1\nfmi = 2", "system.toml: fault.f: "),
        ('schema = 1\n[component.tank]\nplace = "roof"', "has no component tank; those are pipe"),
        ("schema = 1\n[fault.f_pipe]\nspn = 1", "fault.fmi: is missing; SPN and FMI are one code"),
    ],
)
def test_what_is_wrong_with_it_is_told_in_a_line(system: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError) as error:
        load_model(folder(tmp_path, system=system))
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_another_model_of_the_folder_may_lack_a_signal(tmp_path: Path) -> None:
    system = SYSTEM + "[signal.x]\nmaximum_age_s = 1.0\n"
    assert load_model(folder(tmp_path, system=system, file="small.toml")).period_s == 2.5


def test_it_says_what_people_read(tmp_path: Path) -> None:
    said = """[signal]
y = { label = "filling", display = ["km", "dm"] }
[display]
m = "cm"
[fault.f_pipe]
spn = 520200
fmi = 7
[component.pipe]
place = "below"
"""
    model = load_model(folder(tmp_path, system="schema = 1\n" + said))
    fault = model.faults["f_pipe"]
    assert (fault.spn, fault.fmi, fault.place) == (520200, 7, "below")
    units = units_of(model)
    assert units.of("m").text(0.5) == "50 cm"
    assert [units.of("m", size, "y").unit for size in (1e4, 1.0)] == ["km", "dm"]
    assert units.of("m", 1.0, "y").text(0.5) == "5.00 dm"  # a digit more than the noise of 1 cm leaves
    assert units.of("K").text(300.0) == "300 K"
    assert parse_model(dump_model(model), "written") == model


@pytest.mark.parametrize(
    ("unit", "at_20", "apart"), [("degC", "20.000 degC", "1.5 degC"), ("degF", "68.00 degF", "2.7 degF")]
)
def test_a_unit_may_have_another_zero(tmp_path: Path, unit: str, at_20: str, apart: str) -> None:
    model = load_model(folder(tmp_path, MODEL.replace('"m"', '"K"'), f'schema = 1\n[signal.y]\ndisplay = "{unit}"'))
    shown = units_of(model).of("K", signal="y")
    assert (shown.text(293.15), shown.difference(1.5)) == (at_20, apart)
