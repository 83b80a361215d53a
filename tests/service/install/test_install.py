"""What is written onto a vehicle: whole files, nothing of its own replaced, every setting that was checked."""

import re
from pathlib import Path

import pytest

from faultline.service.core.errors import InputError
from faultline.service.daemon.config import (
    BundleConfig,
    BusConfig,
    Config,
    ControlConfig,
    EventsConfig,
    MemoryConfig,
    StoreConfig,
    TrustConfig,
    load_config,
)
from faultline.service.install import OUTPUTS, main
from faultline.service.j1939.config import J1939Config, NameConfig
from faultline.service.j1939.config import load_config as load_j1939
from faultline.service.mqtt.config import MqttConfig, TlsConfig
from faultline.service.mqtt.config import load_config as load_mqtt
from faultline.service.strict import Part

WORDS = ["--prefix", "/opt/faultline", "--base", "/usr"]
BUNDLE_UNIT = "etc/systemd/system/faultline-bundle@.service"
UNIT, CONFIG = "etc/systemd/system/faultline.service", "etc/faultline/faultline.toml"


def unit_of(root: Path) -> dict[str, list[str]]:
    """The unit's settings with all their values."""
    found: dict[str, list[str]] = {}
    for line in (root / UNIT).read_text().splitlines():
        if re.match(r"[A-Z]\w+=", line):
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


def test_a_root_gets_unit_configuration_and_settings(tmp_path: Path) -> None:
    assert main([*WORDS, "--root", str(tmp_path), "--interface", "can1", "--bitrate", "250000"]) == 0
    written = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    network = "etc/systemd/network/60-faultline-can1.network"
    outputs = [f"etc/systemd/system/faultline-{name}.service" for name in OUTPUTS]
    outputs += [f"etc/faultline/{command}.toml" for command in OUTPUTS.values()]
    assert written == sorted(
        [
            UNIT,
            BUNDLE_UNIT,
            CONFIG,
            "etc/sysctl.d/60-faultline.conf",
            "etc/sysusers.d/faultline.conf",
            network,
            *outputs,
        ]
    )
    config = load_config(tmp_path / CONFIG)
    assert [bus.interface for bus in config.bus] == ["socketcan:can1"]
    assert (config.trust.keys, config.trust.allow_unsigned) == ("/etc/faultline/keys", False)
    assert (tmp_path / "etc/faultline/keys").is_dir()
    assert "BitRate=250000\nRestartSec=200ms\nListenOnly=yes" in (tmp_path / network).read_text()
    assert not [path for path in written if re.search(r"@[A-Z]+@", (tmp_path / path).read_text())]


def test_the_unit_runs_the_environment_and_depends_on_no_interface(tmp_path: Path) -> None:
    main([*WORDS, "--root", str(tmp_path)])
    unit = unit_of(tmp_path)
    [start] = unit["ExecStart"]
    assert start == (
        "/opt/faultline/bin/python -P /opt/faultline/bin/faultline run --config /etc/faultline/faultline.toml"
    )
    assert unit["ExecPaths"] == ["/opt/faultline -/usr/lib -/usr/lib64 -/lib -/lib64"]
    assert not {"BindsTo", "Requires", "PartOf"} & {*unit}
    assert (unit["Type"], unit["Restart"], unit["WatchdogSec"]) == (["notify"], ["always"], ["10s"])
    assert unit["RestrictAddressFamilies"] == ["AF_CAN AF_UNIX"]
    assert unit["CapabilityBoundingSet"] == [""]


@pytest.mark.parametrize("output", OUTPUTS)
def test_units_of_the_outputs_are_as_strict_as_the_services(tmp_path: Path, output: str) -> None:
    main([*WORDS, "--root", str(tmp_path)])
    ours, theirs = (
        (tmp_path / f"etc/systemd/system/{name}.service").read_text().splitlines()
        for name in ("faultline", f"faultline-{output}")
    )
    strict = ours[ours.index("NoNewPrivileges=yes") : ours.index("SystemCallErrorNumber=EPERM") + 1]
    assert [line for line in theirs if line in strict] == strict
    assert f"/faultline {OUTPUTS[output]} --config /etc/faultline/{OUTPUTS[output]}.toml" in "\n".join(theirs)


