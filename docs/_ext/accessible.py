"""Additions to the theme: markup for keyboards and screen readers, and unbreakable numbers."""

from __future__ import annotations

import re

_BODY = {
    # Tables and code wider than the page scroll, so they must be reachable by keyboard.
    r'<div class="table-wrapper': '<div tabindex="0" role="group" aria-label="Table" '
    'class="table-wrapper',
    r'(<div class="highlight"><pre)>': r'\1 tabindex="0">',
    r'<math (?=[^>]*display="block")': r'<math tabindex="0" ',
    # Sphinx writes parameters of a multi-line signature as a definition list without terms.
    r'<dl>(?=\s*<dd><em class="sig-param")': r'<dl role="presentation">',
}

_CODE_OR_TAG = re.compile(r"(<(pre|code)\b.*?</\2>|<[^>]*>)", re.DOTALL)


def whole_numbers(html: str) -> str:
    """Make numbers like 10 000 unbreakable in text and tables, but not in code, to be copied."""
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
    """Register the completion of every page, after the theme."""
    app.connect("html-page-context", _complete, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
