"""A real system at 200 Hz (`make campaign-emps EMPS=FOLDER`): what discover finds missing in a linear drive's model.

The two measured runs (Janot, Gautier and Brunot 2019) are not in this repository; FOLDER has `DATA_EMPS_SC.csv`, on
which models are fitted, and `DATA_EMPS_PULSES_SC.csv`, with force pulses, which is held out. The shipped model `emps`
lacks the Coulomb friction that is published. Chosen in sight of these runs: the operating range of the velocity, and
that its estimate is a period late. What is said of the held-out run is said of one that the fit has not seen.

A second search has the entries of `emps_own.toml` besides, as an engineer may write them: what their parameters begin
at is off by orders of magnitude, so that most have no gradient there.
"""

import argparse
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from results_page import head_commit, provenance

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.discrepancy.command import main as discover
from faultline.analysis.model import Model, load_model

RUNS = {"SC": "for estimation", "PULSES_SC": "with force pulses, held out"}
PUBLISHED = {"M": 95.1, "Fv": 203.5, "F_c": 20.4, "F_0": -3.16}
"""Of a machine whose positions are in metres; the files have them scaled."""

RECORDING = """schema = 1
id = "emps-{run}"
kind = "instrumented"
source = "measured (Janot, Gautier and Brunot 2019)"
vehicle = "emps"
cycle = "positioning"
sensor_set = "production"

[table]
file = "log.csv"
time = "time_exp"

[table.signals]
u = {{ column = "u_tot", unit = "V" }}
y_v = {{ column = "v_est", unit = "m/s" }}
"""


def recordings(data: Path, folder: Path) -> list[Path]:
    """Folders of the two runs, the one to fit on first."""
    found = []
    for run in RUNS:
        here = folder / run
        here.mkdir()
        shutil.copy(data / f"DATA_EMPS_{run}.csv", here / "log.csv")
        (here / "recording.toml").write_text(RECORDING.format(run=run))
        found.append(here)
    return found


def page(found: Mapping[str, Any], own: Mapping[str, Any], fitted: Sequence[Model], seconds: float, commit: str) -> str:
    """The results, of the search in the system's library and of that with `own` entries besides."""
    before, after = ({name: p.value for name, p in model.parameters.items() if p.calibrated} for model in fitted)
    rows = []
    for name, published in PUBLISHED.items():
        here = "coulomb_friction_F_c" if name == "F_c" else name
        values = [f"{of[here]:.4g}" if here in of else "" for of in (before, after)]
        rows.append(f"| {name} | {published:g} | {values[0]} | {values[1]} |")
    tried = [f"| {one['name']} | {one['gain']:.1f} |" for one in found["entries"] if one["gain"] is not None]
    regimes = [
        f"| {one['output']} | {one['mode']} | {one['rms_before']:.4g} | {one['rms_after']:.4g} |"
        for one in found["regimes"]
    ]
    lines = [
        "# A real system at 200 Hz: a linear drive",
        "",
        "Made by `make campaign-emps EMPS=FOLDER`; the data are measured, and not in this repository.",
        provenance(commit, seconds),
        "",
        f"Verdict: **{found['verdict']['sentence']}**, {found['verdict']['gain']:.0f} nats where "
        f"{found['verdict']['threshold']:.0f} are asked for; {found['verdict']['remainder']:.0f} "
        "nats are left unexplained.",
        "",
        "| effect of the general library, bound to the drive | evidence [nats] |",
        "|---|---:|",
        *tried,
        "",
        "| parameter | published | without friction | with it |",
        "|---|---:|---:|---:|",
        *rows,
        "",
        "The files have positions from -1 to 1, so masses and viscous friction are in units of the stroke: only F_c",
        "and F_0 [N] and the ratio Fv/M [1/s] compare: published "
        f"{PUBLISHED['Fv'] / PUBLISHED['M']:.3g}, found {after['Fv'] / after['M']:.3g}.",
        "",
        "| held-out free run | mode | RMS error before [m/s] | after |",
        "|---|---|---:|---:|",
        *regimes,
        "",
        "## Entries of an engineer's own",
        "",
        "Entries of `tests/campaigns/emps_own.toml` besides the system's, whose parameters begin orders of magnitude",
        "off: most do nothing there at any size, and the gradient is zero. What the local search left open was",
        "searched globally. They were written in sight of these runs.",
        "",
        f"Verdict: **{own['verdict']['sentence']}**, {own['verdict']['gain']:.0f} nats; "
        f"{own['verdict']['remainder']:.0f} nats are left unexplained. Held-out free run: RMS error "
        f"{own['regimes'][0]['rms_before']:.4g} m/s before, {own['regimes'][0]['rms_after']:.4g} after.",
        "",
        "| entry | tried | evidence [nats] | best size, alone | against it |",
        "|---|---|---:|---|---|",
        *_own_rows(own),
    ]
    return "\n".join([*lines, ""])


def _own_rows(own: Mapping[str, Any]) -> list[str]:
    """An engineer's entries, by evidence."""
    rows = []
    for one in own["entries"]:
        if one["own"]:
            tried = f"{one['starts']} starts" + (f", {one['sizes']} sizes" if one["sizes"] else "")
            best = "; ".join(strength["words"] for strength in one["best"])
            evidence = "" if one["gain"] is None else f"{one['gain']:.1f}"
            rows.append(f"| {one['name']} | {tried} | {evidence} | {best} | {'; '.join(one['against'])} |")
    return rows


def main() -> None:
    """Runs it and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results/emps.md"))
    options = parser.parse_args()
    start, commit = time.monotonic(), head_commit()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        fit, held = map(str, recordings(options.data, folder))
        calibrate(["emps", fit, "--validate", held, "--out", str(folder / "bare.toml"), "--force"])
        discover(["emps", fit, "--held-out", held, "--out", str(folder / "found"), "--apply"])
        found = json.loads((folder / "found" / "discovery.json").read_text())
        library = str(Path(__file__).with_name("emps_own.toml"))
        discover(["emps", fit, "--held-out", held, "--out", str(folder / "own"), "--library", library])
        own = json.loads((folder / "own" / "discovery.json").read_text())
        fitted = [load_model(folder / "bare.toml"), load_model(folder / "found" / "model.toml")]
        options.out.write_text(page(found, own, fitted, time.monotonic() - start, commit))


if __name__ == "__main__":
    main()