def test_the_outputs_configurations_are_taken_by_them(tmp_path: Path) -> None:
    main([*WORDS, "--root", str(tmp_path), "--interface", "can1"])
    folder = tmp_path / "etc" / "faultline"
    assert load_mqtt(folder / "mqtt.toml").host == "localhost"
    with pytest.raises(InputError, match="transmitting is off"):
        load_j1939(folder / "j1939.toml")


@pytest.mark.parametrize(
    ("name", "tables"),
    [
        (
            "faultline",
            (Config, BusConfig, BundleConfig, TrustConfig, EventsConfig, StoreConfig, ControlConfig, MemoryConfig),
        ),
        ("mqtt", (MqttConfig, TlsConfig)),
        ("j1939", (J1939Config, NameConfig)),
    ],
)
def test_the_shipped_configurations_have_every_key(tmp_path: Path, name: str, tables: tuple[type[Part], ...]) -> None:
    main([*WORDS, "--root", str(tmp_path), "--interface", "can1"])
    text = (tmp_path / "etc/faultline" / f"{name}.toml").read_text()
    keys = {key for table in tables for key in table.__struct_fields__}
    assert keys == {
        *re.findall(r"(?m)^(?:# )?(\w+) = ", text),
        *re.findall(r"(?m)^(?:# )?\[+(?:\w+\.)?(\w+)\]", text),
    } - {name}


def test_the_shipped_configuration_is_taken_with_every_key(tmp_path: Path) -> None:
    main([*WORDS, "--root", str(tmp_path), "--interface", "can1"])
    every = re.sub(r"(?m)^# (?=[a-z_]+ = |\[)", "", (tmp_path / CONFIG).read_text()).replace("allow_unsigned", "# ")
    (tmp_path / "every.toml").write_text(every)
    config = load_config(tmp_path / "every.toml")
    assert config.memory == MemoryConfig()
    assert (config.source, config.trust.signatures, config.bus[0].believe_local) == ("truck-17", 2, True)


def test_a_configuration_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / CONFIG).parent.mkdir(parents=True)
    (tmp_path / CONFIG).write_text("mine")
    main([*WORDS, "--root", str(tmp_path)])
    assert (tmp_path / CONFIG).read_text() == "mine"
    assert f"kept   {tmp_path / CONFIG}" in capsys.readouterr().out


def test_a_dry_run_says_all_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--root", str(tmp_path), "--interface", "vcan0", "--virtual", "--dry-run"]) == 0
    told = capsys.readouterr().out
    assert [*tmp_path.iterdir()] == []
    for part in ("[Service]", "[[bus]]", "net.core.rmem_max = 4194304", "Kind=vcan", "MTUBytes=72"):
        assert part in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--interface", "can 0"], "--interface can 0: no name of a network interface"),
        (["--bitrate", "1"], "--bitrate 1: from 10000 to 1000000"),
        (["--bitrate", "250000", "--virtual"], "--bitrate with --virtual"),
        (["--prefix", "/root/venv"], "--prefix /root/venv: is in a home folder, which the service cannot see"),
        (["--prefix", "venv"], "--prefix venv: give the whole path"),
        (["--base", "/home/me/python"], "--base /home/me/python: is in a home folder"),
    ],
)
def test_what_would_not_run_is_refused(tmp_path: Path, words: list[str], message: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(message)}"):
        main([*WORDS, "--root", str(tmp_path), *words])
    assert [*tmp_path.iterdir()] == []


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "etc").write_text("")
    with pytest.raises(InputError, match="be root, or give another --root"):
        main([*WORDS, "--root", str(tmp_path)])
