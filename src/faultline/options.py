"""Command-line parsing of all commands: argparse, with errors that name the option that was probably meant."""

import argparse
import difflib
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn


class Parser(argparse.ArgumentParser):
    """An argument parser that suggests the nearest option for each one it does not know.

    A misspelt option that is required is reported by argparse as missing: the suggestion is added to any error.
    """

    _given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, and keep the arguments for the error message."""
        self._given = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(self._given, namespace)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Write as argparse does, which however hides that the output is full or closed."""
        (file or sys.stderr).write(message)

    def error(self, message: str) -> NoReturn:
        """Exit with 2 and one line on standard error, after the usage."""
        super().error("; ".join([message, *self._suggestions()]))

    def _suggestions(self) -> list[str]:
        known = self._options()
        found = []
        for word in self._given:
            if word == "--":
                break
            option = word.partition("=")[0]
            if not option.startswith("--") or any(each.startswith(option) for each in known):
                continue
            near = difflib.get_close_matches(option, known, n=1)
            found += [f"{option}: did you mean {near[0]}?"] if near else []
        return found

    def _options(self) -> list[str]:
        """Return the options of this parser and of the subcommands that the arguments name."""
        options = list(self._option_string_actions)
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                named = (action.choices[word] for word in self._given if word in action.choices)
                options += [option for parser in named for option in parser._option_string_actions]
        return options


def add_senders(parser: argparse.ArgumentParser) -> None:
    """Add `--sender`, of which `senders_of` makes a mapping."""
    parser.add_argument(
        "--sender",
        action="append",
        default=[],
        type=_sender,
        metavar="MESSAGE=ADDRESS",
        help="take this J1939 message from that source address, as EEC1=0x00; may be given for several messages",
    )


def senders_of(given: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Return source addresses by message, of what `--sender` has been given."""
    return dict(given)


def _sender(text: str) -> tuple[str, int]:
    """A message and a source address, from `MESSAGE=ADDRESS`.

    >>> _sender("EEC1=0x3D"), _sender("EEC1=61")
    (('EEC1', 61), ('EEC1', 61))
    """
    message, _, address = text.rpartition("=")
    try:
        number = int(address, 0)
    except ValueError:
        number = -1
    if not message or not 0 <= number <= 253:
        raise argparse.ArgumentTypeError(f"{text}: give MESSAGE=ADDRESS, an address from 0x00 to 0xFD, as EEC1=0x3D")
    return message, number
