"""Additions to the theme: marks for keyboards and screen readers, and numbers that do not break."""

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

_CODE_OR_TAG = re.compile(r"(<(pre|code)\b.*?</\2>|<[^>]*>)", re.DOTALL)


def whole_numbers(html: str) -> str:
    """The page with 10 000 unbreakable in text and tables; code stays, since it is copied."""
    parts, text = [], 0
    for found in _CODE_OR_TAG.finditer(html):
        parts += [_unbroken(html[text : found.start()]), found[0]]
        text = found.end()
    return "".join([*parts, _unbroken(html[text:])])


def _unbroken(text):
    return re.sub(r"(?<=\d) (?=\d{3}(?!\d))", "\N{NO-BREAK SPACE}", text)


def _complete(app, pagename, templatename, context, doctree):
    context["body"] = whole_numbers(context.get("body", ""))
    for pattern, better in _BODY.items():
        context["body"] = re.sub(pattern, better, context["body"])
    tree = context.get("furo_navigation_tree", "")
    context["furo_navigation_tree"] = tree.replace(
        'role="heading"', 'role="heading" aria-level="2"'
    )


def setup(app):
    """Complete every page, after the theme."""
    app.connect("html-page-context", _complete, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
