"""Model files: what is read, and one clear line for everything that is wrong with one."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import sympy as sp

from faultline.analysis.model import ModelError, dump_model, load_model, parse_model

GOOD = """
schema = 1
name = "tank"
warm_up_s = 30

[known.y]
unit = "m"
min = 0.0
max = 2
noise = 0.01

[unknown.h]
unit = "m"
initial = ["2*y + h0", "h0"]

[unknown.dh]
unit = "m/s"

[parameter.k]
unit = "1/s"
value = 0.5
min = 0.1
max = 1.0
prior = 0.3

[parameter.h0]
unit = "m"
value = 1

[[mode]]
name = "low"
where = {y = {below = 0.5}}

[[mode]]
name = "usual"

[[mode]]
name = "high"
description = "almost full"
instruction = "open the inlet"
where = {y = {above = 1.5, below = 2.0}}

[edges]
settle_s = 4.0
steps = {y = 0.25}

[[equation]]
name = "e1"
expr = "dh + k*h"
fault = {name = "fk", component = "valve", enters = "k -> k*(1 + fk)", sizes = [-0.5], relative_to = "k"}

[[equation]]
name = "e3"
expr = "y - h"
fault = {name = "fy", component = "sensor", enters = "h -> h + fy", sizes = [-0.1, 0.1]}

[[differential]]
name = "e2"
state = "h"
derivative = "dh"

