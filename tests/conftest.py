"""Settings and fixtures of all tests."""

import importlib
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import settings

# The same examples each time, however slow the machine: a failure can be seen again.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")
pytest.register_assert_rewrite("scripted")  # its `follow` asserts for two files of tests


@pytest.fixture(scope="session")
def opengl():
    """Skip the test if no library for off-screen drawing is installed; the message says what to
    install. A library that is installed but does not work is a failure."""
    from circle2d_mj.core.engine import mujoco
    from circle2d_mj.render import gl

    try:
        gl.Offscreen(mujoco.MjModel.from_xml_string("<mujoco/>"), 64, 64).close()
    except gl.NoOpenGL as error:
        if str(error).count("is missing") == len(gl.LIBRARIES):
            pytest.skip(str(error))
        raise


@pytest.fixture
def library(monkeypatch):
    """The examples library_cpo and library_sac_lag, whose algorithms one test registers."""
    from agents import algorithms

    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "examples"))
    modules = {name: importlib.import_module(f"library_{name}") for name in ("cpo", "sac_lag")}
    yield SimpleNamespace(**modules)
    for name in modules:
        del sys.modules[f"library_{name}"]
        algorithms._algorithms.registered.pop(f"{name.replace('_', '-')}-library")


@pytest.fixture(scope="session")
def browser():
    """Chromium, driven by Playwright; the test is skipped if one of them is missing."""
    playwright = pytest.importorskip("playwright.sync_api").sync_playwright
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
    if chromium is None:
        pytest.skip("needs Chromium on the path")
    with playwright() as started:
        opened = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def opened_page(browser):
    """A function that opens a file in the browser; it must give no error and fetch nothing."""
    contexts, said = [], []

    def open_page(file, width, scheme, **options):
        size = {"width": width, "height": 900}
        context = browser.new_context(viewport=size, color_scheme=scheme, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("requestfailed", lambda request: said.append(request.url))
        page.on("request", lambda r: r.url.startswith(("file:", "data:")) or said.append(r.url))
        page.goto(file.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []
