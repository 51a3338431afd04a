"""Pages generated from the code whenever the site is built, so that they are always up to date.

They are written to `docs/made`: tasks, hyper-parameters, API reference, the notebook, and copies of
texts from elsewhere in the repository.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import api_pages
import copies
import hyperparameters
import notebook
import task_pages

ROOT = Path(__file__).parents[2]


def make(folder: Path) -> None:
    """Write all pages into a folder two levels below the repository's root."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, text in pages().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    task_pages.write_films(folder / "tasks")
    notebook.write(ROOT / "docs" / "emcc_of_your_logs.ipynb", folder / "emcc_of_your_logs")


def pages() -> dict[str, str]:
    """Return by name the pages that consist only of text."""
    found = {f"tasks/{name}.md": text for name, text in task_pages.pages().items()}
    found |= {f"hyperparameters/{name}.md": text for name, text in hyperparameters.tables().items()}
    found |= {f"api/{name}.md": text for name, text in api_pages.pages().items()}
    return found | copies.pages(ROOT)


def on_site(name: str, text: str) -> str:
    """Return a page of `docs` as the site shows it, completed by generated parts.

    Links to texts of the repository lead to their pages, a paragraph that is only a link to the
    metric's text becomes that text, and an algorithm's page ends with its hyper-parameters.
    """
    folder = (ROOT / "docs" / name).parent
    metric = "```{include} made/metric.md\n:heading-offset: 1\n```"
    text = re.sub(r"(?m)^\[[^\]]*\]\(\.\./emcc/README\.md\)$", metric, text)
    if name.startswith("algorithms/"):
        table = f"../made/hyperparameters/{Path(name).name}.md"
        text += f"\n## Hyper-parameters\n\n```{{include}} {table}\n```\n"
    return copies.relinked(ROOT, text, folder, folder)


def _read(app, name, source):
    if not name.startswith("made/"):
        source[0] = on_site(name, source[0])


def setup(app):
    """Generate pages before Sphinx looks for pages, and complete other pages as they are read."""
    app.connect("builder-inited", lambda app: make(Path(app.srcdir) / "made"))
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
