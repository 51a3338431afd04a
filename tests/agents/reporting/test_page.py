"""The report's page: one file that fetches nothing, escapes names and links to its parts."""

from html.parser import HTMLParser

import numpy as np
from small_runs import edit_results

from agents.cli.main import main
from agents.paper.sections import STUDY
from agents.reporting.figures import Figure
from agents.reporting.page import Section, page
from agents.reporting.report import report
from agents.reporting.table import Number, Row, Table
from agents.training.grid import grid, prepare
from agents.training.trainer import train


class Page(HTMLParser):
    """Parse a page: its images, ids, links within the page, and what a browser would fetch."""

    def __init__(self, text):
        super().__init__()
        self.open, self.fetched, self.images, self.ids, self.links = [], [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in ("meta", "link", "img", "br", "!doctype", "input"):
            self.open.append(tag)
        if tag == "img":
            self.images.append(attributes)
        if "id" in attributes:
            self.ids.append(attributes["id"])
        targets = [attributes[n] for n in ("src", "href", "xlink:href") if n in attributes]
        self.links += [of[1:] for of in targets if of.startswith("#")]
        self.fetched += [of for of in targets if not of.startswith(("#", "data:"))]

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_a_page_escapes_and_keeps_every_cell():
    rows = [Row("a & b", [Number(1.0, 2, 0.5, 2.0), Number(None)], "<end>")]
    table = Table("caption <1>", ["t", "v", "w", "ends in"], rows, ["note <x>"])
    image = Figure(b"<svg/>", 'curves "of"', "words < words")
    text = page("<title>", [Section("A <task>", table, [image])], {"seeds": "0 < 1"})
    shown = Page(text)
    image = {"alt": 'curves "of": A <task>', "src": "data:image/svg+xml,%3Csvg/%3E"}
    assert [dict(i) for i in shown.images] == [image]
    assert shown.links == shown.ids == ["a-task", "how-it-was-made"]
    for escaped in (
        "a &amp; b",
        "&lt;end&gt;",
        "caption &lt;1&gt;",
        "note &lt;x&gt;",
        "&lt;title&gt;",
        "0 &lt; 1",
        "s &lt; w",
    ):
        assert escaped in text


def test_the_report_of_a_small_grid(tmp_path):
    configs = grid(tmp_path, ["Circle2D-1-v0"], ["trpo-lag"], (0, 1), 1100)
    prepare(configs)
    for folder in configs:
        train(folder)
    report(tmp_path, study=STUDY)
    text = (tmp_path / "index.html").read_text()
    shown = Page(text)
    assert shown.fetched == []  # no network, no files beside it
    order = ["every-run", "cost-rate-against-emcc", "replay-of-training", "circle2d-1-v0"]
    order += ["all-ties-instead-of-split-ones", "how-it-was-made"]
    assert [link for link in shown.links if link in order] == order
    assert [name for name in shown.ids if name in order] == order
    assert set(shown.links) <= set(shown.ids)
    assert "<title>TRPO-Lag on Circle2D-1-v0 (" in text
    assert "2 runs, 1 task, 1 algorithm, seeds 0, 1, 1,500 steps each" in text
    assert len(shown.images) == 4
    assert all(image["alt"] for image in shown.images)
    files = {p.name for p in tmp_path.iterdir() if p.is_file()}
    assert files == {"index.html", "measures.csv", "report.csv", "report.md", "report.tex"}
    assert "torch 2" in text
    edit_results(folder, **{"Circle2D-1-v0__1__failure": np.array("it fell")})
    assert main(["report", str(tmp_path)]) == 1
    for name in ("index.html", "report.md"):
        assert "left out: " in (tmp_path / name).read_text()
