"""Made recordings: what the sensors show if a model, with parameters of our choice, is the vehicle."""

import dataclasses
import hashlib
import struct
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from analysis.graph.bank import PERIOD_S, Bank
from analysis.model import Model
from analysis.recordings.modes import modes_of
from service.core.generators import GeneratorBank
from service.core.modes import ModeTracker
from service.core.observer import Tick

Array = npt.NDArray[np.float64]

DBC = (Path(__file__).parents[3] / "dbc" / "uds.dbc").read_bytes()
ATMOSPHERE = 101325.0
SPEED = (20.0, 20.0, 24.0, 28.0, 30.0, 22.0)
DOSE = (0.0, 0.0, 0.4, 1.0, 0.7, 0.0)
HOLD_TICKS = 150
"""A hold gives four blocks of 5 s once its edge has settled; the first is the warm-up."""


def samples(bank: Bank, trial: Mapping[str, float], seed: int) -> Array:
    """Samples (K, nz), sensor noise included: t19, t20 and t21 use no sensor but their own: the whole plant."""
    names = [test.name for test in bank.tests]
    plant = bank.only([names.index(name) for name in ("t20", "t19", "t21")])
    z = np.zeros((HOLD_TICKS * len(SPEED), 5))
    z[:, 3], z[:, 4] = np.repeat(SPEED, HOLD_TICKS), np.repeat(DOSE, HOLD_TICKS)
    start = plant.start(np.array([ATMOSPHERE, ATMOSPHERE, ATMOSPHERE, 0.0, 0.0]))
    z[:, :3] = -plant.simulate([trial], z, start)[:, 0]
    noise = [known.noise for known in bank.model.known.values()]
    z[:, :4] += np.random.default_rng(seed).normal(0.0, noise[:4], (len(z), 4))
    return z


def ticks(bank: Bank, z: Array) -> list[Tick]:
    """The samples as the vehicle's observer sees them."""
    generators = GeneratorBank(bank.graph(), bank.generators, bank.inputs)
    modes = ModeTracker(modes_of(bank.model), bank.inputs)
    usable = np.ones(len(bank.inputs), dtype=np.bool_)
    return [
        Tick(k, PERIOD_S * k, sample, usable, modes.update(sample, usable), generators.step(sample, usable))
        for k, sample in enumerate(z)
    ]


def freed(model: Model, names: Collection[str]) -> Model:
    """The model with these parameters to be calibrated and no others."""
    parameters = {
        name: dataclasses.replace(parameter, prior=parameter.prior if name in names else None)
        for name, parameter in model.parameters.items()
    }
    return dataclasses.replace(model, parameters=parameters)


def write_recording(folder: Path, z: Array) -> Path:
    """An instrumented recording of the samples, both frames of `dbc/uds.dbc` at every tick."""
    lines = []
    for k, (tp, ap, du, speed, dose) in enumerate(z):
        t = 1_767_225_600 + PERIOD_S * k
        sensors = struct.pack("<HHI", round(tp / 5), round(ap / 50), 0xFFFFFFFF).hex().upper()
        ecu = struct.pack("<HHHH", round(du / 50), round(speed / 0.002), round(dose / 2.5e-5), 0xFFFF).hex().upper()
        lines += [f"({t:.6f}) can0 18FF20F9#{sensors}\n", f"({t + 0.001:.6f}) can0 18FF103D#{ecu}\n"]
    folder.mkdir(parents=True)
    (folder / "can.log").write_text("".join(lines))
    (folder / "uds.dbc").write_bytes(DBC)
    (folder / "recording.toml").write_text(
        f'schema = 1\nid = "{folder.name}"\nkind = "instrumented"\nsource = "made"\nvehicle = "made"\ncycle = "holds"\n'
        'sensor_set = "instrumented"\n\n[can]\nfile = "can.log"\ndbc = "uds.dbc"\n'
        f'dbc_sha256 = "{hashlib.sha256(DBC).hexdigest()}"\n'
    )
    return folder
