"""Formulas as MathML, which browsers render natively: no script, no network."""

from __future__ import annotations

import re

from docutils.nodes import SkipNode
from docutils.utils.math import MathError, latex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)


_BARRED = re.compile(
    r'<munderover>\s*(<mi>\w</mi>)((?:(?!<munderover>).)*?)(<mo stretchy="false">ˉ</mo>)\s*'
    r"</munderover>",
    re.DOTALL,
)
"""A symbol with a bar and an index, where docutils puts the index below the symbol."""


def _write(self, node, block):
    try:
        text = latex2mathml.tex2mathml(node.astext(), as_block=block)
        self.body.append(_BARRED.sub(r"<msub><mover>\1\3</mover>\2</msub>", text))
    except MathError as error:
        logger.warning("formula: %s", error, location=node)
    raise SkipNode


def setup(app):
    """Register the renderer."""
    inline = (lambda self, node: _write(self, node, False), None)
    block = (lambda self, node: _write(self, node, True), None)
    app.add_html_math_renderer("mathml", inline, block)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
