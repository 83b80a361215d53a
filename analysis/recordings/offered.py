"""Signals that files offer: columns of a table and signals of a DBC's messages, with their units."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from faultline.service.core.errors import InputError
from faultline.service.core.j1939.identifiers import FRAME
from faultline.service.core.signals.dbc import BROKEN, load, one_line
from faultline.service.core.signals.dbc_messages import Described, describe_dbc
from faultline.service.core.signals.dbc_text import dbc_text, needed
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.units import UNITS, plain_unit
from faultline.service.logs.units import conversion

Identifiers = Collection[tuple[int, bool]]
"""Identifiers of frames, and whether they have 29 bits."""
SI = tuple(dict.fromkeys(unit for unit, _ in UNITS.values()))


class Offer(NamedTuple):
    """A column or a signal of a DBC.

    `name` is as in the file, `unit` as the file says it (empty: it does not), `message` that of the DBC (empty: a
    column). `is_alone`: no other message has a signal of that name.
    """

    name: str
    unit: str
    message: str = ""
    is_alone: bool = True

    @property
    def reference(self) -> str:
        """How `recording.toml` names it."""
        return self.name if self.is_alone else f"{self.message}.{self.name}"

    @property
    def shown(self) -> str:
        """Its reference with its unit."""
        return f"{self.reference} [{self.unit}]" if self.unit else self.reference

    def unit_for(self, wanted: str) -> str | None:
        """Return a unit that can be converted to the one wanted, as the file or the name says; None: another one.

        It is empty where neither says any.

        >>> Offer("T_degC", "").unit_for("K"), Offer("T_min", "").unit_for("K"), Offer("T [V]", "V").unit_for("K")
        ('degC', '', None)
        """
        if self.unit or self.message:
            return self.unit if conversion(self.unit, wanted) is not None else None
        return next((unit for _, unit in endings(self.name) if conversion(unit, wanted) is not None), "")


def endings(name: str) -> Iterator[tuple[str, str]]:
    """Yield what a name may be in front of a unit, with that unit.

    >>> list(endings("v_km_h")), list(endings("T_degC"))
    ([('v', 'km/h'), ('v_km', 'h')], [('T', 'degC')])
    """
    *front, last = name.split("_")
    if len(front) > 1:
        yield "_".join(front[:-1]), f"{front[-1]}/{last}"
    if front:
        yield "_".join(front), last


def unit_in_name(name: str) -> str:
    """Return the unit that a column's name ends with, as far as nothing else can be meant; else nothing.

    >>> unit_in_name("T_degC"), unit_in_name("v_km_h"), unit_in_name("T_min"), unit_in_name("y_p")
    ('degC', 'km/h', '', '')
    """
    certain = (unit for _, unit in endings(name) if len(unit) > 1 and unit != "min")
    return next((unit for unit in certain if plain_unit(unit) in UNITS or unit in SI), "")


def read_dbc(path: Path) -> str:
    """Return a DBC's text.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return dbc_text(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def of_columns(units: Mapping[str, str]) -> list[Offer]:
    """Return the columns of a table, by the units that it says."""
    return [Offer(name, unit) for name, unit in units.items()]


def of_dbc(text: str, where: str, messages: Mapping[str, "Came"] | None = None) -> list[Offer]:
    """Return the signals of a DBC's text, or of those of its messages that came.

    Raises:
        InputError: the text is no DBC.
    """
    if messages is not None:
        text = needed(text, {name for each in messages.values() for name in each.message.signals})
    try:
        stated = load(text)[0]
    except BROKEN as error:
        raise InputError(f"{where}: not a valid DBC file: {one_line(error)}") from error
    carried = [
        (each.name, each.unit or "", message.name)
        for message in stated
        for each in message.signals
        if messages is None or message.name in messages
    ]
    names = [name for name, _, _ in carried]
    return [Offer(*each, is_alone=names.count(each[0]) == 1) for each in carried]


class Came(NamedTuple):
    """A message of a DBC, and the identifiers of its frames in a log."""

    message: Described
    identifiers: set[tuple[int, bool]]


def came(text: str, where: str, identifiers: Identifiers) -> dict[str, Came]:
    """Return the messages of a DBC of which frames came, by name.

    One of J1939 that is longer than a frame comes in parts, which say nothing here: it is among them.

    Raises:
        InputError: the text is no DBC.
    """
    found = {}
    for each in describe_dbc(text, where):
        if each.layout is None:
            theirs = {(each.identifier, each.is_extended)} & set(identifiers)
        else:
            table = DecodeTable({(each.layout.identifier, each.is_extended): each.layout})
            theirs = {one for one in identifiers if table.layout_of(*one) is not None}
        if theirs or (each.layout is not None and each.layout.j1939 and each.layout.size > FRAME):
            found[each.name] = Came(each, theirs)
    return found
