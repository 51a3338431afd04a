"""Pages that are made from the code whenever the site is built, so that they cannot drift.

They go to `docs/made`: tasks, hyper-parameters, API reference, the notebook, and copies of texts
that live elsewhere in the repository.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import api_pages
import copies
import hyperparameters
import notebook
import task_pages

ROOT = Path(__file__).parents[2]


def make(folder: Path) -> None:
    """Write all pages into a folder that lies two levels below the repository's root."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, text in pages().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    task_pages.write_films(folder / "tasks")
    notebook.write(ROOT / "docs" / "emcc_of_your_logs.ipynb", folder / "emcc_of_your_logs")


def pages() -> dict[str, str]:
    """Name -> text of the pages that are text alone."""
    found = {f"tasks/{name}.md": text for name, text in task_pages.pages().items()}
    found |= {f"hyperparameters/{name}.md": text for name, text in hyperparameters.tables().items()}
    found |= {f"api/{name}.md": text for name, text in api_pages.pages().items()}
    return found | copies.pages(ROOT)


def setup(app):
    """Make the pages before Sphinx looks for pages."""
    app.connect("builder-inited", lambda app: make(Path(app.srcdir) / "made"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
