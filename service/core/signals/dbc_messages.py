"""All messages of a DBC one by one, whether or not each makes sense: what a log is held against."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import textparser
from cantools.database.can import Message
from cantools.database.can import Signal as DbcSignal

from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import (
    BROKEN,
    NOBODY,
    OWN_NAMES,
    SENSELESS,
    by_dbc_name,
    check_message,
    identity_of,
    layout_of,
    load,
    one_line,
    plain_names,
    unsaid,
    wanted_in,
)
from faultline.service.core.signals.dbc_text import Stated, needed, only, stated_messages
from faultline.service.core.signals.decode import EXTENDED
from faultline.service.core.signals.layout import Layout


class Described(NamedTuple):
    """A message of a DBC: its identifier, as in the file, and those of its signals that are asked for.

    Its `layout` has the units of the file; None where the message cannot be read, and `why` then says why.
    """

    name: str
    identifier: int
    is_extended: bool
    signals: tuple[str, ...]
    layout: Layout | None
    why: str = ""


def describe_dbc(
    text: str,
    where: str,
    names: Collection[str] | None = None,
    senders: Mapping[str, int] = NOBODY,
    signals: Mapping[str, str] = OWN_NAMES,
) -> list[Described]:
    """Return the messages that carry signals, of these `names` or of any, whether or not each of them makes sense.

    `signals` are the DBC's names of those that have other ones there.

    Raises:
        InputError: the text breaks the grammar.
    """
    senseless: list[tuple[Stated, str]] = []
    wanted = None if names is None else by_dbc_name(names, signals, where)
    try:
        messages, says_formats = load(text)
    except textparser.Error as error:
        raise InputError(f"{where}: not a valid DBC file: {one_line(error)}") from error
    except SENSELESS:
        text = text if wanted is None else needed(text, plain_names(wanted))
        messages, says_formats, senseless = _load_what_can_be(text, stated_messages(text))
    found = []
    for message in messages:
        carried = wanted_in(message, {each.name: each.name for each in message.signals} if wanted is None else wanted)
        if carried:
            layout, why = _tried(message, carried, messages, senders, says_formats)
            is_extended = message.is_extended_frame
            found.append(Described(message.name, message.frame_id, is_extended, tuple(carried), layout, why))
    return found + [
        Described(name, number & EXTENDED, number > EXTENDED, tuple(sorted(each for _, each in carried)), None, why)
        for (name, number, carried), why in senseless
    ]


def _tried(
    message: Message,
    signals: Mapping[str, DbcSignal],
    messages: Collection[Message],
    senders: Mapping[str, int],
    says_formats: bool,
) -> tuple[Layout | None, str]:
    """The layout of a message in the units of the file, or why there is none."""
    if why := unsaid(message, says_formats):
        return None, f"the DBC {why}"
    try:
        check_message(message, signals.values(), "DBC")
        units = {name: each.unit or "" for name, each in signals.items()}
        return layout_of(message, identity_of(message, messages, senders), signals, units, "DBC"), ""
    except InputError as error:
        return None, f"makes no sense: {str(error).removeprefix('DBC: ')}"


def _load_what_can_be(text: str, stated: Sequence[Stated]) -> tuple[list[Message], bool, list[tuple[Stated, str]]]:
    """The same of those of the `stated` messages that make sense, found by halves; and why the others make none."""
    wanted = frozenset(each for one in stated for each in one.carried)
    try:
        return (*load(only(text, lambda carried: carried <= wanted)), [])
    except BROKEN as error:
        if len(stated) < 2:
            return [], False, [(one, f"makes no sense: {one_line(error)}") for one in stated]
    middle = len(stated) // 2
    first, says_formats, senseless = _load_what_can_be(text, stated[:middle])
    others, also_says, also_senseless = _load_what_can_be(text, stated[middle:])
    return first + others, says_formats or also_says, senseless + also_senseless
