"""Comparison of OmniSafe's trainings with ours: the table and the figure of results/omnisafe.

python docs/_ext/omnisafe_parity.py [FOLDER]

The folder holds the trainings of both sides in `benchmarks/omnisafe_run.py`; with it, their records
are imported first. Rules, written before the runs were looked at: J_R and J_C are means over the
last tenth of a run's episodes. A measure is *equal* if an equivalence test shows that the means
differ by less than a tenth of OmniSafe's return, or by less than 5 in cost; *different* if a
permutation test shows a difference; otherwise *undecided*. Each test at .05, not corrected.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results_table import EMCC, p_value, short, with_range

from agents.paper.evidence import equal
from agents.reporting.figures import COLOURS, drawing
from agents.results.reading import read_groups
from agents.results.statistics import equivalence_of, p_of
from emcc import EpisodeRecords

RESULTS = Path(__file__).parents[2] / "results"
RECORDS, PICTURE = RESULTS / "omnisafe", RESULTS / "pictures" / "omnisafe.png"
PAIRS = {
    "PPO-Lag": ("ppo-lag", "ppo-lag"),
    "CPO": ("cpo", "cpo"),
    "CPO as there": ("cpo", "cpo-omnisafe"),
}
"""Compared algorithms: names of OmniSafe's trainings and of ours."""
EPISODES = 10
"""Episodes per epoch, that is per rollout."""
OF_RETURN, OF_COST = 0.1, 5.0
FINAL = {"J_R": 1, "J_C": 1, "cost_rate": 3}
"""Measures and their digits."""
SIDES = ("omnisafe", "ours")
Runs = Sequence[EpisodeRecords]


def take_in(folder: Path) -> None:
    """Import the records of all trainings in the folder's `omnisafe` and `ours`."""
    for path in sorted((folder / "omnisafe").glob("*/steps.npz")):
        steps = np.load(path)
        ends = np.flatnonzero(steps["end"]) + 1
        lengths, rollouts = np.diff(ends, prepend=0), np.arange(len(ends)) // EPISODES
        own = EpisodeRecords.from_costs(steps["cost"], lengths, steps["reward"], rollouts)
        own.save(RECORDS / "omnisafe" / f"{path.parent.name}.csv")
    sys.path.append(str(RESULTS.parent / "benchmarks"))
    importlib.import_module("omnisafe_cpo")  # registers the algorithm
    for group in read_groups([folder / "ours"], []):
        for run in group.runs:
            run.records.save(RECORDS / "ours" / f"{group.config.algorithm}-{run.seed}.csv")


def runs(side: str, name: str) -> Runs:
    """Return the runs of an algorithm on one side, sorted by seed."""
    paths = (RECORDS / side).glob(f"{name}-*.csv")
    seeds = {int(m[1]): p for p in paths if (m := re.fullmatch(rf"{name}-(\d+)", p.stem))}
    return [EpisodeRecords.load(path) for _, path in sorted(seeds.items())]


def measured(found: Runs) -> dict[str, NDArray[np.float64]]:
    """Return each measure of each run, [runs]."""
    last = [run.select(np.arange(len(run)) >= len(run) * 9 // 10) for run in found]
    columns = [
        [run.reward.mean() for run in last],
        [run.cost.mean() for run in last],
        [run.cost.sum() / run.total_steps for run in found],
        *np.transpose([[*run.emcc_by_part().values()] for run in found]),
    ]
    return dict(zip((*FINAL, *EMCC), map(np.array, columns), strict=True))


def compared(theirs: NDArray, ours: NDArray, margin: float) -> str:
    """Return the verdict with the deciding p value, of equivalence or of equal means."""
    sides = theirs.tolist(), ours.tolist()
    verdict = equal(*sides, margin, 1)
    p = p_of(*sides) if verdict == "not reproduced" else equivalence_of(*sides, margin)
    words = {"reproduced": "equal", "not reproduced": "different"}.get(verdict, verdict)
    return f"{words} ({p_value(p)})"


def verdicts(theirs: Mapping[str, NDArray], ours: Mapping[str, NDArray]) -> tuple[str, str]:
    """Return the verdicts on J_R and J_C."""
    margins = {"J_R": OF_RETURN * abs(float(theirs["J_R"].mean())), "J_C": OF_COST}
    j_r, j_c = (compared(theirs[name], ours[name], m) for name, m in margins.items())
    return j_r, j_c


def omnisafe() -> list[str]:
    """Return rows of means with ranges: for each algorithm OmniSafe's runs above ours, which have
    the verdicts on J_R and J_C."""
    rows = []
    for name, folders in PAIRS.items():
        theirs, ours = (measured(runs(*pair)) for pair in zip(SIDES, folders, strict=True))
        if folders[0] == folders[1]:
            rows.append(_row(f"{name}, OmniSafe", theirs, ("", "")))
        rows.append(_row(f"{name}, ours", ours, verdicts(theirs, ours)))
    return rows


def _row(title: str, values: Mapping[str, NDArray], told: tuple[str, str]) -> str:
    cells = [with_range(values[name], digits) for name, digits in FINAL.items()]
    thirds = "/".join(short(values[name].mean()) for name in EMCC)
    return f"| {' | '.join((title, str(len(values['J_R'])), *cells, thirds, *told))} |"


def figure() -> None:
    """Draw return, cost and MCC of each epoch: a line for each run, and a thick one for the
    mean."""
    rows = {"return of an episode": "reward", "cost of an episode": "cost", "MCC of an epoch": ""}
    with drawing() as pyplot:
        drawn, axes = pyplot.subplots(len(rows), len(PAIRS), figsize=(10, 7.5), sharex=True)
        for column, (name, folders) in zip(axes.T, PAIRS.items(), strict=True):
            column[0].set_title(name)
            for side, folder, colour in zip(SIDES, folders, COLOURS, strict=False):
                for axis, values in zip(column, rows.values(), strict=True):
                    curves = np.array([_curve(run, values) for run in runs(side, folder)])
                    steps = EPISODES * np.arange(1, curves.shape[1] + 1)
                    axis.plot(steps, curves.T, color=colour, alpha=0.25, linewidth=0.8)
                    axis.plot(steps, curves.mean(axis=0), color=colour, linewidth=2)
            column[1].axhline(25, color="black", linewidth=0.8, linestyle=":")
            column[-1].set_xlabel("thousand steps")
        for axis, words in zip(axes[:, 0], rows, strict=True):
            axis.set_ylabel(words)
        for words, colour in zip(("OmniSafe", "ours"), COLOURS, strict=False):
            axes[0, 0].plot([], [], color=colour, linewidth=2, label=words)
        axes[0, 0].legend(frameon=False)
        drawn.tight_layout()
        drawn.savefig(PICTURE, dpi=110, metadata={"Software": None})


def _curve(run: EpisodeRecords, values: str) -> NDArray[np.float64]:
    """Return the mean of a column over each epoch's episodes, or the epochs' MCC if it is ""."""
    if not values:
        return run.mcc_per_rollout()[0]
    return getattr(run, values).reshape(-1, EPISODES).mean(axis=1)


if __name__ == "__main__":
    if sys.argv[1:]:
        take_in(Path(sys.argv[1]))
    figure()
    print("\n".join(omnisafe()))
