"""The report as one HTML page that needs nothing else: no network, no files beside it."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from agents.paper.claims import Checked
from agents.reporting import claims_text
from agents.reporting.figures import Figure
from agents.reporting.table import Number, Table

MEDIA = {"png": "image/png", "svg": "image/svg+xml"}


class Section(NamedTuple):
    """A part of the page: a task with its table and then its figures, or the claims."""

    title: str
    table: Table | None = None
    figures: Sequence[Figure] = ()
    claims: Sequence[Checked] = ()

    @property
    def anchor(self) -> str:
        """The target of links to it. Titles differ in more than punctuation."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def page(title: str, sections: Sequence[Section], made: Mapping[str, str]) -> str:
    """The page. made: how the numbers came about, by name."""
    last = Section("How it was made")
    contents = [*sections, last]
    return _template().render(
        title=title, contents=contents, sections=sections, last=last, made=made
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
    environment.filters["finding"] = claims_text.finding_words
    environment.tests["number"] = lambda cell: isinstance(cell, Number)
    environment.globals["method"] = claims_text.METHOD
    return environment.get_template("page.html")


def _embedded(figure: Figure) -> str:
    """A figure's file as a data URL."""
    return f"data:{MEDIA[figure.kind]};base64,{base64.b64encode(figure.content).decode()}"
