"""Made recordings: what the sensors show if a model, with parameters of our choice, is the vehicle."""

import dataclasses
import hashlib
import struct
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from once import once

from faultline.analysis.calibration.fit import Fit, fit
from faultline.analysis.calibration.sections import Section, sections
from faultline.analysis.model import Model, load_model
from faultline.analysis.simulation import Drive, System, run, system_of
from faultline.service.core.signals.columns import CanSignals
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.logs import Frame
from faultline.service.logs.batch import batch_of

Array = npt.NDArray[np.float64]

DBC = (Path(__file__).parents[3] / "dbc" / "uds.dbc").read_bytes()
SENSORS, ECU = 0x18FF20F9, 0x18FF103D
ATMOSPHERE = 101325.0
SPEED = (20.0, 20.0, 24.0, 28.0, 30.0, 22.0)
DOSE = (0.0, 0.0, 0.4, 1.0, 0.7, 0.0)
HOLD_S = 30.0

STEP_S = 0.05
BUS_S, ECU_S = 0.1, 0.2
"""Between frames of the added sensors, and of the ECU."""

UDS4 = load_model("uds")
UDS4_SYSTEM = system_of(UDS4, UDS4.calibrated)

LATE_S = 0.03
"""The ECU's frame after the sensors'."""


class Errors(NamedTuple):
    """What the vehicle does that a right model does not know: all as large as models say that they are, times these."""

    sensors: float = 1.0
    speed: float = 1.0
    level: float = 1.0
    step_time_s: float = 0.2
    """A step acts up to so much earlier or later."""
    jumps: bool = False
    """The speed jumps anywhere between two samples, as a set point's step makes it, instead of moving for 2 s."""
    wander: float = 0.15
    """The height of each of six slow waves of the true speed [1/s]: no error, but a model has to follow them."""


def freed(model: Model, names: Collection[str]) -> Model:
    """The model with these parameters to be calibrated and no others."""
    parameters = {
        name: dataclasses.replace(parameter, prior=parameter.prior if name in names else None)
        for name, parameter in model.parameters.items()
    }
    return dataclasses.replace(model, parameters=parameters)


def drawn(model: Model, seed: int, share: float = 0.5) -> dict[str, float]:
    """True parameters: the datasheet's, those with a prior a draw of that `share` of its width away."""
    rng = np.random.default_rng(seed)
    return {
        name: p.value * float(np.exp(share * p.prior * rng.standard_normal())) if p.prior else p.value
        for name, p in model.parameters.items()
    }


def frames(
    model: Model,
    true: Mapping[str, float],
    seed: int,
    *,
    delay_s: float = 0.0,
    errors: Errors = Errors(),  # noqa: B008  (a named tuple cannot be changed)
    speed: Sequence[float] = SPEED,
    dose: Sequence[float] = DOSE,
    zero: Mapping[str, float] | None = None,
) -> list[Frame]:
    """A log of a vehicle that is `model` with `true` parameters, holding each speed and dose for `HOLD_S`.

    The speed wanders; a logged dose step acts `delay_s` after the middle of the two samples that show it, about.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, HOLD_S * len(speed), STEP_S)
    ecu_t = t[:: round(ECU_S / STEP_S)] + LATE_S
    n_p = _speed(t, speed, errors.jumps) + errors.wander * _wander(t, rng)
    logged = np.array(dose)[np.minimum((ecu_t / HOLD_S).astype(int), len(dose) - 1)]
    shifts = delay_s + LATE_S - ECU_S / 2.0 + rng.uniform(-1.0, 1.0, len(dose)) * errors.step_time_s
    levels = np.array(dose) + errors.level * model.known["dc_dose"].noise * rng.standard_normal(len(dose))
    acting = _ramps(t, levels, shifts, ECU_S)
    y = _plant(model, true, np.column_stack([n_p, acting]))
    shown = {}
    for name, at in (("y_p_tp", t[::2]), ("y_p_ap", t[::2]), ("y_p_du", ecu_t)):
        known = model.known[name]
        offset = rng.standard_normal() * known.zero if zero is None else zero.get(name, 0.0)
        shown[name] = np.interp(at, t, y[name]) + offset + errors.sensors * rng.normal(0.0, known.noise, len(at))
    told = np.interp(ecu_t, t, n_p) + errors.speed * rng.normal(0.0, model.known["n_p"].noise, len(ecu_t))
    return _encoded(t[::2], shown["y_p_tp"], shown["y_p_ap"], ecu_t, shown["y_p_du"], np.abs(told), logged)


def _speed(t: Array, speed: Sequence[float], jumps: bool) -> Array:
    """The speed's levels, one after the other; a jump takes one step, soon after a sample or soon before the next."""
    if not jumps:
        return _ramps(t, speed, np.zeros(len(speed)), 2.0)
    late = np.random.default_rng(1).choice((1.5, 3.5), len(speed)) * STEP_S
    return _ramps(t, speed, late, STEP_S)


