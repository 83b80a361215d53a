"""Structural models: which variables are in which equations, and nothing more; in matrix form or as named lists.

The matrix form is JSON, with the equations in rows, in the order that numbers the tests:

    {"X": [[1, 1, 0], [0, 2, 3]],   unknowns: 1 occurs, 2 the state and 3 its derivative, in a differential constraint
     "F": [[1], [0]],               faults (may be absent)
     "Z": [[1], [0]],               known signals (may be absent)
     "names": {"equations": ["e1", "e2"], "unknowns": ["q", "p", "dp"], "faults": ["fq"], "knowns": ["y"]}}

`names` and every list in it may be absent; the names are then e1, e2.., x1.., f1.. and z1...
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from faultline.analysis.model import Differential, Known, Model, ModelError, Unknown
from faultline.analysis.model.check import check_name
from faultline.analysis.model.faults import fault_named
from faultline.analysis.model.file import ANY
from faultline.analysis.model.names import entering, unformulated
from faultline.analysis.model.tables import Table, first_repeated
from faultline.analysis.structure.matching import mask_of
from faultline.analysis.structure.structure import Structure
from faultline.service.core.errors import InputError

_NAME = re.compile(r"[^\s,]+")
_MATRICES = {"X": 3, "F": 1, "Z": 1}  # the largest entry
_STATE, _DERIVATIVE = 2, 3


def read_structure(text: str, where: str) -> Structure:
    """The structural model in JSON text of the form above; messages begin with `where`.

    Raises:
        ModelError: it is no JSON of this form, dimensions or names contradict each other, or a row means nothing.
    """
    top = Table(_object(text, where), where, top=True)
    names = top.table("names")
    matrices = _matrices(top.rest(), where)
    x, f, z = matrices["X"], matrices["F"], matrices["Z"]

    def named(key: str, initial: str, size: int) -> tuple[str, ...]:
        given = names.texts(key) if names is not None else ()
        if names is not None and given and len(given) != size:
            raise names.fail(key, f"has {len(given)} names for {size} {key}; give every one a name, or none")
        return given or tuple(f"{initial}{k}" for k in range(1, size + 1))

    equations, unknowns = named("equations", "e", len(x)), named("unknowns", "x", len(x[0]))
    faults, known = named("faults", "f", len(f[0])), named("knowns", "z", len(z[0]))
    if names is not None:
        names.done()
    _check_names(equations, where)
    contents = {
        name: [
            variable
            for row, variables in ((x[i], unknowns), (z[i], known), (f[i], faults))
            for entry, variable in zip(row, variables, strict=True)
            if entry
        ]
        for i, name in enumerate(equations)
    }
    differentials = [
        _differential(name, x[i], unknowns, f"{where}: X[{i}]")
        for i, name in enumerate(equations)
        if max(x[i], default=0) > 1
    ]
    return structural_model(contents, differentials, faults, known, unknowns=unknowns, where=where)


def load_structure(path: str) -> Structure:
    """The structural model in a JSON file.

    Raises:
        InputError: it cannot be read, or is none.
    """
    try:
        text = Path(path).read_bytes().decode()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give a model file") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start})") from error
    return read_structure(text, path)


def as_model(structure: Structure, name: str) -> Model:
    """A structural model as a model without formulas, with signals of any unit and range.

    Raises:
        ModelError: a name cannot stand in a formula.
    """
    for each in (*structure.known, *structure.unknowns, *structure.faults):
        check_name(each, f"{name}: {each!r}")
    of_row = {row: fault for fault, row in structure.fault_rows.items()}
    equations = {}
    for row, equation in enumerate(structure.equations):
        if equation not in structure.differentials:
            variables = (*structure.known_in([equation]), *structure.unknowns_in([equation]))
            fault = None if row not in of_row else entering(fault_named(of_row[row]), variables)
            equations[equation] = unformulated(equation, "", variables, fault)
    signal = Known(unit="", description="", min=-ANY, max=ANY, noise=0.0)
    return Model(
        name=name,
        description="",
        source="",
        known=dict.fromkeys(structure.known, signal),
        unknown={each: Unknown(unit="", description="", initial=(), initial_text=()) for each in structure.unknowns},
        parameters={},
        equations=equations,
        differentials=tuple(structure.differentials.values()),
        provenance=(),
    )


def structural_model(
    equations: Mapping[str, Sequence[str]],
    differentials: Sequence[Differential] = (),
    faults: Sequence[str] = (),
    known: Sequence[str] = (),
    *,
    unknowns: Sequence[str] | None = None,
    where: str = "structural model",
) -> Structure:
    """A structure from the names of the variables in every equation: unknowns, known signals and faults.

    Args:
        equations: by name, in the order that numbers the tests; one may be without unknowns.
        differentials: each is the equation of its name, if there is one (which lists its state and derivative and
            nothing else), or comes after all others.
        faults: in order; each is in exactly one equation, and in no differential constraint.
        known: the known signals, in order.
        unknowns: in order; if not given, every other name is an unknown, in the order in which they occur.
        where: what messages begin with.

    Raises:
        ModelError: names or constraints contradict each other.
    """
    constraints = {d.name: d for d in differentials}
    contents = {name: list(variables) for name, variables in equations.items()}
    for d in differentials:
        contents.setdefault(d.name, [d.state, d.derivative])
    every = list(dict.fromkeys(name for variables in contents.values() for name in variables))
    given = [name for name in every if name not in {*faults, *known}] if unknowns is None else list(unknowns)
    _check_names(list(contents), where)
    _check_names([*given, *known, *faults], where)
    _check_contents(contents, [*given, *known, *faults], where)
    _check_differentials(differentials, contents, given, where)
    return Structure(
        equations=tuple(contents),
        unknowns=tuple(given),
        known=tuple(known),
        faults=tuple(faults),
        unknown_rows=tuple(_mask(variables, given) for variables in contents.values()),
        known_rows=tuple(_mask(variables, known) for variables in contents.values()),
        fault_rows={fault: _fault_row(fault, contents, where) for fault in faults},
        differentials={name: constraints[name] for name in contents if name in constraints},
    )


def _object(text: str, where: str) -> dict[str, object]:
    """The JSON object in the text; a key that comes twice is refused too."""

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        twice = first_repeated([key for key, _ in pairs])
        if twice is not None:
            raise ModelError(f"{where}: key {twice!r} comes twice in an object; keep one")
        return dict(pairs)

    try:
        data = json.loads(text, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise ModelError(f'{where}: not JSON: {error}; write a structural model like {{"X": [[1, 1]]}}') from error
    if not isinstance(data, dict):
        raise ModelError(f'{where}: must be an object like {{"X": [[1, 1]], "F": [[1]]}}, with equations in rows')
    return data


def _matrices(data: Mapping[str, object], where: str) -> dict[str, list[list[int]]]:
    """The matrices by name, those that are absent without columns; all have the rows of X."""
    for key in data:
        if key not in _MATRICES:
            raise ModelError(f"{where}: {key}: unknown key; allowed here are {', '.join([*_MATRICES, 'names'])}")
    found = {key: _matrix(data.get(key, []), top, f"{where}: {key}") for key, top in _MATRICES.items()}
    height = len(found["X"])
    if height == 0:
        raise ModelError(f"{where}: X: there is no equation; give a row for every one, empty if nothing is unknown")
    for key, matrix in found.items():
        if matrix and len(matrix) != height:
            raise ModelError(
                f"{where}: {key}: has {len(matrix)} rows, X has {height}; every matrix has a row for every equation"
            )
    return {key: matrix or [[] for _ in range(height)] for key, matrix in found.items()}


def _matrix(value: object, highest: int, place: str) -> list[list[int]]:
    if not isinstance(value, list):
        raise ModelError(f"{place}: must be a list of rows, not {_short(value)}")
    for i, row in enumerate(value):
        if not isinstance(row, list):
            raise ModelError(f"{place}[{i}]: must be a row like [0, 1], not {_short(row)}")
        if len(row) != len(value[0]):
            raise ModelError(
                f"{place}[{i}]: has {len(row)} entries, the rows before have {len(value[0])}; make them equally long"
            )
        for k, entry in enumerate(row):
            if isinstance(entry, bool) or not isinstance(entry, int) or not 0 <= entry <= highest:
                raise ModelError(f"{place}[{i}][{k}]: must be a whole number from 0 to {highest}, not {_short(entry)}")
    return value


def _differential(name: str, row: Sequence[int], unknowns: Sequence[str], place: str) -> Differential:
    if sorted(entry for entry in row if entry) != [_STATE, _DERIVATIVE]:
        raise ModelError(
            f"{place}: {name} is a differential constraint: it needs one 2 (state), one 3 (its derivative), else zeros"
        )
    return Differential(name=name, state=unknowns[row.index(_STATE)], derivative=unknowns[row.index(_DERIVATIVE)])


def _check_names(names: Sequence[str], where: str) -> None:
    for name in names:
        if not _NAME.fullmatch(name):
            raise ModelError(f"{where}: {name!r} is no name; use at least one character, no space and no comma")
    twice = first_repeated(names)
    if twice is not None:
        raise ModelError(f"{where}: names: {twice} is the name of two things; rename one")


def _check_contents(contents: Mapping[str, Sequence[str]], declared: Sequence[str], where: str) -> None:
    if not contents:
        raise ModelError(f"{where}: there is no equation; give at least one")
    allowed = set(declared)
    for equation, variables in contents.items():
        for name in variables:
            if name not in allowed:
                raise ModelError(f"{where}: {equation}: unknown name {name!r}; add it to the unknowns, known or faults")


def _check_differentials(
    differentials: Sequence[Differential], contents: Mapping[str, Sequence[str]], unknowns: Sequence[str], where: str
) -> None:
    twice = first_repeated([d.name for d in differentials])
    if twice is not None:
        raise ModelError(f"{where}: {twice}: there are two differential constraints of this name; rename one")
    for d in differentials:
        for name in (d.state, d.derivative):
            if name not in unknowns:
                raise ModelError(
                    f"{where}: {d.name}: {name} is no unknown; only unknowns have differential constraints"
                )
        others = sorted(set(contents[d.name]) - {d.state, d.derivative})
        if others or not {d.state, d.derivative} <= set(contents[d.name]):
            raise ModelError(
                f"{where}: {d.name}: a differential constraint holds {d.state} and {d.derivative} and nothing else"
                + (f"; move {', '.join(others)} to the equation of {d.derivative}" if others else "")
            )
    twice = first_repeated([name for d in differentials for name in (d.state, d.derivative)])
    if twice is not None:
        raise ModelError(
            f"{where}: {twice} is in two differential constraints; a variable is one state or one derivative, "
            "and an equation like v = dx makes a copy of it"
        )


def _fault_row(fault: str, contents: Mapping[str, Sequence[str]], where: str) -> int:
    """The row of the only equation that the fault enters."""
    rows = [row for row, variables in enumerate(contents.values()) if fault in variables]
    if not rows:
        raise ModelError(f"{where}: fault {fault} is in no equation; say which one it enters, or remove it")
    if len(rows) > 1:
        names = ", ".join(name for name, variables in contents.items() if fault in variables)
        raise ModelError(
            f"{where}: fault {fault} is in {names}; let it define an unknown of its own and use that in all of them"
        )
    return rows[0]


def _mask(names: Sequence[str], order: Sequence[str]) -> int:
    return mask_of([position for position, name in enumerate(order) if name in names])


def _short(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."
