"""Forward events to an MQTT 5 broker."""

import signal
import time
from contextlib import closing
from importlib import resources
from pathlib import Path

from faultline.options import Parser
from faultline.service.distribution import installed_version
from faultline.service.mqtt.access import context, password
from faultline.service.mqtt.bridge import Bridge
from faultline.service.mqtt.config import load_config
from faultline.service.mqtt.cursor import CursorFile
from faultline.service.mqtt.throttled import Said
from faultline.service.systemd import Notifier, Supervisor, log_as

_say = log_as("mqtt")

EXAMPLE = """example:
  faultline mqtt --config /etc/faultline/mqtt.toml

"""


def main(argv: list[str]) -> int:
    """Runs until SIGTERM or SIGINT; returns the exit code."""
    layout = resources.files("faultline.service").joinpath("vehicle", "mqtt.toml").read_text()
    parser = Parser("faultline mqtt", description=__doc__, epilog=f"{EXAMPLE}the file:\n\n{layout}")
    parser.add_argument("--config", type=Path, required=True, help="the configuration, as below")
    options = parser.parse_args(argv)
    config = load_config(options.config)
    password(config)  # what cannot be read now is said now; for each connection it is read anew
    if config.tls is not None:
        context(config.tls)
    notifier = Notifier()
    with closing(CursorFile(Path(config.cursor))) as file:
        bridge = Bridge(config, file, installed_version(), notifier, Said(_say, time.monotonic))
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: bridge.stop())
        with Supervisor(notifier, {"loop": bridge.heartbeat}, _say):
            bridge.serve()
    return 0
