"""The computation sequence of a residual: the order in which the rest of an MSO set is solved without that equation.

Without its residual equation a minimal over-determined set is just-determined. Its strongly connected components are
solved one after the other; a differential constraint is used in integral or derivative causality, as the component it
is in demands (Svard and Nyberg, "Residual generators for fault diagnosis using computation sequences with mixed
causality", 2010; Frisk et al. 2012; thesis 2.3).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from faultline.analysis.model import Model
from faultline.analysis.structure import Structure, redundancy, structure_of
from faultline.analysis.structure.causality import Causality, solving_order
from faultline.analysis.structure.matching import Matching
from faultline.service.core.errors import InputError

Kind = Literal["algebraic", "integral", "derivative", "mixed"]
Form = Literal["integral", "derivative"]


@dataclass(frozen=True)
class Component:
    """Equations that are solved together: each with the variable it is matched to.

    `kind` is *algebraic* without a differential constraint; *integral* if the states follow from their derivatives,
    `inside` then being the algebraic components to solve, in order, with the states given; *derivative* for a
    constraint that differentiates; *mixed* for a loop that has to differentiate within.
    """

    kind: Kind
    pairs: tuple[tuple[str, str], ...]
    inside: tuple["Component", ...] = ()

    @property
    def equations(self) -> tuple[str, ...]:
        """The equations, constraints included."""
        return tuple(equation for equation, _ in self.pairs)

    @property
    def variables(self) -> tuple[str, ...]:
        """What they are solved for."""
        return tuple(variable for _, variable in self.pairs)


@dataclass(frozen=True)
class ComputationSequence:
    """How to compute the residual of an MSO set: components in an order in which they can be solved.

    `form` is how a differential constraint is used that is the residual equation itself: *integral* compares the state
    with the integral of its derivative (which drifts), *derivative* the derivative with a difference quotient.
    """

    equations: tuple[str, ...]
    residual: str
    form: Form
    causality: Causality
    known: tuple[str, ...]
    components: tuple[Component, ...]


def computation_sequence(
    model: Model | Structure, equations: Sequence[str], residual: str, *, form: Form = "integral"
) -> ComputationSequence:
    """The computation sequence of an MSO set with `residual` as its residual equation.

    Where every constraint is integrated, all states form one component: they advance in one implicit step.

    Raises:
        InputError: `residual` is not among the equations, or they are no MSO set.
    """
    structure = structure_of(model)
    strange = [name for name in equations if name not in structure.equations]
    if strange:
        raise InputError(f"{strange[0]} is no equation of the model; those are {', '.join(structure.equations)}")
    if residual not in equations:
        raise InputError(f"residual {residual} is not among {', '.join(equations)}; choose one of those")
    equations = structure.names(sum(1 << row for row in structure.rows(equations)))
    rest = tuple(name for name in equations if name != residual)
    free = Matching([structure.unknown_rows[row] for row in structure.rows(rest)]).free
    if redundancy(structure, equations) != 1 or free:
        raise InputError(f"{', '.join(equations)} are no minimal over-determined set; give one of `mso_sets`")
    given = replace(structure, differentials={k: d for k, d in structure.differentials.items() if k != residual})
    components = tuple(_mixed(given, equations, residual))
    used = {str(c.kind) for c in components} - {"algebraic"}
    if used == {"integral"}:
        components = (_together(given, rest, residual),)
    if residual in structure.differentials:
        used.add(form)
    return ComputationSequence(
        equations=equations,
        residual=residual,
        form=form,
        causality=_causality(used),
        known=structure.known_in(equations),
        components=components,
    )


def _mixed(structure: Structure, equations: Sequence[str], residual: str) -> Iterator[Component]:
    """The strongly connected components: a constraint counts as an equation like any other."""
    for pairs in solving_order(replace(structure, differentials={}), equations, residual):
        names = [equation for equation, _ in pairs]
        constraints = [structure.differentials[name] for name in names if name in structure.differentials]
        if not constraints:
            yield Component("algebraic", tuple(pairs))
        elif len(pairs) == 1:
            yield Component("integral" if pairs[0][1] == constraints[0].state else "derivative", tuple(pairs))
        else:
            inside = _restricted(structure, names, [variable for _, variable in pairs])
            whole = _together(inside, names, residual)
            yield whole if len(whole.pairs) == len(pairs) else Component("mixed", tuple(pairs))


def _together(structure: Structure, equations: Sequence[str], residual: str) -> Component:
    """All constraints integrated in one step; with fewer pairs than equations where the states leave some unsolved."""
    constraints = [structure.differentials[name] for name in equations if name in structure.differentials]
    states = {d.state for d in constraints}
    algebraic = [name for name in equations if name not in structure.differentials]
    unknowns = [name for name in structure.unknowns_in(equations) if name not in states]
    reduced = _restricted(structure, algebraic, unknowns)
    if Matching([reduced.unknown_rows[row] for row in reduced.rows(algebraic)]).free:
        return Component("integral", ())
    order = solving_order(reduced, algebraic, residual)
    inside = tuple(Component("algebraic", tuple(pairs)) for pairs in order)
    solved = tuple(pair for component in inside for pair in component.pairs)
    return Component("integral", (*((d.name, d.state) for d in constraints), *solved), inside)


def _restricted(structure: Structure, equations: Sequence[str], unknowns: Sequence[str]) -> Structure:
    """The structure in which these equations contain no other unknowns than these: the others are given."""
    mask = sum(1 << x for x, name in enumerate(structure.unknowns) if name in unknowns)
    rows = set(structure.rows(equations))
    kept = tuple(row & mask if i in rows else row for i, row in enumerate(structure.unknown_rows))
    return replace(structure, unknown_rows=kept)


def _causality(used: set[str]) -> Causality:
    match sorted(used):
        case []:
            return "algebraic"
        case ["integral"]:
            return "integral"
        case ["derivative"]:
            return "derivative"
    return "mixed"
