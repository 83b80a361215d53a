"""Models of names only: which variables are in which equations, and nothing of how."""

import dataclasses

import sympy as sp

from faultline.analysis.model.model import Equation, Fault, Model


def without_formulas(model: Model) -> Model:
    """Return the model with its formulas, parameters and initial values forgotten.

    Signals keep their units, ranges and noise, and the system its modes.
    """
    variables = [*model.known, *model.unknown]
    unknown = {
        name: dataclasses.replace(each, initial=(), initial_text=(), min=None) for name, each in model.unknown.items()
    }
    return dataclasses.replace(
        model,
        unknown=unknown,
        parameters={},
        curves={},
        equations={name: _names_of(equation, variables) for name, equation in model.equations.items()},
        provenance=(),
        bench=None,
    )


def _names_of(equation: Equation, variables: list[str]) -> Equation:
    used = tuple(name for name in variables if sp.Symbol(name) in equation.expression.free_symbols)
    fault = equation.fault
    disturbance = equation.disturbance
    return unformulated(
        equation.name,
        equation.description,
        used,
        None if fault is None else entering(fault, used),
        None if disturbance is None else entering(disturbance, used),
    )


def unformulated(
    name: str,
    description: str,
    variables: tuple[str, ...],
    fault: Fault | None,
    disturbance: Fault | None = None,
) -> Equation:
    """Return an equation of which only the variables are known."""
    return Equation(
        name=name,
        description=description,
        text="",
        expression=sp.Function(name)(*map(sp.Symbol, variables)),
        fault=fault,
        disturbance=disturbance,
        variables=variables,
    )


def entering(fault: Fault, variables: tuple[str, ...]) -> Fault:
    """Return the fault as one of an equation without formula: it adds to a variable, in a way that nobody knows."""
    return dataclasses.replace(
        fault,
        enters=variables[0],
        replacement=sp.Symbol(variables[0]) + sp.Symbol(fault.name),
        enters_text="",
        sizes=(),
        relative_to=None,
        share_of=None,
        shares=(),
        consequence=None,
    )
