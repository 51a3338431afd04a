"""The report's page in a browser, opened from the disk as a reader would."""

import numpy as np
import pytest
from small_runs import write_evaluated

from agents.reporting.report import report
from agents.training.config import RunId
from agents.training.derive import Steps
from agents.training.grid import grid, prepare
from agents.training.trainer import train

WIDTHS, SCHEMES = (1280, 768, 400), ("light", "dark")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """The report of two algorithms on two tasks, and of runs without positions."""
    folder = tmp_path_factory.mktemp("grid")
    tasks = ["Circle2D-1-v0", "Circle2D-2-v0"]
    configs = grid(folder, tasks, ["trpo-lag", "cpo"], (0, 1), 3000)
    prepare(configs)
    for path in configs:
        train(path)
    write_evaluated(folder / "without", "wcsac", costs=(3, 4))
    report(folder)
    return folder / "index.html"


@pytest.fixture
def opened(opened_page, page_file):
    return lambda width=1280, scheme="light", **how: opened_page(page_file, width, scheme, **how)


def drawing(page):
    return [page.locator(f"#episode {part}").get_attribute("d") for part in (".way", ".chain")]


def background(page):
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_fits_its_width_and_describes_its_pictures(opened, width, scheme):
    page = opened(width, scheme)
    for details in page.locator("details").all():
        details.evaluate("element => element.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert background(page) == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(21, 24, 28)")
    for picture in page.locator("main svg, main img").all():
        name = "aria-label" if picture.evaluate("e => e.tagName") == "svg" else "alt"
        assert len(picture.get_attribute(name)) > 10
    broken = "[...document.images].filter(image => !image.naturalWidth).length"
    assert page.evaluate(broken) == 0
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    found = axe.run(page).response["violations"]
    serious = [rule for rule in found if rule["impact"] in ("serious", "critical")]
    assert [(rule["id"], rule["nodes"][0]["html"][:200]) for rule in serious] == []


def test_the_slider_by_key_and_mouse(opened):
    page = opened()
    slider, words = page.locator("#replay-time"), page.locator("#replay-words")
    first, said = drawing(page), words.text_content()
    assert said.startswith("Window 1 of 60, the episode from step ")
    slider.focus()
    page.keyboard.press("ArrowRight")
    second = drawing(page)
    assert second != first
    assert words.text_content() != said
    assert words.text_content()[:-1] in page.locator("#episode").get_attribute("aria-label")
    page.keyboard.press("Home")
    assert drawing(page) == first
    box = slider.bounding_box()
    page.mouse.click(box["x"] + box["width"] - 2, box["y"] + box["height"] / 2)
    assert slider.input_value() == slider.get_attribute("max")
    assert slider.get_attribute("aria-valuetext").startswith("step ")
    last = drawing(page)
    assert last not in (first, second)
    curve = page.locator("#curve")
    curve.scroll_into_view_if_needed()
    box = curve.bounding_box()
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + box["height"] / 2)
    page.mouse.up()
    assert int(slider.input_value()) < 0.2 * int(slider.get_attribute("max"))


def test_the_slider_by_touch(opened):
    page = opened(400, has_touch=True, is_mobile=True)
    slider = page.locator("#replay-time")
    slider.scroll_into_view_if_needed()
    first, box = drawing(page), slider.bounding_box()
    page.touchscreen.tap(box["x"] + 0.7 * box["width"], box["y"] + box["height"] / 2)
    assert int(slider.input_value()) > 0.5 * int(slider.get_attribute("max"))
    assert drawing(page) != first


def test_every_run_can_be_chosen(opened, page_file):
    page, seen = opened(), set()
    for task in ("Circle2D-1-v0", "Circle2D-2-v0"):
        page.select_option("#replay-task", label=task)
        for name in ("TRPO-Lag (3,000 steps)", "CPO (3,000 steps)"):
            page.select_option("#replay-algorithm", label=name)
            for seed in ("0", "1"):
                page.select_option("#replay-seed", label=seed)
                label = page.locator("#episode").get_attribute("aria-label")
                assert label.startswith(f"Path of {name}, seed {seed}, on {task}. Window ")
                seen.add(tuple(drawing(page)))
    assert len(seen) == 8


def test_what_is_drawn_is_what_was_recorded(opened, page_file):
    """Path, cost and longest streak in every window of a run, against the run's files."""
    page = opened()
    page.select_option("#replay-algorithm", label="CPO (3,000 steps)")
    page.select_option("#replay-seed", label="1")
    folder, run = page_file.parent / "cpo", RunId("Circle2D-1-v0", 1)
    steps = Steps(folder)
    visited, costs = steps.get(run, "positions"), steps.get(run, "costs/cost")
    low, high = visited.min(axis=0), visited.max(axis=0)
    slider = page.locator("#replay-time")
    for k in range(int(slider.get_attribute("max")) + 1):
        slider.fill(str(k))
        words = page.locator("#replay-words").text_content()
        start = int(words.split("from step ")[1].split(":")[0].replace(",", ""))
        way, _ = drawing(page)
        path = np.array([pair.split(" ") for pair in way[1:].split("L")], dtype=float)
        at = visited[start : start + 50]
        expected = np.stack((at[:, 0] + 15, 15 - at[:, 1]), axis=-1) / 30 * 1000
        assert np.abs(path - expected).max() <= 0.06 + ((high - low) / 1023 / 30 * 1000).max()
        of = costs[start : start + 50]
        chain = max(map(len, "".join(str(int(c)) for c in of).split("0")))
        assert f"MCC {chain / 50:.2f} (longest streak {chain} of 50 steps), cost {of.sum():g}." in (
            words
        )
