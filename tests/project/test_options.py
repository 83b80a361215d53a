"""A misspelt option is named with the one that was probably meant, by every command."""

import argparse
from importlib.metadata import entry_points

import pytest

from faultline.options import Parser, add_channels, channels_of
from faultline.service.cli import GROUP, dispatch

COMMANDS = {entry.name: entry for entry in entry_points(group=GROUP)}


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_names_the_option_that_was_meant(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert dispatch([command, "--hlep"], COMMANDS) == 2
    assert capsys.readouterr().err.endswith("--hlep: did you mean --help?\n")


def _parser() -> Parser:
    parser = Parser(prog="tool")
    parser.add_argument("--bundle", required=True)
    kinds = parser.add_subparsers(dest="kind")
    kinds.add_parser("record").add_argument("--cycle")
    kinds.add_parser("play").add_argument("--bus")
    return parser


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--bundel=b"], "the following arguments are required: --bundle; --bundel: did you mean --bundle?"),
        (["--bundle=b", "record", "--cylce=c"], "unrecognized arguments: --cylce=c; --cylce: did you mean --cycle?"),
        (["--bundle", "b", "play", "--cylce", "c"], "unrecognized arguments: --cylce c"),
        (["--bundle", "b", "--x"], "unrecognized arguments: --x"),
        (["--bund", "b", "record", "--", "--cylce"], "unrecognized arguments: -- --cylce"),
    ],
)
def test_options_of_the_subcommand_that_was_given(
    given: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        _parser().parse_args(given)
    assert ended.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].partition("error: ")[2] == said


def test_it_is_used_as_argparse_is() -> None:
    assert _parser().parse_args(["--bund", "b", "record", "--cycle", "c"]) == argparse.Namespace(
        bundle="b", kind="record", cycle="c"
    )


def test_each_bus_has_one_channel(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser("x")
    add_channels(parser)
    given = parser.parse_args(["--channel", "can0", "--channel", "trailer=can1", "--channel", "can0"]).channel
    assert channels_of(given) == ("can0", {"trailer": "can1"})
    for words in (["--channel", "can0", "--channel", "can1"], ["--channel", "a=can0", "--channel", "a=can1"]):
        with pytest.raises(SystemExit):
            parser.parse_args(words)
        assert "give each bus one channel" in capsys.readouterr().err
