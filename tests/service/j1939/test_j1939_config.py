"""The configuration: what it says, and each mistake with its line."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from faultline.service.cli import dispatch
from faultline.service.j1939.config import load_config
from faultline.service.strict import ConfigError

GOOD = """\
[j1939]
interface = "socketcan:can0"
control = "/run/faultline/control.sock"
events = "/run/faultline/events.sock"
addresses = [144, 145]
transmit = true

[j1939.name]
identity_number = 17
manufacturer_code = 2
function = 3
arbitrary_address_capable = true
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "j1939.toml"
    path.write_text(text)
    return path


def test_says_where_to_ask_and_who_we_are(tmp_path: Path) -> None:
    config = load_config(written(tmp_path, GOOD))
    assert (config.interface, config.control, config.events) == (
        "socketcan:can0",
        "/run/faultline/control.sock",
        "/run/faultline/events.sock",
    )
    assert (config.addresses, config.transmit) == ([144, 145], True)
    # 1 << 63 | function 3 << 40 | manufacturer 2 << 21 | identity 17
    assert f"{config.name.value:016X}" == "8000030000400011"


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        (
            "transmit = true\n",
            "",
            1,
            "j1939.transmit: transmitting is off: set transmit = true here if this device may",
        ),
        ("transmit = true", "transmit = false", 6, "j1939.transmit: transmitting is off: set transmit = true here"),
        ("transmit = true", "transmit = 1", 6, "j1939.transmit: Expected `bool`, got `int`"),
        (
            '"socketcan:can0"',
            '"can0"',
            2,
            "j1939.interface: this text is not accepted; give socketcan:NAME (as socketcan:can0), or udp_multicast:",
        ),
        (
            '"socketcan:can0"',
            '"can:pcan:PCAN_USBBUS1"',
            2,
            "j1939.interface: this text is not accepted; give socketcan:NAME",
        ),
        (
            '"/run/faultline/control.sock"',
            '"control.sock"',
            3,
            "j1939.control: this text is not accepted; give the daemon's control socket, as /",
        ),
        ("events =", "event =", 4, "j1939.event: there is no such key (did you mean `events`?); those are interface, "),
        (
            'events = "/run/faultline/events.sock"\n',
            "",
            1,
            "j1939: `events` is missing; give the daemon's events socket, as /",
        ),
        ("[144, 145]", "[]", 5, "j1939.addresses: Expected `array` of length >= 1; give the addresses to claim"),
        ("[144, 145]", "[144, 254]", 5, "j1939.addresses[1]: Expected `int` <= 253; give addresses from 0 to 253"),
        ("[144, 145]", "[144, -1]", 5, "j1939.addresses[1]: Expected `int` >= 0"),
        ("[144, 145]", "[144, 145, 144]", 5, "j1939.addresses[2]: 144 is there twice; remove one"),
        ("[144, 145]", "[61, 62]", 5, "j1939.addresses[1]: 62 is assigned to a function; after the preferred address"),
        (
            "identity_number = 17",
            "identity_number = 2097152",
            9,
            "j1939.name.identity_number: Expected `int` <= 2097151",
        ),
        ("identity_number = 17\n", "", 8, "j1939.name: `identity_number` is missing; give the number"),
        (
            "manufacturer_code = 2",
            "manufacturer_code = 2048",
            10,
            "j1939.name.manufacturer_code: Expected `int` <= 2047",
        ),
        ("function = 3", 'function = "pump"', 11, "j1939.name.function: Expected `int`, got `str`"),
        ("function = 3", "function = 3\necu_instance = 8", 12, "j1939.name.ecu_instance: Expected `int` <= 7"),
        ("function = 3", "function = 3\ncolour = 8", 12, "j1939.name.colour: there is no such key; those are "),
        (
            "arbitrary_address_capable = true",
            "",
            5,
            "j1939.addresses: a NAME that is not arbitrary_address_capable has one address; leave the others out",
        ),
        ("[j1939]", "[other]\n[j1939]", 1, "other: there is no such key; those are j1939"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path: Path, old: str, new: str, line: int, message: str) -> None:
    assert old in GOOD
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}:{line}: {message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[j1939", "not TOML: "),
        ("\x00", "not TOML: "),
        ("a = 1\n" * 50_000, "more than 256 KiB; this is no configuration"),
    ],
)
def test_what_is_no_configuration_is_told(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_bytes_that_are_no_text_and_a_file_that_is_not_there_are_told(tmp_path: Path) -> None:
    path = tmp_path / "j1939.toml"
    with pytest.raises(ConfigError, match=r"cannot be read: No such file or directory; give another --config"):
        load_config(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not TOML: 'utf-8' codec"):
        load_config(path)


def test_the_command_refuses_to_send_unless_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, GOOD.replace("transmit = true\n", ""))
    commands = {"j1939": EntryPoint("j1939", "faultline.service.j1939.command:main", "faultline.commands")}
    assert dispatch(["j1939", "--config", str(path)], commands) == 2
    told = capsys.readouterr().err
    assert told == (
        f"faultline j1939: error: {path}:1: j1939.transmit: transmitting is off: set transmit = true here if this "
        "device may send on the vehicle's bus\n"
    )
