"""The report as one HTML page that needs nothing else: no network, no files beside it."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import NamedTuple

from agents.reporting.figures import Figure
from emcc.table import Table

STYLE = """
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 1120px; margin: 0 auto;
  padding: 1rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.35rem; margin: 3rem 0 0.75rem; padding-top: 0.75rem;
  border-top: 1px solid #ccc; } h3 { font-size: 1.05rem; margin: 2rem 0 0.5rem; }
a { color: #0b57a4; } nav ul { padding-left: 1.2rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.3rem 0.6rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid #ddd; vertical-align: top; }
td:first-child, td:last-child { white-space: normal; min-width: 7rem; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: #fff; }
td:first-child { min-width: 13rem; } td small { color: #595959; white-space: nowrap; }
tr.paper td { color: #595959; font-style: italic; }
td.best { font-weight: 700; } td.best small { font-weight: 400; }
figure { margin: 0; } figcaption, .note { color: #444; font-size: 0.9rem; max-width: 60rem; }
img { display: block; max-width: 100%; height: auto; }
dt { font-weight: 600; } dd { margin: 0 0 0.5rem 0; white-space: pre-line; }
@media (max-width: 40rem) { td:first-child { min-width: 6.5rem; }
  td:last-child { min-width: 10rem; } img { max-width: none; zoom: 0.6; } }
"""
KINDS = {"png": "image/png", "svg": "image/svg+xml"}


class Section(NamedTuple):
    """A part of the page: a task, with its tables and then its figures."""

    title: str
    tables: Sequence[Table]
    figures: Sequence[Figure]
    text: str = ""
    """HTML, above both"""


def page(title: str, sections: Sequence[Section], made: Mapping[str, str]) -> str:
    """The page. made: how the numbers came about, by name."""
    last = "How it was made"
    contents = "".join(
        f'<li><a href="#{_id(name)}">{escape(name)}</a></li>'
        for name in [*(section.title for section in sections), last]
    )
    rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in made.items())
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',  # or a browser would ask a server for one
            f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
            f"<h1>{escape(title)}</h1><nav><ul>{contents}</ul></nav><main>",
            *map(_section, sections),
            f'<section id="{_id(last)}"><h2>{last}</h2><dl>{rows}</dl></section>',
            "</main></body></html>\n",
        ]
    )


def _id(title: str) -> str:
    """What a link within the page calls a section. Titles differ in more than punctuation."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _section(section: Section) -> str:
    name = _id(section.title)
    parts = [f'<section id="{name}"><h2>{escape(section.title)}</h2>', section.text]
    parts += map(_table, section.tables)
    parts += [_figure(shown, section.title) for shown in section.figures]
    return "\n".join([*parts, "</section>"])


def _figure(shown: Figure, of: str) -> str:
    """An image, which scrolls in its box where it would become too small to be read."""
    content = base64.b64encode(shown.content).decode()
    kind = KINDS[shown.name.rpartition(".")[2]]
    return (
        f"<h3>{escape(shown.title)}</h3>\n<figure>"
        f'<div class="wide"><img alt="{escape(shown.title)}: {escape(of)}" '
        f'src="data:{kind};base64,{content}"></div>'
        f"<figcaption>{escape(shown.caption)}</figcaption></figure>"
    )


def _cell(text: str, best: bool) -> str:
    """A cell; the interval of a mean goes below it."""
    value, bracket, interval = escape(text).partition(" [")
    kind = ' class="best"' if best else ""
    return f"<td{kind}>{value}" + (f"<br><small>[{interval}</small>" if bracket else "") + "</td>"


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    rows = []
    for index, row in enumerate(table.rows):
        kind = ' class="paper"' if "paper (" in row[0] else ""
        cells = "".join(_cell(t, (index, k) in table.marked) for k, t in enumerate(row))
        rows.append(f"<tr{kind}>" + cells + "</tr>")
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody>'
        f'</table></div><p class="note">{escape(table.legend)}</p>{notes}'
    )
