"""The library of effects that a model may miss: TOML to `Effect`.

    schema = 1
    [[effect]]               name, statement, component, source, signature
      rivals, separated_by   entries that look alike; experiments of experiments.toml that tell which it is
      replaces = true        only for an entry that is to stand for one of its name in the system's file
      expected = true        every such system has it to some degree: it is tolerated, and not named
    [effect.roles]           flow = ["q_filt_t", "q_pump"]: a name by model; those of one position go together
    [effect.parameter.g]     unit, description, min, max, and one of
      null, spread             how strong the effect is: null where there is none, spread its prior standard deviation
      value, prior or spread   calibrated too; with neither a constant
    [effect.unknown.z]       unit, description, initial (states only): a new variable
    [[effect.change]]        where = ["q_dos", "A_dos"], replace = "A_dos -> A_dos*(1 + g)"
    [[effect.equation]]      name, description, expr = "..."  (= 0): a new equation
    [[effect.differential]]  name, state, derivative
    [[use]]                  effect of general.toml, component, roles = {force = "F"}, name, statement, signature
      parameter.F_c, unknown.z   what the general entry leaves to a system: unit, spread, value, min, max, initial

A change replaces a name in every equation that has all names of `where` in it, as `enters` of a fault does. Formulas
know the effect's own names, its roles and the names of the model; in the model, `z` of `lag_p_du` is `lag_p_du_z`.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

from faultline.analysis.discrepancy.effects.effect import Change, Effect, EffectEquation, EffectParameter, EffectUnknown
from faultline.analysis.discrepancy.effects.experiments import FILE as EXPERIMENTS
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.model import Differential, ModelError
from faultline.analysis.model.check import check_name
from faultline.analysis.model.expression import FUNCTIONS, parse_expression
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.model.model import check_bounds
from faultline.analysis.model.tables import Table, first_repeated

SCHEMA = 1

FILE = "effects.toml"
GENERAL = Path(__file__).with_name("general.toml")


def load_library(system: Path | None, own: Path | None = None) -> dict[str, Effect]:
    """The effects of the system in a folder by name, if it has any, and those of the file `own`.

    Raises:
        ModelError: a file cannot be read, or an entry is not valid; the message names file, entry, place and remedy.
    """
    shipped = None if system is None or not (system / FILE).is_file() else system / FILE
    its = {} if shipped is None else (_of_program if shipped.is_relative_to(SYSTEMS) else _read)(shipped)
    found = {name: effect for name, (effect, _) in its.items()}
    for name, (effect, replaces) in ({} if own is None or own == shipped else _read(own)).items():
        if replaces != (name in its):
            remedy = "say `replaces = true`, or rename it" if name in its else "remove `replaces`, or correct name"
            problem = "is an entry of the system too" if name in its else "replaces an entry that the system has not"
            raise ModelError(f"{effect.place}: {problem}; {remedy}")
        found[name] = effect
    experiments = load_experiments(system).texts
    for effect in found.values():
        for k, rival in enumerate(effect.rivals):
            if rival not in found or rival == effect.name:
                raise ModelError(f"{effect.place}.rivals[{k}]: {rival} is no other entry; name one, or leave it away")
        for k, name in enumerate(effect.separated_by):
            if name not in experiments:
                known = f"none of {', '.join(experiments)}" if experiments else f"not in the system's {EXPERIMENTS}"
                raise ModelError(f"{effect.place}.separated_by[{k}]: {name} is {known}")
    return found


def is_own(effect: Effect) -> bool:
    """True if an effect is of a user's file, and not of a shipped system."""
    return not effect.place.startswith(str(SYSTEMS))


def effect_of(table: Mapping[str, object], place: str) -> Effect:
    """Return the effect of an entry's `table`, as one of a file has it.

    Raises:
        ModelError: the entry is not valid.
    """
    name = str(table["name"])
    return _effect(
        Table({key: value for key, value in table.items() if key != "name"}, f"{place}: effect {name}"), name
    )


def _read(path: Path) -> dict[str, tuple[Effect, bool]]:
    """The entries of one file, and whether they replace shipped ones."""
    try:
        top = Table(tomllib.loads(path.read_bytes().decode()), str(path), top=True)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read; give a library file") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModelError(f"{path}: not TOML: {error}") from error
    schema = top.number("schema")
    if schema != SCHEMA:
        raise top.fail("schema", f"this is {schema:g}, readable is {SCHEMA}; use the faultline that it was written for")
    tables, uses = top.tables("effect"), top.tables("use")
    top.done()
    if not tables and not uses:
        raise top.fail("effect", "there is none; add [[effect]] or [[use]] entries, or give no file")
    read = [_entry(table, path) for table in (*tables, *map(_used, uses))]
    twice = first_repeated([effect.name for effect, _ in read])
    if twice is not None:
        raise ModelError(f"{path}: two effects are named {twice}; rename one")
    return {effect.name: (effect, replaces) for effect, replaces in read}


_of_program = cache(_read)
"""The same of files that do not change."""


def _used(use: Table) -> Table:
    """An entry of the general library with the names, units and sizes of a system."""
    general = tomllib.loads(GENERAL.read_text())["effect"]
    name = use.text("effect")
    entry = next((each for each in general if each["name"] == name), None)
    if entry is None:
        raise use.fail("effect", f"{name} is none of {', '.join(each['name'] for each in general)}")
    written: dict[str, object] = {"name": name, **use.rest()}
    for kind in ("parameter", "unknown"):
        bound = Table(written, use.place).table(kind)
        for part, given in ({} if bound is None else bound.rest()).items():
            if part not in entry.get(kind, {}) or not isinstance(given, dict):
                raise use.fail(
                    f"{kind}.{part}", f"is none of {', '.join(entry.get(kind, {})) or name + ', which has none'}"
                )
            entry[kind][part] |= given
        written.pop(kind, None)
    roles = Table(written, use.place).table("roles")
    named = {
        role: [one] if isinstance(one, str) else one for role, one in ({} if roles is None else roles.rest()).items()
    }
    return Table({**entry, **written, "roles": named}, use.place)


