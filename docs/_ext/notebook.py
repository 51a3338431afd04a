"""A Jupyter notebook as a page: runs the cells and shows their output below them."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any


def write(path: Path, folder: Path) -> None:
    """Run a notebook; write its page, its pictures, and the notebook for download."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for number, (source, printed, pictures) in enumerate(run(path)):
        parts.append(source)
        if printed:
            parts.append(f"```text\n{printed.rstrip()}\n```")
        for place, picture in enumerate(pictures):
            name = f"{number}-{place}.png"
            (folder / name).write_bytes(picture)
            parts.append(f"![Figure of the cell above]({name})")
    shutil.copy(path, folder)
    parts.append(f"This page is a notebook: {{download}}`{path.name}`.")
    (folder / "index.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def run(path: Path) -> list[tuple[str, str, list[bytes]]]:
    """Run the cells in order in an empty folder; return Markdown, printed text and PNGs of each.

    Exceptions of cells propagate.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    found, here = [], os.getcwd()
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for cell in cells:
                source = "".join(cell["source"])
                if cell["cell_type"] == "markdown":
                    found.append((source, "", []))
                else:
                    found.append((f"```python\n{source}\n```", *_run_cell(source, names)))
        finally:
            os.chdir(here)
    return found


def _run_cell(source: str, names: dict[str, Any]) -> tuple[str, list[bytes]]:
    """Run a cell; return the printed text, with the last expression as in Jupyter, and figures."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    mpl.use("agg")
    body = ast.parse(source).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), "<cell>", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)
            if value is not None:
                print(repr(value))
    pictures = []
    for figure in map(plt.figure, plt.get_fignums()):
        file = io.BytesIO()
        figure.savefig(file, dpi=110, bbox_inches="tight")
        pictures.append(file.getvalue())
    plt.close("all")
    return printed.getvalue(), pictures
