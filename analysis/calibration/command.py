"""Fit a model's parameters to a fault-free recording."""

import argparse
import hashlib
from pathlib import Path

import msgspec

from analysis.calibration.fit import Fit, fit
from analysis.graph.bank import Bank, build_bank
from analysis.model import dump_model
from analysis.progress import Progress
from analysis.recordings.observe import observe, open_known
from analysis.structure.lint import sound_model
from service.core.decode import compile_dbc

EXAMPLE = """example:
  faultline calibrate uds4 logs/bench-training-s1 --out calibrated.toml
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline calibrate", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, or the name of a shipped model")
    parser.add_argument("recording", type=Path, help="an instrumented, fault-free recording")
    parser.add_argument("--out", type=Path, required=True, help="where to write the calibrated model file")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    options = parser.parse_args(argv)
    model = sound_model(options.model)
    bank = build_bank(model)
    with Progress(f"calibrating {model.name}") as progress:
        log = open_known(options.recording, progress.note)
        table = compile_dbc(log.dbc, {channel.signal: channel.unit for channel in bank.inputs}, str(options.recording))
        result = fit(bank, observe(bank, table, log.relative()), str(options.recording), progress.say)
    entry = {"command": "calibrate", "recordings": [log.sha256], "blocks": result.blocks}
    text = dump_model(model.with_parameters(result.values, entry))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text)
    print(msgspec.json.encode(result).decode() if options.json else _table(bank, result, options.out, text))
    return 0


def _table(bank: Bank, result: Fit, out: Path, text: str) -> str:
    lines = [f"{'parameter':<10}{'datasheet':>14}{'calibrated':>14}{'spread':>9}  unit"]
    for name, value in result.values.items():
        parameter = bank.model.parameters[name]
        lines.append(f"{name:<10}{parameter.value:>14.4g}{value:>14.4g}{result.spread[name]:>8.1%}  {parameter.unit}")
    units = dict(zip((test.name for test in bank.tests), bank.units, strict=True))
    lines.append("residual (RMS of 5 s means): " + ", ".join(f"{t} {v:.3g} {units[t]}" for t, v in result.rms.items()))
    lines.append(
        f"wrote {out} (sha256 {hashlib.sha256(text.encode()).hexdigest()[:12]}), from {result.blocks} steady blocks"
    )
    return "\n".join(lines)
