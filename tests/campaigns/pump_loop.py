"""A loop of water with a pump and a valve, whose equations nobody writes: what is in each, and tables of values.

Speed and valve stand at random set points for half a minute each, as an operator or a schedule may have them. A loop
has parameters of its own, and the friction in it changes over a recording by some percent. At 1 Hz all else is static.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from faultline.analysis.recordings.init import main as init

Array = npt.NDArray[np.float64]

MODEL = """
schema = 1
name = "loop"
period_s = 1.0
warm_up_s = 20.0
[known.n]
description = "speed of the pump"
[known.v]
description = "opening of the valve"
[known.y_q]
[known.y_p]
[known.y_i]
[known.y_a]
description = "vibration"
[unknown.q]
[unknown.p]
[unknown.i]
[[equation]]
name = "e1"
variables = ["p", "q", "n"]
fault = {name = "f_pump", component = "impeller"}
[[equation]]
name = "e2"
variables = ["p", "q", "v"]
fault = {name = "f_valve", component = "valve"}
[[equation]]
name = "e3"
variables = ["i", "p", "q", "n"]
fault = {name = "f_motor", component = "motor"}
[[equation]]
name = "e4"
variables = ["y_q", "q"]
fault = {name = "f_y_q", component = "flow sensor"}
[[equation]]
name = "e5"
variables = ["y_p", "p"]
fault = {name = "f_y_p", component = "pressure sensor"}
[[equation]]
name = "e6"
variables = ["y_i", "i"]
[[equation]]
name = "e7"
variables = ["y_a", "n", "i"]
fault = {name = "f_rotor", component = "rotor"}
[edges]
settle_s = 3.0
steps = {n = 0.05, v = 0.05}
"""
SIGNALS = ("n", "v", "y_q", "y_p", "y_i", "y_a")
NOISE = (1e-3, 1e-3, 4e-3, 4e-3, 6e-3, 8e-3)
SIZES = {"f_pump": 0.1, "f_valve": 0.2, "f_motor": 0.1, "f_y_q": 0.04, "f_y_p": 0.04, "f_rotor": 0.15}
"""Large ones: parts of head, opening, current and vibration; of sensors, of the full scale. Severe ones: 2.5 times."""
STAY_S = 30


def samples(
    loop: int, seed: int, seconds: int, fault: str = "", size: float = 0.0, onset_s: int = 0, *, valve: bool = True
) -> Array:
    """Values (K, 6) of a loop every second, with a fault from its onset on; its `valve` moves, or stands still."""
    own, rng = np.random.default_rng([loop, 5]), np.random.default_rng([loop, seed])
    a, b, k0, k1, c, d = own.uniform(0.85, 1.15, 6) * (1.0, 0.5, 0.3, 0.25, 1.2, 0.5)
    stays = seconds // STAY_S + 1
    n, v = (np.repeat(rng.uniform(low, 1.0, stays), STAY_S)[:seconds] for low in (0.6, 0.4))
    v = v if valve else np.full(seconds, 0.7)
    friction = 1.0 + 0.02 * np.sin(2.0 * np.pi * (np.arange(seconds) / 1800.0 + rng.uniform()))
    on = {name: size * (np.arange(seconds) >= onset_s) * (name == fault) for name in SIZES}
    head = a * n**2 * (1.0 - on["f_pump"])
    q = np.sqrt(head / (b + k0 * friction + k1 / (v * (1.0 - on["f_valve"])) ** 2))
    p = head - b * q**2
    i = (0.2 * n + c * p * q / n) * (1.0 + on["f_motor"])
    y_a = (d * n**2 + 0.4 * i) * (1.0 + on["f_rotor"])
    return np.column_stack([n, v, q + on["f_y_q"], p + on["f_y_p"], i, y_a]) + rng.normal(0.0, NOISE, (seconds, 6))


def written(folder: Path, model: Path, values: Array, loop: int) -> Path:
    """Write a recording of these values."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [",".join(map(str, (k, *row))) for k, row in enumerate(values.round(6).tolist())]
    (folder / "log.csv").write_text("\n".join([f"time_s,{','.join(SIGNALS)}", *rows]) + "\n")
    given = ["--vehicle", f"loop-{loop}", "--source", "simulated", "--cycle", "steps", "--force"]
    init([str(folder / "log.csv"), "--system", str(model), "--id", f"{folder.parent.name}-{folder.name}", *given])
    return folder
