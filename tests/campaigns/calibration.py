"""How well a calibration finds what the rig knows: scattered trucks of profile `ideal`, from two loggers to a report.

    .venv/bin/python tests/campaigns/calibration.py --out docs/results/calibration.md

Every truck of the fleet has its own tolerances and age. It is recorded on the training and on the validation cycle,
both recordings are ingested, the four-state model is calibrated on the first, and compared with the second in a free
run. A parameter is recovered where its true value lies within the stated 95 % interval. The displacement is the anchor
(pressures alone cannot tell the flow scale), so the others are compared as they are relative to it.
"""

import argparse
import math
import multiprocessing
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from results_page import head_commit, provenance, share, wilson

from faultline.analysis.calibration.fit import fit, nuisances
from faultline.analysis.calibration.identify import Estimate, identify
from faultline.analysis.calibration.sections import Section, sections
from faultline.analysis.calibration.validate import STEADY, Agreement, validate
from faultline.analysis.model import Model, load_model
from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.ingest import ingest
from faultline.analysis.simulation import System, system_of
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.logs import open_log
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.effects import PROFILES
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.restriction import Restriction
from faultline.testbench.vehicles import MAXIMUM_FLOW, Vehicle, vehicle

DURATION_S = 480.0
ANCHOR = "D_p"
WITH_FLOW, AGAINST_FLOW = ("A_t", "A_p", "A_du", "A_ori", "A_dos"), ("B_ap",)
"""How a parameter scales with the displacement, at given pressures."""


@dataclass(frozen=True)
class Result:
    """One truck: errors and stated 95 % half widths of the logarithms, free run by output and mode, seconds taken."""

    name: str
    error: dict[str, float]
    half: dict[str, float]
    told: dict[str, bool]
    agreement: dict[str, dict[str, Agreement]]
    seconds: float


def run(number: int) -> Result:
    """Calibrates the truck of this number."""
    truck, model = vehicle(f"truck-{number}"), load_model("uds")
    system = system_of(model, model.varying)
    with tempfile.TemporaryDirectory() as folder:
        training, validation = (_sections(truck, cycle, number, model, system, Path(folder)) for cycle in CYCLES_USED)
    start = time.monotonic()
    found = fit(system, training, lambda _: None)
    seconds = time.monotonic() - start
    estimates, values = identify(found).estimates, true_values(truck, model)
    scale = found.values[ANCHOR] / values[ANCHOR]
    error = {}
    for name, value in values.items():
        expected = value * (scale if name in WITH_FLOW else 1 / scale if name in AGAINST_FLOW else 1.0)
        error[name] = math.log(found.values[name] / expected)
    runs = validate(system, validation, found.unknowns.usual(found.x), nuisances(found, validation))
    return Result(
        name=truck.name,
        error={name: e for name, e in error.items() if name != ANCHOR},
        half={name: 0.5 * math.log(high / low) for name in error for low, high in [_interval(estimates[name])]},
        told={name: estimates[name].told for name in error},
        agreement=runs.agreement,
        seconds=seconds,
    )


CYCLES_USED = ("training", "validation")


def _interval(estimate: Estimate) -> tuple[float, float]:
    return estimate.interval(estimate.relative_spread)


def _sections(truck: Vehicle, cycle: str, seed: int, model: Model, system: System, folder: Path) -> list[Section]:
    request = Request(f"{cycle}", truck, CYCLES[cycle], (), seed, DURATION_S, PROFILES["ideal"])
    bench, _ = record(request, load_dbc(), folder / "bench", folder / "truth", force=False, progress=lambda _: None)
    ingested = folder / cycle
    ingested.mkdir()
    for name, content in ingest(bench, setup_of(model.name), lambda _: None).files.items():
        (ingested / name).write_bytes(content)
    log = open_log(ingested)
    table = compile_dbc(log.dbc, {name: known.unit for name, known in model.known.items()}, str(ingested))
    return sections(model, system, log.signals(table), cycle)


def true_values(truck: Vehicle, model: Model) -> dict[str, float]:
    """What the diagnosis model's parameters are for this truck."""
    plant, pump = truck.plant, truck.pump
    value = {name: p.value for name, p in model.parameters.items()}
    rest = value["V_du"] / value["B_du"]
    hose = plant.hose.rated + plant.compliance_du - rest  # the model has all that swells in V_ap, but for B_du's part
    return {
        "D_p": pump.displacement,
        "C_v": pump.leakage * value["eta"] / pump.displacement,
        "A_t": _area(plant.tank_filter, value),
        "A_p": _area(plant.pump_filter, value),
        "A_du": _area(plant.du_filter, value),
        "A_ori": _area(plant.return_orifice, value),
        "A_dos": _area(plant.dosing_valve, value),
        "B_ap": value["V_ap"] / hose,
    }


