"""Pages: single HTML files that need no network, rendered from Jinja templates, with style sheet and pictures inside.

A page's template stands beside the code that fills it, extends `base.html.j2` and uses the macros of `parts.html.j2`.
The engine escapes all text. It is no part of the vehicle's base, but of the extras `web` and `design`.
"""

import base64
from collections.abc import Collection, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from faultline.service.core.errors import InputError
from faultline.service.distribution import install_command

if TYPE_CHECKING:
    from jinja2 import Environment

SHARED = Path(__file__).parent


class Td(NamedTuple):
    """Table cell: its words, smaller words below, how dark it is (0 to 1), whether it is framed."""

    words: str
    small: str = ""
    tint: float = 0.0
    framed: bool = False


Row = Sequence[str | Td]


class Table(NamedTuple):
    """A table; the first cell of each row is the row's head. Nothing is shown of one without rows.

    Columns in `text` hold words, the others numbers; rows in `chosen` are emphasised.
    """

    head: Sequence[str]
    rows: Sequence[Row]
    caption: str = ""
    text: Collection[int] = ()
    chosen: Collection[int] = ()


class NoEngineError(InputError):
    """The template engine is not installed; the message says what to install."""


def check_engine() -> None:
    """Raise NoEngineError where no page can be rendered, to be called before the work that a page is about."""
    _environment(SHARED)


def render(template: Path, **values: object) -> str:
    """Return the page that a template makes of `values`.

    Raises:
        NoEngineError: the template engine is not installed.
    """
    return _environment(template.parent).get_template(template.name).render(values)


@cache
def _environment(folder: Path) -> "Environment":
    """Return the engine for the templates of a folder."""
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ModuleNotFoundError as error:
        raise NoEngineError(f"the report needs {error.name}; {install_command('web')}") from error
    made = Environment(
        loader=FileSystemLoader([folder, SHARED]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["data_url"] = lambda png: f"data:image/png;base64,{base64.b64encode(png).decode()}"
    return made
