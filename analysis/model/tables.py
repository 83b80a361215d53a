"""Strict reading of TOML tables: every key is asked for, and what nobody asked for is an error with its path."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

from faultline.analysis.model.errors import ModelError

T = TypeVar("T")


class Table:
    """A table at a `place` like `uds.toml: equation[3]`; reads take keys away, `done` refuses what is left."""

    def __init__(self, data: Mapping[str, object], place: str, *, top: bool = False) -> None:
        self._data = dict(data)
        self._top = top
        self._allowed: dict[str, None] = {}  # in the order of asking
        self.place = place

    def at(self, key: str) -> str:
        """The place of a key of this table."""
        return f"{self.place}: {key}" if self._top else f"{self.place}.{key}"

    def fail(self, key: str, problem: str) -> ModelError:
        """An error at a key of this table, to raise."""
        return ModelError(f"{self.at(key)}: {problem}")

    def text(self, key: str, default: str | None = None) -> str:
        """A string; required unless there is a default."""
        return self._take(key, str, "a string", default)

    def optional_text(self, key: str) -> str | None:
        """A string, None if absent."""
        self._allowed[key] = None
        return self.text(key) if key in self._data else None

    def number(self, key: str) -> float:
        """A finite number."""
        return self._finite(key, self._take(key, object, "a number", None))

    def optional_number(self, key: str) -> float | None:
        """A finite number, None if absent."""
        self._allowed[key] = None
        return self.number(key) if key in self._data else None

    def optional_whole(self, key: str, least: int, most: int) -> int | None:
        """A whole number from `least` to `most`, None if absent."""
        self._allowed[key] = None
        if key not in self._data:
            return None
        value = self._take(key, int, "a whole number", None)
        if isinstance(value, bool) or not least <= value <= most:
            raise self.fail(key, f"must be a whole number from {least} to {most}, not {value!r}")
        return value

    def flag(self, key: str) -> bool:
        """True or false, false if absent."""
        return self._take(key, bool, "true or false", False)

    def has(self, key: str) -> bool:
        """Return whether there is such a key, which may be absent."""
        self._allowed[key] = None
        return key in self._data

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers."""
        return tuple(self._finite(f"{key}[{k}]", v) for k, v in enumerate(self._take(key, list, "a list", None)))

    def rows(self, key: str) -> tuple[tuple[float, ...], ...]:
        """A list of lists of finite numbers, empty if absent."""
        rows: list[object] = self._take(key, list, "a list of lists", [])
        for k, row in enumerate(rows):
            if not isinstance(row, list):
                raise self.fail(f"{key}[{k}]", f"must be a list, not {row!r}")
        return tuple(
            tuple(self._finite(f"{key}[{k}][{n}]", v) for n, v in enumerate(row))
            for k, row in enumerate(rows)
            if isinstance(row, list)
        )

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of strings, empty if absent."""
        values: list[object] = self._take(key, list, "a list", [])
        for k, value in enumerate(values):
            if not isinstance(value, str):
                raise self.fail(f"{key}[{k}]", f"must be a string, not {value!r}")
        return tuple(str(value) for value in values)

    def text_or_texts(self, key: str) -> tuple[str, ...]:
        """A string or a list of them, empty if absent."""
        return (self.text(key),) if isinstance(self._data.get(key), str) else self.texts(key)

    def table(self, key: str) -> "Table | None":
        """A table within, None if absent."""
        self._allowed[key] = None
        if key not in self._data:
            return None
        return Table(self._take(key, dict, "a table", None), self.at(key))

    def named_tables(self, key: str) -> dict[str, "Table"]:
        """A table of tables, `[key.name]`, empty if absent."""
        section = self._take(key, dict, "a table of tables", {})
        return {name: self._within(f"{key}.{name}", value) for name, value in section.items()}

    def tables(self, key: str) -> list["Table"]:
        """A list of tables, `[[key]]`, empty if absent."""
        return [self._within(f"{key}[{k}]", value) for k, value in enumerate(self._take(key, list, "a list", []))]

    def rest(self) -> dict[str, object]:
        """Everything that has not been read, as it stands."""
        data, self._data = self._data, {}
        return data

    def done(self) -> None:
        """Raises ModelError for a key that was not read."""
        for key in self._data:
            raise self.fail(key, f"unknown key; allowed here are {', '.join(self._allowed)}")

    def _take(self, key: str, kind: type[T], what: str, default: T | None) -> T:
        self._allowed[key] = None
        if key not in self._data:
            if default is None:
                raise self.fail(key, f"is missing; give {what}")
            return default
        value = self._data.pop(key)
        if not isinstance(value, kind):
            raise self.fail(key, f"must be {what}, not {value!r}")
        return value

    def _finite(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
            raise self.fail(key, f"must be a finite number, not {value!r}")
        return float(value)

    def _within(self, key: str, value: object) -> "Table":
        if not isinstance(value, dict):
            raise self.fail(key, f"must be a table, not {value!r}")
        return Table(value, self.at(key))


def first_repeated(names: Sequence[str]) -> str | None:
    """The first name that has occurred before, None if all differ."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None
