"""The one command, `faultline`: finds a subcommand by its entry point and imports only what that one needs.

Exit codes: 0 done, 1 the answer is no (a fault, a failed verification), 2 wrong use or bad input, 130 interrupted,
141 nobody reads the output any more.
"""

import ast
import difflib
import os
import re
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, requires
from importlib.util import find_spec
from pathlib import Path

from service import distribution
from service.core.errors import InputError

GROUP = "faultline.commands"

PLACES = {"service": "On the vehicle", "analysis": "Offline", "training": "Offline, with torch", "testbench": "The rig"}
"""Headings of the help, by the package that a command is in."""

HEAD = """usage: faultline COMMAND ...
       faultline COMMAND --help
       faultline --version

Finds which component of a vehicle subsystem is failing, from the CAN bus.
"""

INTERRUPTED = 130  # 128 + SIGINT, as a shell reports it
UNREAD = 141  # 128 + SIGPIPE


def main(argv: list[str] | None = None) -> int:
    """Runs `faultline argv...` and returns its exit code."""
    arguments = sys.argv[1:] if argv is None else argv
    return dispatch(arguments, {entry.name: entry for entry in entry_points(group=GROUP)})


def dispatch(arguments: list[str], commands: Mapping[str, EntryPoint]) -> int:
    """As `main`, with the commands given."""
    try:
        if not arguments or arguments[0] in ("-h", "--help"):
            print(overview(commands), file=sys.stdout if arguments else sys.stderr)
            code = 0 if arguments else 2
        elif arguments[0] == "--version":
            print(f"faultline {distribution.installed_version()}")
            code = 0
        elif arguments[0] not in commands:
            code = _unknown(arguments[0], commands)
        else:
            code = _run(commands[arguments[0]], arguments[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # The interpreter flushes once more at its end: give it something that takes the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD
    return code


def _run(command: EntryPoint, arguments: list[str]) -> int:
    try:
        code: int = command.load()(arguments)
    except InputError as error:
        print(f"faultline {command.name}: error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.filename is None:  # no file of the user's, but something that went wrong
            raise
        print(
            f"faultline {command.name}: error: {error.filename}: {error.strerror}; give another path", file=sys.stderr
        )
        return 2
    except ModuleNotFoundError as error:
        remedy = _remedy(error.name or "")
        if remedy is None:
            raise
        print(f"faultline {command.name}: error: needs {error.name}; {remedy}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"faultline {command.name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return code


def overview(commands: Mapping[str, EntryPoint]) -> str:
    """The text of `faultline --help`: every command with its one line, grouped by where it runs."""
    lines = [HEAD]
    for package, heading in PLACES.items():
        here = [entry for _, entry in sorted(commands.items()) if entry.module.partition(".")[0] == package]
        if here:
            lines += [f"{heading}:", *(f"  {entry.name:<12}{_first_line(entry.module)}" for entry in here), ""]
    return "\n".join(lines).rstrip()


def _first_line(module: str) -> str:
    """First line of a module's docstring, read from its source: importing thirteen commands takes seconds."""
    package, *rest = module.split(".")
    spec = find_spec(package)
    for folder in spec.submodule_search_locations or () if spec else ():
        stem = Path(folder, *rest)
        for path in (stem.with_suffix(".py"), stem / "__init__.py"):
            if path.is_file():
                return (ast.get_docstring(ast.parse(path.read_bytes())) or "").partition("\n")[0]
    return "(not part of this installation)"


def _unknown(name: str, commands: Mapping[str, EntryPoint]) -> int:
    near = difflib.get_close_matches(name, commands, n=1)
    hint = f"; did you mean `faultline {near[0]}`?" if near else "; `faultline --help` lists them"
    print(f"faultline: error: no command {name!r}{hint}", file=sys.stderr)
    return 2


def _remedy(module: str) -> str | None:
    """What to install to get a module that is part of an extra, or of a package left out of this installation."""
    top = module.partition(".")[0]
    if top in PLACES:
        return "this installation of faultline is without it, use a full one"
    try:
        declared = requires(distribution.NAME) or []
    except PackageNotFoundError:
        return None
    for line in declared:
        match = re.fullmatch(r"([A-Za-z0-9_.-]+).*extra == ['\"](\w+)['\"].*", line)
        if match and match[1] == top:
            return distribution.install_command(match[2])
    return None
