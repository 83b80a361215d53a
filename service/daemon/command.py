"""Listen on CAN buses and tell subscribers which component is failing."""

import argparse
import socket
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from faultline.options import Parser
from faultline.service.bundle.files import Trust
from faultline.service.bundle.load import Bundle
from faultline.service.bus import open_bus
from faultline.service.core.errors import InputError
from faultline.service.core.j1939.context import CodeTracker
from faultline.service.daemon.config import (
    BundleConfig,
    BusConfig,
    Config,
    ControlConfig,
    EventsConfig,
    TrustConfig,
    load_config,
    named,
)
from faultline.service.daemon.loop import Loop
from faultline.service.daemon.pipeline import BusChannel, connect, wanted_by, watched
from faultline.service.daemon.refused import Loader, RefusedBundles
from faultline.service.daemon.reload import Reload
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.outputs.control import ControlSocket
from faultline.service.outputs.socket import RING, EventSocket
from faultline.service.store.journal import Journal
from faultline.service.systemd import Notifier, Supervisor, log_as

BOOT = Path("/proc/sys/kernel/random/boot_id")  # random(4)

_say = log_as("run")

EXAMPLE = """example:
  faultline run --config /etc/faultline/faultline.toml
  faultline run --bundle out/bundle --bus socketcan:vcan0 --socket /tmp/events.sock
"""


def main(argv: list[str]) -> int:
    """Run the daemon until SIGTERM or SIGINT; returns its exit code."""
    options, config = _asked(argv)
    notifier = Notifier()
    notifier.tell(STATUS="loading bundles")
    load = Loader(lambda: _trust(config), [bus.name for bus in config.bus])
    bundles, refused = _loaded(config, load, required=options.config is None)
    with ExitStack() as opened:
        journal = opened.enter_context(Journal(_store(config, options.config), _say, RING))
        read = None if journal.path is None else journal.read
        subscribers = opened.enter_context(EventSocket(Path(config.events.socket), journal.earlier, read))
        journal.earlier = []  # the socket has them
        control = None
        if (given := config.control) is not None:
            control = opened.enter_context(ControlSocket(Path(given.socket), given.clear))
        lines = _lines(config, bundles, options.speed, required=options.config is None)
        for line in lines:
            opened.enter_context(line.bus)
        reload = None if options.config is None else Reload(options.config, config, lines, _trust, load, _say)
        loop = Loop(
            *(Sequencer(config.source, journal.last), lines, journal, subscribers, notifier, _say),
            reload=reload,
            refused=RefusedBundles(refused, load, config.source, options.speed),
            control=control,
            memory=config.memory,
            boot=BOOT.read_text().strip() if BOOT.exists() else "",
        )
        _say(
            f"ready, {', '.join(f'bundle {each.manifest.name} {each.id[:12]}' for _, each in bundles) or 'no bundle'}, "
            f"bus {', '.join(bus.interface for bus in config.bus)}, events on {config.events.socket}"
            + (f", {options.speed:g}x" if options.speed != 1 else "")
        )
        with Supervisor(notifier, {"loop": loop.heartbeat, "store": journal}, _say):
            loop.serve()
            notifier.tell(STOPPING=1)
    return 0


def _store(config: Config, path: Path | None) -> Path | None:
    """Return the path of the store; None in a trial, or if the configuration gives none."""
    if config.store is not None:
        return Path(config.store.path)
    if path is not None:
        _say(f"{path}: no [store]: events are told and not kept")
    return None


def _asked(argv: Sequence[str]) -> tuple[argparse.Namespace, Config]:
    """Return the options, and the configuration: the one in a file, or what the options of a trial make."""
    parser = Parser("faultline run", description=__doc__, epilog=EXAMPLE)
    add = parser.add_argument
    add("--config", type=Path, help="the configuration; its interfaces may come and go, and need not be there yet")
    add("--bundle", type=Path, help="without a configuration: the bundle folder")
    add(
        "--bus",
        action="append",
        metavar="[NAME=]BUS",
        help="and the bus: socketcan:NAME or udp_multicast:GROUP:PORT, which must be there; NAME=BUS for one that the "
        "bundle names",
    )
    add("--socket", type=Path, help="and where subscribers connect (Unix socket)")
    add("--control", type=Path, help="and, if wanted, where other processes ask (Unix socket)")
    add("--source", help="the vehicle's name in events (default: the host's)")
    add("--speed", type=float, default=1.0, help="how many times real time the bus runs, for replays")
    options = parser.parse_args(argv)
    if not 0 < options.speed < float("inf"):
        parser.error("--speed must be a number above zero")
    trial = ("bundle", "bus", "socket")
    if options.config is not None:
        parser.refuse(options, (*trial, "control", "source"), "--config says that already")
        return options, load_config(options.config)
    parser.require(options, trial, "--config")
    config = Config(
        bus=_buses(options.bus),
        bundle=[BundleConfig(path=str(options.bundle), bus="bus")],
        trust=TrustConfig(allow_unsigned=True),
        events=EventsConfig(socket=str(options.socket)),
        control=ControlConfig(socket=str(options.control)) if options.control else None,
        source=named(options.source or socket.gethostname(), "--source"),
    )
    return options, config


def _buses(given: Sequence[str]) -> list[BusConfig]:
    """Return the buses of a trial: one without a name, and those that the bundle names."""
    pairs = [each.rpartition("=") for each in given]
    if [name for name, _, _ in pairs].count("") != 1:
        raise InputError("--bus: give one bus without a name; those that the bundle names as NAME=BUS")
    return [BusConfig(name=name or "bus", interface=interface) for name, _, interface in pairs]


def _trust(config: Config) -> Trust | None:
    """Return the signatures that bundles must have; None if unsigned ones are allowed."""
    if config.trust.keys is None:
        return None
    from faultline.service.bundle.signing import Signed, load_keys  # with a cryptographic library, which a trial lacks

    return Signed(load_keys(Path(config.trust.keys)), config.trust.signatures)


def _loaded(
    config: Config, load: Loader, *, required: bool
) -> tuple[list[tuple[BundleConfig, Bundle]], dict[BundleConfig, str]]:
    """Load the bundles, or their spares, and return why some are refused; raises InputError if `required`."""
    if required:
        return [(each, load(Path(each.path))) for each in config.bundle], {}
    loaded: list[tuple[BundleConfig, Bundle]] = []
    refused: dict[BundleConfig, str] = {}
    for each in config.bundle:
        bundle, why = load.or_spare(Path(each.path))
        if bundle is not None:
            loaded.append((each, bundle))
        if why:
            refused[each] = why
            _say(f"refused: {why}; " + (f"{bundle.where} runs instead" if bundle else "tried again later"))
    return loaded, refused


def _lines(
    config: Config, bundles: Sequence[tuple[BundleConfig, Bundle]], speed: float, *, required: bool
) -> list[BusChannel]:
    """Open the buses, each with its pipelines."""
    lines = []
    for bus in config.bus:
        here = [(each.path, bundle) for each, bundle in bundles if each.bus == bus.name]
        wanted = wanted_by((bundle.table for _, bundle in here), bus.trouble_codes)
        opened = open_bus(bus.interface, wanted, believe_local=bus.believe_local, required=required)
        watching = [watched(bundle, config.source, speed, place=place) for place, bundle in here]
        codes = CodeTracker() if bus.trouble_codes else None
        lines.append(BusChannel(bus.name, opened, watching, _say, bus.interface, codes))
    connect(lines)
    return lines
