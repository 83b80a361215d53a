"""Screen as a pure function of the view model and of the terminal's size."""

from collections.abc import Sequence
from textwrap import wrap

from faultline.service.core.display import Display, display_of
from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.health import meaning
from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.watching.lines import PLAIN, Line, Look, Piece, Section, fitted, line, rendered
from faultline.service.watching.table import NAME, legend, table, widest
from faultline.service.watching.view_model import ViewModel, at

MODE_WORDS = {"live": ("LIVE", "good"), "waiting": ("WAITING", "warn"), "away": ("AWAY", "bad")}


def screen(seen: ViewModel, columns: int, rows: int, look: Look = PLAIN) -> list[str]:
    """Return at most `rows` lines of at most `columns` columns; all characters are printable."""
    tick, system = seen.tick, seen.system
    sections = [
        Section([_head(seen), verdict(seen)], 2),
        Section(_why(seen, columns) or _explanations(tick, system), 3),
        Section(_conditions(seen), 1),
        Section(_signals(tick, system, columns), 2),
        table(tick, system, columns, look),
        Section(legend(tick, system, columns), 1),
        Section([line(Piece("event  ", "dim"), each) for each in seen.events], 1, range(len(seen.events)), False),
    ]
    lines = fitted(sections, (0, 2, 1, 4, 3, 5, 6), rows)
    return [rendered(each, columns, look) for each in lines[:rows]]


def verdict(seen: ViewModel) -> Line:
    """Return the verdict in words."""
    tick = seen.tick
    if tick is None:
        return line(Piece("cannot tell: ", "warn"), "no live values")
    blind = f"; cannot tell: {' '.join(tick.cannot_tell)}" if tick.cannot_tell else ""
    if tick.diagnoses:
        best = _names(tick.diagnoses[0], seen.system)
        others = len(tick.diagnoses) - 1
        return line(Piece("FAULT ", "bad"), Piece(best, "bold"), f", or {others} more" if others else "", blind)
    if tick.anomaly or tick.alarm:
        why = f"alarm of {' '.join(tick.alarm)}" if tick.alarm else "the residuals together have changed"
        return line(Piece("suspected ", "warn"), f"and not confirmed: {why}{blind}")
    if tick.cannot_tell:
        return line(Piece("cannot tell: ", "warn"), f"no alarm, but {' '.join(tick.cannot_tell)} cannot tell")
    return line(Piece("no fault: ", "good"), "every test is quiet")


def _head(seen: ViewModel) -> Line:
    word, style = MODE_WORDS[seen.connection]
    names = [] if seen.state is None else [each.name for each in seen.state.systems]
    parts = [seen.state.source if seen.state else "", seen.system.name if seen.system else ""]
    if seen.system is not None and len(names) > 1 and seen.system.name in names:
        parts[-1] += f" ({names.index(seen.system.name) + 1} of {len(names)}, Tab: next)"
    if seen.tick is not None:
        parts += [f"t {seen.tick.t_s:.1f} s", f"mode {seen.tick.mode}"]
    return line(Piece(word, style), "  ", "  ".join(part for part in parts if part))


def _why(seen: ViewModel, columns: int) -> list[Line]:
    """Return why there are no values, whole."""
    return [line(Piece(each, "warn")) for each in wrap(seen.why, max(columns, 20))] if seen.tick is None else []


def _names(diagnosis: Diagnosis, system: SystemDescription | None) -> str:
    """Return the faults with their components; of what is unknown, where it is."""
    meanings = {} if system is None else {each.name: f" ({each.component})" for each in system.faults}
    if diagnosis.faults:
        return " and ".join(f"{name}{meanings.get(name, '')}" for name in diagnosis.faults)
    equations = {} if system is None else {each.name: f" ({each.description})" for each in system.equations}
    near = ", ".join(f"{name}{equations.get(name, '')}" for name in diagnosis.near)
    return f"unknown{f', near {near}' if near else ''}"


def _explanations(tick: LiveTick | None, system: SystemDescription | None) -> list[Line]:
    """Return each explanation with its probability and component; then the tests that discriminate."""
    if tick is None:
        return []
    descriptions = {} if system is None else {each.name: each.description or "" for each in system.faults}
    lines = []
    for each in tick.diagnoses:
        p = "  p = ?    " if each.p is None else f"  p = {each.p:.3f}  "
        what = ", ".join(descriptions[name] for name in each.faults if name in descriptions)
        lines.append(line(f"{each.rank:2d}.", Piece(p, "dim"), Piece(_names(each, system), "bold"), f"  {what}"))
    for pair in tick.separating:
        one, other = (" and ".join(names) for names in pair.between)
        tests = [f"{' '.join(pair.telling)}"] if pair.telling else []
        tests += [f"{' '.join(pair.waiting)} (cannot tell now)"] if pair.waiting else []
        by = f"told apart by {', '.join(tests)}" if tests else "no test tells them apart: size and sign do"
        lines.append(line(Piece("    ", "dim"), f"{one} or {other}: {by}"))
    return lines


def _conditions(seen: ViewModel) -> list[Line]:
    if seen.state is None or seen.connection == "away":
        return []
    return [
        line(Piece("! ", "warn"), f"{each.of} {meaning(each.kind)}, since {each.since or 'before'}")
        for each in seen.state.conditions
    ]


def _signals(tick: LiveTick | None, system: SystemDescription | None, columns: int) -> list[Line]:
    """Return values with unit, predictions and quality; side by side if there is room."""
    if system is None:
        return []
    names = widest([each.signal for each in system.inputs])
    words = [_word(tick, k) for k in range(len(system.inputs))]
    cells = []
    for k, (each, word) in enumerate(zip(system.inputs, words, strict=True)):
        value = None if tick is None else at(tick.z, k)
        predicted = [] if tick is None else _predictions(tick, system, each.signal)
        shown = display_of(each)
        cell = line(f"{each.signal[:NAME]:<{names}} {shown.text(value):>11} ")
        cell.append(Piece(f"{word:<{max(map(len, words))}}", "" if word == "good" else "warn"))
        is_predicted = any(one.predicts == each.signal for one in system.generators)
        cell.append(Piece(f"  pred {_span(predicted, shown):<14}" if is_predicted else " " * 21))
        cells.append(cell)
    width = max((sum(len(piece.text) for piece in cell) for cell in cells), default=0)
    abreast = max(1, (columns + 3) // (width + 3))
    lines = []
    for begin in range(0, len(cells), abreast):
        row: Line = []
        for cell in cells[begin : begin + abreast]:
            used = sum(len(piece.text) for piece in cell)
            row += [*cell, Piece(" " * (width - used + 3))]
        lines.append(row)
    return lines


def _word(tick: LiveTick | None, k: int) -> str:
    """Return a signal's quality, in capitals if it is not good."""
    quality = "no value" if tick is None else at(tick.quality, k) or "?"
    return quality if quality == "good" else quality.upper().replace("_", " ")


def _predictions(tick: LiveTick, system: SystemDescription, signal: str) -> list[float]:
    found = []
    for k, each in enumerate(system.generators):
        y_hat = at(tick.y_hat, k)
        if each.predicts == signal and at(tick.usable, k) and y_hat is not None:
            found.append(y_hat)
    return found


def _span(values: Sequence[float], shown: Display) -> str:
    if not values:
        return "-"
    low, high = shown.number(min(values)), shown.number(max(values))
    return low if low == high else f"{low} to {high}"
