"""The configuration is taken as it is meant or refused in one line that says where and what to do."""

import os
import re
import ssl
import subprocess
import sys
from pathlib import Path

import pytest

from faultline.service.core.errors import InputError
from faultline.service.mqtt import command
from faultline.service.mqtt import config as module
from faultline.service.mqtt.access import context, password
from faultline.service.mqtt.config import MqttConfig, TlsConfig, load_config
from faultline.service.strict import LARGEST, ConfigError

SHIPPED = (Path(module.__file__).parents[1] / "vehicle" / "mqtt.toml").read_text()

GOOD = """\
[mqtt]
host = "broker.example"
events = "/run/faultline/events.sock"
control = "/run/faultline/control.sock"
cursor = "/var/lib/faultline-mqtt/cursor"
[mqtt.tls]
ca = "/etc/ca.pem"
"""


def loaded(tmp_path: Path, text: str) -> MqttConfig:
    path = tmp_path / "mqtt.toml"
    path.write_text(text)
    return load_config(path)


def test_the_shipped_file_is_taken_as_it_is_and_with_every_key(tmp_path: Path) -> None:
    assert loaded(tmp_path, SHIPPED) == MqttConfig(
        host="localhost",
        events="/run/faultline/events.sock",
        control="/run/faultline/control.sock",
        cursor="/var/lib/faultline-mqtt/cursor",
    )
    everything = loaded(tmp_path, re.sub(r"(?m)^# (?=[a-z_]+ = |\[)", "", SHIPPED))
    assert everything == MqttConfig(
        host="localhost",
        port=8883,
        prefix="faultline",
        vehicle="truck-17",
        user="truck-17",
        password_file="mqtt-password",  # noqa: S106
        client_id="faultline-truck-17",
        events="/run/faultline/events.sock",
        control="/run/faultline/control.sock",
        cursor="/var/lib/faultline-mqtt/cursor",
        tls=TlsConfig(ca="/etc/faultline/broker-ca.pem", certificate="/etc/faultline/mqtt.pem", key="mqtt-key"),
    )


def test_the_page_and_the_help_name_every_key(capsys: pytest.CaptureFixture[str]) -> None:
    fields = [one for table in (MqttConfig, TlsConfig) for one in table.__struct_fields__]
    page = (Path(__file__).parents[3] / "docs" / "mqtt.md").read_text()
    assert [key for key in fields if f"`{key}`" not in page] == []
    with pytest.raises(SystemExit):
        command.main(["--help"])
    assert SHIPPED.rstrip() in capsys.readouterr().out


@pytest.mark.parametrize("key", [*MqttConfig.__struct_fields__, *(f"tls.{key}" for key in TlsConfig.__struct_fields__)])
def test_every_key_says_what_to_give(tmp_path: Path, key: str) -> None:
    lines = {name: f'{name} = "/x"' for name in ("events", "control", "cursor")}
    lines |= {"host": 'host = "localhost"', key: f"{key} = []"}
    with pytest.raises(ConfigError, match=rf": mqtt\.{re.escape(key)}: Expected .*, got `array`; give \w.*"):
        loaded(tmp_path, "\n".join(["[mqtt]", *lines.values()]))


@pytest.mark.parametrize(("tls", "port"), [("", 1883), ("[mqtt.tls]\n", 8883)])
def test_the_port_is_the_usual_one(tmp_path: Path, tls: str, port: int) -> None:
    text = GOOD.partition("[mqtt.tls]")[0].replace("broker.example", "localhost")
    assert loaded(tmp_path, text + tls).to == ("localhost", port)


def edited(line: str, new: str) -> str:
    """The good one with the line that begins so replaced; without one the new line comes at the end of [mqtt]."""
    if not line:
        return GOOD.replace("[mqtt.tls]", f"{new}\n[mqtt.tls]")
    assert re.search(rf"(?m)^{re.escape(line)}.*$", GOOD)
    return re.sub(rf"(?m)^{re.escape(line)}.*$", lambda _: new, GOOD)


