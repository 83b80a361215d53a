"""The model file: TOML to `Model`.

    schema = 1
    name = "uds"
    warm_up_s = 20.0         after this long no state remembers its assumed start [s]  (20 if absent)
    [known.y_p_tp]           unit, description, min, max, noise, zero, drift, added  (the last three may be absent)
    [unknown.p_tp]           unit, description, initial = ["y_p_tp", "p_tank"]  (states only)
    [parameter.A_t]          unit, description, value, min, max, prior or spread, drift, source  (only value is a must)
    [curve.k_valve]          description, source, x = [...], y = [...]; a map has z = [[...], ...], a row for each x
    [[equation]]             name, description, expr = "q - A*sgsqrt(d)"  (= 0), fault, disturbance  (may be absent);
                             where no formula is known, variables = ["q", "d"] and fault = {name, component, ...}
      fault = {name, component, description, enters = "A -> A + fA", sizes = [...], relative_to = "A",
               share_of = "k", shares = [...]}: a second form, in which parameter k changes by these fractions
               consequence = {fault = "fB", where = {y = {below = 2.0}}}: at such signals it brings that fault's effect
                           in the larger half of its sizes, or in those of `sizes`
      disturbance = {the same without a component}: what may be wrong here that is no component's fault, as a leak
    [[differential]]         name, state, derivative
    [residual.r1]            faults: instead of equations, a known signal that another tool computes, zero without them
    [fault.f_leak]           component, description: what these faults are
    [[provenance]]           any keys: what calibration did

What stands in `system.toml` beside it may stand here as well (`analysis.model.system`); a file that has a period or
modes of its own is whole.

Strict: an unknown key, an undeclared name or a wrong type is an error that names its place.
"""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import sympy as sp

from faultline import systems
from faultline.analysis.model.bench import bench_of
from faultline.analysis.model.check import check_model, check_names
from faultline.analysis.model.curves import Curve, Curves, trouble
from faultline.analysis.model.display import units_of
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.model.faults import code_of, fault_of, listed_fault, residual_of, structural_fault
from faultline.analysis.model.model import (
    PERIODS,
    WARM_UP_S,
    Differential,
    Equation,
    Known,
    Model,
    Parameter,
    Unknown,
    check_bounds,
)
from faultline.analysis.model.names import entering, unformulated
from faultline.analysis.model.older import as_written_today
from faultline.analysis.model.system import SYSTEM, modes_of, with_system
from faultline.analysis.model.tables import Table
from faultline.fill_in import unfilled

SCHEMA = 1
ANY = 1e12
"""The bounds of a signal of which no range is known."""
LISTED = 6
"""Places to fill in that a message lists."""
SHORTEST_S, LONGEST_S = 1e-3, 60.0
"""Of sampling periods."""

SYSTEMS = Path(systems.__file__).parent
MODEL = "model.toml"
NO_MODELS = (SYSTEM, "effects.toml", "experiments.toml")


def load_model(path: str | Path) -> Model:
    """The model in a file or in the folder of a system, or the shipped one of that name.

    Raises:
        ModelError: there is no such file, or it is no valid model.
    """
    file = model_file(path)
    try:
        text = file.read_bytes().decode()
    except OSError as error:
        names = ", ".join(shipped_models())
        raise ModelError(
            f"{path}: cannot be read; give a model file, a system's folder, or a shipped model: {names}"
        ) from error
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not a text file in UTF-8 (byte {error.start})") from error
    beside = file.with_name(SYSTEM)
    return parse_model(text, str(path), beside if beside.is_file() else None, whole=file.name == MODEL)


def model_file(path: str | Path) -> Path:
    """The file that `load_model` reads, whether it is there or not."""
    file = Path(path) / MODEL if Path(path).is_dir() else Path(path)
    return file if file.is_file() else shipped_models().get(str(path), file)


def folder_of(path: str | Path, name: str) -> Path | None:
    """The folder of the system that the model in a file or folder, or of a shipped name, belongs to.

    It is where the model lies, if that is a system's; else that of the shipped model of the same `name`, which a
    calibrated one keeps. None where there is neither.
    """
    file = Path(path) if Path(path).exists() else shipped_models().get(str(path), Path(path))
    folder = file if file.is_dir() else file.parent
    if file.is_dir() or any((folder / beside).is_file() for beside in NO_MODELS):
        return folder
    return next((one.parent for one in shipped_models().values() if _name(one) == name), None)


def alike(model: Model) -> Path | None:
    """The folder of a shipped system whose model has the signals, unknowns and parameters of this one, if there is one.

    A data sheet of another make is often a copy of its file, under another name and in a place of its own.
    """
    names = [*model.known], [*model.unknown], [*model.parameters]
    tables = ("known", "unknown", "parameter")
    for file in shipped_models().values():
        own = tomllib.loads(file.read_text())
        if all(own.get(table, {}).keys() == {*found} for table, found in zip(tables, names, strict=True)):
            return file.parent
    return None


