"""A DBC's bytes to text, in whatever character set, and the part of the text that some signals need.

The format names no character set; tools write the one of the machine that they run on.
"""

import re
from collections.abc import Callable, Collection, Iterator, Set
from typing import NamedTuple

_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_DECLARED = re.compile(rb'BA_\s+"\w*(?:encoding|code_?page|charset)"\s+"?([\w.:-]+)"?\s*;', re.IGNORECASE)


def dbc_text(raw: bytes) -> str:
    """Return the text of a DBC file: every sequence of bytes is one.

    The character set is that of the byte order mark, else UTF-8 where the bytes are valid in it, else what the file
    declares by an attribute whose name ends in `Encoding`, `Codepage` or `Charset`, else Windows-1252.

    >>> dbc_text("°C".encode("cp1252")), dbc_text("°C".encode())
    ('°C', '°C')
    """
    for mark, name in _MARKS:
        if raw.startswith(mark):
            return raw[len(mark) if name == "utf-8" else 0 :].decode(name, errors="replace")
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return _declared(raw) or raw.decode("cp1252", errors="replace")


def _declared(raw: bytes) -> str | None:
    """The text in the character set that the file declares; None where it declares none that fits."""
    found = _DECLARED.search(raw)
    if found is None:
        return None
    name = found[1].decode("ascii", errors="replace")
    try:
        text = raw.decode(f"cp{name}" if name.isdecimal() else name)
    except (LookupError, UnicodeDecodeError):
        return None
    return text if found[0].decode() in text else None  # else it is none whose first half is ASCII


_STRING = r'"(?:\\"|[^"])*?"'
_KEYWORDS = (
    *("BA_", "BA_DEF_", "BA_DEF_DEF_", "BA_DEF_DEF_REL_", "BA_DEF_REL_", "BA_DEF_SGTYPE_", "BA_REL_", "BA_SGTYPE_"),
    *("BO_", "BO_TX_BU_", "BS_", "BU_", "CAT_", "CAT_DEF_", "CM_", "ENVVAR_DATA_", "EV_", "EV_DATA_", "NS_", "SG_"),
    *("SGTYPE_", "SGTYPE_VAL_", "SG_MUL_VAL_", "SIGTYPE_VALTYPE_", "SIG_GROUP_", "SIG_TYPE_REF_", "SIG_VALTYPE_"),
    *("VAL_", "VAL_TABLE_", "VERSION"),
)
_TOKEN = re.compile(rf"{_STRING}|//[^\n]*|;|\b(?:{'|'.join(_KEYWORDS)})\b")
_QUOTED = re.compile(_STRING)
_SIGNAL = re.compile(r"\bSG_\s+(\w+)")
_NUMBER = re.compile(r"\d+")
_STATED = re.compile(r"BO_\s+(\d+)\s+(\w+)")
_OF_SIGNAL = re.compile(r"\w+_\s+(\d+)\s+(\w+)")
_OF_MESSAGE = re.compile(r"\b(?:BO_|SG_)\s+(\d+)")
_LONG_NAME = re.compile(r'BA_\s+"SystemSignalLongSymbol"\s+SG_\s+(\d+)\s+(\w+)\s+"([^"]*)"')

_OPEN = ("BO_", "NS_", "BS_", "BU_", "VERSION")
"""Statements that end where the next one begins; the others end with a semicolon."""
_INSIDE = {"BO_": ("SG_",), "NS_": tuple(each for each in _KEYWORDS if each not in ("BS_", "BU_"))}
"""Keywords that begin no statement within these."""
_ATTRIBUTES = ('"VFrameFormat"', '"GenMsgCycleTime"', '"SystemSignalLongSymbol"', '"SystemMessageLongSymbol"')


class _Statement(NamedTuple):
    kind: str
    begin: int
    end: int


Carried = tuple[str, str]
"""A message's number and the name of a signal of it, as the text has them."""


class Stated(NamedTuple):
    """A message as the text has it: name, number (with the bit of 29-bit identifiers) and signals."""

    name: str
    number: int
    carried: Set[Carried]


def stated_messages(text: str) -> list[Stated]:
    """Return the messages with signals, one of each number, also those that no reader takes."""
    found: dict[int, Stated] = {}
    for kind, begin, end in _statements(text):
        head = _STATED.match(text, begin, end) if kind == "BO_" else None
        carried = _carried(text[begin:end]) if head is not None else set()
        if head is not None and carried:
            before = found.get(number := int(head[1]))
            found[number] = Stated(head[2], number, carried | (before.carried if before is not None else set()))
    return [*found.values()]


def needed(text: str, names: Collection[str]) -> str:
    """Return the text with nothing but the messages that carry signals of these `names`; lines keep their numbers.

    Kept are their frame format, cycle time, long names, value types and multiplexing, not value tables and comments.
    """
    longer = {(number, short) for number, short, name in _LONG_NAME.findall(text) if name in names}
    return only(text, lambda carried: any(name in names or (number, name) in longer for number, name in carried))


def only(text: str, is_needed: Callable[[Set[Carried]], bool]) -> str:
    """Return the same of the messages of which `is_needed` is true, as it is called with their signals."""
    statements = list(_statements(text))
    signals: set[Carried] = set()  # of all messages that stay
    for kind, begin, end in statements:
        if kind == "BO_" and is_needed(carried := _carried(text[begin:end])):
            signals |= carried
    pieces, done = [], 0
    for statement in statements:
        _, begin, end = statement
        pieces += ["\n" * text.count("\n", done, begin), _kept(statement, text[begin:end], signals)]
        done = end
    return "".join(pieces) + "\n" * text.count("\n", done)


def _kept(statement: _Statement, body: str, signals: Set[Carried]) -> str:
    """The statement, or as many empty lines."""
    plain = _QUOTED.sub('""', body)
    match statement.kind:
        case "VERSION" | "BS_" | "BU_":
            stays = True
        case "BO_":
            stays = bool(carried := _carried(body)) and carried <= signals
        case "BA_DEF_" | "BA_DEF_DEF_":
            stays = any(name in body for name in _ATTRIBUTES)
        case "BA_":
            of = _OF_MESSAGE.search(plain)
            is_needed = of is not None and any(of[1] == number for number, _ in signals)
            stays = is_needed and any(name in body for name in _ATTRIBUTES)
        case "SIG_VALTYPE_" | "SG_MUL_VAL_":
            found = _OF_SIGNAL.match(plain)
            stays = found is not None and (found[1], found[2]) in signals
        case _:
            stays = False
    return body if stays else "\n" * body.count("\n")


def _carried(message: str) -> set[Carried]:
    """The message's number with each of its signals."""
    plain = _QUOTED.sub('""', message)
    number = _NUMBER.search(plain)
    return {(number[0], name) for name in _SIGNAL.findall(plain)} if number else set()


def _statements(text: str) -> Iterator[_Statement]:
    """The statements in their order; what stands between them is none."""
    kind, begin = "", 0
    for token in _TOKEN.finditer(text):
        word = token[0]
        if word == ";":
            if kind and kind not in _OPEN:
                yield _Statement(kind, begin, token.end())
                kind = ""
        elif word[0] in '"/' or (kind and kind not in _OPEN) or word in _INSIDE.get(kind, ()):
            continue
        else:
            if kind:
                yield _Statement(kind, begin, token.start())
            kind, begin = word, token.start()
    if kind:
        yield _Statement(kind, begin, len(text))
