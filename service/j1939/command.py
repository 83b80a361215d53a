"""Send faults as J1939 trouble codes (DM1, DM2) on a vehicle's bus."""

from contextlib import closing
from pathlib import Path

from faultline.options import Parser
from faultline.service.j1939.config import load_config
from faultline.service.j1939.loop import Loop
from faultline.service.j1939.memory import Memory
from faultline.service.j1939.node import Node
from faultline.service.j1939.wire import Wire
from faultline.service.systemd import Notifier, Supervisor, log_as

_say = log_as("j1939")

EXAMPLE = """example:
  faultline j1939 --config /etc/faultline/j1939.toml
"""


def main(argv: list[str]) -> int:
    """Runs the node until SIGTERM or SIGINT; returns its exit code."""
    parser = Parser("faultline j1939", description=__doc__, epilog=EXAMPLE)
    parser.add_argument("--config", type=Path, required=True, help="the configuration (TOML), which must allow sending")
    config = load_config(parser.parse_args(argv).config)
    name, notifier = config.name.value, Notifier()
    wire = Wire(config.interface, config.addresses)
    with closing(wire.bus), closing(Memory(Path(config.control), Path(config.events), _say)) as memory:
        loop = Loop(Node(name, config.addresses), wire, memory, notifier, _say)
        _say(f"NAME {name:016X}, {config.interface}, asks {config.control}")
        with Supervisor(notifier, {"loop": loop.heartbeat}, _say):
            loop.serve()
            notifier.tell(STOPPING=1)
    return 0
