"""The report as one HTML page that needs nothing else: no network, no files beside it."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

from emcc.table import Table

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 1180px; margin: 0 auto;
  padding: 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.25rem 0.6rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid #ddd; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: #fff; }
td small { color: #666; } td { vertical-align: top; }
tr.paper td { color: #777; font-style: italic; }
td.best { font-weight: 700; } td.best small { font-weight: 400; }
img, svg { max-width: 100%; height: auto; }
.note, figcaption { color: #555; font-size: 0.85rem; }
figure { margin: 1rem 0; }
dt { font-weight: 600; } dd { margin: 0 0 0.5rem 0; white-space: pre-line; }
"""


class Section(NamedTuple):
    """What the page shows of one task."""

    task: str
    table: Table
    curves: str
    """SVG"""
    heatmaps: Mapping[str, Path]
    """PNG files, by title"""


def page(title: str, sections: Sequence[Section], made: Mapping[str, str], more: str = "") -> str:
    """The page. made: how the numbers came about, by name; more: HTML behind the tasks."""
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
    ]
    for section in sections:
        parts.append(f"<h2>{escape(section.task)}</h2>")
        parts.append(_table(section.table))
        if section.curves:
            svg = section.curves[section.curves.index("<svg") :]
            parts.append(
                f'<figure class="curves">{svg}<figcaption>Mean over seeds and, faint, the '
                "standard deviation. Dashed: the cost limit.</figcaption></figure>"
            )
        for name, path in section.heatmaps.items():
            image = base64.b64encode(path.read_bytes()).decode()
            alt = escape(f"Visited states of {name}")
            parts.append(
                f'<figure><img alt="{alt}" src="data:image/png;base64,{image}">'
                "<figcaption>States visited in the rollouts that dominate EMCC."
                "</figcaption></figure>"
            )
    parts.append(more)
    rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in made.items())
    parts.append(f"<h2>How it was made</h2><dl>{rows}</dl>")
    parts.append("</body></html>\n")
    return "\n".join(parts)


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
