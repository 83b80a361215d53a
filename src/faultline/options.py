"""Command-line parsing of all commands: argparse, with errors that name the option that was probably meant."""

import argparse
import difflib
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn


class Parser(argparse.ArgumentParser):
    """An argument parser that suggests the nearest option for each one it does not know, and keeps lines as written.

    A misspelt option that is required is reported by argparse as missing: the suggestion is added to any error.
    """

    _given: Sequence[str] = ()

    def __init__(self, *args: Any, **named: Any) -> None:
        super().__init__(*args, **{"formatter_class": argparse.RawDescriptionHelpFormatter, **named})

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

    def refuse(self, options: argparse.Namespace, names: Iterable[str], why: str) -> None:
        """End with an error that says why, where any of these options was given."""
        if given := [name for name in names if getattr(options, name) is not None]:
            self.error(f"{why}: leave out {_listed(given)}")

    def require(self, options: argparse.Namespace, names: Iterable[str], instead: str) -> None:
        """End with an error, where any of these options is missing that are needed where none is given `instead`."""
        if missing := [name for name in names if getattr(options, name) is None]:
            self.error(f"give {instead}, or {_listed(missing)} too")

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


def add_channels(parser: argparse.ArgumentParser) -> None:
    """Add `--channel`, of which `channels_of` makes the channel of all messages, and those of buses with names."""
    parser.add_argument(
        "--channel",
        action=_AddChannel,
        default={},
        metavar="[BUS=]CHANNEL",
        help="the bus to take, of a log of several; BUS=CHANNEL says which is the bus that the bundle calls so",
    )


class _AddChannel(argparse.Action):
    """Takes one channel for each bus."""

    def __call__(self, _parser: object, namespace: argparse.Namespace, values: Any, _option: str | None = None) -> None:
        """Add it to the mapping of buses to channels."""
        bus, _, channel = values.rpartition("=")
        found = {**getattr(namespace, self.dest)}
        if not channel or found.setdefault(bus, channel) != channel:
            raise argparse.ArgumentError(self, f"{values}: give each bus one channel, as can0 or {bus or 'BUS'}=can1")
        setattr(namespace, self.dest, found)


def channels_of(given: Mapping[str, str]) -> tuple[str | None, dict[str, str]]:
    """Return the channel of messages whose bus has no name, and channels by the buses' names.

    >>> channels_of({"": "can0", "trailer": "can1"})
    ('can0', {'trailer': 'can1'})
    """
    return given.get(""), {bus: channel for bus, channel in given.items() if bus}


def add_buses(parser: argparse.ArgumentParser) -> None:
    """Add `--bus`, of which `buses_of` makes a mapping."""
    parser.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="MESSAGE=BUS",
        type=_bus,
        help="this message comes on the bus of that name, where the vehicle has several; may be given more than once",
    )


def buses_of(given: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the buses' names by message, of what `--bus` has been given."""
    return dict(given)


def _bus(text: str) -> tuple[str, str]:
    message, _, bus = text.partition("=")
    if not message or re.fullmatch(r"\w[\w.-]*", bus) is None:
        raise argparse.ArgumentTypeError(f"{text}: give MESSAGE=BUS, as UDS_SENSORS=aftertreatment")
    return message, bus


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in names)
