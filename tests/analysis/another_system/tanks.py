r"""A bench of three tanks, simulated on its own: its physics and values are not those of any model file.

State: the levels h1, h2, h3 [m] and the pump's flow q [m3/s], which follows its command u with a lag and pulsates a
little. Tank i has the cross section S; between the tanks, and out of the last one, water flows through the area a_i:

    S h1' = q - q1 - leak1,  S h2' = q1 - q2 - leak2,  S h3' = q2 - q3 - leak3      q_i = a_i v(h_i - h_{i+1}), h4 = 0
    T q'  = K u (1 + ripple) - q                                                    leak_i = l_i v(h_i)

with Torricelli's v(d) = sign(d) sqrt(2 g |d|). The sensors add noise and have a resolution.
"""

import hashlib
import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

Array = npt.NDArray[np.float64]

DBC = (Path(__file__).parent / "tanks.dbc").read_bytes()

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


@dataclass(frozen=True)
class Fault:
    """From `onset_s` [s] on tank `tank` (0 to 2) has a hole of area `leak` [m2] and its a_i less the part `clogged`."""

    tank: int
    onset_s: float
    leak: float = 0.0
    clogged: float = 0.0


def record(folder: Path, seed: int, duration_s: float, fault: Fault | None = None) -> Path:
    """Simulates a run with a random sequence of pump commands and writes it as an instrumented recording."""
    rng = np.random.default_rng(seed)
    holds = rng.permutation(np.tile(COMMANDS, int(duration_s / HOLD_S / len(COMMANDS)) + 1))
    t = np.arange(0.0, duration_s, FRAME_S)
    u = np.repeat(holds, round(HOLD_S / FRAME_S))[: len(t)]
    measured = levels(t, u, fault) + rng.normal(0.0, NOISE, (len(t), 3))
    return write(folder, t, u, RESOLUTION * np.round(measured / RESOLUTION))


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


def write(folder: Path, t: Array, u: Array, y: Array) -> Path:
    """The frames of `tanks.dbc` as a recording: the levels `y` (K, 3) of every row, the command `u` of every other."""
    lines = []
    for k, (now, command, row) in enumerate(zip(t, u, y, strict=True)):
        stamp = 1_767_225_600 + now
        if k % 2 == 0:
            raw = struct.pack("<HHI", round(command / 2.5e-5), 0xFFFF, 0xFFFFFFFF)
            lines.append(f"({stamp:.6f}) can0 18FF3021#{raw.hex().upper()}\n")
        raw = struct.pack("<HHHH", *(max(0, round(level / 1e-4)) for level in row), 0xFFFF)
        lines.append(f"({stamp + 0.001:.6f}) can0 18FF3122#{raw.hex().upper()}\n")
    folder.mkdir(parents=True)
    (folder / "can.log").write_text("".join(lines))
    (folder / "tanks.dbc").write_bytes(DBC)
    (folder / "recording.toml").write_text(
        f'schema = 1\nid = "{folder.name}"\nkind = "instrumented"\nsource = "simulated"\nvehicle = "bench"\n'
        'cycle = "steps"\nsensor_set = "instrumented"\n\n[can]\nfile = "can.log"\ndbc = "tanks.dbc"\n'
        f'dbc_sha256 = "{hashlib.sha256(DBC).hexdigest()}"\n'
    )
    return folder


def _rates(t: float, x: Array, u: float, fault: Fault | None) -> Array:
    area, leak = AREAS.copy(), np.zeros(3)
    if fault is not None:
        area[fault.tank] *= 1 - fault.clogged
        leak[fault.tank] = fault.leak
    h, q = x[:3], x[3]
    through = area * _velocity(h - np.append(h[1:], 0.0))
    into = np.append(q, through[:2])
    wanted = FULL_FLOW * u * (1 + RIPPLE * np.sin(2 * np.pi * t / RIPPLE_S))
    return np.append((into - through - leak * _velocity(h)) / SECTION, (wanted - q) / LAG_S)


def _velocity(head: Array) -> Array:
    speed: Array = np.sign(head) * np.sqrt(2 * GRAVITY * np.abs(head))
    return speed
