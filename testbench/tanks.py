r"""The test rig of another system: three tanks in a row, whose levels are measured (docs/your-system.md).

Its physics and values are not those of any model file.

State: the levels h1, h2, h3 [m] and the pump's flow q [m3/s], which follows its command u with a lag and pulsates a
little. Tank i has the cross section S; between the tanks, and out of the last one, water flows through the area a_i:

    S h1' = q - q1 - leak1,  S h2' = q1 - q2 - leak2,  S h3' = q2 - q3 - leak3      q_i = a_i v(h_i - h_{i+1}), h4 = 0
    T q'  = K u (1 + ripple) - q                                                    leak_i = l_i v(h_i)

with Torricelli's v(d) = sign(d) sqrt(2 g |d|). The sensors add noise and have a resolution.
"""

import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from faultline.writing import write_files

Array = npt.NDArray[np.float64]

DBC = Path(__file__).with_name("tanks.dbc").read_text()

SECTION = 1.96e-3  # m2
AREAS = np.array([6.6e-5, 5.5e-5, 6.3e-5])  # m2, discharge coefficient included
FULL_FLOW = 1.85e-4  # m3/s
LAG_S = 0.8
RIPPLE, RIPPLE_S = 0.01, 7.0  # of the flow, and its period
GRAVITY = 9.80665  # m/s2
NOISE, RESOLUTION = 1e-3, 5e-4  # m

COMMANDS = (0.45, 0.55, 0.65, 0.7)
HOLD_S = 40.0
FRAME_S = 0.1


FAULTS = {
    "f_leak1": "a hole in tank 1 of so many m2",
    "f_leak2": "a hole in tank 2 of so many m2",
    "f_leak3": "a hole in tank 3 of so many m2",
    "fA_12": "the pipe between tanks 1 and 2 has lost this part of its area",
    "fA_23": "the pipe between tanks 2 and 3 has lost this part of its area",
    "fA_3": "the outlet has lost this part of its area",
    "f_y1": "the level sensor of tank 1 shows so many m too much",
    "f_y2": "the level sensor of tank 2 shows so many m too much",
    "f_y3": "the level sensor of tank 3 shows so many m too much",
}


@dataclass(frozen=True)
class Fault:
    """One of `FAULTS`, of a `size` as said there, from `onset_s` [s] on."""

    name: str
    size: float
    onset_s: float

    def of(self, kind: str) -> Array:
        """Its size (3,) in tank, pipe or sensor 1 to 3 if it is of the kind `f_leak`, `fA_` or `f_y`, else 0."""
        places = {"12": "1", "23": "2"}
        here, place = self.name.startswith(kind), self.name.removeprefix(kind)
        return self.size * np.array([here and places.get(place, place) == number for number in "123"], dtype=np.float64)


class Run(NamedTuple):
    """Times `t` (K,) [s], the command `u` (K,) of the pump, and the levels `y` (K, 3) [m] as they are measured."""

    t: Array
    u: Array
    y: Array


def run(seed: int, duration_s: float, fault: Fault | None = None) -> Run:
    """Simulate a random sequence of pump commands."""
    rng = np.random.default_rng(seed)
    holds = rng.permutation(np.tile(COMMANDS, int(duration_s / HOLD_S / len(COMMANDS)) + 1))
    t = np.arange(0.0, duration_s, FRAME_S)
    u = np.repeat(holds, round(HOLD_S / FRAME_S))[: len(t)]
    measured = levels(t, u, fault) + rng.normal(0.0, NOISE, (len(t), 3))
    if fault is not None:
        measured += np.outer(t >= fault.onset_s, fault.of("f_y"))
    return Run(t, u, RESOLUTION * np.round(measured / RESOLUTION))


def levels(t: Array, u: Array, fault: Fault | None) -> Array:
    """The levels (K, 3) [m] at the times `t` [s] (K,) under the commands `u` (K,), from rest at the first of them."""
    starts = [0, *(np.flatnonzero(np.diff(u)) + 1)]
    if fault is not None:
        starts = sorted({*starts, int(np.searchsorted(t, fault.onset_s))})
    flow = FULL_FLOW * u[0]
    drops = (flow / AREAS) ** 2 / (2 * GRAVITY)
    x = np.array([*np.cumsum(drops[::-1])[::-1], flow])
    parts = []
    for start, stop in pairwise([*starts, len(t)]):
        there = fault if fault is not None and t[start] >= fault.onset_s else None
        span = (t[start], t[start] + FRAME_S * (stop - start))
        solution = solve_ivp(
            _rates, span, x, "LSODA", np.append(t[start:stop], span[1]), args=(u[start], there), rtol=1e-8, atol=1e-10
        )
        parts.append(solution.y[:3, :-1].T)
        x = solution.y[:, -1]
    return np.concatenate(parts)


def table(run: Run) -> str:
    """The run as a table of values that a laboratory's logger writes, at 5 Hz: the command in percent, levels in cm."""
    rows = zip(run.t[::2], 100.0 * run.u[::2], 100.0 * run.y[::2], strict=True)
    lines = [f"{t:.1f},{u:.2f},{y[0]:.2f},{y[1]:.2f},{y[2]:.2f}\n" for t, u, y in rows]
    return "time [s],u [%],y1 [cm],y2 [cm],y3 [cm]\n" + "".join(lines)


def can_log(run: Run) -> str:
    """The run as frames of `tanks.dbc` in candump's format: the levels of every row, the command of every other."""
    lines = []
    for k, (now, command, row) in enumerate(zip(*run, strict=True)):
        stamp = 1_767_225_600 + now
        if k % 2 == 0:
            raw = struct.pack("<HHI", round(command / 2.5e-5), 0xFFFF, 0xFFFFFFFF)
            lines.append(f"({stamp:.6f}) can0 18FF3021#{raw.hex().upper()}\n")
        raw = struct.pack("<HHHH", *(max(0, round(level / 1e-4)) for level in row), 0xFFFF)
        lines.append(f"({stamp + 0.001:.6f}) can0 18FF3122#{raw.hex().upper()}\n")
    return "".join(lines)


def truth(recording: str, fault: Fault | None) -> str:
    """What was wrong in a recording, as a truth file."""
    text = f'schema = 1\nrecording = "{recording}"\n'
    if fault is None:
        return text
    rest = f'size = {fault.size!r}\nonset_s = {fault.onset_s!r}\nprofile = "abrupt"\n'
    return f'{text}\n[[fault]]\nname = "{fault.name}"\n{rest}'


def write(folder: Path, run: Run, *, can: bool) -> list[Path]:
    """Write `log.csv`, or `can.log` with its DBC; return the files."""
    texts = {"can.log": can_log(run), "tanks.dbc": DBC} if can else {"log.csv": table(run)}
    write_files({folder / name: text for name, text in texts.items()})
    return [folder / name for name in texts]


def _rates(t: float, x: Array, u: float, fault: Fault | None) -> Array:
    area, leak = AREAS.copy(), np.zeros(3)
    if fault is not None:
        area *= 1.0 - fault.of("fA_")
        leak = fault.of("f_leak")
    h, q = x[:3], x[3]
    through = area * _velocity(h - np.append(h[1:], 0.0))
    into = np.append(q, through[:2])
    wanted = FULL_FLOW * u * (1 + RIPPLE * np.sin(2 * np.pi * t / RIPPLE_S))
    return np.append((into - through - leak * _velocity(h)) / SECTION, (wanted - q) / LAG_S)


def _velocity(head: Array) -> Array:
    speed: Array = np.sign(head) * np.sqrt(2 * GRAVITY * np.abs(head))
    return speed