@pytest.mark.parametrize(
    ("line", "new", "said"),
    [
        ("", "insecure = true", r"6: mqtt.insecure: there is no such key; those are host, events, control,"),
        (
            "events",
            'event = "/e"',
            r"3: mqtt.event: there is no such key \(did you mean `events`\?\); those are host, ",
        ),
        ("ca", "insecure = true", r"7: mqtt.tls.insecure: there is no such key; those are ca, certificate, key"),
        ("[mqtt]", "[other]", r"1: other: there is no such key; those are mqtt"),
        ("host", "", r"1: mqtt: `host` is missing; give the broker's name or address"),
        ("cursor", "", r"1: mqtt: `cursor` is missing; give a file that we may write"),
        ("host", 'host = ""', r"2: mqtt.host: .*; give the broker's name or address"),
        ("host", 'host = "a b"', r"2: mqtt.host: .*; give the broker's name or address"),
        ("", 'port = "1883"', r"6: mqtt.port: Expected `int . null`, got `str`; give its port, 1 to 65535"),
        ("", "port = 0", r"6: mqtt.port: Expected `int` >= 1; give its port"),
        ("", 'password = "secret"', r"6: mqtt.password: there is no such key"),
        ("", 'password_file = "/a"', r"6: mqtt.password_file: a password without a user; give `user` too"),
        ("", "keepalive = 1", r"6: mqtt.keepalive: Expected `int` >= 5; give seconds between signs of life, 5 to 3600"),
        ("", "acknowledged_within = 0", r"6: mqtt.acknowledged_within: .*; give seconds until an answer is overdue"),
        ("events", 'events = "events.sock"', r"3: mqtt.events: .*; give the daemon's events socket, as /run"),
        ("", "plain = true", r"6: mqtt.plain: there is \[mqtt.tls\] too; remove one of them"),
        ("ca", 'key = "k"', r"6: mqtt.tls: `certificate` and `key` belong together; give both or none"),
        ("ca", 'ca = "../ca.pem"', r"7: mqtt.tls.ca: .*; give a file with the certificates"),
        ("", 'client_id = "a b"', r"6: mqtt.client_id: .*; give our name at the broker: letters"),
        ("", 'vehicle = "a/b"', r"6: mqtt.vehicle: vehicle 'a/b' cannot be part of a topic: letters, digits"),
        ("", 'vehicle = ""', r"6: mqtt.vehicle: vehicle '' cannot be part of a topic"),
        ("", 'vehicle = "a\\u0000b"', r"6: mqtt.vehicle: vehicle 'a\\x00b' cannot be part of a topic"),
        ("", f'vehicle = "{"a" * 81}"', r"6: mqtt.vehicle: vehicle 'a+\.\.\.' is longer than 80 characters"),
        ("", 'prefix = "fleet/#"', r"6: mqtt.prefix: prefix 'fleet/#': level '#' cannot be part of a topic"),
        ("", 'prefix = "$share/x"', r"6: mqtt.prefix: prefix '\$share/x': level '\$share' cannot be part"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_line_and_a_remedy(
    tmp_path: Path, line: str, new: str, said: str
) -> None:
    with pytest.raises(ConfigError, match=rf"^{tmp_path}/mqtt\.toml:{said}") as caught:
        loaded(tmp_path, edited(line, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("host", ["10.0.0.7", "broker.example", "localhost.example", "192.168.1.1"])
def test_another_machine_in_the_clear_is_refused_unless_it_is_said(tmp_path: Path, host: str) -> None:
    text = GOOD.partition("[mqtt.tls]")[0].replace("broker.example", host)
    with pytest.raises(ConfigError, match=r":2: mqtt.host: is another machine, and all would go there in the clear"):
        loaded(tmp_path, text)
    assert loaded(tmp_path, text + "plain = true\n").plain


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.1.2.3", "::1"])
def test_this_machine_needs_no_tls(tmp_path: Path, host: str) -> None:
    text = GOOD.partition("[mqtt.tls]")[0].replace("broker.example", host)
    assert loaded(tmp_path, text).tls is None


@pytest.mark.parametrize("content", [b"\xff", b"[mqtt", b"[mqtt]\nhost = 'a\0b'\n"])
def test_what_is_no_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mqtt.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="not TOML"):
        load_config(path)


def test_a_file_that_is_not_there_or_endless_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read: No such file or directory; give another --config"):
        load_config(tmp_path / "none")
    (tmp_path / "big").write_bytes(b"#" * (LARGEST + 1))
    with pytest.raises(ConfigError, match="more than 256 KiB"):
        load_config(tmp_path / "big")


def with_password(tmp_path: Path, place: str) -> MqttConfig:
    text = GOOD.replace("[mqtt.tls]", f'user = "u"\npassword_file = "{place}"\n[mqtt.tls]')
    return loaded(tmp_path, text)


@pytest.mark.parametrize(
    ("content", "read"), [(b"se cret", "se cret"), (b"secret\n", "secret"), (b"secret\r\n", "secret")]
)
def test_the_password_is_what_is_in_the_file(tmp_path: Path, content: bytes, read: str) -> None:
    (tmp_path / "password").write_bytes(content)
    assert password(with_password(tmp_path, f"{tmp_path}/password")) == read
    assert password(with_password(tmp_path, "password"), {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == read


def test_without_a_password_file_there_is_no_password(tmp_path: Path) -> None:
    assert password(loaded(tmp_path, GOOD)) is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty; put the password in it"),
        (b"\n", "is empty"),
        (b"x" * 65536, "is too long"),
        (b"\xff\xfe", "is no text; give the password's file"),
    ],
)
def test_a_password_that_is_none_is_refused_and_not_shown(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "password").write_bytes(content)
    with pytest.raises(InputError, match=said) as caught:
        password(with_password(tmp_path, f"{tmp_path}/password"))
    assert "xxx" not in str(caught.value)


def test_a_credential_needs_a_credentials_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="pw: is the name of a systemd credential, and there are none; give a path"):
        password(with_password(tmp_path, "pw"), {})
    with pytest.raises(InputError, match="cannot be read: No such file"):
        password(with_password(tmp_path, "pw"), {"CREDENTIALS_DIRECTORY": str(tmp_path)})


def test_certificate_and_name_are_looked_at_and_old_protocols_refused() -> None:
    made = context(TlsConfig())
    assert (made.verify_mode, made.check_hostname) == (ssl.CERT_REQUIRED, True)
    assert made.minimum_version == ssl.TLSVersion.TLSv1_2


@pytest.mark.parametrize("content", [None, b"", b"no certificate"])
def test_certificates_that_are_none_are_refused(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "ca").write_bytes(content)
    with pytest.raises(InputError, match=rf"^{tmp_path}/ca: no certificates there: .*; give `ca` in \[mqtt.tls\]"):
        context(TlsConfig(ca=f"{tmp_path}/ca"))
    with pytest.raises(InputError, match="not our certificate and its key"):
        context(TlsConfig(certificate=f"{tmp_path}/ca", key=f"{tmp_path}/ca"))


def test_the_process_needs_no_numerical_library() -> None:
    """Some 30 MB instead of 60: it stands beside the daemon in the same memory."""
    heavy = ["numpy", "onnxruntime", "cantools", "can", "cryptography", "sqlite3"]
    code = f"import sys, faultline.service.mqtt.command; print([name for name in {heavy} if name in sys.modules])"
    root = str(Path(module.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=environment)
    assert done.stdout == "[]\n"
