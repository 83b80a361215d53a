"""docs/j1939.md says what the code does."""

import configparser
import re
from pathlib import Path

import msgspec

from faultline.service.core.j1939.dm1 import MOST, MOST_OC
from faultline.service.j1939.claim import VIOLATED_S
from faultline.service.j1939.config import J1939Config, NameConfig, load_config
from faultline.service.j1939.memory import ASK_S, KEEP_S, PATIENCE_S
from faultline.service.j1939.node import LONGEST_RETRY_S, RETRY_S
from faultline.service.j1939.outbox import CONNECTIONS
from faultline.service.j1939.transport import GAP_S

PAGE = (Path(__file__).parents[3] / "docs" / "j1939.md").read_text()


def section(name: str) -> str:
    return PAGE.partition(f"## {name}\n")[2].partition("\n## ")[0]


def test_its_configuration_is_one(tmp_path: Path) -> None:
    path = tmp_path / "j1939.toml"
    [text] = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    path.write_text(text)
    assert load_config(path).addresses == [144, 145]


def test_every_key_is_described() -> None:
    cells = re.findall(r"^\| (`.*?) \|", section("Configuration"), re.MULTILINE)
    named = {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}
    fields = {field.name for struct in (J1939Config, NameConfig) for field in msgspec.structs.fields(struct)}
    assert named == fields - {"name"}


def test_its_numbers_are_the_codes() -> None:
    bus, happens = section("What is on the bus"), section("What may happen")
    assert f"{MOST} codes are the most" in bus
    assert f"at most {MOST_OC}" in bus
    assert f"{GAP_S * 1000:.0f} ms apart" in bus
    assert CONNECTIONS == 4
    assert "four at a time" in bus
    assert f"for {KEEP_S:g} s more" in happens
    assert f"{ASK_S:g} s after the last question, and {PATIENCE_S:g} s later" in happens
    assert f"every {VIOLATED_S:g} s at most" in happens
    assert f"after {RETRY_S:g} s, {2 * RETRY_S:g} s and so on, then every minute" in happens
    assert LONGEST_RETRY_S == 60.0


def test_its_unit_may_do_what_it_must_and_no_more() -> None:
    [text] = re.findall(r"```ini\n(.*?)```", PAGE, re.DOTALL)
    unit = configparser.RawConfigParser(strict=False)
    unit.read_string(text)
    assert unit["Service"]["Type"] == "notify"
    assert unit["Service"]["RestrictAddressFamilies"].split() == ["AF_CAN", "AF_UNIX"]
    assert unit["Service"]["CapabilityBoundingSet"] == ""
