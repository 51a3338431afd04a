"""The four paths of docs/first_steps.md, block after block as a reader copies them, shortened."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "first_steps.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
SHORT = (
    (r"--steps \S+", "--steps 1500 --evaluation-episodes 2"),
    (r"range\(20_000\)", "range(1_500)"),
    (r"--window 10", "--window 1"),  # an epoch is one window of ten episodes
)


@pytest.mark.slow
def test_the_blocks_of_the_page_run(opengl, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(
        "PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    )
    shutil.copytree(ROOT / "examples", "examples")
    names = {}
    for language, block in BLOCKS:
        code = block
        for pattern, short in SHORT:
            code = re.sub(pattern, short, code)
        file = re.match(r"# (\w+\.py)\n", code)
        if file:
            Path(file[1]).write_text(code)
        elif language == "python":
            exec(compile(code, "docs/first_steps.md", "exec"), names)
        elif language == "sh":
            done = subprocess.run(["bash", "-euc", code], capture_output=True, encoding="utf-8")
            assert done.returncode == 0, (code, done.stderr)
        else:
            Path("paper.tex").write_text(code)
    if shutil.which("pdflatex"):
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace")
        assert done.returncode == 0, done.stdout
        assert "Overfull" not in done.stdout
    made = (
        "runs/grid/index.html",
        "curves.pdf",
        "runs/compared/compare.tex",
        "visited.png",
        "ball.gif",
    )
    assert [name for name in made if not Path(name).exists()] == []
