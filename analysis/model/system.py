"""What is said of a system besides its equations: `system.toml`, beside its models.

schema = 1
period_s = 0.2           ticks are so far apart [s]  (a hundredth of the warm-up if absent)
[signal.y_p_tp]          maximum_age_s: an older sample is not used [s]  (five periods if absent)
      lag_s                  how late it may show, a standard deviation [s]  (a tenth of a period if absent)
      outlier                a sample so far from those around it that does not last is wrong  (by its noise if absent)
      label, display         its name for people (its description if absent), and units as in [display]
[display]                Pa = "bar", or ["bar", "mbar"]: units of the model as people read them, coarse to fine
[fault.fA_t]             spn, fmi: its code on a J1939 network
[component."tank filter"]  place: where to find it
[[mode]]                 name, description, instruction, where = {dc_dose = {above = 0.0, below = 0.02}}
(the first that holds counts; one has no `where` and holds where no other does; none: one mode)
[edges]                  settle_s, steps = {n_p = 4.0}: how long a step counts, and how large it is
[bench]                  how it is measured on a test bench (`analysis.model.bench`)
"""

import copy
import tomllib
from collections.abc import Mapping
from pathlib import Path

from faultline.analysis.model.bench import of_variant
from faultline.analysis.model.bounds import bounds_of
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.model import EDGE, ONE_MODE, Known, Mode, OperatingModes
from faultline.analysis.model.tables import Table, first_repeated

SYSTEM = "system.toml"
SCHEMA = 1
OF_SYSTEM = ("period_s", "mode", "edges", "bench", "display")
"""Keys of a model file, and a file that has one of them says all of it itself."""
OF_FAULTS = ("fault", "component")
"""Tables that say more of faults, by their names or by those of their components."""


def with_system(model: Mapping[str, object], where: str, file: Path, *, whole: bool) -> dict[str, object]:
    """Return the tables of a model with what the system's file says of it.

    Raises:
        ModelError: the file is not valid, or speaks of a signal that a `whole` model has not.
    """
    if any(key in model for key in OF_SYSTEM):
        return dict(model)
    try:
        top = Table(tomllib.loads(file.read_bytes().decode()), str(file), top=True)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModelError(f"{file}: not read: {error}") from error
    if top.number("schema") != SCHEMA:
        raise top.fail("schema", f"readable is {SCHEMA}; use the faultline that wrote the file")
    known = model.get("known")
    signals = dict(known) if isinstance(known, dict) else {}
    for name, table in top.named_tables("signal").items():
        if name in signals and isinstance(signals[name], dict):
            signals[name] = {**table.rest(), **signals[name]}
        elif whole:
            raise ModelError(f"{table.place}: {where} has no known signal {name}; those are {', '.join(signals)}")
    faults = _with_faults(model, top, where, whole=whole)
    rest = top.rest()
    for key in rest:
        if key not in OF_SYSTEM:
            raise top.fail(
                key, f"unknown key; allowed here are {', '.join(('schema', 'signal', *OF_FAULTS, *OF_SYSTEM))}"
            )
    if not whole:
        parameters = model.get("parameter")
        rest |= of_variant(rest.pop("bench", None), signals, parameters if isinstance(parameters, dict) else ())
    return {**model, **rest, "known": signals, **faults}


def _with_faults(model: Mapping[str, object], top: Table, where: str, *, whole: bool) -> dict[str, object]:
    """The equations and the listed faults, with the codes and places that the system's file gives."""
    found = copy.deepcopy({key: model[key] for key in ("equation", "fault") if key in model})
    equations, listed = found.get("equation"), found.get("fault")
    faults = [e.get("fault") for e in (equations if isinstance(equations, list) else []) if isinstance(e, dict)]
    named = [(str(fault.get("name")), fault) for fault in faults if isinstance(fault, dict)]
    named += [(name, fault) for name, fault in (listed if isinstance(listed, dict) else {}).items()]
    for key in OF_FAULTS:
        there = [(name if key == "fault" else str(fault.get(key)), fault) for name, fault in named]
        for name, table in top.named_tables(key).items():
            more, meant = table.rest(), [fault for its, fault in there if its == name]
            if whole and not meant:
                names = ", ".join(its for its, _ in there)
                raise ModelError(f"{table.place}: {where} has no {key} {name}; those are {names}")
            for fault in meant:
                fault.update({**more, **fault})
    return found


def modes_of(top: Table, known: Mapping[str, Known]) -> OperatingModes:
    """The operating modes in the tables of a model.

    Raises:
        ModelError: they are not valid.
    """
    tables, edges = top.tables("mode"), top.table("edges")
    steady = tuple(_mode(table, known) for table in tables) or ONE_MODE.steady
    if (twice := first_repeated([EDGE, *(mode.name for mode in steady)])) is not None:
        raise top.fail("mode", f"two modes are named {twice}; rename one ({EDGE} is the time after a step)")
    if sum(not mode.where for mode in steady) != 1:
        raise top.fail("mode", "give exactly one mode without `where`: it holds where no other does")
    if edges is None:
        return OperatingModes(steady=steady, edges={}, settle_s=0.0)
    settle_s, steps = edges.number("settle_s"), _steps(edges, known)
    edges.done()
    if settle_s <= 0 or not steps:
        raise edges.fail("settle_s", "steps and a positive settle_s go together; give both or leave [edges] away")
    return OperatingModes(steady=steady, edges=steps, settle_s=settle_s)


def _mode(table: Table, known: Mapping[str, Known]) -> Mode:
    bounds = bounds_of(table)
    for name in bounds:
        if name not in known:
            raise ModelError(f"{table.at('where')}.{name}: {name} is no known signal; those are {', '.join(known)}")
    mode = Mode(
        name=table.text("name"),
        where=bounds,
        description=table.text("description", ""),
        instruction=table.text("instruction", ""),
    )
    table.done()
    return mode


def _steps(edges: Table, known: Mapping[str, Known]) -> dict[str, float]:
    """The sizes of steps by signal, in the file's order."""
    table = edges.table("steps")
    written = {} if table is None else table.rest()
    sizes = Table(written, edges.at("steps"))
    for name in written:
        if name not in known:
            raise sizes.fail(name, f"is no known signal; those are {', '.join(known)}")
    steps = {name: sizes.number(name) for name in written}
    for name, size in steps.items():
        if size <= 0:
            raise sizes.fail(name, f"a step of {size:g} is none; give a positive one")
    return steps
