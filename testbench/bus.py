"""What is put on the bus: each message's content, period and jitter, encoded from a DBC by cantools."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from math import inf, isfinite, isinf, nan, sqrt
from pathlib import Path
from typing import NamedTuple

import cantools.database
from cantools.database.can import Database, Message
from cantools.errors import Error as CantoolsError

from faultline.testbench.errors import RigError
from faultline.testbench.plant import SYSTEM_PRESSURE
from faultline.testbench.units import ATMOSPHERE, ML

RATED_DOSE = 1.2 * ML  # m^3/s with the valve held open at SYSTEM_PRESSURE, as the controller believes
DENSITY = 1090e3  # g/m^3, ISO 22241-1 at 20 degC
NOT_AVAILABLE, ERROR = nan, inf
"""What is known of a quantity whose sensor is off, and of one whose sensor has been found at fault."""
TANK = {"def_tank_volume": 75.2, "def_tank_temperature": 22.0}  # %, degC: a supply so large that dosing does not show


class Knowledge(NamedTuple):
    """What the senders know at an instant.

    The controller: y_p_du [Pa], n_p [rev/s], dc_dose and the requested dose [0..1]. The sensor box, where there is one:
    y_p_tp and y_p_ap [Pa]. Where nothing is known, a value is `NOT_AVAILABLE` or `ERROR`.
    """

    p_du: float
    n_p: float
    duty: float
    request: float
    p_tp: float = NOT_AVAILABLE
    p_ap: float = NOT_AVAILABLE


def _dosing(duty: float, p_du: float) -> float:
    """The controller's idea of the dosed mass flow [g/h]."""
    if not isfinite(p_du):
        return p_du
    drive = max(p_du - ATMOSPHERE, 0.0) / (SYSTEM_PRESSURE - ATMOSPHERE)
    return duty * RATED_DOSE * sqrt(drive) * DENSITY * 3600


CONTENT: Mapping[str, Callable[[Knowledge], dict[str, float]]] = {
    "UDS_ECU": lambda k: {"y_p_du": k.p_du / 1e3, "n_p": k.n_p, "dc_dose": 100 * k.duty},
    "A1SCRDSI1": lambda k: {"def_actual_dosing": _dosing(k.duty, k.p_du), "def_doser_pressure": k.p_du / 1e3},
    "A1SCRDSR1": lambda k: {"def_requested_dosing": _dosing(k.request, SYSTEM_PRESSURE)},
    "A1SCRDSR3": lambda k: {"def_valve_command": 100 * k.duty},
    "A1DEFSI": lambda k: {"def_pump_speed": 60 * k.n_p},
    "AT1T1I1": lambda _: dict(TANK),
    "UDS_SENSORS": lambda k: {"y_p_tp": k.p_tp / 1e3, "y_p_ap": k.p_ap / 1e3},
}
"""The signals of each message, in the DBC's units."""

BROADCAST_JITTER = 0.001  # s, sd: sent from a timer
DIAGNOSTIC_JITTER = {
    # s, sd: sent from a background task, and by a small box with nothing else to do but its converter.
    "UDS_ECU": 0.008, "UDS_SENSORS": 0.003,
}  # fmt: skip
SENSOR_BOX = "UDS_SENSORS"
"""The message that only an instrumented vehicle has."""
EXTENDED = 1 << 31
"""Marks an identifier of 29 bits in a DBC file."""


@dataclass(frozen=True)
class Sender:
    """One periodic message: `period` and `jitter` (sd) [s]."""

    message: Message
    period: float
    jitter: float

    def encode(self, knowledge: Knowledge) -> bytes:
        """The payload, each signal limited to its range in the DBC; bits without a signal are 1 (not available).

        A signal that is not available is all ones, one at fault has the highest byte FE (SAE J1939-71, 5.2.1).
        """
        values = CONTENT[self.message.name](knowledge)
        for signal in self.message.signals:
            value, low, high = values[signal.name], signal.minimum, signal.maximum
            if not isfinite(value):
                ones = (1 << signal.length) - 1
                raw = ones - (1 << max(signal.length - 8, 0)) if isinf(value) else ones
                values[signal.name] = raw * float(signal.scale) + float(signal.offset)
                continue
            value = value if low is None else max(value, float(low))
            values[signal.name] = value if high is None else min(value, float(high))
        return self.message.encode(values, padding=True, strict=False)


@dataclass(frozen=True)
class Dbc:
    """A DBC file: its bytes, which are copied into every recording, and the messages that the rig sends by it.

    `controllers` are on every vehicle, `sensor_box` on an instrumented one besides.
    """

    content: bytes
    controllers: tuple[Sender, ...]
    sensor_box: Sender

    @property
    def sha256(self) -> str:
        """Hash of the file."""
        return sha256(self.content).hexdigest()


def load_dbc(path: Path | None = None) -> Dbc:
    """The DBC at `path`, or the one that comes with faultline.

    Raises:
        RigError: no such file, not a DBC, or without a message, signal or cycle time that the rig needs.
    """
    where = str(path) if path else "uds.dbc"
    try:
        content = path.read_bytes() if path else resources.files("faultline.dbc").joinpath("uds.dbc").read_bytes()
    except OSError as error:
        raise RigError(f"{where}: {error.strerror}; give a DBC with --dbc") from error
    return _read(where, content)


def with_periods(dbc: Dbc, periods: Mapping[str, float]) -> Dbc:
    """The DBC of a vehicle whose messages have other periods [s], by name, as its file says them."""
    text = dbc.content.decode()
    for sender in (*dbc.controllers, dbc.sensor_box):
        if sender.message.name in periods:
            of = f'BA_ "GenMsgCycleTime" BO_ {sender.message.frame_id | EXTENDED}'
            milliseconds = round(1000 * periods[sender.message.name])
            text = text.replace(f"{of} {round(1000 * sender.period)};", f"{of} {milliseconds};")
    return _read("the vehicle's DBC", text.encode())


def _read(where: str, content: bytes) -> Dbc:
    try:
        database = cantools.database.load_string(content.decode(), database_format="dbc")
    except (UnicodeDecodeError, CantoolsError) as error:
        raise RigError(f"{where} is not a DBC file: {' '.join(str(error).split())}") from error
    if not isinstance(database, Database):
        raise RigError(f"{where} is not a database of CAN messages")
    by_name = {message.name: message for message in database.messages}
    senders = {name: _sender(where, name, by_name.get(name)) for name in CONTENT}
    sensor_box = senders.pop(SENSOR_BOX)
    return Dbc(content, tuple(senders.values()), sensor_box)


def _sender(where: str, name: str, message: Message | None) -> Sender:
    if message is None:
        raise RigError(f"{where} has no message {name}, which the rig sends")
    ours, theirs = set(CONTENT[name](Knowledge(0.0, 0.0, 0.0, 0.0))), {signal.name for signal in message.signals}
    if ours != theirs:
        raise RigError(
            f"{where}: {name} has the signals {', '.join(sorted(theirs))}; the rig sends {', '.join(sorted(ours))}"
        )
    if not message.cycle_time:
        raise RigError(f"{where}: {name} has no cycle time (GenMsgCycleTime)")
    return Sender(message, message.cycle_time / 1000, DIAGNOSTIC_JITTER.get(name, BROADCAST_JITTER))