@cache
def _name(file: Path) -> object:
    return tomllib.loads(file.read_text()).get("name")


def shipped_models() -> Mapping[str, Path]:
    """The models that come with the program: a system's by its name, its others as `uds/production`."""
    found = sorted(path for path in SYSTEMS.glob("*/*.toml") if path.name not in NO_MODELS)
    named = {path: path.parent.name if path.name == MODEL else f"{path.parent.name}/{path.stem}" for path in found}
    return {name: path for path, name in sorted(named.items(), key=lambda each: each[1])}


def parse_model(text: str, where: str, system: Path | None = None, *, whole: bool = False) -> Model:
    """The model in TOML text, with what the file `system` says of it; messages begin with `where`.

    A `whole` model has all signals of which the system says something.

    Raises:
        ModelError: the text is no valid model.
    """
    try:
        written = as_written_today(tomllib.loads(text), where)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModelError(f"{where}: not TOML: {error}") from error
    if marked := list(unfilled(written)):
        more = f" and {len(marked) - LISTED} more" if len(marked) > LISTED else ""
        raise ModelError(f"{where}: still to be filled in: {', '.join(marked[:LISTED])}{more}")
    top = Table(written if system is None else with_system(written, where, system, whole=whole), where, top=True)
    schema = top.number("schema")
    if schema != SCHEMA:
        raise top.fail("schema", f"this is {schema:g}, readable is {SCHEMA}; use the faultline that wrote the file")
    equations = top.tables("equation")
    formulas = not any(table.has("variables") for table in equations)
    known = {name: _known(table, formulas) for name, table in top.named_tables("known").items()}
    unknown = top.named_tables("unknown")
    parameters = {name: _parameter(table) for name, table in top.named_tables("parameter").items()}
    curves = {name: _curve(table) for name, table in top.named_tables("curve").items()}
    names = check_names([*known], [*unknown], [*parameters], [*curves], where)
    listed = {name: listed_fault(table, names) for name, table in top.named_tables("fault").items()}
    read = [_equation(table, names, curves) for table in equations]
    warm_up_s = _warm_up(top)
    model = Model(
        name=top.text("name"),
        description=top.text("description", ""),
        source=top.text("source", ""),
        known=known,
        unknown={name: _unknown(table, [*known, *parameters], curves, formulas) for name, table in unknown.items()},
        parameters=parameters,
        curves=curves,
        equations={equation.name: equation for equation in read},
        differentials=tuple(_differential(table) for table in top.tables("differential")),
        residuals={name: residual_of(table, known, listed) for name, table in top.named_tables("residual").items()},
        listed_faults=listed,
        provenance=tuple(table.rest() for table in top.tables("provenance")),
        modes=modes_of(top, known),
        bench=bench_of(top, {name: each.unit for name, each in known.items()}, parameters),
        warm_up_s=warm_up_s,
        period_s=_period(top, warm_up_s),
        display=_display(top),
    )
    top.done()
    units_of(model, where)  # each is of the right dimension
    check_model(model, [equation.name for equation in read], where)
    return model


def _warm_up(top: Table) -> float:
    seconds = top.optional_number("warm_up_s")
    if seconds is not None and seconds < 0:
        raise top.fail("warm_up_s", f"{seconds:g} s is no time; give zero or more")
    return WARM_UP_S if seconds is None else seconds


def _period(top: Table, warm_up_s: float) -> float:
    seconds = top.optional_number("period_s")
    if seconds is not None and not SHORTEST_S <= seconds <= LONGEST_S:
        raise top.fail("period_s", f"{seconds:g} s; give {SHORTEST_S:g} s to {LONGEST_S:g} s")
    return min(max((warm_up_s or WARM_UP_S) / PERIODS, SHORTEST_S), LONGEST_S) if seconds is None else seconds


def _display(top: Table) -> dict[str, tuple[str, ...]]:
    table = top.table("display")
    written = {} if table is None else table.rest()
    wanted = Table(written, top.at("display"))
    return {unit: wanted.text_or_texts(unit) for unit in written}