def _ramps(t: Array, values: Sequence[float] | Array, late: Array, width_s: float) -> Array:
    """Steps at multiples of `HOLD_S` and so much `late`, straight lines of `width_s` with the step in the middle."""
    value = np.asarray(values, dtype=np.float64)
    middle = HOLD_S * np.arange(1, len(value)) + late[1:]
    times = np.column_stack([middle - width_s / 2.0, middle + width_s / 2.0]).ravel()
    return np.asarray(np.interp(t, times, np.column_stack([value[:-1], value[1:]]).ravel()))


def _wander(t: Array, rng: np.random.Generator) -> Array:
    """Slow waves of the speed."""
    waves = zip(rng.uniform(0.02, 0.3, 6), rng.uniform(0.0, 6.28, 6), strict=True)
    return np.asarray(np.sum([np.sin(6.28 * f * t + phase) for f, phase in waves], axis=0))


def _plant(model: Model, true: Mapping[str, float], u: Array) -> dict[str, Array]:
    """The outputs, run in with the first inputs."""
    system = system_of(model, [*true])
    ran_in = np.concatenate([np.tile(u[0], (round(60.0 / STEP_S), 1)), u])
    start = np.array([ATMOSPHERE if state in {"p_tp", "p_bp"} else 1e6 for state in system.states])
    trajectory = run(system, Drive(STEP_S, ran_in, start, np.tile(start, (len(ran_in), 1))), true)
    return {name: y[-len(u) :] for name, y in trajectory.outputs().items()}


def _encoded(t: Array, tp: Array, ap: Array, ecu_t: Array, du: Array, n_p: Array, dose: Array) -> list[Frame]:
    """Both frames of `dbc/uds.dbc`."""
    found = [
        Frame(float(at), SENSORS, True, struct.pack("<HHI", round(a / 5), round(b / 50), 0xFFFFFFFF))
        for at, a, b in zip(t, tp, ap, strict=True)
    ]
    found += [
        Frame(float(at), ECU, True, struct.pack("<HHHH", round(a / 50), round(b / 0.002), round(c / 2.5e-5), 0xFFFF))
        for at, a, b, c in zip(ecu_t, du, n_p, dose, strict=True)
    ]
    return sorted(found, key=lambda frame: frame.t)


def log_sections(model: Model, system: System, log: Sequence[Frame]) -> list[Section]:
    """The sections of a log in `dbc/uds.dbc`."""
    table = compile_dbc(DBC.decode(), {name: known.unit for name, known in model.known.items()}, "made")
    return sections(model, system, CanSignals(table, lambda: [batch_of(log)]), "made")


class Case(NamedTuple):
    """A made vehicle, its sections and what calibration made of them."""

    model: Model
    system: System
    true: dict[str, float]
    sections: list[Section]
    fit: Fit


DELAY_S = 0.1


@once
def calibrated(name: str, seed: int, starts: int = 1) -> Case:
    """A shipped model calibrated on a vehicle of its own kind, whose commands act `DELAY_S` late."""
    model = load_model(name)
    system = system_of(model, model.calibrated)
    true = drawn(model, seed)
    found = log_sections(model, system, frames(model, true, seed, delay_s=DELAY_S))
    return Case(model, system, true, found, fit(system, found, silent, starts))


def silent(_: str) -> None:
    """Progress that nobody watches."""


def write_recording(folder: Path, log: Sequence[Frame], vehicle: str = "made") -> Path:
    """An instrumented recording."""
    lines = [f"({1_767_225_600 + frame.t:.6f}) can0 {frame.can_id:08X}#{frame.data.hex().upper()}\n" for frame in log]
    folder.mkdir(parents=True)
    (folder / "can.log").write_text("".join(lines))
    (folder / "uds.dbc").write_bytes(DBC)
    (folder / "recording.toml").write_text(
        f'schema = 1\nid = "{folder.name}"\nkind = "instrumented"\nsource = "made"\nvehicle = "{vehicle}"\n'
        'cycle = "holds"\nsensor_set = "instrumented"\n\n[can]\nfile = "can.log"\ndbc = "uds.dbc"\n'
        f'dbc_sha256 = "{hashlib.sha256(DBC).hexdigest()}"\n'
    )
    return folder
