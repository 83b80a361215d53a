"""What all pages are made of: the engine, the tables, the one style sheet."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from jinja2 import UndefinedError

from faultline.service import pages
from faultline.service.pages import Table, Td, render

HOSTILE = "<script>alert('1')</script>&\""


def shown(folder: Path, text: str, **values: object) -> ElementTree.Element:
    """What a template makes, which is well-formed XML besides its first line."""
    template = folder / "page.html.j2"
    template.write_text(
        '{% extends "base.html.j2" %}{% from "parts.html.j2" import table, section, figure, points %}' + text
    )
    page = render(template, **({"title": "t"} | values))
    first, _, rest = page.partition("\n")
    assert first == "<!doctype html>"
    return ElementTree.fromstring(rest)  # noqa: S314 (it is ours)


def tabled(folder: Path, table: Table) -> ElementTree.Element:
    [found] = shown(folder, "{% block content %}{{ table(t) }}{% endblock %}", t=table).iter("table")
    return found


def test_what_a_cell_holds_is_text_and_no_markup(tmp_path: Path) -> None:
    made = tabled(tmp_path, Table([HOSTILE], [[HOSTILE, HOSTILE, Td(HOSTILE, HOSTILE)]], HOSTILE))
    heads = [(th.get("scope"), th.text) for th in made.iter("th")]
    assert heads == [("col", HOSTILE), ("row", HOSTILE)]
    assert [made.findtext("caption"), made.findtext("tbody/tr/td/small")] == 2 * [HOSTILE]
    assert [td.text for td in made.iter("td")] == 2 * [HOSTILE]


def test_titles_sections_and_pictures_are_escaped_too(tmp_path: Path) -> None:
    content = "{{ points([title]) }}{{ figure(png, title, title) }}"
    text = f"{{% block content %}}{{% call section(title) %}}{content}{{% endcall %}}{{% endblock %}}"
    page = shown(tmp_path, text, title=HOSTILE, png=b"\x89PNG")
    assert not [*page.iter("script")]
    assert [page.findtext(f".//{tag}") for tag in ("title", "h2", "li", "figcaption")] == 4 * [HOSTILE]
    [image] = page.iter("img")
    assert (image.get("alt"), image.get("src")) == (HOSTILE, "data:image/png;base64,iVBORw==")


def test_cells_are_tinted_framed_and_have_small_words(tmp_path: Path) -> None:
    made = tabled(
        tmp_path, Table(["a", "b", "c"], [["r", Td("w", "s", 2.0, framed=True), "x"]], text=(2,), chosen=(0,))
    )
    [row] = made.findall("tbody/tr")
    _, cell, words = row
    assert (cell.get("class"), cell.get("style")) == ("framed", "background:rgba(213,94,0,0.45)")
    assert (cell.text, cell.findtext("small")) == ("w", "s")
    assert (row.get("class"), words.get("class"), words.get("style")) == ("chosen", "text", None)
    assert [th.get("class") for th in made.findall("thead/tr/th")] == [None, None, "text"]


def test_what_is_empty_is_left_out(tmp_path: Path) -> None:
    text = '{% block content %}{% call section("t") %}{{ table(t) }}{{ points([]) }}{% endcall %}{% endblock %}'
    [main] = shown(tmp_path, text, t=Table(["a"], [])).iter("main")
    assert len(main) == 0


def test_a_value_that_is_not_given_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UndefinedError, match="'nothing' is undefined"):
        shown(tmp_path, "{% block content %}{{ nothing }}{% endblock %}")


def test_every_page_has_the_one_style_sheet_and_runs_nothing(tmp_path: Path) -> None:
    page = shown(tmp_path, "")
    assert (Path(pages.__file__).with_name("style.css").read_text()).strip() == (
        page.findtext(".//style") or ""
    ).strip()
    [policy] = [each.get("content", "") for each in page.iter("meta") if each.get("http-equiv")]
    assert policy.startswith("default-src 'none';")
    assert "script-src" not in policy


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("evaluate", ["b", "r", "--truth", "t", "--report", "out"]),
        ("discover", ["uds/production", "r", "--held-out", "h"]),
    ],
)
def test_without_the_engine_a_report_is_refused_before_the_work(
    tmp_path: Path, command: str, arguments: list[str]
) -> None:
    module = {"evaluate": "evaluation", "discover": "discrepancy"}[command]
    code = f"""
import sys
from importlib.metadata import EntryPoint
sys.modules["jinja2"] = None
from faultline.service.cli import dispatch
command = EntryPoint({command!r}, "faultline.analysis.{module}.command:main", "faultline.commands")
sys.exit(dispatch(sys.argv[1:], {{{command!r}: command}}))
"""
    ended = subprocess.run(
        [sys.executable, "-c", code, command, *arguments], cwd=tmp_path, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    said = "error: the report needs jinja2; pip install 'faultline-diagnosis[web]'\n"
    assert ended.stderr == f"faultline {command}: {said}"
