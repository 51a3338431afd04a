"""Marks that the theme lacks for readers with a keyboard or a screen reader."""

from __future__ import annotations

import re

_BODY = {
    # Tables and code that are wider than the page scroll, so the keyboard must reach them.
    r'<div class="table-wrapper': '<div tabindex="0" role="group" aria-label="Table" '
    'class="table-wrapper',
    r'(<div class="highlight"><pre)>': r'\1 tabindex="0">',
    r'<math (?=[^>]*display="block")': r'<math tabindex="0" ',
    # Parameters of a signature, one a line: Sphinx writes a list of definitions without a term.
    r'<dl>(?=\s*<dd><em class="sig-param")': r'<dl role="presentation">',
}


def _complete(app, pagename, templatename, context, doctree):
    for pattern, better in _BODY.items():
        context["body"] = re.sub(pattern, better, context.get("body", ""))
    tree = context.get("furo_navigation_tree", "")
    context["furo_navigation_tree"] = tree.replace(
        'role="heading"', 'role="heading" aria-level="2"'
    )


def setup(app):
    """Complete every page, after the theme."""
    app.connect("html-page-context", _complete, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
