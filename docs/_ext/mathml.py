"""Formulas as MathML, which browsers draw by themselves: no script, no network."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from docutils.nodes import SkipNode
from docutils.utils.math import MathError, latex2mathml
from sphinx.util import logging

logger = logging.getLogger(__name__)


_SPACE = "http://www.w3.org/1998/Math/MathML"
ET.register_namespace("", _SPACE)


def _write(self, node, block):
    try:
        self.body.append(_barred(latex2mathml.tex2mathml(node.astext(), as_block=block)))
    except MathError as error:
        logger.warning("formula: %s", error, location=node)
    raise SkipNode


def _barred(text):
    """Put the index of a symbol with a bar beside it; docutils puts it below."""
    tree = ET.fromstring(text)
    for node in tree.iter(f"{{{_SPACE}}}munderover"):
        symbol, index, above = node
        if above.text == "ˉ":
            node.tag = f"{{{_SPACE}}}msub"
            barred = ET.Element(f"{{{_SPACE}}}mover")
            barred.extend((symbol, above))
            node[:] = barred, index
    return ET.tostring(tree, encoding="unicode")


def setup(app):
    """Register the renderer."""
    inline = (lambda self, node: _write(self, node, False), None)
    block = (lambda self, node: _write(self, node, True), None)
    app.add_html_math_renderer("mathml", inline, block)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
