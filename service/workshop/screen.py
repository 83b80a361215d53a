"""Progress on a terminal: one screen, drawn anew in place; or a line per change where nobody looks at a screen."""

import shutil
import unicodedata
from typing import Protocol, TextIO

from faultline.service.core.display import display_of
from faultline.service.workshop.cycle import Cycle
from faultline.service.workshop.words import SILENCE_S, order, so_far

HOME, BELOW, LINE, HIDE, SHOW = "\x1b[H", "\x1b[J", "\x1b[K", "\x1b[?25l", "\x1b[?25h"
CLEAR = "\x1b[2J"
BAR = 24  # characters


class Screen(Protocol):
    """Output for progress."""

    def show(self, cycle: Cycle) -> None:
        """Show the present state."""

    def close(self) -> None:
        """Leaves the terminal as it was."""


class Plain:
    """Output of a line for each change: of the order, of the diagnosis, of blind tests, and of finished steps."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._told: dict[str, str] = {}

    def show(self, cycle: Cycle) -> None:
        """Print what has changed."""
        progress, tick = cycle.progress, cycle.latest
        done = [f"{each.mode} {each.visit}" for k, each in enumerate(progress.steps) if progress.is_done(k)]
        self._say(cycle, "done", f"done: {', '.join(done)}" if done else "", "")
        k = progress.next
        mode = tick.mode if tick is not None and cycle.silent_s < SILENCE_S else ""
        state = f"{mode} {k} {bool(tick and all(tick.usable))} {cycle.suspected}"
        self._say(cycle, "order", order(cycle), state)
        self._say(cycle, "told", so_far(cycle), so_far(cycle).partition("(")[0])
        if tick is not None:
            blind = " ".join(tick.cannot_tell)
            self._say(cycle, "blind", f"cannot tell: {blind}" if blind else "all tests can tell", blind)

    def close(self) -> None:
        """Do nothing."""

    def _say(self, cycle: Cycle, what: str, text: str, key: str) -> None:
        key = key or text
        if text and self._told.get(what) != key:
            self._told[what] = key
            print(f"{cycle.elapsed_s:7.1f} s  {printable(text)}", file=self._out, flush=True)


class Live:
    """One screen, drawn anew in place."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        out.write(f"{HIDE}{CLEAR}")

    def show(self, cycle: Cycle) -> None:
        """Draw the present state, as much of it as the terminal has room for."""
        size = shutil.get_terminal_size()
        rows = [printable(row)[: size.columns - 1] for row in drawn(cycle)][: size.lines - 1]
        self._out.write(HOME + "".join(f"{row}{LINE}\n" for row in rows) + BELOW)
        self._out.flush()

    def close(self) -> None:
        """Shows the cursor again, below what was drawn."""
        self._out.write(SHOW)
        self._out.flush()


def drawn(cycle: Cycle) -> list[str]:
    """Return the screen's lines, the most important first."""
    tick, progress = cycle.latest, cycle.progress
    rows = [
        f"faultline workshop  {cycle.system.name}  {cycle.elapsed_s:.0f} s",
        "",
        f">> {order(cycle)}",
        f"   so far: {so_far(cycle)}",
        "",
    ]
    for k, step in enumerate(progress.steps):
        filled = round(BAR * progress.seconds[k] / step.hold_s)
        mark = "done" if progress.is_done(k) else "now" if progress.next == k else ""
        seconds = f"{progress.seconds[k]:3.0f}/{step.hold_s:.0f} s"
        rows.append(f"   {step.mode:<8}{step.visit}  [{'#' * filled:<{BAR}}] {seconds}  {mark}")
    if tick is None:
        return rows
    rows += ["", f"   mode {tick.mode}"]
    rows += [
        f"   {channel.signal:<12}{display_of(channel).text(value):>14}{'' if quality == 'good' else f'  {quality}'}"
        for channel, value, quality in zip(cycle.system.inputs, tick.z, tick.quality, strict=True)
    ]
    rows += ["", f"   {'test':<8}{'now':<13}{'worst':>7}   seconds in {', '.join(cycle.modes)}"]
    for test in cycle.system.tests:
        now = "cannot tell" if test in tick.cannot_tell else "ALARM" if test in tick.alarm else "quiet"
        seconds = "".join(f"{cycle.seconds[test][mode]:6.0f}" for mode in cycle.modes)
        rows.append(f"   {test:<8}{now:<13}{cycle.worst[test]:+7.2f}   {seconds}")
    return rows


def printable(text: str) -> str:
    r"""Return the text without control characters of a terminal: names come from elsewhere.

    >>> printable("pump\x1b[2J")
    'pump?[2J'
    """
    return "".join("?" if unicodedata.category(each) in ("Cc", "Cf", "Cs") else each for each in text)
