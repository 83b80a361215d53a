"""Display of a running service on the terminal until the user ends it."""

import os
import sys
import time
from contextlib import suppress

from faultline.service.watching.lines import Look
from faultline.service.watching.live_client import LiveClient
from faultline.service.watching.screen import screen
from faultline.service.watching.terminal import Terminal

SHORTEST_S, LONGEST_S = 0.2, 0.5
"""Between two drawings: no more than five a second, and often enough that a tick that is old does not stand."""


def show(client: LiveClient) -> int:
    """Draw the view model until `q` is typed; returns 0."""
    look = look_of_terminal()
    client.begin()
    with Terminal() as terminal:
        while True:
            drawn = time.monotonic()
            columns, rows = terminal.size()
            terminal.draw(screen(client.seen(), columns, rows, look))
            typed = terminal.keys(client.wake, LONGEST_S)
            if "q" in typed:
                return 0
            if "\t" in typed:
                client.next_system()
            time.sleep(max(0.0, drawn + SHORTEST_S - time.monotonic()))
            with suppress(BlockingIOError):  # nothing new
                os.eventfd_read(client.wake)


def look_of_terminal() -> Look:
    """Return the terminal's capabilities by NO_COLOR, TERM, and the encoding of standard output."""
    is_dumb = os.environ.get("TERM", "") in ("", "dumb")
    encoding = (sys.stdout.encoding or "ascii").lower().replace("-", "")
    return Look(colour=not os.environ.get("NO_COLOR") and not is_dumb, unicode=encoding == "utf8")
