"""`[bench]` in `system.toml`: read beside any model of the system, written with it, and checked by name."""

from pathlib import Path

import pytest

from faultline.analysis.model import ModelError, dump_model, load_model, parse_model
from faultline.analysis.model.file import SYSTEMS

MODEL, SYSTEM = ((SYSTEMS / "uds" / name).read_text() for name in ("model.toml", "system.toml"))


def _folder(at: Path, system: str, file: str = "model.toml", model: str = MODEL) -> Path:
    (at / file).write_text(model)
    (at / "system.toml").write_text(system)
    return at if file == "model.toml" else at / file


def test_a_written_model_keeps_the_bench() -> None:
    model = load_model("uds")
    assert model.bench is not None
    assert [*model.bench.units.items()] == [("y_p_du", "Pa"), ("n_p", "1/s"), ("dc_dose", "1")]
    assert parse_model(dump_model(model), "again").bench == model.bench


def test_without_a_table_there_is_no_bench() -> None:
    assert load_model("three-tank").bench is None


def test_a_smaller_model_of_the_system_has_no_bench_without_its_signals(tmp_path: Path) -> None:
    """Only the whole model must have all signals that the system speaks of."""
    small = MODEL.replace("y_p_ap", "s_ap")
    assert load_model(_folder(tmp_path, SYSTEM, "small.toml", small)).bench is None
    with pytest.raises(ModelError, match=r"system\.toml: signal\.y_p_ap: .* has no known signal y_p_ap"):
        load_model(_folder(tmp_path, SYSTEM, "model.toml", small))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'follower = "y_p_ap"',
            'follower = "y_q"',
            r"bench\.follower: y_q is no known signal; those are y_p_tp, y_p_ap",
        ),
        ('follower = "y_p_ap"', 'follower = "y_p_du"', r"bench\.reference: y_p_du has two of the roles reference, fol"),
        ('follower = "y_p_ap"', 'follower = "n_p"', r"bench\.follower: n_p is in 1/s; the clocks are aligned by press"),
        ('drive = "n_p"', "", r"bench\.drive: is missing; give a string"),
        ('ambient = ["p_tank"', 'ambient = ["p_tnk"', r"bench\.ambient: p_tnk is no parameter; those are eps_p, D_p"),
        ("step_pa = 30e3", "step_pa = -30e3", r"bench\.step_pa: -30000; give a positive number"),
        ("step_pa = 30e3", "step_bar = 0.3", r"bench\.step_pa: is missing; give a number"),
        (
            "pulse_hz = [1.0, 9.0]",
            "pulse_hz = [9.0, 1.0]",
            r"bench\.pulse_hz: give the lowest and the highest frequency",
        ),
        ("[bench]", "[bench]\npump = 1", r"bench\.pump: unknown key; allowed here are reference, follower"),
    ],
)
def test_what_is_not_valid_is_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in SYSTEM
    with pytest.raises(ModelError, match=words) as caught:
        load_model(_folder(tmp_path, SYSTEM.replace(old, new)))
    assert "\n" not in str(caught.value)
