"""What must hold between the parts of a model: names, differential constraints, initial values, faults."""

import keyword
import re
from collections.abc import Sequence

import sympy as sp

from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.expression import FUNCTIONS
from faultline.analysis.model.model import Fault, Model
from faultline.analysis.model.tables import first_repeated

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def check_names(
    known: Sequence[str], unknown: Sequence[str], parameters: Sequence[str], curves: Sequence[str], where: str
) -> list[str]:
    """All names of variables and parameters.

    Raises:
        ModelError: one is declared twice or cannot be written in a formula.
    """
    names = [*known, *unknown, *parameters]
    for name in (*names, *curves):
        check_name(name, f"{where}: {name!r}")
    twice = first_repeated([*names, *curves])
    if twice is not None:
        raise ModelError(f"{where}: {twice} is declared twice among known, unknown, parameter and curve; rename one")
    return names


def is_name(name: str) -> bool:
    """Return whether a name can stand in a formula and in generated code."""
    return bool(_NAME.fullmatch(name)) and not keyword.iskeyword(name) and name not in FUNCTIONS


def check_name(name: str, place: str) -> None:
    """Raises ModelError unless the name can stand in a formula and in generated code."""
    if not is_name(name):
        raise ModelError(
            f"{place}: is no name; use letters, digits and _ as in p_tp, no keyword, and no name of a function"
        )


def check_model(model: Model, equation_names: Sequence[str], where: str) -> None:
    """Checks a whole model; `equation_names` are the equations' names as written, repeated ones included.

    Raises:
        ModelError: the first thing that does not hold.
    """
    if model.equations and model.residuals:
        raise ModelError(f"{where}: residual: there are equations too; give one of the two, and the other in a model")
    if not (model.equations or model.residuals):
        raise ModelError(f"{where}: equation: there is none; a model needs at least one, or residuals of another tool")
    if stray := set(model.listed_faults).difference(*model.residuals.values()):
        raise ModelError(f"{where}: fault.{min(stray)}: no residual is sensitive to it; name it in one, or remove it")
    rows = [*equation_names, *(d.name for d in model.differentials)]
    twice = first_repeated(rows)
    if twice is not None:
        raise ModelError(f"{where}: two equations or differentials are named {twice}; rename one")
    _check_faults(model, where)
    _check_differentials(model, where)
    _check_states(model, where)
    _check_used(model, where)


def _check_faults(model: Model, where: str) -> None:
    entering = [
        (f"equation[{k}].{what}", each)
        for k, equation in enumerate(model.equations.values())
        for what, each in (("fault", equation.fault), ("disturbance", equation.disturbance))
        if each is not None
    ]
    for place, each in entering:
        if each.share_of is not None and each.share_of not in model.parameters:
            raise ModelError(f"{where}: {place}.share_of: {each.share_of} is no parameter; name one that is")
        _check_consequence(model, each, f"{where}: {place}.consequence")
        if each.relative_to is not None and each.relative_to not in model.parameters:
            raise ModelError(
                f"{where}: {place}.relative_to: {each.relative_to} is no parameter; leave it away for sizes in SI units"
            )
    twice = first_repeated([each.name for _, each in entering])
    if twice is not None:
        raise ModelError(
            f"{where}: fault {twice} is in two equations; let it define an unknown of its own and use that in both"
        )
    codes: dict[tuple[int | None, int | None], str] = {}
    for place, each in entering:
        if each.spn is not None and codes.setdefault((each.spn, each.fmi), each.component) != each.component:
            raise ModelError(
                f"{where}: {place}.spn: {each.spn} with FMI {each.fmi} is the {codes[each.spn, each.fmi]} already; "
                "give each component a code of its own, one of a manufacturer's (520192 to 524287) where none fits"
            )
    for k, equation in enumerate(model.equations.values()):
        if equation.variables:
            continue  # where they enter is not known
        if equation.fault and equation.disturbance and equation.fault.enters == equation.disturbance.enters:
            raise ModelError(
                f"{where}: equation[{k}].disturbance.enters: {equation.fault.enters} is what its fault replaces; "
                "let it replace another name"
            )


def _check_consequence(model: Model, fault: Fault, place: str) -> None:
    if fault.consequence is None:
        return
    of, others = fault.consequence.fault, [name for name in model.faults if name != fault.name]
    if of not in others:
        raise ModelError(f"{place}.fault: {of} is no other fault; those are {', '.join(others)}")
    for name in fault.consequence.where:
        if name not in model.known:
            raise ModelError(f"{place}.where.{name}: {name} is no known signal; those are {', '.join(model.known)}")
    if sizes := fault.consequence.sizes:
        largest = sorted((size for size in fault.sizes if (size > 0.0) == (sizes[0] > 0.0)), key=abs)[-len(sizes) :]
        if len(sizes) < 2 or sorted(sizes) != sorted(largest):
            raise ModelError(f"{place}.sizes: are the two or more largest of the fault's sizes, all of one sign")
    elif len(fault.sizes) < 3 or len({size > 0.0 for size in fault.sizes}) > 1:
        raise ModelError(
            f"{place}: goes with three sizes or more, all of one sign, of which the larger half have it; or say `sizes`"
        )


def _check_differentials(model: Model, where: str) -> None:
    for k, d in enumerate(model.differentials):
        for role, name in (("state", d.state), ("derivative", d.derivative)):
            if name not in model.unknown:
                raise ModelError(f"{where}: differential[{k}].{role}: {name} is no unknown; declare [unknown.{name}]")
    joined = [name for d in model.differentials for name in (d.state, d.derivative)]
    twice = first_repeated(joined)
    if twice is not None:
        raise ModelError(f"{where}: {twice} is in two differentials; a variable is one state or one derivative")
    for name in model.unknown:
        if name.startswith("d") and name[1:] in model.unknown and name not in joined:
            raise ModelError(
                f"{where}: unknown.{name}: no [[differential]] makes it the derivative of {name[1:]}; "
                "add one, or give it a name that does not read like a derivative"
            )


def _check_states(model: Model, where: str) -> None:
    states = {d.state for d in model.differentials}
    signals = {sp.Symbol(name) for name in model.known}
    for name, unknown in model.unknown.items():
        if name in states and not unknown.initial and not model.without_formula:
            raise ModelError(
                f"{where}: unknown.{name}.initial: is missing; a state needs one, a parameter alone will do"
            )
        if name not in states and unknown.initial:
            raise ModelError(f"{where}: unknown.{name}.initial: only a state starts somewhere; {name} is none")
        for k, expression in enumerate(unknown.initial):
            slopes = [sp.diff(expression, signal) for signal in signals & expression.free_symbols]
            if any(slope.free_symbols & signals for slope in slopes) or _bent(expression, signals):
                raise ModelError(
                    f"{where}: unknown.{name}.initial[{k}]: `{unknown.initial_text[k]}` is not affine in known signals"
                )


def _bent(expression: sp.Expr, signals: set[sp.Symbol]) -> bool:
    """Whether a signal is inside a function, where a derivative may look constant (the sign in that of abs)."""
    return any(call.free_symbols & signals for call in expression.atoms(sp.Function))


def _check_used(model: Model, where: str) -> None:
    used = {symbol.name for e in model.equations.values() for symbol in e.expression.free_symbols}
    for name in model.unknown:
        if name not in used:
            raise ModelError(f"{where}: unknown.{name}: is in no equation; use it or remove it")