def _area(restriction: Restriction, value: dict[str, float]) -> float:
    """Of the turbulent orifice with the same drop at the largest flow."""
    return MAXIMUM_FLOW / (value["C_q"] * math.sqrt(2 / value["rho"] * restriction.drop(MAXIMUM_FLOW)))


def hour() -> float:
    """Seconds that the rig takes to record an hour of a truck's random drive, on one core."""
    request = Request("hour", vehicle("truck"), CYCLES["drive"], (), 0, 3600.0)
    with tempfile.TemporaryDirectory() as folder:
        start = time.monotonic()
        out = Path(folder)
        record(request, load_dbc(), out / "bench", out / "truth", force=False, progress=lambda _: None)
        return time.monotonic() - start


def page(results: list[Result], rig_s: float, commit: str, seconds: float) -> str:
    """The results as Markdown; `rig_s` is what an hour of the rig takes [s]."""
    within = {name: sum(abs(r.error[name]) <= r.half[name] for r in results) for name in results[0].error}
    every = sum(all(abs(e) <= r.half[name] for name, e in r.error.items()) for r in results)
    pairs = len(results) * len(within)
    taken = np.array([r.seconds for r in results])
    lines = [
        "# Calibration of the four-state model",
        "",
        f"{len(results)} trucks of the rig's fleet (`tests/campaigns/calibration.py`), each with tolerances and age of "
        f"its own, profile `ideal`, {DURATION_S:g} s a cycle; two loggers, ingested; calibrated on the training cycle, "
        "free run over the validation cycle. All data are simulated.",
        "",
        f"**Within the stated 95 % intervals: {share(sum(within.values()), pairs)} of all parameters; "
        f"in {every} of {len(results)} trucks all {len(within)} at once.** One calibration, four searches: median "
        f"{np.median(taken):.0f} s, longest {taken.max():.0f} s, two side by side.",
        "",
        "| parameter | within | the share, 95 % | half width, median | error, RMS | error / half width, RMS |",
        "|---|---|---|---|---|---|",
    ]
    for name, count in within.items():
        low, high = wilson(count, len(results))
        half, error = (np.array([getattr(r, key)[name] for r in results]) for key in ("half", "error"))
        z = math.sqrt(float(np.mean((error / half) ** 2)))
        note = "" if all(r.told[name] for r in results) else " (not told by the data, prior only)"
        lines.append(
            f"| {name}{note} | {count} | {100 * low:.0f} to {100 * high:.0f} % | {100 * np.median(half):.2f} % | "
            f"{100 * math.sqrt(float(np.mean(error**2))):.2g} % | {z:.2f} |"
        )
    lines += ["", *_free_runs(results), ""]
    lines += [f"One hour of a truck's random drive is recorded in {rig_s:.0f} s on one core.", ""]
    lines += [provenance(commit, seconds), ""]
    return "\n".join(lines)


def _free_runs(results: list[Result]) -> list[str]:
    lines = [
        "Free run over the validation cycle: RMS error over the channel's noise floor (sensor and valve's ripple, "
        "around lines of 5 s). *Expected* is what the errors of the inputs make of the right model: the pump speed's "
        "noise is integrated, and so is what a dose step's unknown time leaves.",
        "",
        "| output | mode | RMS [Pa], median | noise floor [Pa] | ratio, median | 95 % | largest | expected [Pa] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for output, by_mode in results[0].agreement.items():
        for mode in sorted(by_mode, key=lambda mode: mode != STEADY):
            those = [r.agreement[output][mode] for r in results if mode in r.agreement[output]]
            ratio = np.array([a.rms / a.floor for a in those])
            rms, floor, expected = (np.median([getattr(a, key) for a in those]) for key in ("rms", "floor", "expected"))
            lines.append(
                f"| {output} | {mode} | {rms:.0f} | {floor:.0f} | {np.median(ratio):.2f} | "
                f"{np.quantile(ratio, 0.95):.2f} | {ratio.max():.2f} | {expected:.0f} |"
            )
    return lines


def campaign(count: int, processes: int = 2) -> list[Result]:
    """Trucks 1 to `count`."""
    with multiprocessing.Pool(processes) as pool:
        return pool.map(run, range(1, count + 1), chunksize=1)


def main() -> None:
    """Runs the campaign and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    start, commit = time.monotonic(), head_commit()
    results = campaign(options.count)
    text = page(results, hour(), commit, time.monotonic() - start)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
