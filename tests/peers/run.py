"""Run safety-gymnasium's own tests with this package in place of `safety_gymnasium`.

python tests/peers/run.py CHECKOUT [pytest's arguments]

CHECKOUT: a checkout of github.com/PKU-Alignment/safety-gymnasium; only its folder `tests` is used,
and nothing is fetched. Prints how many test cases pass, of all cases and of those whose task ids
this package has.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

PLUGIN = """
import gymnasium
import pytest
import safety_gymnasium

asked = []

def recording(make):
    def made(id, *args, **arguments):
        asked.append(str(id))
        return make(id, *args, **arguments)
    return made

safety_gymnasium.make = recording(safety_gymnasium.make)
gymnasium.make = recording(gymnasium.make)
safety_gymnasium.make_ma = recording(safety_gymnasium.make_ma)

def here(id):
    return id.removeprefix("circle2d_mj/") in safety_gymnasium.registry or id in gymnasium.registry

@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    report = outcome.get_result()
    if call.when == "call":
        known = bool(asked) and all(map(here, asked))
        with open("cases.txt", "a") as file:
            print("here" if known else "elsewhere", report.outcome, item.nodeid, file=file)
    if call.when == "setup":
        asked.clear()
"""


def main(checkout: Path, arguments: list[str]) -> int:
    """Run the tests; return 0 if 95 % of the cases whose ids this package has pass."""
    if not (checkout / "tests" / "test_env.py").is_file():
        sys.exit(f"{checkout} is no checkout of safety-gymnasium: it has no tests/test_env.py")
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder) / "tests"
        shutil.copytree(checkout / "tests", here)
        (here / "recording.py").write_text(PLUGIN)
        run = [sys.executable, "-m", "circle2d_mj.safety_gymnasium", "python", "-m", "pytest"]
        how = ["-q", "-p", "recording", "-p", "no:cacheprovider", "--rootdir", str(here)]
        env = {**os.environ, "PYTHONPATH": str(here), "PYTHONSAFEPATH": ""}
        more = ["--continue-on-collection-errors", "-W", "ignore", *arguments]
        subprocess.run([*run, *how, *more], cwd=here, env=env, check=False)
        cases = [line.split(maxsplit=2) for line in (here / "cases.txt").read_text().splitlines()]
    counts = Counter((where, outcome) for where, outcome, _ in cases)
    of_here = counts["here", "passed"] + counts["here", "failed"]
    passed = counts["here", "passed"] + counts["elsewhere", "passed"]
    for where, outcome, name in cases:
        if (where, outcome) == ("here", "failed"):
            print("failed:", name)
    ours = f"{counts['here', 'passed']} of {of_here} whose ids are here"
    print(
        f"{passed} of {len(cases)} cases passed, {ours}; files that cannot be imported not counted"
    )
    return 0 if of_here and counts["here", "passed"] >= 0.95 * of_here else 1


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1]).resolve(), sys.argv[2:]))
