"""Texts of the repository that the site shows as well: each keeps its one home."""

from __future__ import annotations

import os
import re
from pathlib import Path

TEXTS = {
    "metric.md": "emcc/README.md",
    "results.md": "results/README.md",
    "solving.md": "results/solve/README.md",
    "benchmarks.md": "benchmarks/README.md",
    "changelog.md": "CHANGELOG.md",
}
"""Page in `docs/made` -> its home."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(<?([^)<>\s]+)>?\)")


def pages(root: Path) -> dict[str, str]:
    """Name -> text of the copies."""
    return {name: _copy(root, home) for name, home in TEXTS.items()}


def _copy(root: Path, home: str) -> str:
    """A text with its links changed so that they hold in `docs/made`."""
    text, folder = (root / home).read_text(encoding="utf-8"), (root / home).parent

    def moved(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        path, mark, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target) or not path:
            return found[0]
        whole = (folder / path).resolve()
        for page, text_home in TEXTS.items():
            if whole == root / text_home:
                return f"[{words}]({page}{mark}{anchor})"
        near = os.path.relpath(whole, root / "docs" / "made")
        # A text without a page here is a file to be downloaded.
        return (
            f"{{download}}`{words} <{near}>`"
            if whole.suffix == ".md"
            else (f"{picture}[{words}]({near}{mark}{anchor})")
        )

    return _LINK.sub(moved, text)
