"""The one command, `faultline`: finds a subcommand by its entry point and imports only what that one needs.

Exit codes: 0 done, 1 the answer is no (a fault, a failed verification), 2 wrong use, bad input or a file that cannot be
written, 3 an error of faultline itself or an output that cannot be written, 130 interrupted, 141 nobody reads the
output any more. All of them, by command: docs/exit-codes.md.
"""

import ast
import difflib
import os
import re
import sys
import traceback
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, requires
from importlib.util import find_spec
from io import BufferedWriter, FileIO, TextIOWrapper
from pathlib import Path
from typing import Any

from faultline.service import distribution
from faultline.service.core.errors import InputError
from faultline.writing import FULL

GROUP = "faultline.commands"

PLACES = {"service": "On the vehicle", "analysis": "Offline", "training": "Offline, with torch", "testbench": "The rig"}
"""Headings of the help, by the package that a command is in."""

HEAD = """usage: faultline COMMAND ...
       faultline COMMAND --help
       faultline --version

Finds which component of a vehicle subsystem is failing, from the CAN bus.
"""

FOOT = """Exit codes: 0 done, 1 the answer is no (a fault), 2 wrong use or bad input, 3 an error of faultline itself,
130 interrupted, 141 nobody reads the output (docs/exit-codes.md).
"""

REFUSED = 2
INTERNAL = 3
INTERRUPTED = 130  # 128 + SIGINT, as a shell reports it
UNREAD = 141  # 128 + SIGPIPE


def main(argv: list[str] | None = None) -> int:
    """Runs `faultline argv...` and returns its exit code."""
    arguments = sys.argv[1:] if argv is None else argv
    return dispatch(arguments, {entry.name: entry for entry in entry_points(group=GROUP)})


def dispatch(arguments: list[str], commands: Mapping[str, EntryPoint]) -> int:
    """Run with the commands given, as `main`."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who called us: what is written goes nowhere, not into another file
            setattr(sys, name, open(os.devnull, "w"))  # noqa: PTH123, SIM115 for as long as the process lives
    if sys.stderr is sys.__stderr__ and sys.stderr is not None:
        messages = BufferedWriter(_Messages(sys.stderr.fileno(), "w", closefd=False))
        sys.stderr = TextIOWrapper(messages, sys.stderr.encoding, "backslashreplace", line_buffering=True)
    code, said = _outcome(arguments, commands)
    trouble = _trouble()
    if isinstance(trouble, KeyboardInterrupt):
        code, said = INTERRUPTED, "interrupted"
    elif isinstance(trouble, BrokenPipeError):
        code, said = UNREAD, ""
    elif trouble is not None:
        code, said = INTERNAL, f"error: {_no_room(trouble)}"
    if said:
        who = f"faultline {arguments[0]}" if arguments and arguments[0] in commands else "faultline"
        print(f"{who}: {said}", file=sys.stderr)
    return code


class _Messages(FileIO):
    """Standard error: what cannot be written, as nobody reads it or its disk is full, is dropped and no error."""

    def write(self, data: Any) -> int:
        """Write the bytes or drop them; returns how many."""
        with suppress(OSError):
            super().write(data)
        return len(data)


def _outcome(arguments: list[str], commands: Mapping[str, EntryPoint]) -> tuple[int, str]:
    """Return the exit code, and the line for the user if there is one; a traceback goes before it."""
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            print(overview(commands), file=sys.stdout if arguments else sys.stderr)
            return 0 if arguments else REFUSED, ""
        if arguments[0] == "--version":
            print(f"faultline {distribution.installed_version()}")
            return 0, ""
        if arguments[0] not in commands:
            return REFUSED, _unknown(arguments[0], commands)
        code: int = commands[arguments[0]].load()(arguments[1:])
    except SystemExit as ended:  # argparse's, and of a signal
        return (ended.code if isinstance(ended.code, int) else 0 if ended.code is None else INTERNAL), ""
    except InputError as error:
        return REFUSED, f"error: {error}"
    except KeyboardInterrupt:
        return INTERRUPTED, "interrupted"
    except ModuleNotFoundError as error:
        remedy = _remedy(error.name or "")
        return _internal(error) if remedy is None else (REFUSED, f"error: needs {error.name}; {remedy}")
    except OSError as error:
        return _of_system(error)
    except Exception as error:  # noqa: BLE001 a crash must not look like an answer
        return _internal(error)
    return code, ""


def _of_system(error: OSError) -> tuple[int, str]:
    """Return exit code and message of an operating system's error that nobody caught."""
    full = error.errno in FULL
    if error.filename is not None:
        remedy = f"{_space(error.filename)}, or give another path" if full else "give another path"
        return REFUSED, f"error: {error.filename}: {error.strerror}; {remedy}"
    if isinstance(error, BrokenPipeError):
        return UNREAD, ""
    return (INTERNAL, f"error: {_no_room(error)}") if full else _internal(error)


