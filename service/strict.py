"""Strict configuration files: TOML into a struct; what is unknown or makes no sense is an error that names the line."""

import re
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Generic, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from faultline.service.core.errors import InputError

T = TypeVar("T", bound=msgspec.Struct)
Step = str | int
"""To a part of a file: a key, or the number of an item."""

Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.-]*\Z", max_length=80)]
"""It stands in ids and topics: nothing that means something there."""
Path_ = Annotated[str, Meta(pattern=r"\A/[^\x00]*\Z", max_length=1000)]

LARGEST = 256 * 1024  # bytes of a file that somebody wrote


class ConfigError(InputError):
    """A configuration that must not be used."""


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness: every field by name, none unknown."""


Explain = Callable[[str, list[Step]], tuple[str, list[Step]]]


class Read(NamedTuple, Generic[T]):
    """What a file says, and its text, for errors in what its parts must say of each other."""

    said: T
    path: Path
    text: str

    def wrong(self, steps: Sequence[Step], message: str) -> ConfigError:
        """An error at the part that `steps` lead to, to raise."""
        return _error(self.path, self.text, steps, message)


def read(path: Path, kind: type[T], explain: Explain = lambda message, steps: (message, steps)) -> Read[T]:
    """The file at `path` as a struct; `explain` may say more about what makes no sense, and where.

    Raises:
        ConfigError: it cannot be read, is no TOML, or is none of that kind.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise ConfigError(f"{path}: more than {LARGEST // 1024} KiB; this is no configuration")
        text = raw.decode()
        tree = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give another --config") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    try:
        return Read(msgspec.convert(tree, kind), path, text)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at `")
        steps = [int(number) if number else key for key, number in re.findall(r"\.([\w-]+)|\[(\d+)\]", where)]
        if (unknown := re.search(r"unknown field `(.*)`", message)) is not None:
            steps.append(unknown.group(1))
        message, steps = explain(message, steps)
        raise _error(path, text, steps, message) from error


def line_of(text: str, steps: Sequence[Step]) -> int:
    r"""The line of a TOML text (from 1) that `steps` lead to, or of the nearest part around it that has one.

    >>> line_of("[a]\nb = 1\n[[c]]\n[[c]]\nd = 2", ["c", 1, "d"])
    5
    """
    found, depth = 1, 0
    table, counts = list[Step](), Counter[str]()
    for number, line in enumerate(text.splitlines(), start=1):
        if (many := re.match(r"\s*\[\[\s*([\w.-]+)\s*\]\]", line)) is not None:
            table = [*many[1].split("."), counts[many[1]]]
            counts[many[1]] += 1
            here = table
        elif (one := re.match(r"\s*\[\s*([\w.\s-]+?)\s*\]", line)) is not None:
            table = here = [part.strip() for part in one[1].split(".")]
        elif (key := re.match(r"""\s*["']?([\w.-]+)["']?\s*=""", line)) is not None:
            here = [*table, *key[1].split(".")]
        else:
            continue
        if here == list(steps[: len(here)]) and len(here) > depth:
            found, depth = number, len(here)
    return found


def _error(path: Path, text: str, steps: Sequence[Step], message: str) -> ConfigError:
    name = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).removeprefix(".")
    return ConfigError(f"{path}:{line_of(text, steps)}: {name + ': ' if name else ''}{message}")
