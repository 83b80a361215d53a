"""A model with an effect in it: the same model where the effect's parameters have their null values.

Formulas are changed in the form in which the file has them, by replacing names in their syntax trees. So numbers stay
as written, what a human grouped stays grouped, and the text is the formula that is computed with.
"""

import ast
import dataclasses
from collections.abc import Mapping

import sympy as sp

from faultline.analysis.discrepancy.effects.effect import Change, Effect
from faultline.analysis.discrepancy.effects.soundness import check_rewritten
from faultline.analysis.model import Differential, Equation, Fault, Model, ModelError, Unknown
from faultline.analysis.model.expression import parse_expression


def applicable(model: Model, effect: Effect) -> str | None:
    """Why the effect has no place in the model, in a line; None if it has."""
    declared = {*model.known, *model.unknown, *model.parameters}
    if any(effect.prefixed(name) in declared for name in (*effect.parameters, *effect.unknowns)):
        return f"{model.name} has {effect.name} in it already"
    names = _names(model, effect)
    if names is None:
        return f"{model.name} has {_none_of(effect)}"
    for change in effect.changes:
        where = [names.get(name, name) for name in change.where]
        for name in where:
            if name not in declared:
                return f"{model.name} has no {name}"
        if not _matching(model, change, names):
            return f"no equation of {model.name} has {' and '.join(where)} in it"
    return None


def rewritten(model: Model, effect: Effect) -> Model:
    """The model with the effect in it, at its null values.

    Raises:
        ModelError: the effect has no place in the model, or what comes out means nothing; the message names file,
            entry, place and remedy.
    """
    reason = applicable(model, effect)
    if reason is not None:
        raise ModelError(f"{effect.place}: {reason}; leave it away, or give the entry roles that fit")
    names = _names(model, effect) or {}
    declared = _with_names(model, effect, names)
    equations = dict(model.equations)
    for k, change in enumerate(effect.changes):
        for name in _matching(model, change, names):
            place = f"{effect.place}.change[{k}].replace"
            equations[name] = _changed(equations[name], change, names, declared, place)
    for k, new in enumerate(effect.equations):
        text, name = substituted(new.text, names), effect.prefixed(new.name)
        expression = _parsed(text, declared, f"{effect.place}.equation[{k}].expr")
        equations[name] = Equation(name=name, description=new.description, text=text, expression=expression, fault=None)
    differentials = (
        Differential(name=effect.prefixed(d.name), state=names[d.state], derivative=names[d.derivative])
        for d in effect.differentials
    )
    result = dataclasses.replace(declared, equations=equations, differentials=(*model.differentials, *differentials))
    check_rewritten(model, result, effect)
    return result


def _with_names(model: Model, effect: Effect, names: Mapping[str, str]) -> Model:
    """The model with the effect's parameters and unknowns, which no equation has yet."""
    source = f"effect {effect.name}: {effect.source}"
    parameters = {**model.parameters, **{names[own]: p.in_model(source) for own, p in effect.parameters.items()}}
    unknown = dict(model.unknown)
    for own, new in effect.unknowns.items():
        texts = tuple(substituted(text, names) for text in new.initial)
        places = (f"{effect.place}.unknown.{own}.initial[{k}]" for k in range(len(texts)))
        read = (parse_expression(t, [*model.known, *parameters], place) for t, place in zip(texts, places, strict=True))
        unknown[names[own]] = Unknown(
            unit=new.unit, description=new.description, initial=tuple(read), initial_text=texts
        )
    return dataclasses.replace(model, parameters=parameters, unknown=unknown)


def _names(model: Model, effect: Effect) -> dict[str, str] | None:
    """What the effect's own names and its roles are in the model; None if it has not the names of any position."""
    own = {name: effect.prefixed(name) for name in (*effect.parameters, *effect.unknowns)}
    if not effect.roles:
        return own
    declared = {*model.known, *model.unknown, *model.parameters}
    for column in zip(*effect.roles.values(), strict=True):
        if declared.issuperset(column):
            return {**dict(zip(effect.roles, column, strict=True)), **own}
    return None


def _none_of(effect: Effect) -> str:
    """What a model has not that has the names of no position."""
    columns = [" with ".join(dict.fromkeys(column)) for column in zip(*effect.roles.values(), strict=True)]
    return f"neither {' nor '.join(columns)}" if len(columns) > 1 else f"no {columns[0]}"


def _matching(model: Model, change: Change, names: Mapping[str, str]) -> list[str]:
    """The names of the equations that the change is about."""
    wanted = {sp.Symbol(names.get(name, name)) for name in change.where}
    return [name for name, e in model.equations.items() if wanted <= e.expression.free_symbols]


def _changed(equation: Equation, change: Change, names: Mapping[str, str], model: Model, place: str) -> Equation:
    """The equation with one name replaced; a fault that entered there follows where one name becomes another."""
    symbol, replacement = names.get(change.symbol, change.symbol), substituted(change.replacement, names)
    if sp.Symbol(symbol) not in equation.expression.free_symbols:
        raise ModelError(f"{place}: {symbol} is not in {equation.name}, `{equation.text}`; replace what is in it")
    if _parsed(equation.text, model, place) != equation.expression:
        raise ModelError(f"{place}: {equation.name} is not what its text says, `{equation.text}`; correct the model")
    text = substituted(equation.text, {symbol: replacement})
    expression = _parsed(text, model, place)
    fault = equation.fault
    if fault is not None and sp.Symbol(fault.enters) not in expression.free_symbols:
        if not replacement.isidentifier():
            problem = f"takes {symbol} out of {equation.name}, where fault {fault.name} enters"
            raise ModelError(f"{place}: {problem}; keep it in the replacement")
        fault = _moved(fault, replacement)
    return dataclasses.replace(equation, text=text, expression=expression, fault=fault)


def _moved(fault: Fault, name: str) -> Fault:
    """The fault entering at `name` in the same way."""
    _, _, replacement = fault.enters_text.partition("->")
    return dataclasses.replace(
        fault,
        enters=name,
        replacement=fault.replacement.xreplace({sp.Symbol(fault.enters): sp.Symbol(name)}),
        enters_text=f"{name} -> {substituted(replacement, {fault.enters: name})}",
    )


def _parsed(text: str, model: Model, place: str) -> sp.Expr:
    return parse_expression(text, [*model.known, *model.unknown, *model.parameters], place, model.curves)


def substituted(text: str, replacements: Mapping[str, str]) -> str:
    """A formula in which names are replaced by formulas, all at once.

    >>> substituted("q - A*sgsqrt(p)**2", {"A": "A*(1 + g)", "p": "p - z"})
    'q - A*(1 + g)*sgsqrt(p - z)**2'
    """
    trees = {name: _tree(formula) for name, formula in replacements.items()}
    written = ast.unparse(_Names(trees).visit(_tree(text)))
    for operator in ("**", "*", "/"):
        written = written.replace(f" {operator} ", operator)
    return written


def _tree(formula: str) -> ast.expr:
    return ast.parse(" ".join(formula.split()), mode="eval").body


class _Names(ast.NodeTransformer):
    """Puts trees in the place of names."""

    def __init__(self, trees: Mapping[str, ast.expr]) -> None:
        self._trees = trees

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """The tree for a name, or the name."""
        return self._trees.get(node.id, node)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """A call whose arguments are visited; its function is no variable."""
        node.args = [self.visit(argument) for argument in node.args]
        return node
