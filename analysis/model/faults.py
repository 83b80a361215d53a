"""Faults in a model file: those that enter an equation, and those that are listed for residuals of another tool."""

import dataclasses
from collections.abc import Collection, Sequence

import sympy as sp

from faultline.analysis.model.bounds import bounds_of
from faultline.analysis.model.check import check_name
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.model.model import Consequence, Fault
from faultline.analysis.model.tables import Table


def code_of(table: Table) -> tuple[int | None, int | None]:
    """Suspect parameter (19 bits, all ones is none) and failure mode (5 bits) of SAE J1939-73."""
    spn, fmi = table.optional_whole("spn", 1, 2**19 - 2), table.optional_whole("fmi", 0, 31)
    if (spn is None) != (fmi is None):
        raise table.fail("spn" if spn is None else "fmi", "is missing; SPN and FMI are one code: give both, or none")
    return spn, fmi


def fault_of(table: Table, names: Sequence[str], component: str, *code: int | None) -> Fault:
    """A fault or disturbance that enters an equation; `code` are SPN and FMI, if it may have them."""
    name, text = table.text("name"), table.text("enters")
    check_name(name, f"{table.at('name')}: {name!r}")
    if name in names:
        raise table.fail("name", f"{name} is declared already; give the fault variable a name of its own")
    enters, arrow, replacement = (part.strip() for part in text.partition("->"))
    if not arrow or enters not in names:
        raise table.fail("enters", f"`{text}` must be like `A -> A + {name}`, with a declared name on the left")
    fault = Fault(
        name=name,
        component=component,
        description=table.text("description", ""),
        enters=enters,
        replacement=parse_expression(replacement, [*names, name], table.at("enters")),
        enters_text=text,
        sizes=table.numbers("sizes"),
        relative_to=table.optional_text("relative_to"),
        spn=code[0] if code else None,
        fmi=code[1] if code else None,
        place=table.text("place", "") if component else "",
        share_of=table.optional_text("share_of"),
        shares=table.numbers("shares") if table.has("shares") else (),
        consequence=_consequence(table.table("consequence")),
    )
    table.done()
    if sp.simplify(fault.replacement.subs(sp.Symbol(name), 0) - sp.Symbol(enters)) != 0:
        raise table.fail("enters", f"`{text}` must leave {enters} as it is where {name} = 0")
    if sp.Symbol(name) not in fault.replacement.free_symbols:
        raise table.fail("enters", f"{name} is not on the right of `{text}`")
    if not fault.sizes or 0.0 in fault.sizes:
        raise table.fail("sizes", "give at least one size, none of them zero")
    if (fault.share_of is None) != (not fault.shares):
        raise table.fail("share_of", "names the parameter of which `shares` are lost: give both, or none")
    if any(share == 0.0 or share <= -1.0 for share in fault.shares):
        raise table.fail("shares", "are fractions by which a parameter changes, none of them zero, all above -1")
    return fault


def structural_fault(table: Table, names: Sequence[str], *, is_fault: bool) -> Fault:
    """A fault or disturbance of an equation without formula."""
    name = table.text("name")
    check_name(name, f"{table.at('name')}: {name!r}")
    if name in names:
        raise table.fail("name", f"{name} is declared already; give the fault variable a name of its own")
    if is_fault:
        return _without_formula(table, name)
    disturbance = dataclasses.replace(fault_named(name, description=table.text("description", "")), component="")
    table.done()
    return disturbance


def _consequence(table: Table | None) -> Consequence | None:
    if table is None:
        return None
    sizes = table.numbers("sizes") if table.has("sizes") else ()
    found = Consequence(fault=table.text("fault"), where=bounds_of(table), sizes=sizes)
    table.done()
    if not found.where:
        raise table.fail("where", "is missing; say at which signals the consequence shows")
    return found


def listed_fault(table: Table, names: Sequence[str]) -> Fault:
    """A fault of residuals that another tool computes: what it enters is not known."""
    name = table.place.rpartition(".")[2]
    check_name(name, f"{table.place}: {name!r}")
    if name in names:
        raise ModelError(f"{table.place}: {name} is declared already; give the fault a name of its own")
    return _without_formula(table, name)


def _without_formula(table: Table, name: str) -> Fault:
    """A fault of which nothing is said but what it is."""
    spn, fmi = code_of(table)
    fault = fault_named(name, table.text("component"), table.text("description", ""), spn, fmi, table.text("place", ""))
    table.done()
    return fault


def fault_named(
    name: str,
    component: str = "",
    description: str = "",
    spn: int | None = None,
    fmi: int | None = None,
    place: str = "",
) -> Fault:
    """A fault of which it is not known how it enters, and how large it may be; its component by default its name."""
    return Fault(
        name=name,
        component=component or name,
        description=description,
        enters="",
        replacement=sp.S.Zero,
        enters_text="",
        sizes=(),
        relative_to=None,
        spn=spn,
        fmi=fmi,
        place=place,
    )


def residual_of(table: Table, known: Collection[str], listed: Collection[str]) -> tuple[str, ...]:
    """The faults that a residual is sensitive to."""
    signal, faults = table.place.rpartition(".")[2], table.texts("faults")
    table.done()
    if signal not in known:
        raise ModelError(f"{table.place}: {signal} is no known signal; declare [known.{signal}], or correct the name")
    if not faults:
        raise table.fail("faults", "is empty; name the faults that the residual is sensitive to")
    for name in faults:
        if name not in listed:
            raise table.fail("faults", f"{name} is not listed; add [fault.{name}] with its component")
    return faults
