"""Why a fault can or cannot be isolated from another, in words, and what would separate the two."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

from faultline.analysis.model.errors import ModelError
from faultline.analysis.structure.diagnosability import Interpretation, OverDeterminedPart
from faultline.analysis.structure.matching import bits
from faultline.analysis.structure.sensors import add_sensors
from faultline.analysis.structure.structure import Structure, over_determined

LISTED = 12  # names that a sentence lists before it says how many more there are


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Whether `fault` is isolable from `other` with residuals of this causality, and why.

    Equations and unknowns come in the model's order. If it is isolable, `test` has the equations of a minimal
    over-determined set that shows it. If not, `shared` are the equations that all tests of the fault have in common
    (none if there is no test), `sensors` the unknowns of which one more sensor, without fault, would separate them, and
    `causalities` those that would. `text` says it in sentences.
    """

    fault: str
    other: str
    causality: Interpretation
    isolable: bool
    test: tuple[str, ...]
    shared: tuple[str, ...]
    sensors: tuple[str, ...]
    causalities: tuple[Interpretation, ...]
    text: str


def why(structure: Structure, fault: str, other: str, causality: Interpretation) -> Explanation:
    """Explains whether `fault` is isolable from `other`.

    Raises:
        ModelError: a name is not a fault of the structure, both are the same, or there is no such causality.
    """
    for name in (fault, other):
        if name not in structure.fault_rows:
            raise ModelError(f"{name}: no fault of the model; those are {', '.join(structure.faults) or 'none'}")
    if fault == other:
        raise ModelError(f"{fault}: no fault is isolable from itself; name two")
    parts = OverDeterminedPart(structure, causality)
    row, other_row = structure.fault_rows[fault], structure.fault_rows[other]
    isolable = bool(parts.without(1 << other_row) >> row & 1)
    test: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    causalities: tuple[Interpretation, ...] = ()
    if isolable:
        test = structure.names(_test(structure, parts, row, other_row))
        sentences = _shown(structure, parts, fault, other, causality, test)
    else:
        shared = structure.names(_shared(parts, row))
        sensors = tuple(_separating(structure, row, other_row, causality))
        causalities = tuple(
            kind
            for kind in get_args(Interpretation)
            if OverDeterminedPart(structure, kind).without(1 << other_row) >> row & 1
        )
        sentences = [
            *_reason(structure, parts, fault, other, causality, shared),
            *_remedy(row == other_row, sensors, causality, causalities),
        ]
    return Explanation(
        fault=fault,
        other=other,
        causality=causality,
        isolable=isolable,
        test=test,
        shared=shared,
        sensors=sensors,
        causalities=causalities,
        text=" ".join(sentences),
    )


def _test(structure: Structure, parts: OverDeterminedPart, row: int, other_row: int) -> int:
    """The rows of a minimal set that contains `row` and not `other_row`, with as few other faults as can be left out.

    A row is left out if `row` stays over-determined without it; what remains is a minimal set that can be run so.
    """
    part = parts.without(1 << other_row)
    faulty = {*structure.fault_rows.values()}
    removed = ~part
    for candidate in sorted(bits(part & ~(1 << row)), key=lambda r: (r not in faulty, r)):
        if parts.without(removed | 1 << candidate) >> row & 1:
            removed |= 1 << candidate
    return parts.without(removed)


def _shared(parts: OverDeterminedPart, row: int) -> int:
    """The rows that every test with `row` contains, none if there is no test: `row` is in no test without them."""
    whole = parts.without()
    if not whole >> row & 1:
        return 0
    return sum(1 << r for r in bits(whole) if not parts.without(1 << r) >> row & 1)


def _separating(structure: Structure, row: int, other_row: int, causality: Interpretation) -> Iterator[str]:
    """The unknowns, no derivatives, of which a single fault-free sensor makes `row` isolable from `other_row`."""
    derivatives = {d.derivative for d in structure.differentials.values()}  # no sensor measures them
    parts = OverDeterminedPart(add_sensors(structure, structure.unknowns), causality)
    first = len(structure.equations)
    sensors = ((1 << len(structure.unknowns)) - 1) << first
    for x, unknown in enumerate(structure.unknowns):
        if unknown in derivatives:
            continue
        if parts.without(sensors & ~(1 << first + x) | 1 << other_row) >> row & 1:
            yield unknown


def _shown(
    structure: Structure,
    parts: OverDeterminedPart,
    fault: str,
    other: str,
    causality: Interpretation,
    test: Sequence[str],
) -> list[str]:
    sees = _listed(structure.faults_in(test), "and")
    sentences = [
        f"{fault} is isolable from {other} with {causality} causality: the test of {_listed(test, 'and')} sees {sees}, "
        f"but not {other}."
    ]
    if not parts.without(1 << structure.fault_rows[fault]) >> structure.fault_rows[other] & 1:
        sentences.append(f"It is not so the other way round: {other} is not isolable from {fault}.")
    return sentences


def _reason(
    structure: Structure,
    parts: OverDeterminedPart,
    fault: str,
    other: str,
    causality: Interpretation,
    shared: Sequence[str],
) -> list[str]:
    """One sentence on why the fault is not isolable from the other."""
    row, other_row = structure.fault_rows[fault], structure.fault_rows[other]
    equation, others = structure.equations[row], structure.equations[other_row]
    start = f"{fault} is not isolable from {other} with {causality} causality:"
    if row == other_row:
        return [f"{start} both enter {equation}, so every test sees both or neither."]
    if equation not in over_determined(structure):
        return [f"{start} no test sees {fault}, because {equation} is outside of the over-determined part."]
    if not shared:
        return [f"{start} no test of this causality sees {fault}, because none contains {equation}."]
    if not parts.without(1 << row) >> other_row & 1:
        return [
            f"{start} every test contains {_listed(shared, 'and')} or none of these, "
            f"and {fault} enters {equation}, {other} {others}."
        ]
    rest = [name for name in shared if name not in (equation, others)]
    more = f" (and {_listed(rest, 'and')})" if rest else ""
    return [
        f"{start} every test that contains {equation}, where {fault} enters, also contains {others}, "
        f"where {other} enters{more}.",
        f"It is not so the other way round: {other} is isolable from {fault}.",
    ]


def _remedy(
    same: bool, sensors: Sequence[str], causality: Interpretation, causalities: Sequence[Interpretation]
) -> list[str]:
    """Sentences on what would separate the two faults, and what would not."""
    if same:
        return ["Neither a sensor nor another causality can separate them; two equations instead of that one might."]
    found = f"A sensor of {_listed(sensors, 'or')} would separate them." if sensors else "No single sensor would help."
    if causality == "mixed":
        return [found]  # what needs mixed causality is no test of any other
    would = f"{_listed(causalities, 'or').capitalize()} causality would" if causalities else "No other causality would"
    cannot = [kind for kind in get_args(Interpretation) if kind not in (causality, *causalities)]
    rest = f"; {_listed(cannot, 'and')} cannot" if causalities and cannot else ""
    return [found, f"{would}{rest}."]


def _listed(names: Sequence[str], last: str) -> str:
    """Names as a phrase: a, b and c."""
    shown = [*names[:LISTED], *([f"{len(names) - LISTED} more"] if len(names) > LISTED else [])]
    return f"{', '.join(shown[:-1])} {last} {shown[-1]}" if len(shown) > 1 else "".join(shown)