def _entry(table: Table, path: Path) -> tuple[Effect, bool]:
    name = table.text("name")
    check_name(name, f"{table.at('name')}: {name!r}")
    written = table.rest()
    marks = {mark: written.pop(mark, False) for mark in ("replaces", "expected")}
    entry = Table(written, f"{path}: effect {name}")  # named, not numbered
    for mark, value in marks.items():
        if not isinstance(value, bool):
            raise entry.fail(mark, f"must be true or false, not {value!r}")
    return replace(_effect(entry, name), expected=bool(marks["expected"])), bool(marks["replaces"])


def _effect(table: Table, name: str) -> Effect:
    effect = Effect(
        name=name,
        statement=table.text("statement"),
        component=table.text("component"),
        source=table.text("source"),
        signature=table.text("signature"),
        rivals=table.texts("rivals"),
        separated_by=table.texts("separated_by"),
        roles=_roles(table.table("roles")),
        parameters={own: _parameter(part) for own, part in table.named_tables("parameter").items()},
        unknowns={own: _unknown(part) for own, part in table.named_tables("unknown").items()},
        changes=tuple(_change(part) for part in table.tables("change")),
        equations=tuple(_equation(part) for part in table.tables("equation")),
        differentials=tuple(_differential(part) for part in table.tables("differential")),
        place=table.place,
    )
    table.done()
    _check_own_names(effect, table)
    if not effect.strengths:
        raise table.fail("parameter", "none has a null value; give one `null`, where there is no effect, and `spread`")
    if not effect.changes:
        raise table.fail("change", "there is none, so the model stays as it is; say what the effect replaces")
    twice = first_repeated([*(e.name for e in effect.equations), *(d.name for d in effect.differentials)])
    if twice is not None:
        raise table.fail("equation", f"two equations or differentials are named {twice}; rename one")
    return effect


def _check_own_names(effect: Effect, table: Table) -> None:
    own = [*effect.roles, *effect.parameters, *effect.unknowns]
    for name in own:
        check_name(name, f"{effect.place}: {name!r}")
    twice = first_repeated(own)
    if twice is not None:
        raise table.fail(twice, "is declared twice among roles, parameter and unknown; rename one")
    for k, d in enumerate(effect.differentials):
        for role, name in (("state", d.state), ("derivative", d.derivative)):
            if name not in effect.unknowns:
                problem = f"{name} is no unknown of the effect; declare [effect.unknown.{name}]"
                raise table.fail(f"differential[{k}].{role}", problem)


def _roles(table: Table | None) -> dict[str, tuple[str, ...]]:
    if table is None:
        return {}
    written = table.rest()
    names = Table(written, table.place)
    roles = {role: names.texts(role) for role in written}
    for role, choices in roles.items():
        if not choices or len(choices) != len(next(iter(roles.values()))):
            raise names.fail(role, "those of one position go together; give every role as many names, at least one")
    return roles


def _parameter(table: Table) -> EffectParameter:
    null, value = table.optional_number("null"), table.optional_number("value")
    if (null is None) == (value is None):
        raise table.fail("null", "give either null, where there is no effect, or the value of a parameter beside it")
    parameter = EffectParameter(
        unit=table.text("unit"),
        description=table.text("description"),
        value=value if null is None else null,  # type: ignore[arg-type]  # one of the two is a number
        null=null,
        min=table.optional_number("min"),
        max=table.optional_number("max"),
        prior=table.optional_number("prior"),
        spread=table.optional_number("spread"),
    )
    table.done()
    if null is not None and parameter.spread is None:
        raise table.fail("spread", "is missing; say how strong the effect may well be, in its unit")
    check_bounds(parameter.in_model(""), table.place)
    return parameter


def _unknown(table: Table) -> EffectUnknown:
    unknown = EffectUnknown(
        unit=table.text("unit"), description=table.text("description", ""), initial=table.texts("initial")
    )
    table.done()
    for k, text in enumerate(unknown.initial):
        _check_formula(text, table.at(f"initial[{k}]"))
    return unknown


def _change(table: Table) -> Change:
    where, text = table.texts("where"), table.text("replace")
    table.done()
    if not where:
        raise table.fail("where", "is missing; name what the equation has in it")
    symbol, arrow, replacement = (part.strip() for part in text.partition("->"))
    if not arrow or not symbol.isidentifier():
        raise table.fail("replace", f"`{text}` must be like `A -> A*(1 + g)`, with a name on the left")
    _check_formula(replacement, table.at("replace"))
    return Change(where=where, symbol=symbol, replacement=replacement)


def _equation(table: Table) -> EffectEquation:
    equation = EffectEquation(
        name=table.text("name"), description=table.text("description", ""), text=table.text("expr")
    )
    table.done()
    _check_formula(equation.text, table.at("expr"))
    return equation


def _differential(table: Table) -> Differential:
    differential = Differential(name=table.text("name"), state=table.text("state"), derivative=table.text("derivative"))
    table.done()
    return differential


def _check_formula(text: str, place: str) -> None:
    """Whether it is one, whatever its names are: those are known with the model only."""
    parse_expression(text, _names_in(text), place)


def _names_in(text: str) -> list[str]:
    return sorted(set(re.findall(r"(?<![\w.])[A-Za-z]\w*", text)) - FUNCTIONS)
