"""The configuration: what is taken, and where errors are."""

import os
import socket
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.service.daemon.config import load_config
from faultline.service.strict import LARGEST, ConfigError

GOOD = """\
source = "truck-17"

[[bus]]
name = "powertrain"
interface = "socketcan:can0"

[[bus]]
name = "body"  # a comment
interface = "socketcan:can1"
believe_local = true

[[bundle]]
path = "/var/lib/faultline/bundles/uds"
bus = "powertrain"

[events]
socket = "/run/faultline/events.sock"

[trust]
keys = "/etc/faultline/keys"
"""


def refused(folder: Path, text: str | bytes) -> str:
    path = folder / "c.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(str(path))


def test_a_whole_configuration(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(GOOD)
    config = load_config(path)
    assert config.source == "truck-17"
    assert [(bus.name, bus.interface, bus.believe_local) for bus in config.bus] == [
        ("powertrain", "socketcan:can0", False),
        ("body", "socketcan:can1", True),
    ]
    assert [(bundle.path, bundle.bus) for bundle in config.bundle] == [("/var/lib/faultline/bundles/uds", "powertrain")]
    path.write_text(GOOD.replace('source = "truck-17"\n', ""))
    assert load_config(path).source == socket.gethostname()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "believe_local = true",
            "believe_local = 1",
            ":10: bus[1].believe_local: Expected `bool`, got `int`; give true or false",
        ),
        (
            "believe_local",
            "belief_local",
            ":10: bus[1].belief_local: there is no such key (did you mean `believe_local`?); those are name, ",
        ),
        ("believe_local", '"\\n"', ":7: bus[1].?: there is no such key; those are name, interface, believe_local"),
        (
            'bus = "powertrain"',
            'bus = "power"',
            ":14: bundle[0].bus: there is no bus 'power'; those are powertrain, body",
        ),
        ('name = "body"', 'name = "powertrain"', ":8: bus[1].name: bus 'powertrain' is there twice; rename one"),
        (
            'name = "body"',
            'name = "a/b"',
            ":8: bus[1].name: this text is not accepted; give letters, digits, _ . and -",
        ),
        ('"truck-17"', '"a/+/#"', ":1: source: this text is not accepted; give letters, digits"),
        ('"truck-17"', "17", ":1: source: Expected `str`, got `int`"),
        ('path = "/var', 'path = "var', ":13: bundle[0].path: this text is not accepted; give a whole path"),
        (
            'interface = "socketcan:can1"\n',
            "",
            ":7: bus[1]: `interface` is missing; give socketcan:NAME, can:INTERFACE:CHANNEL",
        ),
        ("[events]", "[event]", ":16: event: there is no such key (did you mean `events`?); those are bus, "),
        (
            'socket = "/run/faultline/events.sock"',
            "",
            ":16: events: `socket` is missing; give the daemon's events socket, as /",
        ),
        ("[[bus]]", "[[bus]", ": not TOML: "),
        ('keys = "/etc/faultline/keys"', "", ":19: trust: give the folder of the trusted public keys, `keys`, or for"),
        ("[trust]", "[trust]\nallow_unsigned = true", ":19: trust: give the folder of the trusted public keys"),
        ("[events]", "[memory]\nentries = 0\n[events]", ":17: memory.entries: Expected `int` >= 1"),
        (
            'source = "truck-17"',
            'store = "/x"',
            ":1: store: Expected `object | null`, got `str`; give the table [store]",
        ),
        ("[trust]", "[trust]\nsignatures = 0", ":20: trust.signatures: Expected `int` >= 1"),
        (
            "[events]",
            '[[bundle]]\npath = "/var/lib/faultline/bundles/uds"\nbus = "body"\n[events]',
            ":17: bundle[1].path: this bundle is",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    assert refused(tmp_path, GOOD.replace(old, new)).startswith(message)


def test_what_is_no_configuration_is_refused(tmp_path: Path) -> None:
    assert refused(tmp_path, b"\xff").startswith(": not TOML: ")
    assert refused(tmp_path, "").startswith(":1: `bus` is missing; give a table [[bus]]")
    assert "no configuration" in refused(tmp_path, b"#" * (LARGEST + 1))
    assert refused(tmp_path, "a = " + "[" * 100_000).startswith(": not TOML: ")
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read: No such file or directory; give another"):
        load_config(tmp_path / "absent.toml")


@settings(max_examples=int(os.environ.get("SEEDS", "200")))
@given(st.data())
def test_no_damage_breaks_the_reader(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    raw = bytearray(GOOD.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("c") / "c.toml"
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    message = ""
    try:
        load_config(path)
    except ConfigError as error:
        message = str(error)
    assert "\n" not in message
