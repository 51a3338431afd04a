"""The documentation in a browser, opened from the disk: no errors, no overflow, accessible."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ("index", "training", "made/tasks/Circle2D-1-v0", "algorithms/wcsac", "made/api/emcc")
PAGES += ("made/results", "made/baselines", "made/emcc_of_your_logs/index", "first_steps")
"""One page of each kind."""
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built from a copy, so that the repository stays unchanged for other tests."""
    pytest.importorskip("furo")
    folder = tmp_path_factory.mktemp("repository")
    for path in ROOT.iterdir():
        if path.name != "docs" and not path.name.startswith("."):
            (folder / path.name).symlink_to(path)
    shutil.copytree(ROOT / "docs", folder / "docs", ignore=shutil.ignore_patterns("made", "_build"))
    command = [sys.executable, "-m", "sphinx", "-W", "--quiet", "-b", "html", "docs", "site"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "site"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 400])
def test_pages_in_a_browser(opened_page, site, width, scheme):
    """No error, nothing fetched, no overflow, no broken picture, no serious violation by axe."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    serious = []
    for name in PAGES:
        page = opened_page(site / f"{name}.html", width, scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        broken = "[...document.images].filter(image => !image.naturalWidth).length"
        assert page.evaluate(broken) == 0, name
        # Axe would fetch the style sheets by itself, which a page from the disk may not.
        found = axe.run(page, options={"preload": False}).response["violations"]
        serious += [
            (name, rule["id"], rule["nodes"][0]["html"][:200])
            for rule in found
            if rule["impact"] in ("serious", "critical")
        ]
    assert serious == []
