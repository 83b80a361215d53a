"""Table of the tests: verdict, sum in parts of the threshold, row of the fault signature matrix."""

from collections.abc import Collection, Sequence
from string import ascii_lowercase, digits
from typing import NamedTuple

from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.watching.lines import ALWAYS, PLAIN, Line, Look, Piece, Section, line, wrapped
from faultline.service.watching.view_model import at

NARROW, WIDE = 60, 100
"""Columns from which tests have longer words, and longer bars."""
NAME = 16
"""Columns for a name in a table."""
FULL = 2.0
"""Where a bar ends, in parts of the threshold: a CUSUM goes no further."""


class _Widths(NamedTuple):
    """Columns of the table's parts; the matrix has the rest of the row."""

    name: int
    says: int
    bar: int
    number: int
    gap: int

    @classmethod
    def of(cls, system: SystemDescription, columns: int) -> "_Widths":
        name = widest([each.test for each in system.generators])
        if columns < NARROW:
            return cls(name, 6, 8, 5, 1)
        return cls(name, 11, 12 if columns < WIDE else 24, 6, 2)

    @property
    def matrix(self) -> int:
        """Return the column at which the matrix begins."""
        return 2 + self.name + 1 + self.says + 1 + self.bar + 1 + 1 + self.number + self.gap


def table(tick: LiveTick | None, system: SystemDescription | None, columns: int, look: Look) -> Section:
    """Return a row per test: its verdict, its sum in parts of the threshold, and the faults that it is sensitive to."""
    if system is None:
        return Section([])
    rows = {each.test: set[str]() for each in system.generators}
    for each in system.generators:
        rows[each.test].update(each.faults)
    sums, candidates = _sums(tick, system), _candidates(tick)
    widths, heads = _Widths.of(system, columns), _heads(system, columns)
    title = f"{'x threshold' if widths.says > 6 else 'x thr':>{widths.bar + 2 + widths.number}}"
    text = f"  {'test':<{widths.name}} {'says':<{widths.says}} {title}{'':<{widths.gap}}"
    marked = [Piece(text, "mark" if fault in candidates else "dim") for fault, text in _marked(heads, candidates)]
    lines, worth = [line(Piece(text, "dim"), *marked)], [ALWAYS]
    for test, faults in rows.items():
        says, style, sign = _says(tick, test, widths)
        is_alarm = says == "ALARM"
        total = sums.get(test)
        number = "-" if total is None else f"{max(-99.0, min(99.0, total)):+.2f}"
        marker = ("▶ " if look.unicode else "> ") if is_alarm else "  "
        text = f"{marker}{test[:NAME]:<{widths.name}} {says:<{widths.says}} {bar(total, widths.bar, look)}"
        row = line(Piece(f"{text} {number:>{widths.number}}{'':<{widths.gap}}", style))
        for fault, head in heads:
            mark = sign[look.unicode] if fault in faults else "·" if look.unicode else "."
            lit = "mark" if is_alarm and fault in candidates else style
            cell = f"{mark.rjust(min(2, len(head))):<{len(head)}}"
            row.append(Piece(cell, lit if fault in faults else "dim"))
        lines.append(row)
        worth.append((2.0 if is_alarm else 0.0) + min(abs(total or 0.0), 1.9))
    return Section(lines, 4, worth)


def _says(tick: LiveTick | None, test: str, widths: _Widths) -> tuple[str, str, tuple[str, str]]:
    """Return a test's word, its style, and the mark in its row for a fault that it is sensitive to (ASCII, Unicode)."""
    if tick is None:
        return "-", "dim", ("o", "□")
    if test in tick.alarm:
        return "ALARM", "bad", ("#", "■")
    if test in tick.cannot_tell:
        return "cannot tell"[: widths.says].rstrip(), "warn", ("?", "?")
    return "quiet", "", ("o", "□")


def bar(value: float | None, width: int, look: Look = PLAIN) -> str:
    """Return the bar of a sum in parts of its threshold, which stands in the middle; full at twice the threshold.

    >>> bar(0.5, 8, Look(unicode=False)), bar(-1.5, 8, Look(unicode=False)), bar(None, 8, Look(unicode=False))
    ('##..|....', '####|##..', '    |    ')
    """
    full, empty, mark = ("█", "·", "│") if look.unicode else ("#", ".", "|")
    half = width // 2
    if value is None:
        return " " * half + mark + " " * (width - half)
    filled = min(width, round(min(abs(value), FULL) / FULL * width))
    cells = full * filled + empty * (width - filled)
    return cells[:half] + mark + cells[half:]


def _sums(tick: LiveTick | None, system: SystemDescription) -> dict[str, float]:
    """Return by test the largest sum of its generators."""
    found: dict[str, float] = {}
    for k, each in enumerate(system.generators):
        value = at(tick.sums, k) if tick is not None else None
        if value is not None and abs(value) >= abs(found.get(each.test, 0.0)):
            found[each.test] = value
    return found


def _candidates(tick: LiveTick | None) -> frozenset[str]:
    return frozenset(name for each in tick.diagnoses for name in each.faults) if tick is not None else frozenset()


def _heads(system: SystemDescription, columns: int) -> list[tuple[str, str]]:
    """Return of each fault its name and the head of its column: the name, or a letter that the legend explains."""
    names, room = [each.name for each in system.faults], columns - _Widths.of(system, columns).matrix
    if sum(len(name) + 2 for name in names) <= room:
        return [(name, f" {name} ") for name in names]
    width = 3 if 3 * len(names) <= room else 1
    letters = (letter.rjust(min(width, 2)).ljust(width) for letter in _letters(len(names)))
    return list(zip(names, letters, strict=True))


def _letters(count: int) -> list[str]:
    letters = ascii_lowercase + digits
    return [letters[k] if k < len(letters) else "?" for k in range(count)]


def _marked(heads: Sequence[tuple[str, str]], candidates: frozenset[str]) -> list[tuple[str, str]]:
    """A candidate has a star, or where there is no room for that a capital."""
    return [
        (fault, text if fault not in candidates else f"*{text[1:]}" if len(text) > 1 else text.upper())
        for fault, text in heads
    ]


def legend(tick: LiveTick | None, system: SystemDescription | None, columns: int) -> list[Line]:
    """Return the legend of the letters above the columns, where those are letters; candidates have a star."""
    if system is None or all(name == head.strip() for name, head in _heads(system, columns)):
        return []
    candidates = _candidates(tick)
    parts = []
    for letter, each in zip(_letters(len(system.faults)), system.faults, strict=True):
        is_candidate = each.name in candidates
        text = f"{'*' if is_candidate else ''}{letter} {each.name[:NAME]}"
        parts.append(Piece(text, "bold" if is_candidate else "dim"))
    return wrapped(parts, columns)


def widest(names: Collection[str]) -> int:
    """Columns for the longest of the names, as far as there is room for names."""
    return max(4, min(NAME, max(map(len, names), default=0)))
