"""Lines of a screen: safe characters, cutting, and the space for each section."""

import unicodedata
from collections.abc import Sequence
from math import inf
from typing import NamedTuple

STYLES = {"": "", "bold": "1", "bad": "1;31", "warn": "33", "good": "32", "dim": "2", "mark": "1;7"}
"""SGR parameters (ECMA-48, 8.3.117) by what is meant."""


class Look(NamedTuple):
    """Capabilities of the terminal: colours, and more than ASCII."""

    colour: bool = False
    unicode: bool = True

    @property
    def more(self) -> str:
        """Return the mark where something is cut."""
        return "…" if self.unicode else "~"


PLAIN = Look()


class Piece(NamedTuple):
    """Text in one style."""

    text: str
    style: str = ""


Line = list[Piece]


def line(*parts: str | Piece) -> Line:
    """Return a line of pieces and of plain text."""
    return [part if isinstance(part, Piece) else Piece(part) for part in parts]


def clean(text: str, look: Look) -> str:
    r"""Return the text as columns of one character each: nothing in it moves the cursor, whatever it contains.

    >>> clean("a\x1b[2Jb\n\u202ec\u4e2d", Look())
    'a?[2Jb??c?'
    """
    return "".join(each if _is_plain(each, look.unicode) else "?" for each in text)


def _is_plain(each: str, is_unicode: bool) -> bool:
    if each.isascii():
        return each.isprintable()
    wide = unicodedata.east_asian_width(each) in "WF" or unicodedata.combining(each)
    return is_unicode and each.isprintable() and not wide


def rendered(pieces: Line, columns: int, look: Look) -> str:
    """Return a line of at most that many columns, with colours where there may be any.

    >>> rendered(line("a ", Piece("fault", "bad")), 5, Look())
    'a fa…'
    """
    texts = [Piece(clean(text, look), style) for text, style in pieces]
    is_cut = sum(len(text) for text, _ in texts) > columns
    room = columns - 1 if is_cut else columns
    out = ""
    for text, style in texts:
        part = text[:room]
        room -= len(part)
        out += f"\x1b[{STYLES[style]}m{part}\x1b[0m" if look.colour and style and part else part
    return out + look.more if is_cut else out.rstrip(" ")


def wrapped(parts: Sequence[Piece], columns: int) -> list[Line]:
    """Return the parts, two blanks between them, on as many lines as they need.

    >>> [[piece.text for piece in each] for each in wrapped([Piece("a b"), Piece("c"), Piece("d")], 6)]
    [['a b  ', 'c'], ['d']]
    """
    lines: list[Line] = []
    used = 0
    for part in parts:
        if lines and used + 2 + len(part.text) <= columns:
            lines[-1][-1] = Piece(lines[-1][-1].text + "  ", lines[-1][-1].style)
            lines[-1].append(part)
            used += 2 + len(part.text)
        else:
            lines.append([part])
            used = len(part.text)
    return lines


class Section(NamedTuple):
    """Section of lines. `least` of them are shown before another section has more than its own.

    Where not all have room those of the largest `worth` stay, in their order; without it the first.
    """

    lines: list[Line]
    least: int = 1
    worth: Sequence[float] = ()
    says_more: bool = True


def fitted(sections: Sequence[Section], order: Sequence[int], rows: int) -> list[Line]:
    """Return the sections below each other on that many rows, room given in that `order`; blanks if there is room."""
    counts = [0] * len(sections)
    left = rows
    for most in (lambda each: each.least, lambda each: len(each.lines)):
        for k in order:
            more = min(most(sections[k]), len(sections[k].lines)) - counts[k]
            more = max(0, min(more, left))
            counts[k] += more
            left -= more
    shown = [k for k, count in enumerate(counts) if count]
    is_airy = left >= len(shown) - 1
    out: list[Line] = []
    for k in shown:
        if out and is_airy:
            out.append([])
        out += _cut(sections[k], counts[k])
    return out


def _cut(section: Section, count: int) -> list[Line]:
    if count == len(section.lines):
        return section.lines
    says_more = section.says_more and count > 1
    worth = section.worth or [-k for k in range(len(section.lines))]
    kept = sorted(range(len(section.lines)), key=lambda k: (-worth[k], k))[: count - says_more]
    lines = [section.lines[k] for k in sorted(kept)]
    return [*lines, line(Piece(f"  and {len(section.lines) - len(kept)} more", "dim"))] if says_more else lines


ALWAYS = inf
"""The worth of what is never cut."""
