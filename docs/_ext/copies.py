"""Texts of the repository that the site shows as well: each keeps its one home."""

from __future__ import annotations

import os
import re
from pathlib import Path

TEXTS = {
    "metric.md": "emcc/README.md",
    "zoo.md": "results/zoo/README.md",
    "results.md": "results/README.md",
    "physics.md": "results/physics/README.md",
    "safety.md": "results/safety/README.md",
    "library.md": "results/library/README.md",
    "omnisafe.md": "results/omnisafe/README.md",
    "solving.md": "results/solve/README.md",
    "baselines.md": "results/baselines/README.md",
    "benchmarks.md": "benchmarks/README.md",
    "changelog.md": "CHANGELOG.md",
}
"""Page in `docs/made` -> its home."""
SHOWN = {home: f"docs/made/{name}" for name, home in TEXTS.items()} | {
    "emcc/README.md": "docs/metric.md",  # which includes it
    "docs/emcc_of_your_logs.ipynb": "docs/made/emcc_of_your_logs/index.md",
}
"""Home of a text -> the page that shows it."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(<?([^)<>\s]+)>?\)")


def pages(root: Path) -> dict[str, str]:
    """Name -> text of the copies."""
    made = root / "docs" / "made"
    return {
        name: relinked(root, (root / home).read_text(encoding="utf-8"), (root / home).parent, made)
        for name, home in TEXTS.items()
    }


def relinked(root: Path, text: str, folder: Path, shown: Path) -> str:
    """A text with its links changed so that they hold on the site.

    folder: of the text, in which its links hold. shown: the folder of its page.
    """

    def moved(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        path, mark, anchor = target.partition("#")
        if not path or not (folder / path).exists():  # an address, or no link at all
            return found[0]
        place = Path(os.path.relpath(folder / path, root)).as_posix()
        page = SHOWN.get(place, place)
        near = os.path.relpath(root / page, shown)
        # A text without a page here is a file to be downloaded.
        if page.endswith(".md") and not page.startswith("docs/"):
            return f"{{download}}`{words} <{near}>`"
        return f"{picture}[{words}]({near}{mark}{anchor})"

    return _LINK.sub(moved, text)
