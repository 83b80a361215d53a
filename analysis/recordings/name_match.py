"""Which column or DBC signal is which signal of a model: by name and unit; what is not certain is left to a person."""

import re
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher
from typing import NamedTuple

from faultline.analysis.model.model import Known
from faultline.analysis.recordings.offered import Offer, endings

ALIKE = 0.6
"""From which similarity on names are proposed: difflib's ratio, or the part of words that the description has too."""
SHOWN = 6


class Match(NamedTuple):
    """What a signal of the model is: an offer with its unit, where it is certain; else a remark with candidates.

    `unit` is empty where the file says none, and None where it says one that cannot be converted. `is_alike`: the
    candidates have names that are alike.
    """

    offer: Offer | None
    unit: str | None = None
    remark: str = ""
    is_alike: bool = False


def match_names(known: Mapping[str, Known], offers: Sequence[Offer]) -> dict[str, Match]:
    """Return a match for each signal of the model: of its own name, of one that is equal without case and marks.

    A similar name, or one that several have, is a remark.
    """
    found: dict[str, Match] = {}
    for equal in (_is_same, _is_equal):
        for name, each in known.items():
            if name not in found and (there := [offer for offer in offers if equal(name, offer)]):
                found[name] = _of_equals(there, each.unit)
    taken = {match.offer for match in found.values() if match.offer is not None}
    left = [offer for offer in offers if offer not in taken]
    return {name: found.get(name) or _similar(name, each, left) for name, each in known.items()}


def _is_same(name: str, offer: Offer) -> bool:
    return offer.name == name


def _is_equal(name: str, offer: Offer) -> bool:
    return _plain(name) in _forms(offer)


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())


def _forms(offer: Offer) -> list[str]:
    """The name without case and marks, and without the unit that it may end with."""
    return [_plain(offer.name), *(_plain(front) for front, _ in (endings(offer.name) if not offer.message else ()))]


def _of_equals(offers: Sequence[Offer], wanted: str) -> Match:
    usable = [(offer, unit) for offer in offers if (unit := offer.unit_for(wanted)) is not None]
    columns = [each for each in usable if not each[0].message]
    if len(usable) == 1 or len(columns) == 1:  # a table's are taken before those of the log beside it
        return Match(*(columns or usable)[0])
    if usable:
        return Match(None, remark=" or ".join(offer.reference for offer, _ in usable), is_alike=True)
    if len(offers) == 1 and not offers[0].message:
        return Match(offers[0], None, f"{wanted} is wanted and {offers[0].unit} is what the file says")
    return Match(None, remark=f"{_listed(offers)} cannot be converted to {wanted}")


def _similar(name: str, known: Known, offers: Sequence[Offer]) -> Match:
    """A remark with the offers of similar names and the right dimension, the most similar ones first."""
    usable = [offer for offer in offers if offer.unit_for(known.unit) is not None]
    scores = [max(_ratio(name, offer), _shared(known.description, offer)) for offer in usable]
    alike = [usable[k] for k in sorted(range(len(usable)), key=lambda k: -scores[k]) if scores[k] >= ALIKE]
    if alike:
        return Match(None, remark=f"{' or '.join(offer.shown for offer in alike[:3])}?", is_alike=True)
    there = f"are {_listed(usable)}" if usable else "is none"
    return Match(None, remark=f"no name is alike; in a unit for {known.unit} there {there}")


def _ratio(name: str, offer: Offer) -> float:
    return max(SequenceMatcher(None, _plain(name), form).ratio() for form in _forms(offer))


def _shared(description: str, offer: Offer) -> float:
    """The part of the words of an offer's name, of three letters at least, that a description has too.

    >>> _shared("pressure in the dosing unit", Offer("DosingPressure", "bar"))
    1.0
    """
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]{2,}|[A-Z]{3,}", offer.name) if len(word) > 2]
    own = set(re.findall(r"[a-z]+", description.lower()))
    return sum(word in own for word in words) / len(words) if words else 0.0


def _listed(offers: Sequence[Offer]) -> str:
    return ", ".join([offer.shown for offer in offers[:SHOWN]] + (["..."] if len(offers) > SHOWN else []))
