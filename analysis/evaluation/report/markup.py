"""The few pieces of HTML that the page is made of: tables that screen readers can read, figures with their words."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import NamedTuple

STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#5b646e;--paper:#fff;--card:#f5f6f8;--line:#d9dde2;--blue:#0072b2}
@media (prefers-color-scheme:dark){:root{--ink:#e8eaed;--soft:#a5adb6;--paper:#14171a;--card:#1f2428;--line:#363d44;
--blue:#6cb8e6}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:80rem;background:var(--paper);color:var(--ink);
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
h1{font-size:1.4rem;margin:.5rem 0}
h2{font-size:1.2rem;margin:2.5rem 0 .5rem;border-bottom:1px solid var(--line)}
p{max-width:60rem}
.verdict{font-size:1.15rem;margin:.5rem 0;border-left:.35rem solid var(--blue);padding:.3rem .8rem}
.note{background:var(--card);border:1px solid var(--line);border-radius:.4rem;padding:.5rem .8rem}
figure{margin:1.5rem 0}
figure img{display:block;width:100%;min-width:48rem;height:auto;background:#fff;border-radius:.4rem;
border:1px solid var(--line)}
figcaption,caption{color:var(--soft);font-size:.9rem;text-align:left;margin:.3rem 0}
caption{padding:.3rem 0;max-width:60rem}
.wide{overflow-x:auto;margin:1rem 0}
table{border-collapse:collapse;font-size:.85rem}
th,td{text-align:right;padding:.25rem .55rem;border-bottom:1px solid var(--line);white-space:nowrap}
thead th{color:var(--soft);font-weight:600;vertical-align:bottom}
tbody th{text-align:left;font-weight:600;position:sticky;left:0;background:var(--paper)}
td.text,th.text{text-align:left;white-space:normal;min-width:12rem}
td.marked{box-shadow:inset 0 0 0 2px var(--blue)}
td small{color:var(--soft)}
dt{font-weight:600;margin-top:.5rem}
dd{margin:0 0 0 1rem;max-width:58rem}
summary{cursor:pointer;color:var(--blue);margin:.5rem 0}
@media print{body{max-width:none;padding:0;font-size:10pt}figure,tr{break-inside:avoid}.wide{overflow:visible}
figure img{min-width:0}}
"""

TINT = 0.45
"""The darkest background of a cell: text stays legible on it, light or dark."""


class Td(NamedTuple):
    """A cell of a table: its words, smaller words below, how dark it is (0 to 1), whether it is marked, is text."""

    words: str
    small: str = ""
    tint: float = 0.0
    marked: bool = False
    text: bool = False


Row = Sequence[str | Td]


def table(caption: str, head: Sequence[str], rows: Iterable[Row]) -> str:
    """A table under its caption; the first cell of each row is the row's head."""
    body = "".join(f"<tr>{_head(row[0])}{''.join(map(_cell, row[1:]))}</tr>" for row in rows)
    heads = "".join(f'<th scope="col">{escape(words)}</th>' for words in head)
    made = f"<caption>{escape(caption)}</caption><thead><tr>{heads}</tr></thead><tbody>{body}</tbody>"
    scrolls = 'role="group" tabindex="0" aria-label="a table that may scroll"'  # by keyboard too
    return f'<div class="wide" {scrolls}><table>{made}</table></div>'


def figure(png: bytes, alt: str, caption: str) -> str:
    """A picture inside the page; `alt` is what it says to who cannot see it."""
    source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    picture = f'<div class="wide"><img alt="{escape(alt)}" src="{source}"/></div>'
    return f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"


def title(words: str) -> str:
    """The page's heading."""
    return f"<h1>{escape(words)}</h1>"


def section(title: str, *parts: str) -> str:
    """Parts under a heading; nothing where there are none."""
    body = "\n".join(part for part in parts if part)
    return f"<h2>{escape(title)}</h2>\n{body}" if body else ""


def paragraph(words: str, kind: str = "") -> str:
    """A paragraph of the class `kind`."""
    of = f' class="{kind}"' if kind else ""
    return f"<p{of}>{escape(words)}</p>"


def folded(title: str, *parts: str) -> str:
    """Parts that open on a click, without a script."""
    return f"<details><summary>{escape(title)}</summary>{''.join(parts)}</details>"


def definitions(terms: Iterable[tuple[str, str]]) -> str:
    """Terms with what they mean."""
    return f"<dl>{''.join(f'<dt>{escape(term)}</dt><dd>{escape(words)}</dd>' for term, words in terms)}</dl>"


def document(title: str, parts: Iterable[str]) -> str:
    """The whole page, which is well-formed XML besides its first line."""
    head = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width,initial-scale=1"/>'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body><main>\n"
    )
    return head + "\n".join(part for part in parts if part) + "\n</main></body></html>\n"


def _head(cell: str | Td) -> str:
    return f'<th scope="row">{escape(cell if isinstance(cell, str) else cell.words)}</th>'


def _cell(cell: str | Td) -> str:
    if isinstance(cell, str):
        return f"<td>{escape(cell)}</td>"
    kinds = " ".join(kind for kind, is_so in (("marked", cell.marked), ("text", cell.text)) if is_so)
    of = f' class="{kinds}"' if kinds else ""
    tint = f' style="background:rgba(213,94,0,{TINT * min(cell.tint, 1.0):.2f})"' if cell.tint > 0.0 else ""
    small = f"<br/><small>{escape(cell.small)}</small>" if cell.small else ""
    return f"<td{of}{tint}>{escape(cell.words)}{small}</td>"
