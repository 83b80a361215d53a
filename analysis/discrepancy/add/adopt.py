"""Effects taken into a model for good, and out again: the provenance entry of a discovery holds what it has replaced.

command = "discover"
effects = ["full_open_gain"]     in the order in which they were added
recordings, held_out             SHA-256 of the logs that were fitted, and of those that the choice was judged on
...                              whatever else is to be known: vehicle, evidence
[was]                            what `undone` needs
  value = {C_v = 2.1e-9}         of the parameters that have another one now
  expr = {e04 = "..."}           formulas of the equations that have another one now
  enters = {e16 = "..."}         where faults entered that enter elsewhere now
  added = {parameter, unknown, equation, differential}    lists of names

Only what came last can be undone: what a later calibration has found holds for the model with the effects in it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TypeVar

from faultline.analysis.calibration.provenance import DISCOVER
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.model import Model, ModelError, Parameter, dump_model, parse_model
from faultline.analysis.model.tables import Table

T = TypeVar("T")

ROUNDING = 1e-9
"""Of a bound and of a spread: a value that is beyond the bound by less is at it."""


def adopted(model: Model, effects: Sequence[Effect], values: Mapping[str, float], facts: Mapping[str, object]) -> Model:
    """The model with the effects in it, its calibrated parameters at `values` [SI], and what was done in provenance.

    `facts` has `recordings` and `held_out` (lists of SHA-256), and whatever else shall be kept.

    Raises:
        ModelError: an effect has no place in the model; a calibrated parameter has no value, or one outside its bounds;
            a fact is nothing that TOML can hold.
    """
    new = model
    for effect in effects:
        new = rewritten(new, effect)
    missing = [name for name in new.calibrated if name not in values]
    if missing:
        raise ModelError(f"{model.name}: parameter.{missing[0]}: was not fitted; give values of {', '.join(missing)}")
    inside = within_bounds(new, values)
    entry = {"command": DISCOVER, "effects": [effect.name for effect in effects], **facts}
    new = new.with_parameters({**values, **inside}, _plain({**entry, "was": _was(model, new, inside)}))
    return parse_model(dump_model(new), model.name)


def undone(model: Model) -> Model:
    """The model as it was before its discovery.

    Raises:
        ModelError: the model's last provenance entry is none of a discovery, or does not fit what is in the model.
    """
    place = f"{model.name}: provenance[{len(model.provenance) - 1}]"
    if not model.provenance:
        raise ModelError(f"{model.name}: provenance: is empty, there is nothing to undo; give a model with an effect")
    entry = model.provenance[-1]
    if entry.get("command") != DISCOVER:
        problem = f"is of {entry.get('command')!r}, and only a discovery that came last can be undone"
        raise ModelError(f"{place}: {problem}; give the model file that was there before")
    was = Table(entry, place).table("was")
    if was is None:
        raise ModelError(f"{place}.was: is missing; give the model file as `faultline discover` wrote it")
    return parse_model(dump_model(_restored(model, was)), model.name)


def within_bounds(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """The values of the model's parameters, at the bound where rounding has carried one beyond it."""
    return {name: _inside(model.parameters[name], value) for name, value in values.items() if name in model.parameters}


def _inside(parameter: Parameter, value: float) -> float:
    """The value, or the bound that rounding has carried it beyond."""
    for bound in (parameter.min, parameter.max):
        if bound is not None and abs(value - bound) <= ROUNDING * (abs(bound) + (parameter.spread or 0.0)):
            return bound
    return value


def _was(old: Model, new: Model, values: Mapping[str, float]) -> dict[str, object]:
    """What the new model has not any more, and the names that it has besides."""
    pairs = {name: (e, new.equations[name]) for name, e in old.equations.items()}
    given = {d.name for d in old.differentials}
    before = {name: old.parameters[name].value for name in values if name in old.parameters}
    return {
        "value": {name: value for name, value in before.items() if value != values[name]},
        "expr": {name: e.text for name, (e, now) in pairs.items() if e.text != now.text},
        "enters": {
            name: e.fault.enters_text
            for name, (e, now) in pairs.items()
            if e.fault and now.fault and e.fault.enters_text != now.fault.enters_text
        },
        "added": {
            "parameter": [name for name in new.parameters if name not in old.parameters],
            "unknown": [name for name in new.unknown if name not in old.unknown],
            "equation": [name for name in new.equations if name not in old.equations],
            "differential": [d.name for d in new.differentials if d.name not in given],
        },
    }


def _plain(value: Mapping[str, object]) -> dict[str, object]:
    """The same with lists where there are tuples, as a file gives it back."""
    return {key: _listed(part) for key, part in value.items()}


def _listed(value: object) -> object:
    if isinstance(value, Mapping):
        return _plain(value)
    return [_listed(part) for part in value] if isinstance(value, list | tuple) else value


def _restored(model: Model, was: Table) -> Model:
    """The model with its old texts; what is computed with them is made anew when the text is read."""
    value, expr, enters, added = (_section(was, key) for key in ("value", "expr", "enters", "added"))
    was.done()
    gone = {kind: added.texts(kind) for kind in ("parameter", "unknown", "equation", "differential")}
    added.done()
    parameters = {name: p for name, p in model.parameters.items() if name not in gone["parameter"]}
    equations = {name: e for name, e in model.equations.items() if name not in gone["equation"]}
    for name, p in parameters.items():
        parameters[name] = dataclasses.replace(p, value=_or(value.optional_number(name), p.value))
    for name, e in equations.items():
        fault = e.fault
        if fault is not None:
            fault = dataclasses.replace(fault, enters_text=_or(enters.optional_text(name), fault.enters_text))
        equations[name] = dataclasses.replace(e, text=_or(expr.optional_text(name), e.text), fault=fault)
    for section in (value, expr, enters):
        section.done()
    return dataclasses.replace(
        model,
        parameters=parameters,
        equations=equations,
        unknown={name: u for name, u in model.unknown.items() if name not in gone["unknown"]},
        differentials=tuple(d for d in model.differentials if d.name not in gone["differential"]),
        provenance=model.provenance[:-1],
    )


def _section(was: Table, key: str) -> Table:
    table = was.table(key)
    if table is None:
        raise was.fail(key, "is missing; give the model file as `faultline discover` wrote it")
    return table


def _or(found: T | None, otherwise: T) -> T:
    return otherwise if found is None else found
