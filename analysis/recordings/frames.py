"""Puts the added sensors on the CAN log, as the frames that an instrumented vehicle would have sent."""

from collections.abc import Iterable, Mapping

import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal

from faultline.analysis.recordings.track import Mask
from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray
from faultline.service.logs import Frame

PASCAL = {"Pa": 1.0, "kPa": 1e3, "bar": 1e5}
"""Pascal per unit of a DBC."""


def sensor_message(database: Database, name: str, signals: Iterable[str], where: str) -> Message:
    """The message of this name, which carries the added sensors.

    Raises:
        InputError: the DBC has no such message, or it lacks a signal or gives it in no unit of pressure.
    """
    message = next((message for message in database.messages if message.name == name), None)
    if message is None:
        raise InputError(f"{where}: has no message {name} for the added sensors; record with the project's DBC")
    for wanted in signals:
        signal = next((signal for signal in message.signals if signal.name == wanted), None)
        if signal is None:
            raise InputError(f"{where}: {name} has no signal {wanted}, which external.tables names")
        if signal.unit not in PASCAL:
            raise InputError(f"{where}: {name}.{wanted} is in {signal.unit!r}; give it in {', '.join(PASCAL)}")
    return message


def sensor_frames(message: Message, t: FloatArray, pressures: Mapping[str, FloatArray]) -> list[Frame]:
    """One frame per sample: `t` (N,) [s], `pressures` (N,) [Pa] by signal, NaN and out of range as not available."""
    columns = {
        signal.name: _raw(signal, pressures[signal.name] if signal.name in pressures else np.full(len(t), np.nan))
        for signal in message.signals
    }
    return [
        Frame(
            time,
            message.frame_id,
            message.is_extended_frame,
            message.encode({name: raw[k] for name, raw in columns.items()}, scaling=False, padding=True, strict=False),
        )
        for k, time in enumerate(t.tolist())
    ]


def clipped(message: Message, pressures: Mapping[str, FloatArray]) -> dict[str, int]:
    """How many values of each signal lie beyond its range, and so are not available on the bus."""
    signals = {signal.name: signal for signal in message.signals}
    return {
        name: int((np.isfinite(pressure) & ~_within(signals[name], _in_unit(signals[name], pressure))).sum())
        for name, pressure in pressures.items()
    }


def _raw(signal: Signal, pressure: FloatArray) -> list[int]:
    """Raw values: rounded, all ones (not available, SAE J1939-71) where there is no value within the signal's range."""
    value = _in_unit(signal, pressure)
    raw, known = np.round((value - float(signal.offset)) / float(signal.scale)), _within(signal, value)
    return [int(number) if good else (1 << signal.length) - 1 for number, good in zip(raw, known, strict=True)]


def _in_unit(signal: Signal, pressure: FloatArray) -> FloatArray:
    return pressure / PASCAL.get(signal.unit or "", 1.0)


def _within(signal: Signal, value: FloatArray) -> Mask:
    """Which values are numbers in the signal's range."""
    top = float(signal.maximum if signal.maximum is not None else np.inf)
    bottom = float(signal.minimum if signal.minimum is not None else -np.inf)
    return np.asarray((value >= bottom) & (value <= top))


def candump(frames: Iterable[Frame]) -> str:
    """The frames as candump's text log, to the microsecond."""
    lines = []
    for t, can_id, extended, data in frames:
        name = f"{can_id:08X}" if extended else f"{can_id:03X}"
        mark = "##0" if len(data) > 8 else "#"
        lines.append(f"({t:.6f}) can0 {name}{mark}{data.hex().upper()}\n")
    return "".join(lines)
