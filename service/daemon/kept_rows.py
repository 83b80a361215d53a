"""Rows that the store has kept of the fault memory: read, or set aside where they cannot be."""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import msgspec

from faultline.service.bundle.files import one_line
from faultline.service.core.records.fault import Fault, check
from faultline.service.store.journal import Journal

T = TypeVar("T")


class KeptRows:
    """Rows of a journal. State: whether any of them `is_damaged`. `say` is called with a line for each of those."""

    def __init__(self, journal: Journal, say: Callable[[str], None]) -> None:
        self._journal, self._say = journal, say
        self.is_damaged = False

    def named(self, kind: str) -> list[str]:
        """Return the names of all rows of a kind, such as `fault`."""
        return [name for name in self._journal.kept if name.startswith(f"{kind}/")]

    def read(self, names: Iterable[str], kind: type[T]) -> Iterator[T]:
        """Yield the values of the rows that are there; what cannot be read is set aside."""
        for name in names:
            text = self._journal.kept.get(name)
            if text is None:
                continue
            try:
                value = msgspec.json.decode(text, type=kind)
                if isinstance(value, Fault):
                    check(value, name)
            except Exception as error:  # noqa: BLE001 whatever is wrong with it: it is set aside, and that is told
                self.set_aside(name, one_line(error))
            else:
                yield value

    def set_aside(self, name: str, why: str) -> None:
        """Keep a row under another name, which nobody reads and nothing is written to."""
        aside = f"unreadable/{name}"
        while aside in self._journal.kept:
            aside += "+"
        self._say(f"the store's {name} cannot be read ({why}); it is kept as {aside}")
        self._journal.remember({name: None, aside: self._journal.kept[name]})
        self.is_damaged = True
