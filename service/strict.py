"""Strict reading of configuration files: TOML into a struct.

An unknown key, a missing one or a value that is not accepted is an error that names file, line and key, and says what
to give: the description (`Meta`) of the field.
"""

import difflib
import re
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Generic, NamedTuple, TypeVar

import msgspec
from msgspec import Meta, inspect

from faultline.service.core.errors import InputError

T = TypeVar("T", bound=msgspec.Struct)
Step = str | int
"""To a part of a file: a key, or the number of an item."""

LETTERS = "letters, digits, _ . and -, a letter or digit first, 80 at most"
Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.-]*\Z", max_length=80, description=LETTERS)]
"""It stands in ids and topics: nothing that means something there."""
Path_ = Annotated[str, Meta(pattern=r"\A/[^\x00]*\Z", max_length=1000, description="a whole path, from / on")]
EventsSocket = Annotated[Path_, Meta(description="the daemon's events socket, as /run/faultline/events.sock")]
ControlSocket = Annotated[Path_, Meta(description="the daemon's control socket, as /run/faultline/control.sock")]

LARGEST = 256 * 1024  # bytes of a file that somebody wrote


class ConfigError(InputError):
    """A configuration that must not be used."""


class Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness: every field by name, none unknown."""


class Read(NamedTuple, Generic[T]):
    """Content of a file, and its text, for errors in what its parts must say of each other."""

    said: T
    path: Path
    text: str

    def wrong(self, steps: Sequence[Step], message: str) -> ConfigError:
        """Return an error at the part that `steps` lead to, to raise."""
        return _error(self.path, self.text, steps, message)


def read(path: Path, kind: type[T]) -> Read[T]:
    """Read the file at `path` as a struct.

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
        raise _error(path, text, *_explained(error, kind)) from error


def _explained(error: msgspec.ValidationError, kind: type[T]) -> tuple[list[Step], str]:
    """Return where the error is, and what is wrong with what to give instead."""
    message, _, where = str(error).partition(" - at `")
    steps = [int(number) if number else key for key, number in re.findall(r"\.([^.[`]+)|\[(\d+)\]", where)]
    if (unknown := re.search(r"unknown field `(.*)`", message, re.DOTALL)) is not None:
        table, _ = _part(kind, steps)
        keys = [each.name for each in table.fields] if isinstance(table, inspect.StructType) else []
        near = difflib.get_close_matches(unknown[1], keys, n=1)
        hint = f" (did you mean `{near[0]}`?)" if near else ""
        return [*steps, unknown[1]], f"there is no such key{hint}; those are {', '.join(keys)}"
    if (missing := re.search(r"missing required field `(.*)`", message)) is not None:
        return steps, f"`{missing[1]}` is missing; give {_part(kind, [*steps, missing[1]])[1]}"
    _, asked = _part(kind, steps)
    message = "this text is not accepted" if asked and "matching regex" in message else message
    return steps, f"{message}; give {asked}" if asked else message


def _part(kind: type[T], steps: Sequence[Step]) -> tuple[inspect.Type, str]:
    """Return the type that `steps` lead to in `kind`, and what it asks for: an item, what its list asks for."""
    found, header, asked = inspect.type_info(kind), "", ""
    for step in steps:
        if isinstance(found, inspect.StructType):
            header = f"{header}.{step}".removeprefix(".")
            found, asked = _bare(next(each.type for each in found.fields if each.name == step))
        elif isinstance(found, (inspect.ListType, inspect.VarTupleType)):
            found, own = _bare(found.item_type)
            asked = own or asked
    if isinstance(found, inspect.ListType) and isinstance(found.item_type, inspect.StructType):
        asked = f"a table [[{header}]]"
    elif isinstance(found, inspect.StructType) and not asked:
        asked = f"the table [{header}]"
    return found, asked or ("true or false" if isinstance(found, inspect.BoolType) else "")


def _bare(given: inspect.Type) -> tuple[inspect.Type, str]:
    """Return a type without description and `None`, and the description."""
    if isinstance(given, inspect.UnionType):
        given = next(each for each in given.types if not isinstance(each, inspect.NoneType))
    if isinstance(given, inspect.Metadata):
        return given.type, (given.extra_json_schema or {}).get("description", "")
    return given, ""


def line_of(text: str, steps: Sequence[Step]) -> int:
    r"""Return the line of a TOML text (from 1) that `steps` lead to, or of the nearest part around it that has one.

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
    said = f"{name + ': ' if name else ''}{message}"
    return ConfigError(f"{path}:{line_of(text, steps)}: {''.join(c if c.isprintable() else '?' for c in said)}")
