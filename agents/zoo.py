"""The zoo's results: returns and costs of its agents on each task, with the best published ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agents.errors import extra

if TYPE_CHECKING:
    import pandas

# In a wheel the file is inside the package, in a checkout among the results.
_FILES = (Path(__file__).with_name("zoo.csv"), Path(__file__).parents[1] / "results/zoo/zoo.csv")


def zoo() -> pandas.DataFrame:
    """Return the agents that come with the package, a row for each task: `circle2d zoo`.

    J_R and J_C are means over fresh seeds, with 100 episodes each, of the undiscounted return and
    cost of the policy without its noise and with it. EMCC_0.33 to EMCC_0.99 are those of the thirds
    of training (α = 0.1, in windows of ten episodes). published_J_R and published_J_C are those of
    the algorithm in OmniSafe's benchmarks with the highest return within the limit, without those
    that end an episode at the limit; its on-policy algorithms took ten million steps, the others up
    to three million. `policy` is a name for `load_policy`; `commit` is the version of this package
    that trained the agents.
    """
    extra("pandas", "train")
    import pandas as pd

    return pd.read_csv(next(file for file in _FILES if file.exists()))
