"""Texts from elsewhere in the repository that the site shows; they are copied when it is built."""

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
"""Source file of each page in `docs/made`."""
SHOWN = {home: f"docs/made/{name}" for name, home in TEXTS.items()} | {
    "emcc/README.md": "docs/metric.md",  # this page includes the text
    "docs/emcc_of_your_logs.ipynb": "docs/made/emcc_of_your_logs/index.md",
}
"""Page that shows each source file."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(<?([^)<>\s]+)>?\)")


def pages(root: Path) -> dict[str, str]:
    """Return the copies by name."""
    made = root / "docs" / "made"
    return {
        name: relinked(root, (root / home).read_text(encoding="utf-8"), (root / home).parent, made)
        for name, home in TEXTS.items()
    }


def relinked(root: Path, text: str, folder: Path, shown: Path) -> str:
    """Rewrite the links of a text so that they are valid on the site.

    folder: of the source file, from which links are valid. shown: the folder of the page.
    """

    def moved(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        path, mark, anchor = target.partition("#")
        if not path or not (folder / path).exists():  # a web address, or not a link
            return found[0]
        place = Path(os.path.relpath(folder / path, root)).as_posix()
        page = SHOWN.get(place, place)
        near = os.path.relpath(root / page, shown)
        # A text without a page on the site becomes a download.
        if page.endswith(".md") and not page.startswith("docs/"):
            return f"{{download}}`{words} <{near}>`"
        return f"{picture}[{words}]({near}{mark}{anchor})"

    return _LINK.sub(moved, text)