def _space(filename: str) -> str:
    place = next(each for each in Path(filename).absolute().parents if each.exists())
    return f"free some space at {place}"


def _no_room(error: OSError) -> str:
    return f"the output cannot be written: {error.strerror}; free some space, or send it elsewhere"


def _internal(error: Exception) -> tuple[int, str]:
    traceback.print_exception(error)
    words = " ".join(str(error).split())
    return INTERNAL, f"internal error: {type(error).__name__}: {words}; please report it with the lines above"


def _trouble() -> OSError | KeyboardInterrupt | None:
    """Return why standard output cannot be written; None if it can. What it holds then is dropped.

    An interrupt ends the wait for a reader, such as a pager, that takes no more.
    """
    try:
        sys.stdout.flush()
    except (OSError, KeyboardInterrupt) as error:
        # The interpreter flushes once more at its end, and would exit with 120: give it something that takes the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error
    return None


def overview(commands: Mapping[str, EntryPoint]) -> str:
    """Return the text of `faultline --help`: every command with its one line, grouped by where it runs."""
    lines = [HEAD]
    for package, heading in PLACES.items():
        here = [entry for _, entry in sorted(commands.items()) if entry.module.split(".")[:2] == ["faultline", package]]
        if here:
            lines += [f"{heading}:", *(f"  {entry.name:<12}{_first_line(entry.module)}" for entry in here), ""]
    return "\n".join([*lines, FOOT]).rstrip()


def _first_line(module: str) -> str:
    """Return the first line of a module's docstring, from its source: importing thirteen commands takes seconds."""
    package, *rest = module.split(".")
    spec = find_spec(package)
    for folder in spec.submodule_search_locations or () if spec else ():
        stem = Path(folder, *rest)
        for path in (stem.with_suffix(".py"), stem / "__init__.py"):
            if path.is_file():
                return (ast.get_docstring(ast.parse(path.read_bytes())) or "").partition("\n")[0]
    return "(not part of this installation)"


def _unknown(name: str, commands: Mapping[str, EntryPoint]) -> str:
    near = difflib.get_close_matches(name, commands, n=1)
    hint = f"; did you mean `faultline {near[0]}`?" if near else "; `faultline --help` lists them"
    return f"error: no command {name!r}{hint}"


def _remedy(module: str) -> str | None:
    """Return what to install to get a module of an extra, or of a package that this installation lacks."""
    if module in {f"faultline.{package}" for package in PLACES}:
        return "this installation of faultline is without it, use a full one"
    try:
        declared = requires(distribution.NAME) or []
    except PackageNotFoundError:
        return None
    for line in declared:
        match = re.fullmatch(r"([A-Za-z0-9_.-]+).*extra == ['\"](\w+)['\"].*", line)
        if match and match[1] == module.partition(".")[0]:
            return distribution.install_command(match[2])
    return None
