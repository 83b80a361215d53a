"""Serve the fault memory, events and live values over HTTP, for tools on this machine."""

import argparse
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from faultline.options import Parser, add_channels, add_senders, channels_of, senders_of
from faultline.service import distribution
from faultline.service.core.errors import InputError
from faultline.service.systemd import log_as

LISTEN = "127.0.0.1:8080"

_say = log_as("serve")

EXAMPLE = """example:
  faultline serve --config /etc/faultline/serve.toml
  faultline serve --control /tmp/control.sock --events /tmp/events.sock --listen 127.0.0.1:8080
  faultline serve --recording out/demo/logs/validation-6-fA_du --bundle out/demo/bundle --open
  curl -N http://127.0.0.1:8080/v1/events?after=0
"""


def main(argv: list[str]) -> int:
    """Serves until SIGTERM or SIGINT; returns its exit code.

    Raises:
        InputError: the libraries of the extra `web` are not there, or the settings make no sense.
    """
    options = _asked(argv)
    try:
        import starlette
        import uvicorn
    except ModuleNotFoundError as error:
        raise InputError(f"needs {error.name}; {distribution.install_command('web')}") from error
    del starlette, uvicorn
    if options.recording is None:
        return _serve(options)
    from faultline.service.recorded.command import served  # brings in the inference library, which serving does without

    channel, buses = channels_of(options.channel)
    with served(options.recording, options.bundle, _say, channel, senders_of(options.sender), buses) as (
        control,
        events,
    ):
        options.control, options.events = str(control), str(events)
        return _serve(options)


def _serve(options: argparse.Namespace) -> int:
    """Serve until the end is requested."""
    from faultline.service.web.listen import listen, remove, url
    from faultline.service.web.server import serve
    from faultline.service.web.settings import Settings, load_settings
    from faultline.service.web.tokens import find_tokens

    if options.config is not None:
        settings = load_settings(options.config)
    else:
        given = {name: getattr(options, name) for name in ("control", "events", "listen", "token_file")}
        settings = Settings(**given)
    tokens = find_tokens(settings.token_file)
    if settings.allow_remote and not tokens:
        raise InputError("allow_remote: every request needs a token then; give token_file too")
    sock = listen(settings.place)
    try:
        if options.open:
            threading.Thread(target=_open, args=(url(sock),), daemon=True).start()
        serve(settings, tokens, sock, _say)
    finally:
        remove(settings.place)
    return 0


def _open(where: str) -> None:
    """Open the page in the machine's browser, which may take its time, and may be waiting for us."""
    if not where.startswith("http") or not webbrowser.open(where):
        _say(f"no browser is opened: open {where} yourself")


def _asked(argv: Sequence[str]) -> argparse.Namespace:
    parser = Parser("faultline serve", description=__doc__, epilog=EXAMPLE)
    add = parser.add_argument
    add("--config", type=Path, help="the settings (docs/http.md)")
    add("--control", help="without them: the daemon's control socket")
    add("--events", help="and where it serves events")
    add("--listen", help="and where to listen: 127.0.0.1:8080, or unix:PATH")
    add("--token-file", help="and the file of tokens that may clear faults, one a line")
    add("--recording", type=Path, help="instead of a running service: a finished recording, or a log")
    add("--bundle", type=Path, help="and the bundle folder that diagnoses it")
    add_channels(parser)
    add_senders(parser)
    add("--open", action="store_true", help="open the page in this machine's browser")
    options = parser.parse_args(argv)
    if options.recording is not None:
        parser.refuse(options, ("config", "control", "events", "token_file"), "--recording needs no service")
        if options.bundle is None:
            parser.error("--recording needs --bundle too")
        options.listen = options.listen or LISTEN
        return options
    if options.bundle is not None:
        parser.error("--bundle goes with --recording")
    if options.config is not None:
        parser.refuse(options, ("control", "events", "listen", "token_file"), "--config says that already")
    else:
        parser.require(options, ("control", "events", "listen"), "--config or --recording")
    return options
