"""A model as TOML text. The same model gives the same bytes, and the text parses back to an equal model."""

import datetime
import json
import re
from collections.abc import Mapping, Sequence

from faultline.analysis.model.bounds import Bounds
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.file import ANY, SCHEMA
from faultline.analysis.model.model import Consequence, Equation, Mode, Model

WORDS = ("description", "instruction")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def dump_model(model: Model) -> str:
    """The model file's text; formulas are written as the file had them.

    Raises:
        ModelError: the provenance holds something that TOML cannot.
    """
    head: dict[str, object] = {"schema": SCHEMA, "name": model.name}
    head |= {"description": model.description, "source": model.source, "warm_up_s": model.warm_up_s}
    head["period_s"] = model.period_s
    blocks = [pairs(head)]
    for name, k in model.known.items():
        fields: dict[str, object] = {"unit": k.unit or None, "description": k.description}
        fields |= {"min": None if k.min <= -ANY else k.min, "max": None if k.max >= ANY else k.max}
        fields |= {"noise": k.noise or None}
        fields |= {name: value for name, value in (("zero", k.zero), ("drift", k.drift), ("added", k.added)) if value}
        fields |= {"maximum_age_s": k.maximum_age_s, "lag_s": k.lag_s, "outlier": k.outlier}
        fields |= {"sensor_min": k.sensor_min}
        fields |= {"label": k.label or None, "display": k.display or None}
        blocks.append(f"[known.{name}]\n" + pairs(fields))
    for name, u in model.unknown.items():
        fields = {"unit": u.unit or None, "description": u.description, "min": u.min}
        blocks.append(f"[unknown.{name}]\n" + pairs({**fields, **({"initial": u.initial_text} if u.initial else {})}))
    for name, p in model.parameters.items():
        fields = {"unit": p.unit, "description": p.description, "value": p.value, "min": p.min, "max": p.max}
        fields |= {"prior": p.prior, "spread": p.spread, "drift": p.drift or None, "source": p.source}
        blocks.append(f"[parameter.{name}]\n" + pairs(fields))
    for name, c in model.curves.items():
        fields = {
            "description": c.description or None,
            "source": c.source or None,
            "x": c.x,
            "y": c.y,
            "z": c.z or None,
        }
        blocks.append(f"[curve.{name}]\n" + pairs(fields))
    if model.display:
        blocks.append("[display]\n" + pairs(dict(model.display)))
    blocks.extend("[[mode]]\n" + pairs(_mode(mode)) for mode in model.modes.steady)
    if model.modes.edges:
        blocks.append("[edges]\n" + pairs({"settle_s": model.modes.settle_s, "steps": model.modes.edges}))
    if model.bench is not None:
        blocks.append("[bench]\n" + pairs(model.bench.written))
    blocks.extend("[[equation]]\n" + pairs(_equation(e)) for e in model.equations.values())
    blocks.extend("[[differential]]\n" + pairs(vars(d)) for d in model.differentials)
    blocks.extend(f"[residual.{name}]\n" + pairs({"faults": faults}) for name, faults in model.residuals.items())
    for name, f in model.listed_faults.items():
        code = {"spn": f.spn, "fmi": f.fmi, "place": f.place or None}
        blocks.append(f"[fault.{name}]\n" + pairs({"component": f.component, "description": f.description, **code}))
    blocks.extend("[[provenance]]\n" + pairs(entry) for entry in model.provenance)
    return "\n".join(blocks)


def _mode(mode: Mode) -> dict[str, object]:
    return {"name": mode.name, "where": _where(mode.where) or None, **{k: getattr(mode, k) or None for k in WORDS}}


def _where(bounds: Bounds) -> dict[str, dict[str, float]]:
    return {
        name: {side: bound for side, bound in zip(("above", "below"), each, strict=True) if bound is not None}
        for name, each in bounds.items()
    }


def _equation(equation: Equation) -> dict[str, object]:
    table: dict[str, object] = {"name": equation.name, "description": equation.description}
    table |= {"variables": equation.variables} if equation.variables else {"expr": equation.text}
    for what, each in (("fault", equation.fault), ("disturbance", equation.disturbance)):
        if each is not None:
            brings = each.consequence
            table[what] = {
                "name": each.name,
                **({"component": each.component} if what == "fault" else {}),
                "description": each.description,
                **({} if each.spn is None else {"spn": each.spn, "fmi": each.fmi}),
                **({"place": each.place} if each.place else {}),
                **({"enters": each.enters_text, "sizes": each.sizes} if each.enters_text else {}),
                **({} if each.relative_to is None else {"relative_to": each.relative_to}),
                **({} if each.share_of is None else {"share_of": each.share_of, "shares": each.shares}),
                **({} if brings is None else {"consequence": _consequence(brings)}),
            }
    return table


def _consequence(brings: Consequence) -> dict[str, object]:
    table: dict[str, object] = {"fault": brings.fault, "where": _where(brings.where)}
    return table | ({"sizes": brings.sizes} if brings.sizes else {})


def pairs(table: Mapping[str, object]) -> str:
    """Lines `key = value`, without those of value None."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in table.items() if value is not None)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)


def _value(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case int():
            return repr(int(value))
        case float():
            return repr(float(value))  # numpy's floats are floats that write themselves otherwise
        case str():  # JSON's escapes are TOML's, but JSON leaves DEL bare
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case datetime.datetime() | datetime.date() | datetime.time():
            return value.isoformat()
        case Mapping():
            return "{" + ", ".join(f"{_key(str(k))} = {_value(v)}" for k, v in value.items()) + "}"
        case Sequence():
            return "[" + ", ".join(_value(v) for v in value) + "]"
    raise ModelError(f"provenance: {value!r} cannot be written to TOML; use strings, numbers, lists and tables")
