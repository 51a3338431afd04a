"""The numbers in docs/metric.md are those that `emcc` gives."""

import re
from pathlib import Path

import emcc

PAGE = (Path(__file__).parents[1] / "docs" / "metric.md").read_text()


def test_the_example_of_ties():
    """`emcc` itself is held to the definition in tests/emcc."""
    rows = re.findall(r"^\| (\d+) \| (\.\d+) \| (\.\d+) \|$", PAGE, re.MULTILINE)
    assert [int(safe) for safe, *_ in rows] == [89, 90, 91]
    for safe, *printed in rows:
        values = [0.0] * int(safe) + [0.5] * (100 - int(safe))
        assert [emcc.emcc(values, 0.1, ties) for ties in ("all", "split")] == [*map(float, printed)]
    costs = [4, 38, 54, 0, 0, 25, 39, 13, 20, 0]
    assert [emcc.cvar(costs, 0.5, ties) for ties in ("all", "split")] == [31.5, 35.2]
    assert "is 31.5 with `all` and 35.2 with `split`" in PAGE
