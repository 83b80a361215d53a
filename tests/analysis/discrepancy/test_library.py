"""The library's file: what ships, what a user's file adds, and what is refused with file, entry, place and remedy."""

import re
from pathlib import Path

import pytest

from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.model import ModelError
from faultline.analysis.model.file import SYSTEMS

UDS = SYSTEMS / "uds"
CREEPING_HOSE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "creeping_hose.toml"

MINE = """schema = 1
[[effect]]
name = "mine"
statement = "the hose swells"
component = "hose"
source = "seen"
signature = "always"
rivals = ["stiff_hose"]
separated_by = ["steady_hold"]
[effect.roles]
B = ["B_ap", "B_du"]
dp = ["dp_ap", "dp_du"]
[effect.parameter.g]
unit = "1"
description = "by how much"
null = 0.0
spread = 0.1
min = 0.0
[effect.parameter.T]
unit = "s"
description = "how late"
value = 5.0
prior = 0.5
[effect.unknown.x]
unit = "1"
initial = ["0"]
[effect.unknown.dx]
unit = "1/s"
[[effect.change]]
where = ["dp", "B"]
replace = "B -> B*(1 + g*x)"
[[effect.equation]]
name = "swells"
expr = "T*dx - (1 - x)"
[[effect.differential]]
name = "d"
state = "x"
derivative = "dx"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text)
    return path


def test_the_shipped_entries_say_what_a_mechanic_understands_and_what_tells_them_apart() -> None:
    library = load_library(UDS)
    assert len(library) >= 28
    for effect in library.values():
        assert all((effect.statement, effect.component, effect.source, effect.signature)), effect.name
        assert effect.rivals, effect.name
        assert effect.separated_by, effect.name
        assert set(effect.separated_by) <= {*load_experiments(UDS).texts}, effect.name
        assert all(effect.name in library[rival].rivals for rival in effect.rivals), effect.name


def test_every_strength_has_a_size_and_two_physical_bounds() -> None:
    for effect in load_library(UDS).values():
        for name, p in effect.strengths.items():
            assert name.startswith(f"{effect.name}_")
            assert p.min is not None, name
            assert p.max is not None, name
            assert p.null == p.value == 0.0, name
            assert p.min <= p.null < p.null + (p.spread or 0.0) <= p.max, name


def test_every_experiment_separates_something() -> None:
    assert {e for effect in load_library(UDS).values() for e in effect.separated_by} == {*load_experiments(UDS).texts}


def test_a_users_file_adds_to_what_ships(tmp_path: Path) -> None:
    library = load_library(UDS, write(tmp_path, MINE))
    assert [*library] == [*load_library(UDS), "mine"]
    mine = library["mine"]
    assert [*mine.strengths] == ["mine_g"]
    assert mine.roles == {"B": ("B_ap", "B_du"), "dp": ("dp_ap", "dp_du")}
    assert (mine.changes[0].symbol, mine.changes[0].replacement) == ("B", "B*(1 + g*x)")
    assert mine.parameters["T"].null is None
    assert mine.unknowns["x"].initial == ("0",)


def test_a_users_entry_replaces_a_shipped_one_only_if_it_says_so(tmp_path: Path) -> None:
    named = MINE.replace('"mine"', '"pump_slip"')
    with pytest.raises(ModelError, match=r"effect pump_slip: is an entry of the system too; say `replaces = true`"):
        load_library(UDS, write(tmp_path, named))
    said = write(tmp_path, named.replace('source = "seen"', 'source = "seen"\nreplaces = true'))
    assert load_library(UDS, said)["pump_slip"].component == "hose"
    with pytest.raises(ModelError, match="effect mine: replaces an entry that the system has not; remove `replaces`"):
        load_library(UDS, write(tmp_path, MINE.replace('source = "seen"', 'source = "seen"\nreplaces = true')))


def test_the_example_in_the_documentation_is_in_no_shipped_library() -> None:
    assert "creeping_hose" not in load_library(UDS)
    assert load_library(UDS, CREEPING_HOSE)["creeping_hose"].parameters["tau"].prior == 0.7


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("schema = 1", "schema = 2", "own.toml: schema: this is 2, readable is 1"),
        ("schema = 1", "", "own.toml: schema: is missing"),
        (MINE[11:], "", "own.toml: effect: there is none"),
        ('"hose"\n', '"hose"\ncolour = 1\n', "own.toml: effect mine.colour: unknown key; allowed here are statement"),
        ('name = "mine"', 'name = "my own"', "own.toml: effect[0].name: 'my own': is no name"),
        ('"the hose swells"', "7", "effect mine.statement: must be a string, not 7"),
        ('source = "seen"', "", "effect mine.source: is missing"),
        ('source = "seen"', 'source = "seen"\nreplaces = 1', "effect mine.replaces: must be true or false, not 1"),
        ('["stiff_hose"]', '["soft_hose"]', "effect mine.rivals[0]: soft_hose is no other entry"),
        ('["stiff_hose"]', '["mine"]', "effect mine.rivals[0]: mine is no other entry"),
        ('["steady_hold"]', '["wait"]', "effect mine.separated_by[0]: wait is none of pressure_ladder, "),
        ('B = ["B_ap", "B_du"]', 'B = ["B_ap"]', "effect mine.roles.dp: those of one position go together"),
        ('B = ["B_ap", "B_du"]', "B = []", "effect mine.roles.B: those of one position go together"),
        ('B = ["B_ap", "B_du"]', "B = 1", "effect mine.roles.B: must be a list, not 1"),
        ("null = 0.0", "", "effect mine.parameter.g.null: give either null, where there is no effect, or the value"),
        ("null = 0.0", "null = 0.0\nvalue = 1.0", "effect mine.parameter.g.null: give either null"),
        ("spread = 0.1", "", "effect mine.parameter.g.spread: is missing; say how strong"),
        ("spread = 0.1", "spread = -0.1", "effect mine.parameter.g: a spread must be positive"),
        ("min = 0.0", "min = 0.5", "effect mine.parameter.g: value 0 is outside [0.5, inf]"),
        ("min = 0.0", "max = -0.5", "effect mine.parameter.g: value 0 is outside [-inf, -0.5]"),
        ("null = 0.0\nspread", "value = 1.0\nspread", "effect mine.parameter: none has a null value"),
        ("prior = 0.5", "prior = 0.5\nspread = 1.0", "effect mine.parameter.T: a spread must be positive, and there"),
        ("unknown.dx]", "unknown.T]", "effect mine.T: is declared twice among roles, parameter and unknown"),
        ("parameter.T]", "parameter.abs]", "effect mine: 'abs': is no name"),
        ('initial = ["0"]', 'initial = ["0 +"]', "effect mine.unknown.x.initial[0]: not a formula"),
        ('where = ["dp", "B"]', "", "effect mine.change[0].where: is missing; name what the equation has in it"),
        ("B -> B*(1 + g*x)", "B", "effect mine.change[0].replace: `B` must be like `A -> A*(1 + g)`"),
        ("B -> B*", "B*2 -> B*", "effect mine.change[0].replace: `B*2 -> B*(1 + g*x)` must be like"),
        ("B*(1 + g*x)", "B*cos(g)", "effect mine.change[0].replace: `cos(g)` is no call of"),
        ("T*dx - (1 - x)", "T*dx - (1 - x", "effect mine.equation[0].expr: not a formula"),
        ('name = "swells"', 'name = "d"', "effect mine.equation: two equations or differentials are named d"),
        ('state = "x"', 'state = "p_ap"', "effect mine.differential[0].state: p_ap is no unknown of the effect"),
        ('derivative = "dx"', "", "effect mine.differential[0].derivative: is missing"),
    ],
)
def test_a_bad_entry_is_refused_with_its_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in MINE
    with pytest.raises(ModelError, match=re.escape(message)) as caught:
        load_library(UDS, write(tmp_path, MINE.replace(old, new, 1)))
    assert "\n" not in str(caught.value)


def test_an_entry_without_a_change_is_refused(tmp_path: Path) -> None:
    start, end = MINE.index("[[effect.change]]"), MINE.index("[[effect.equation]]")
    with pytest.raises(ModelError, match=r"effect mine\.change: there is none, so the model stays as it is"):
        load_library(UDS, write(tmp_path, MINE[:start] + MINE[end:]))


def test_two_entries_of_a_name_are_refused(tmp_path: Path) -> None:
    twice = MINE + MINE.removeprefix("schema = 1\n")
    with pytest.raises(ModelError, match=r"own\.toml: two effects are named mine; rename one"):
        load_library(UDS, write(tmp_path, twice))


def test_what_is_no_file_or_no_toml_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read; give a library file"):
        load_library(UDS, tmp_path / "none.toml")
    with pytest.raises(ModelError, match=r"own\.toml: not TOML"):
        load_library(UDS, write(tmp_path, "effect ="))
    (tmp_path / "own.toml").write_bytes(b"\xff")
    with pytest.raises(ModelError, match=r"own\.toml: not TOML"):
        load_library(UDS, tmp_path / "own.toml")
