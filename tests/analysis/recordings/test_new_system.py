"""The first folder of a system, written from a log: what it proposes, and what it leaves to its author by name."""

import re
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from faultline.analysis.model import ModelError, load_model
from faultline.analysis.recordings.new_system import main
from faultline.service.core.errors import InputError

GOLDEN = Path(__file__).parents[2] / "golden" / "log"
DBC = Path(str(resources.files("faultline.dbc").joinpath("uds.dbc")))


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A level in mm every 2 s with a noise of 3 mm, a command every 10 s, and a column without numbers."""
    rng = np.random.default_rng(1)
    rows = ["time_s,level [mm],u [%],state"]
    for k in range(500):
        level = 500.0 + 300.0 * np.sin(0.01 * k) + rng.normal(0.0, 3.0)
        rows.append(f"{2.0 * k},{level:.3f},{50 if k % 10 < 5 else 20 if k % 5 == 0 else ''},on")
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    return tmp_path / "log.csv"


def values(text: str, signal: str) -> dict[str, str]:
    part = text[text.index(f"[known.{signal}]") :].split("\n\n")[0]
    return dict(re.findall(r"^(\w+) = (.*)$", part, flags=re.MULTILINE))


def test_units_ranges_noise_and_periods_are_those_of_the_log(table: Path, tmp_path: Path) -> None:
    assert main(["system", "tank", "--from", str(table), "--out", str(tmp_path / "tank")]) == 0
    text = (tmp_path / "tank" / "model.toml").read_text()
    level = values(text, "level")
    assert level["unit"] == '"m"'
    assert float(level["min"]) < 0.2
    assert 0.8 < float(level["max"]) < 1.0
    assert float(level["noise"]) == pytest.approx(3e-3, rel=0.15)
    assert values(text, "u")["unit"] == '"1"'
    system = (tmp_path / "tank" / "system.toml").read_text()
    assert "period_s = 2  #" in system
    assert "level.maximum_age_s = 10\n" in system
    assert 'u.display = "%"\n' in system
    assert '[display]\n"m" = "mm"\n' in system


def test_what_is_left_to_the_author_is_told_by_name_until_it_is_filled_in(table: Path, tmp_path: Path) -> None:
    main(["system", "tank", "--from", str(table), "--signals", "level", "--out", str(tmp_path / "tank")])
    with pytest.raises(
        ModelError, match=r"still to be filled in: description, source, warm_up_s, known.level.descr.* more$"
    ):
        load_model(tmp_path / "tank")
    file = tmp_path / "tank" / "model.toml"
    text = file.read_text()
    begin = text[: text.index("# Everything else")].replace('"FILL IN: seconds until the slowest', '100.0  # "')
    begin = re.sub(r'"FILL IN[^"]*"', '"level"', begin)
    file.write_text(begin + '[unknown.h]\nunit = "m"\n[[equation]]\nname = "e1"\nexpr = "level - h"\n')
    model = load_model(tmp_path / "tank")
    assert (model.period_s, model.maximum_age_s("level")) == (2.0, 10.0)


def test_columns_get_names_for_formulas_and_those_that_never_change_are_left_away(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{k};{30 + k % 7};{k % 5};0" for k in range(50)]
    (tmp_path / "log.csv").write_text("\n".join(["time;Volume Flow RateRMS;exp [-];anomaly", *rows]) + "\n")
    assert main(["system", "loop", "--from", str(tmp_path / "log.csv"), "--out", str(tmp_path / "loop")]) == 0
    assert "never change in the log, and left away: anomaly (--signals" in capsys.readouterr().out
    text = (tmp_path / "loop" / "model.toml").read_text()
    assert [*tomllib.loads(text)["known"]] == ["Volume_Flow_RateRMS", "x_exp"]
    assert values(text, "Volume_Flow_RateRMS")["description"] == '"Volume Flow RateRMS"'
    assert values(text, "Volume_Flow_RateRMS")["unit"] == '"1"  # the log says none'
    assert [*tomllib.loads((tmp_path / "loop" / "system.toml").read_text())["signal"]] == [
        "Volume_Flow_RateRMS",
        "x_exp",
    ]
    kept = ["--signals", "anomaly", "--out", str(tmp_path / "kept")]
    assert main(["system", "loop", "--from", str(tmp_path / "log.csv"), *kept]) == 0


def test_a_can_log_gives_the_signals_of_its_dbc(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--from", str(GOLDEN / "can.log"), "--dbc", str(DBC)]
    assert main(["system", "pump", *given, "--signals", "n_p", "y_p_du", "--out", str(tmp_path / "pump")]) == 0
    assert f"wrote {tmp_path / 'pump' / 'model.toml'}" in capsys.readouterr().out
    text = (tmp_path / "pump" / "model.toml").read_text()
    assert (values(text, "n_p")["unit"], values(text, "y_p_du")["unit"]) == ('"1/s"', '"Pa"')
    assert "period_s = 0.2  #" in (tmp_path / "pump" / "system.toml").read_text()


def test_what_cannot_be_begun_is_refused_in_a_line(table: Path, tmp_path: Path) -> None:
    here = tmp_path / "there"
    here.mkdir()
    for arguments, told in (
        (["--out", str(here)], "there: is there already; give another folder with --out, or --force"),
        (["--signals", "speed", "--out", str(tmp_path / "n")], "--signals speed: no such signals; there are level, u"),
        (["--signals", "state", "--out", str(tmp_path / "n")], "none of its signals has values: state"),
    ):
        with pytest.raises(InputError) as error:
            main(["system", "tank", "--from", str(table), *arguments])
        assert told in str(error.value)
    with pytest.raises(InputError, match="cannot be read"):
        main(["system", "x", "--from", str(table), "--dbc", str(tmp_path / "none.dbc"), "--out", str(tmp_path / "n")])
    assert not (tmp_path / "n").exists()