[[provenance]]
command = "calibrate"
recordings = ["abc"]
"""


def test_a_file_becomes_a_model() -> None:
    model = parse_model(GOOD, "tank.toml")
    h, k, fk, y = sp.symbols("h k fk y")
    assert (model.name, model.description, model.source) == ("tank", "", "")
    assert (model.known["y"].max, model.parameters["h0"].min, model.parameters["h0"].prior) == (2.0, None, None)
    assert model.unknown["h"].initial == (2 * y + sp.Symbol("h0"), sp.Symbol("h0"))
    assert model.expression("e1", with_fault=False) == sp.Symbol("dh") + k * h
    assert model.expression("e1", with_fault=True) == sp.Symbol("dh") + k * (1 + fk) * h
    assert list(model.faults) == ["fk", "fy"]
    assert [model.faults["fk"].absolute(s, model) for s in model.faults["fk"].sizes] == [-0.25]
    assert model.faults["fy"].absolute(0.1, model) == 0.1
    assert model.warm_up_s == 30.0
    low, usual, high = model.modes.steady
    assert (low.where, usual.where, high.where) == ({"y": (None, 0.5)}, {}, {"y": (1.5, 2.0)})
    assert (high.description, high.instruction) == ("almost full", "open the inlet")
    assert (model.modes.names, model.modes.rest) == (("edge", "low", "usual", "high"), usual)
    assert (model.modes.edges, model.modes.settle_s) == ({"y": 0.25}, 4.0)
    assert (model.period_s, model.maximum_age_s("y")) == (0.3, 1.5)
    assert model.provenance == ({"command": "calibrate", "recordings": ["abc"]},)


@pytest.mark.parametrize(
    "gone", ["", "below = 0.5", "above = 1.5, ", "[edges]\nsettle_s = 4.0\nsteps = {y = 0.25}\n", "warm_up_s = 30\n"]
)
def test_modes_and_warm_up_are_optional_and_survive_being_written(gone: str) -> None:
    text = GOOD.replace(gone, "above = 0.1" if gone == "below = 0.5" else "")
    model = parse_model(text, "m")
    assert parse_model(dump_model(model), "m") == model
    bare = parse_model(GOOD.replace(GOOD[GOOD.index("[[mode]]") : GOOD.index("[[equation]]")], ""), "m")
    assert bare.modes.names == ("edge", "operation")
    assert not bare.modes.edges
    assert parse_model(dump_model(bare), "m") == bare
    assert parse_model(GOOD.replace("warm_up_s = 30\n", ""), "m").warm_up_s == 20.0


def test_a_disturbance_enters_like_a_fault_and_is_none() -> None:
    written = 'disturbance = {name = "q", description = "leak", enters = "dh -> dh + q", sizes = [0.1]}\n'
    text = GOOD.replace('name = "e1"\n', 'name = "e1"\n' + written, 1)
    model = parse_model(text, "m")
    q, dh, k, h, fk = sp.symbols("q dh k h fk")
    assert ([*model.faults], [*model.disturbances], [*model.assumable]) == (["fk", "fy"], ["q"], ["fk", "fy", "q"])
    assert sp.expand(model.expression("e1", with_fault=True) - (dh + q + k * (1 + fk) * h)) == 0
    assert model.expression("e1", with_fault=False) == dh + k * h
    assert parse_model(dump_model(model), "m") == model
    for old, new, told in (
        ("dh -> dh + q", "k -> k + q", "m: equation[0].disturbance.enters: k is what its fault replaces"),
        (written, written.replace('"q"', '"fk"').replace("dh + q", "dh + fk"), "m: fault fk is in two equations"),
        ("dh -> dh + q", "y -> y + q", "m: equation[0].disturbance.enters: y is not in"),
    ):
        with pytest.raises(ModelError, match=re.escape(told)):
            parse_model(text.replace(old, new), "m")


def test_the_file_s_order_is_kept() -> None:
    model = parse_model(GOOD, "tank.toml")
    assert list(model.parameters) == ["k", "h0"]
    assert list(model.equations) == ["e1", "e3"]


def change(old: str, new: str) -> Callable[[str], str]:
    def changed(text: str) -> str:
        assert old in text
        return text.replace(old, new, 1)

    return changed


def add(text: str) -> Callable[[str], str]:
    return lambda before: before + text


WRONG = [
    ("not toml", change("schema = 1", "schema = "), "m.toml: not TOML: "),
    ("schema missing", change("schema = 1\n", ""), "m.toml: schema: is missing; give a number"),
    ("schema newer", change("schema = 1", "schema = 2"), "m.toml: schema: this is 2, readable is 1; use the faultline"),
    ("name missing", change('name = "tank"\n', ""), "m.toml: name: is missing; give a string"),
    (
        "unknown key on top",
        change("schema = 1", "schema = 1\nspeed = 3"),
        "m.toml: speed: unknown key; allowed here are schema, ",
    ),
    (
        "unknown key in a signal",
        change("noise = 0.01", "noise = 0.01\nnosie = 1"),
        "m.toml: known.y.nosie: unknown key; allowed here are unit, description, min, max, noise, zero, drift",
    ),
    (
        "unknown key in a fault",
        change("sizes = [-0.5]", "sizes = [-0.5], color = 1"),
        "m.toml: equation[0].fault.color: unknown key; ",
    ),
    (
        "unknown key in an unknown",
        change('unit = "m/s"', 'unit = "m/s"\nvalue = 1'),
        "m.toml: unknown.dh.value: unknown",
    ),
    ("unknown key in a parameter", change("prior = 0.3", "sd = 0.3"), "m.toml: parameter.k.sd: unknown key; "),
    ("unknown key in an equation", change('name = "e1"', 'name = "e1"\nx = 1'), "m.toml: equation[0].x: unknown key; "),
    (
        "unknown key in a differential",
        change('state = "h"', 'state = "h"\nx = 1'),
        "m.toml: differential[0].x: unknown key; allowed here are name, state, derivative",
    ),
    ("unit missing", change('unit = "m"\nmin', "min"), "m.toml: known.y.unit: is missing; give a string"),
    ("text for a number", change("noise = 0.01", 'noise = "0.01"'), "m.toml: known.y.noise: must be a finite number"),
    ("truth for a number", change("noise = 0.01", "noise = true"), "m.toml: known.y.noise: must be a finite number"),
    ("no number", change("noise = 0.01", "noise = nan"), "m.toml: known.y.noise: must be a finite number, not nan"),
    ("huge whole number", change("max = 2", "max = 1" + "0" * 400), "m.toml: known.y.max: must be a finite number"),
    ("number for a text", change('unit = "m"', "unit = 1"), "m.toml: known.y.unit: must be a string, not 1"),
    ("list of numbers for texts", change('"h0"]', "3]"), "m.toml: unknown.h.initial[1]: must be a string, not 3"),
    ("value for a table", change("schema = 1", "schema = 1\nknown = 3"), "m.toml: not TOML: "),
    ("signal that is no table", change("[known.y]", "[known]\nx = 3\n[known.y]"), "m.toml: known.x: must be a table"),
    ("size no number", change("[-0.5]", '["-0.5"]'), "m.toml: equation[0].fault.sizes[0]: must be a finite number"),
    ("empty range", change("max = 2", "max = 0"), "m.toml: known.y.max: the operating range [0, 0] is empty"),
    ("no noise", change("noise = 0.01", "noise = 0"), "m.toml: known.y.noise: must be positive"),
    ("value out of bounds", change("value = 0.5", "value = 5"), "m.toml: parameter.k: value 5 is outside [0.1, 1] 1/s"),
    ("prior without a sign", change("prior = 0.3", "prior = 0"), "m.toml: parameter.k: a prior is the spread of"),
    (
        "prior of a negative",
        change("value = 1", "value = -1\nprior = 1"),
        "m.toml: parameter.h0: a prior is the spread",
    ),
    ("name twice in a section", add('[unknown.h]\nunit = "m"\n'), "m.toml: not TOML: "),
    (
        "name in two sections",
        add('[parameter.y]\nunit = "m"\nvalue = 1\n'),
        "m.toml: y is declared twice among known, unknown, parameter and curve; rename one",
    ),
    ("no name", change("[unknown.dh]", '[unknown."d h"]'), "m.toml: 'd h': is no name; use letters"),
    ("keyword as a name", change("[parameter.h0]", "[parameter.lambda]"), "m.toml: 'lambda': is no name; "),
    ("function as a name", change("[parameter.h0]", "[parameter.abs]"), "m.toml: 'abs': is no name; "),
    (
        "equation name twice",
        change('name = "e3"', 'name = "e1"'),
        "m.toml: two equations or differentials are named e1",
    ),
    ("equation named as differential", change('name = "e3"', 'name = "e2"'), "m.toml: two equations or differentials"),
    (
        "undefined name",
        change("dh + k*h", "dh + k*h_x"),
        "m.toml: equation[0].expr: unknown name 'h_x'; known names are y, h, dh, k, h0",
    ),
    ("unused unknown", add('[unknown.q]\nunit = "m"\n'), "m.toml: unknown.q: is in no equation; use it or remove it"),
    (
        "fault in two equations",
        change('"fy", component = "sensor", enters = "h -> h + fy"', '"fk", component = "s", enters = "h -> h + fk"'),
        "m.toml: fault fk is in two equations; let it define",
    ),
    ("fault named as declared", change('name = "fy"', 'name = "h"'), "m.toml: equation[1].fault.name: h is declared"),
    ("fault with no name", change('name = "fy"', 'name = "f y"'), "m.toml: equation[1].fault.name: 'f y': is no name"),
    ("component missing", change('component = "valve", ', ""), "m.toml: equation[0].fault.component: is missing"),
    ("enters without arrow", change("k -> k*(1 + fk)", "k*(1 + fk)"), "m.toml: equation[0].fault.enters: `k*(1 + fk)`"),
    (
        "enters an expression",
        change("k -> k*", "2*k -> k*"),
        "m.toml: equation[0].fault.enters: `2*k -> k*(1 + fk)` must",
    ),
    (
        "enters another equation",
        change("h -> h + fy", "k -> k + fy"),
        "m.toml: equation[1].fault.enters: k is not in `y - h`; a fault must change its equation",
    ),
    ("enters nothing", change("h -> h + fy", "h -> h"), "m.toml: equation[1].fault.enters: fy is not on the right"),
    (
        "a zero fault changes",
        change("h -> h + fy", "h -> 2*h + fy"),
        "m.toml: equation[1].fault.enters: `h -> 2*h + fy` must leave h as it is where fy = 0",
    ),
    ("no sizes", change("[-0.1, 0.1]", "[]"), "m.toml: equation[1].fault.sizes: give at least one size"),
    ("size zero", change("[-0.1, 0.1]", "[0.0]"), "m.toml: equation[1].fault.sizes: give at least one size, none"),
    (
        "shares of no parameter",
        change('relative_to = "k"', 'relative_to = "k", share_of = "y", shares = [-0.5]'),
        "m.toml: equation[0].fault.share_of: y is no parameter; name one that is",
    ),
    (
        "shares of nothing",
        change('relative_to = "k"', 'relative_to = "k", shares = [-0.5]'),
        "m.toml: equation[0].fault.share_of: names the parameter of which `shares` are lost: give both, or none",
    ),
    (
        "more than all is lost",
        change('relative_to = "k"', 'relative_to = "k", share_of = "k", shares = [-1.5]'),
        "m.toml: equation[0].fault.shares: are fractions by which a parameter changes, none of them zero, all above -1",
    ),
    (
        "a consequence of no fault",
        change('relative_to = "k"', 'relative_to = "k", consequence = {fault = "fX", where = {y = {above = 1.0}}}'),
        "m.toml: equation[0].fault.consequence.fault: fX is no other fault; those are fy",
    ),
    (
        "a consequence of two sizes",
        change('relative_to = "k"', 'relative_to = "k", consequence = {fault = "fy", where = {y = {above = 1.0}}}'),
        "m.toml: equation[0].fault.consequence: goes with three sizes or more, all of one sign",
    ),
    (
        "a consequence of one size",
        change(
            'relative_to = "k"',
            'relative_to = "k", consequence = {fault = "fy", where = {y = {above = 1.0}}, sizes = [-0.5]}',
        ),
        "m.toml: equation[0].fault.consequence.sizes: are the two or more largest of the fault's sizes, all of one ",
    ),
    (
        "a consequence everywhere",
        change('relative_to = "k"', 'relative_to = "k", consequence = {fault = "fy"}'),
        "m.toml: equation[0].fault.consequence.where: is missing; say at which signals the consequence shows",
    ),
    (
        "a consequence where nobody knows",
        change('relative_to = "k"', 'relative_to = "k", consequence = {fault = "fy", where = {h = {above = 1.0}}}'),
        "m.toml: equation[0].fault.consequence.where.h: h is no known signal; those are ",
    ),
    (
        "sizes of no parameter",
        change('relative_to = "k"', 'relative_to = "y"'),
        "m.toml: equation[0].fault.relative_to: y is no parameter; leave it away for sizes in SI units",
    ),
    (
        "derivative without a constraint",
        change('[[differential]]\nname = "e2"\nstate = "h"\nderivative = "dh"\n', ""),
        "m.toml: unknown.dh: no [[differential]] makes it the derivative of h; add one",
    ),
    (
        "state undefined",
        change('state = "h"', 'state = "x"'),
        "m.toml: differential[0].state: x is no unknown; declare",
    ),
    (
        "derivative known",
        change('derivative = "dh"', 'derivative = "y"'),
        "m.toml: differential[0].derivative: y is no",
    ),
    ("its own derivative", change('derivative = "dh"', 'derivative = "h"'), "m.toml: h is in two differentials"),
    (
        "state without start",
        change('initial = ["2*y + h0", "h0"]', ""),
        "m.toml: unknown.h.initial: is missing; a state",
    ),
    (
        "start of no state",
        change('unit = "m/s"', 'unit = "m/s"\ninitial = ["y"]'),
        "m.toml: unknown.dh.initial: only a state starts somewhere; dh is none",
    ),
    (
        "start from an unknown",
        change('"h0"]', '"dh"]'),
        "m.toml: unknown.h.initial[1]: unknown name 'dh'; known names are y, k, h0",
    ),
    ("start not affine", change('"h0"]', '"y**2"]'), "m.toml: unknown.h.initial[1]: `y**2` is not affine in known"),
    (
        "start with a bend",
        change('"h0"]', '"abs(y)"]'),
        "m.toml: unknown.h.initial[1]: `abs(y)` is not affine in known",
    ),
    ("drift negative", change("noise = 0.01", "noise = 0.01\ndrift = -1"), "m.toml: known.y.drift: -1 is no standard"),
    ("added is a number", change("noise = 0.01", "noise = 0.01\nadded = 1"), "m.toml: known.y.added: must be true or"),
    (
        "drift of nothing",
        change('unit = "m"\nvalue = 1\n', 'unit = "m"\nvalue = 0\ndrift = 0.1\n'),
        "m.toml: parameter.h0.drift: is in parts of the value, and that is zero; give",
    ),
    ("warm-up no time", change("warm_up_s = 30", "warm_up_s = -1"), "m.toml: warm_up_s: -1 s is no time; give zero"),
    (
        "mode signal unknown",
        change("{y = {below", "{h = {below"),
        "m.toml: mode[0].where.h: h is no known signal; those",
    ),
    ("mode bounds crossed", change("below = 2.0", "below = 1.0"), "m.toml: mode[2].where.y.below: 1 is not above 1.5"),
    (
        "mode without bounds",
        change("{below = 0.5}", "{}"),
        "m.toml: mode[0].where.y.below: give `above`, `below` or both",
    ),
    ("mode twice", change('"low"', '"high"'), "m.toml: mode: two modes are named high; rename one (edge is the time"),
    ("mode called edge", change('"low"', '"edge"'), "m.toml: mode: two modes are named edge; rename one"),
    (
        "mode for the rest twice",
        change("where = {y = {below = 0.5}}", ""),
        "m.toml: mode: give exactly one mode without",
    ),
    (
        "mode for the rest missing",
        change('name = "usual"', 'name = "usual"\nwhere = {y = {below = 3.0}}'),
        "m.toml: mode: give exactly one mode without `where`: it holds where no other does",
    ),
    (
        "unknown key in a mode",
        change("instruction", "instructions"),
        "m.toml: mode[2].instructions: unknown key; allowed",
    ),
    ("edge of no signal", change("{y = 0.25}", "{h = 1}"), "m.toml: edges.steps.h: is no known signal; those are y"),
    ("edge no number", change("{y = 0.25}", "{y = '1'}"), "m.toml: edges.steps.y: must be a finite number"),
    ("edge no step", change("{y = 0.25}", "{y = 0}"), "m.toml: edges.steps.y: a step of 0 is none; give"),
    (
        "edges that never settle",
        change("settle_s = 4.0", "settle_s = 0"),
        "m.toml: edges.settle_s: steps and a positive",
    ),
    ("settling without edges", change("steps = {y = 0.25}", ""), "m.toml: edges.settle_s: steps and a positive settle"),
    ("unknown key in edges", change("steps =", "step ="), "m.toml: edges.step: unknown key; allowed here "),
    (
        "period too short",
        change("warm_up_s = 30", "period_s = 1e-4"),
        "m.toml: period_s: 0.0001 s; give 0.001 s to 60 s",
    ),
    (
        "age no age",
        change("noise = 0.01", "noise = 0.01\nmaximum_age_s = 0"),
        "m.toml: known.y.maximum_age_s: 0 s; give",
    ),
    ("start over a signal", change('"h0"]', '"1/y"]'), "m.toml: unknown.h.initial[1]: `1/y` is not affine in known"),
]


@pytest.mark.parametrize(("wrong", "message"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG])
def test_a_wrong_file_says_what_is_wrong_where(wrong: Callable[[str], str], message: str) -> None:
    with pytest.raises(ModelError) as error:
        parse_model(wrong(GOOD), "m.toml")
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def test_a_model_needs_an_equation() -> None:
    with pytest.raises(ModelError, match=r"^m: equation: there is none"):
        parse_model('schema = 1\nname = "empty"', "m")


def test_a_file_is_found_by_path_and_a_shipped_model_by_name(tmp_path: Path) -> None:
    path = tmp_path / "tank.toml"
    path.write_text(GOOD)
    assert load_model(path) == load_model(str(path)) == parse_model(GOOD, "tank")
    assert load_model("uds").name == "uds"


def test_a_message_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "tank.toml"
    path.write_text("schema = 7")
    with pytest.raises(ModelError, match="schema: this is 7") as error:
        load_model(path)
    assert str(error.value).startswith(f"{path}: ")


def test_what_is_no_text_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "tank.toml"
    path.write_bytes(b"schema = 1\n\xff")
    with pytest.raises(ModelError, match=r"not a text file in UTF-8 \(byte 11\)"):
        load_model(path)
    with pytest.raises(ModelError, match="cannot be read; give a model file"):
        load_model(tmp_path)
    with pytest.raises(ModelError, match="cannot be read"):
        load_model("../model/uds")