def _known(table: Table, formulas: bool) -> Known:
    """A signal; without formulas it may have any unit, range and noise."""

    def number(key: str, otherwise: float) -> float:
        return table.number(key) if formulas or table.has(key) else otherwise

    known = Known(
        unit=table.text("unit", None if formulas else ""),
        description=table.text("description", ""),
        min=number("min", -ANY),
        max=number("max", ANY),
        noise=number("noise", 0.0),
        zero=table.optional_number("zero") or 0.0,
        drift=table.optional_number("drift") or 0.0,
        added=table.flag("added"),
        maximum_age_s=table.optional_number("maximum_age_s"),
        lag_s=table.optional_number("lag_s"),
        outlier=table.optional_number("outlier"),
        sensor_min=table.optional_number("sensor_min"),
        label=table.text("label", ""),
        display=table.text_or_texts("display"),
    )
    table.done()
    for name in ("maximum_age_s", "lag_s"):
        if (seconds := getattr(known, name)) is not None and seconds <= 0:
            raise table.fail(name, f"{seconds:g} s; give a positive one")
    if known.outlier is not None and known.outlier <= 0:
        raise table.fail("outlier", f"{known.outlier:g}; give a positive distance in the signal's unit")
    if known.min >= known.max:
        raise table.fail("max", f"the operating range [{known.min:g}, {known.max:g}] is empty")
    if known.sensor_min is not None and known.sensor_min > known.min:
        raise table.fail(
            "sensor_min", f"{known.sensor_min:g} is within the operating range; give less than {known.min:g}"
        )
    if known.noise <= 0 and (formulas or table.has("noise")):
        raise table.fail("noise", "must be positive: it is the scale of the sensor's residuals")
    for name in ("zero", "drift"):
        _check_deviation(table, name, getattr(known, name))
    return known


def _check_deviation(table: Table, name: str, value: float) -> None:
    if value < 0:
        raise table.fail(name, f"{value:g} is no standard deviation; give a positive one, or none")


def _unknown(table: Table, names: Sequence[str], curves: Curves, formulas: bool) -> Unknown:
    texts = table.texts("initial")
    unknown = Unknown(
        unit=table.text("unit", None if formulas else ""),
        description=table.text("description", ""),
        initial=tuple(parse_expression(t, names, table.at(f"initial[{k}]"), curves) for k, t in enumerate(texts)),
        initial_text=texts,
        min=table.optional_number("min"),
    )
    table.done()
    return unknown


def _parameter(table: Table) -> Parameter:
    parameter = Parameter(
        unit=table.text("unit"),
        description=table.text("description", ""),
        value=table.number("value"),
        min=table.optional_number("min"),
        max=table.optional_number("max"),
        prior=table.optional_number("prior"),
        source=table.text("source", ""),
        spread=table.optional_number("spread"),
        drift=table.optional_number("drift") or 0.0,
    )
    table.done()
    _check_deviation(table, "drift", parameter.drift)
    if parameter.drift and not parameter.value:
        raise table.fail("drift", "is in parts of the value, and that is zero; give the value that it usually has")
    check_bounds(parameter, table.place)
    return parameter


def _curve(table: Table) -> Curve:
    rows = table.rows("z")
    curve = Curve(
        x=table.numbers("x"),
        y=table.numbers("y"),
        z=rows,
        description=table.text("description", ""),
        source=table.text("source", ""),
    )
    table.done()
    if why := trouble(curve):
        raise ModelError(f"{table.place}: {why}")
    return curve


def _equation(table: Table, names: Sequence[str], curves: Curves) -> Equation:
    if table.has("variables"):
        return _structural(table, names)
    text = table.text("expr")
    fault, disturbance = table.table("fault"), table.table("disturbance")
    equation = Equation(
        name=table.text("name"),
        description=table.text("description", ""),
        text=text,
        expression=parse_expression(text, names, table.at("expr"), curves),
        fault=None if fault is None else fault_of(fault, names, fault.text("component"), *code_of(fault)),
        disturbance=None if disturbance is None else fault_of(disturbance, names, ""),
    )
    table.done()
    for what, each in (("fault", equation.fault), ("disturbance", equation.disturbance)):
        if each is not None and sp.Symbol(each.enters) not in equation.expression.free_symbols:
            raise table.fail(f"{what}.enters", f"{each.enters} is not in `{text}`; a {what} must change its equation")
    return equation


def _structural(table: Table, names: Sequence[str]) -> Equation:
    """An equation of which only the variables are known."""
    name, text = table.text("name"), table.text("description", "")
    variables, fault, disturbance = table.texts("variables"), table.table("fault"), table.table("disturbance")
    if not variables:
        raise table.fail("variables", "is empty; name the variables of the equation")
    entered = None if fault is None else entering(structural_fault(fault, names, is_fault=True), variables)
    disturbed = (
        None if disturbance is None else entering(structural_fault(disturbance, names, is_fault=False), variables)
    )
    equation = unformulated(name, text, variables, entered, disturbed)
    table.done()
    for name in variables:
        if name not in names or variables.count(name) > 1:
            problem = "is declared nowhere; declare it" if name not in names else "is there twice; name it once"
            raise table.fail("variables", f"{name} {problem}")
    return equation


def _differential(table: Table) -> Differential:
    differential = Differential(name=table.text("name"), state=table.text("state"), derivative=table.text("derivative"))
    table.done()
    return differential
