"""Model files of faultline 0.1 are read as this version would write them."""

import tomllib

import pytest

from faultline.analysis.model import ModelError, dump_model, load_model, parse_model

MODES = 'signal = "dc_dose"\n'
MODES += "idle_below = 0.02\nmaximum_above = 0.98\nsettle_s = 8.0\nedges = { dc_dose = 0.03, n_p = 4.0 }\n"


def older(modes: str) -> str:
    """The shipped model as 0.1 had it: one table of modes, no period, no ages."""
    text = dump_model(load_model("uds"))
    words = ("period_s", "maximum_age_s")
    head, _, rest = text.partition("[[mode]]")
    lines = [line for line in head.splitlines() if not line.startswith(words)]
    return "\n".join(lines) + f"\n[modes]\n{modes}\n" + rest[rest.index("[[equation]]") :]


def test_an_old_model_is_the_same_system() -> None:
    old, new = parse_model(older(MODES), "old.toml"), load_model("uds")
    assert (old.period_s, old.modes.edges, old.modes.settle_s) == (new.period_s, new.modes.edges, new.modes.settle_s)
    assert [(m.name, m.where) for m in old.modes.steady] == [(m.name, m.where) for m in new.modes.steady]
    assert {name: old.maximum_age_s(name) for name in old.known} == dict.fromkeys(new.known, 1.0)
    assert "modes" not in tomllib.loads(dump_model(old))


def test_modes_without_bounds_are_one() -> None:
    old = parse_model(older('signal = "dc_dose"\n'), "old.toml")
    assert [mode.name for mode in old.modes.steady] == ["partial"]
    assert not old.modes.edges


@pytest.mark.parametrize(("modes", "problem"), [('signal = "q"\nidle_below = 1.0\n', "q is no known"), ("", "signal")])
def test_a_wrong_old_table_is_refused(modes: str, problem: str) -> None:
    with pytest.raises(ModelError, match=problem):
        parse_model(older(modes), "old.toml")
