"""Begin the folder of a system from a log: its signals with units, ranges, noise and periods; the rest is marked.

`model.toml` has the signals, and places for the equations; `system.toml` has the period and the maximum ages. What is
marked FILL IN is checked by name when the model is loaded.
"""

import argparse
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from faultline.analysis.recordings.names import names_of
from faultline.analysis.recordings.offered import SI, of_columns, of_dbc, read_dbc, unit_in_name
from faultline.analysis.recordings.signatures import name_of, read_signatures
from faultline.analysis.recordings.track import Track, tracks_of
from faultline.fill_in import MARK
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.units import UNITS, plain_unit
from faultline.service.logs import Log
from faultline.service.logs.opening import open_any
from faultline.service.logs.tables.table import ColumnMap
from faultline.service.logs.units import conversion
from faultline.writing import check_folder, write_files

EXAMPLE = """examples:
  faultline new system house --from logs/week.csv
  faultline new system boiler --from residuals.csv --signatures signatures.csv
  faultline new system pump --from drive.blf --dbc truck.dbc --signals speed pressure --out systems/pump
"""
PERIODS = 5.0
"""Of a signal, after which a sample is too old."""
BEYOND = 1e4
"""How far a residual may go with a fault, in parts of what it does without."""
DIGITS = 2
"""Of ranges and noise: they are proposals."""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: the log cannot be read or has none of the signals, or the folder is there already.
    """
    parser = Parser(
        "faultline new", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["system"], help="what to begin")
    parser.add_argument("name", help="of the system, as in formulas: letters, digits, _")
    parser.add_argument("--from", dest="log", type=Path, required=True, help="a log, or a recording's folder")
    parser.add_argument("--dbc", type=Path, help="the DBC of a CAN log")
    parser.add_argument("--signals", nargs="+", metavar="NAME", help="these alone (all that the log has)")
    parser.add_argument(
        "--signatures",
        type=Path,
        metavar="CSV",
        help="the fault signature matrix of residuals that are in the log: a row for each, a column for every fault",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder to write (NAME)")
    parser.add_argument("--force", action="store_true", help="write over the files of a folder that is there")
    options = parser.parse_args(argv)
    out: Path = options.out or Path(options.name)
    if out.exists() and not options.force:
        raise InputError(f"{out}: is there already; give another folder with --out, or --force")
    check_folder(out.parent)
    log = with_units(open_any(options.log))
    signals, left_away = _signals(log, options.log, options.dbc, options.signals)
    signatures = None
    if options.signatures is not None:
        found = read_signatures(options.signatures, [signal.column for signal in signals])
        signatures = {signal.name: found[signal.column] for signal in signals if signal.column in found}
    model = model_text(options.name, log.id, signals, signatures)
    files = {"model.toml": model, "system.toml": system_text(signals)}
    write_files({out / name: text for name, text in files.items()})
    for line in left_away:
        print(line)
    made = ", ".join(str(out / name) for name in files)
    print(f"wrote {made}: fill in what is marked, then `faultline structure {out}`")
    return 0


class _Signal(NamedTuple):
    """A column or a signal of a DBC: its `name` and `unit` in the model, the unit that is `written`, its values."""

    column: str
    name: str
    written: str
    unit: str
    track: Track


def _signals(log: Log, path: Path, dbc: Path | None, wanted: list[str] | None) -> tuple[list[_Signal], list[str]]:
    """The signals of a log, and lines on those that are left away.

    Raises:
        InputError: the log has none of the signals.
    """
    written = _written(log, dbc, wanted)
    units = {name: _in_si(unit) for name, unit in written.items()}
    tracks = {name: track for name, track in _tracks(log, dbc, units).items() if len(track.t) > 2}
    if not tracks:
        raise InputError(f"{path}: none of its signals has values: {', '.join(units) or 'give its --dbc'}")
    silent = [name for name in units if name not in tracks]
    still = [name for name, track in tracks.items() if np.ptp(track.value) == 0.0] if wanted is None else []
    moving = {name: track for name, track in tracks.items() if name not in still} or tracks
    lines = [f"without values in the log, and left away: {', '.join(silent)}"] if silent else []
    if still and moving is not tracks:
        lines.append(f"never change in the log, and left away: {', '.join(still)} (--signals names those to keep)")
    names = names_of(moving)
    return [_Signal(each, names[each], written[each], units[each], track) for each, track in moving.items()], lines


def _written(log: Log, dbc: Path | None, wanted: list[str] | None) -> dict[str, str]:
    """The signals that may be there, with their units in the log."""
    offers = [] if dbc is None else of_dbc(read_dbc(dbc), str(dbc))
    offers += of_columns(log.values.file.units) if log.values is not None else []
    stated = {} if log.values is None else {each.column: each.unit for each in log.values.maps.values()}
    written = {each.name: stated.get(each.name) or each.unit for each in offers}
    if wanted is not None and (unknown := [name for name in wanted if name not in written]):
        raise InputError(f"--signals {' '.join(unknown)}: no such signals; there are {', '.join(written) or 'none'}")
    return {name: unit for name, unit in written.items() if wanted is None or name in wanted}


def _display(signals: Sequence[_Signal]) -> dict[str, str]:
    """By unit of the model the log's, as people know the system by these; of plain numbers by signal."""
    found: dict[str, str] = {}
    for signal in signals:
        plain = plain_unit(signal.written)
        if plain not in ("", signal.unit) and conversion(signal.written, signal.unit):
            found.setdefault(f"{signal.name}.display" if signal.unit == "1" else signal.unit, plain)
    return found


def with_units(log: Log) -> Log:
    """Return the log with the units that the names of its columns end with."""
    if log.values is None:
        return log
    ends = {name: unit_in_name(name) for name, unit in log.values.file.units.items() if not unit}
    maps = {name: ColumnMap(name, unit) for name, unit in ends.items() if unit}
    return replace(log, values=replace(log.values, maps={**maps, **log.values.maps}))


