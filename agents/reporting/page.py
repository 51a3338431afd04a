"""The report as one self-contained HTML page: it needs no network and no other files."""

from __future__ import annotations

import base64
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from agents.reporting.figures import Figure
from agents.reporting.maps import SIDE, Map, Maps, Scene
from agents.reporting.table import Number, Table
from circle2d_mj.render import canvas

URL = " !$()*+,-./:;=?@[]^_`{|}~'"
"""Characters that need no escaping in a data URL in double quotes."""


class Otherwise(NamedTuple):
    """The verdict on a statement under another choice of runs."""

    choice: str
    verdict: str
    findings: Sequence[tuple[str, str]]
    """Text and verdict of each part whose verdict changes."""


HANGS = "†"
"""Mark of a verdict that depends on the choice of runs."""


class Statement(NamedTuple):
    """A statement and its verdict from the runs."""

    text: str
    verdict: str
    rule: str
    findings: Sequence[tuple[str, str]]
    """Text and verdict of each part."""
    otherwise: Sequence[Otherwise] = ()

    @property
    def told(self) -> str:
        """The verdict with its mark and, for several parts, the number of each verdict."""
        counts = Counter(verdict for _, verdict in self.findings)
        parts = ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common())
        words = f"{self.verdict.capitalize()}{f' {HANGS}' if self.otherwise else ''}"
        return f"{words} (parts: {parts})" if len(self.findings) > 1 else words


class Section(NamedTuple):
    """A part of the page: a task with its table, figures and maps, statements, or the replay."""

    title: str
    table: Table | None = None
    figures: Sequence[Figure] = ()
    statements: Sequence[Statement] = ()
    method: str = ""
    """How the statements are decided."""
    maps: Sequence[Maps] = ()
    replay: Mapping[str, Any] | None = None
    """Data from `maps.replay_data`."""

    @property
    def anchor(self) -> str:
        """Target of links to the section. Titles must differ in more than punctuation."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")

    def statements_markdown(self) -> str:
        """Return the statements as Markdown, each below a heading."""
        lines = [f"## {self.title}", "", self.method, ""]
        for number, stated in enumerate(self.statements, 1):
            lines += [f"### {number}. {stated.text} **{stated.told}**", "", f"Rule: {stated.rule}"]
            lines += ["", *_listed(stated.findings)]
            for other in stated.otherwise:
                lines += [f"With {other.choice}: {other.verdict}", "", *_listed(other.findings)]
        return "\n".join(lines)


def _listed(findings: Sequence[tuple[str, str]]) -> list[str]:
    return [*(f"- {words}: {verdict}" for words, verdict in findings), ""]


def page(
    title: str,
    sections: Sequence[Section],
    made: Mapping[str, str],
    lead: str = "",
    scenes: Sequence[Scene] = (),
) -> str:
    """Return the page as HTML.

    sections: in order; made: how the numbers were made, by name; lead: one line below the title;
    scenes: those that the maps and the replay use.
    """
    last = Section("How it was made")
    return _template().render(
        title=title,
        lead=lead,
        contents=[*sections, last],
        sections=sections,
        last=last,
        made=made,
        scenes=scenes,
    )


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("agents.reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["embedded"] = _embedded
    environment.filters["png"] = _png
    environment.filters["json"] = script_json
    environment.tests["number"] = lambda cell: isinstance(cell, Number)
    environment.tests["map"] = lambda cell: isinstance(cell, Map)
    colours = {"line": canvas.LINE, "dot": canvas.DOT, "cost": canvas.BOX}
    environment.globals.update(
        side=SIDE,
        heat=_gradient(),
        colours={name: f"rgb{colour}" for name, colour in colours.items()},
    )
    return environment.get_template("page.html")


def script_json(data: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a script element."""
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


def _embedded(figure: Figure) -> str:
    """Return a figure as a data URL."""
    # Text takes a third less than base64; it must have no line breaks and no double quotes.
    svg = re.sub(rb"\s+([MLCQz])\s+", rb"\1", figure.content)  # the commands of paths
    svg = re.sub(rb"\s+", b" ", svg).replace(b"'", b"&apos;").replace(b'"', b"'")
    return Markup(f"data:image/svg+xml,{quote(svg, safe=URL)}")


def _png(content: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"


def _gradient() -> str:
    """Return the colours of heat maps, from one visit to the most, for CSS."""
    colours = canvas.heat_colours(np.linspace(0.0, 1.0, len(canvas.HEAT))).tolist()
    return ", ".join(f"rgb({r} {g} {b})" for r, g, b in colours)