def _in_si(unit: str) -> str:
    plain = plain_unit(unit)
    if plain in SI:
        return plain
    return UNITS[plain][0] if plain in UNITS else next((si for si in SI if conversion(unit, si)), plain)


def _tracks(log: Log, dbc: Path | None, units: Mapping[str, str]) -> dict[str, Track]:
    table = log.table(units, log.id) if dbc is None else compile_dbc(read_dbc(dbc), units, str(dbc), convert=conversion)
    return tracks_of(log.signals(table), units)


def model_text(
    name: str,
    log: str,
    signals: Sequence[_Signal],
    signatures: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """The model file: signals as the log has them, and places for the equations, or residuals by their signatures."""
    head = [
        "schema = 1",
        f"name = {json.dumps(name)}",
        f'description = "{MARK}: what the system is"',
        f'source = "{MARK}: where the equations are from"',
        f'warm_up_s = "{MARK}: seconds until the slowest state has forgotten its start"',
        "",
        f"# Signals, as they were in {log}: ranges and noise are proposals.",
    ]
    given = signatures or {}
    known = [_known(signal, given=signal.name in given) for signal in signals]
    return "\n".join(head) + "\n" + "".join(known) + (_given(given) if given else EQUATIONS)


def _given(signatures: Mapping[str, Sequence[str]]) -> str:
    """The residuals, and the faults that they are sensitive to."""
    faults = dict.fromkeys(fault for each in signatures.values() for fault in each)
    text = "\n# Residuals of another tool: zero without a fault, and moved by these.\n"
    for signal, row in signatures.items():
        text += f"\n[residual.{signal}]\nfaults = {json.dumps([name_of(fault) for fault in row])}\n"
    for fault in faults:
        text += f"\n[fault.{name_of(fault)}]\ncomponent = {json.dumps(fault)}  # what a technician would replace\n"
    return text


EQUATIONS = f"""
# Everything else is unknown: flows, pressures, temperatures inside. A state has initial values and a derivative.

[unknown.x]
unit = "{MARK}"
description = "{MARK}"
initial = ["{MARK}: signals or parameters that give it at the start"]

[unknown.dx]
unit = "{MARK}"

[parameter.k]
unit = "{MARK}"
description = "{MARK}"
value = "{MARK}"
source = "{MARK}: datasheet, drawing, guess"

# Equations, each expr = 0 (docs/models.md), and what may fail in them. Where no formula is known,
# variables = ["a", "b"] in place of expr says what is in it, and networks learn the rest: "As structure only" there.

[[equation]]
name = "e1"
description = "{MARK}"
expr = "{MARK}"

[equation.fault]
name = "f_1"
component = "{MARK}: what a technician would replace"
description = "{MARK}: how it fails"
enters = "{MARK}: as k -> k + f_1"
sizes = []

[[differential]]
name = "e2"
state = "x"
derivative = "dx"
"""


def _known(signal: _Signal, *, given: bool) -> str:
    """A signal as it was; a `given` residual may become much larger, as faults move it."""
    track = signal.track
    low, high = float(track.value.min()), float(track.value.max())
    margin = (BEYOND if given else 0.1) * ((high - low) or abs(high) or 10.0)
    bent = track.value[:-2] - 2.0 * track.value[1:-1] + track.value[2:]
    noise = 1.4826 * float(np.median(np.abs(bent))) / math.sqrt(6.0) or 1e-3 * margin
    description = "residual of another tool" if given else MARK if signal.name == signal.column else signal.column
    unit = json.dumps(signal.unit) + ("" if signal.written.strip() else "  # the log says none")
    return (
        f"\n[known.{signal.name}]  # {len(track.t)} values from {low:.4g} to {high:.4g}, every {track.period_s:.3g} s\n"
        f"unit = {unit}\ndescription = {json.dumps(description, ensure_ascii=False)}\n"
        f"min = {rounded(low - margin, math.floor)}\nmax = {rounded(high + margin, math.ceil)}\n"
        f"noise = {rounded(noise, round)}\n"
    )


def rounded(value: float, how: Callable[[float], int]) -> str:
    """To two digits of its size, down, up or to the nearest, as a number of TOML."""
    if value == 0.0:
        return "0.0"
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - DIGITS + 1)
    return repr(float(f"{how(value / unit) * unit:.{DIGITS + 1}g}"))


def system_text(signals: Sequence[_Signal]) -> str:
    """The system file: the period of the fastest signal, ages of the others by their own, and units for people."""
    display = _display(signals)
    periods = {signal.name: float(f"{signal.track.period_s:.3g}") for signal in signals}
    fastest = min(max(min(periods.values()), 1e-3), 60.0)
    ages = "".join(f"{name}.maximum_age_s = {PERIODS * max(period, fastest):g}\n" for name, period in periods.items())
    ages += "".join(f"{key} = {json.dumps(unit)}\n" for key, unit in display.items() if key.endswith(".display"))
    others = {key: unit for key, unit in display.items() if not key.endswith(".display")}
    shown = "".join(f"{json.dumps(key)} = {json.dumps(unit)}\n" for key, unit in others.items())
    shown = shown and f"\n# In which units people read those of the model.\n\n[display]\n{shown}"
    return f"""schema = 1
period_s = {fastest:g}  # that of the fastest signal

# The age from which a sample is not used: five periods of each signal.

[signal]
{ages}{shown}
# Operating modes, if residuals look different in them (docs/models.md): a mode for each, one of them without `where`.
# [[mode]]
# name = "idle"
# where = {{ {next(iter(periods))} = {{ below = 0.0 }} }}
"""
