"""Tables for the pages of results/, from the reports' numbers.

python docs/_ext/results_table.py
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import scipy.stats

import emcc
from agents import algorithms
from agents.paper.grid import PAPER_ALGORITHMS
from agents.results.reading import read_groups

Key = TypeVar("Key", bound=Hashable)
Levels = Sequence[pd.DataFrame]
"""Runs by level."""
RESULTS = Path(__file__).parents[2] / "results"
EMCC = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99")
SAFETY_MEASURES = (*EMCC, "cost_rate")
MEASURES = [*SAFETY_MEASURES, "J_R", "J_C", "CVaR_0.5"]
"""All measures that the paper prints."""
LEVELS = tuple(f"Circle2D-{level}-v0" for level in range(4))
PHYSICS = {f"Circle2DMuJoCo-{level}-v0": f"Circle2D-{level}-v0" for level in range(4)}
"""Tasks with physics, and the same levels without physics."""
ALGORITHMS = tuple(map(algorithms.title, PAPER_ALGORITHMS))
LIMIT, SAFETY_LIMIT, STEPS = 5.0, 25.0, 1_000_000
BENCHMARK_STEPS = " (1,000,000 steps)"
"""Suffix of names on SafetyPointGoal1-v0, where the paper's runs are ten times as long."""
OFF_POLICY = "SAC|CAL"
"""Pattern that matches only names of off-policy algorithms."""
FORCES = (110.0, 330.0)
"""Half of the servo's greatest force along an axis, and a force that only impacts reach, N."""
POINT_CIRCLE = "circle2d_mj/SafetyPointCircle1-v0"
POINT_GOAL = "circle2d_mj/SafetyPointGoal1-v0"
HOPPER = "circle2d_mj/SafetyHopperVelocity-v1"
HALF_CHEETAH = "circle2d_mj/SafetyHalfCheetahVelocity-v1"
POINT_PUSH = "circle2d_mj/SafetyPointPush1-v0"
POINT_BUTTON = "circle2d_mj/SafetyPointButton1-v0"
CAR_GOAL = "circle2d_mj/SafetyCarGoal1-v0"
SAFETY_TASKS = {
    POINT_GOAL: ("runs.zip", "sac-pid-cal.zip"),
    HALF_CHEETAH: ("half-cheetah.zip",),
    POINT_PUSH: ("push-trust-region.zip", "push-others.zip"),
    POINT_BUTTON: ("button-nine.zip", "button-others.zip"),
    CAR_GOAL: ("car.zip",),
}
"""The benchmark's Safety tasks and their archives; the hypotheses tested on the others come from
the first."""
LIBRARY = {
    "CPO": "CPO-library (input_scale 15.0)",
    "CPO, solved": "CPO-library (input_scale 15.0, residual 1e-10)",
    "SAC-Lag": "SAC-Lag-library (time_limit bootstrap, reward_scale running)",
    "SAC-LB": "SAC-LB (time_limit bootstrap, reward_scale running)",
    "WCSAC": "WCSAC (variance_target unsquared, damping_gradient through)",
}
"""Names of runs with settings of the paper group's later library, by their titles on the page."""
SGD = "TRPO-Lag (multiplier_optimizer sgd)"
TERMINAL = "{} (time_limit terminal)"
UNITS = "SAC-LB (input_scale 15.0)"
UNITS_WITH_PHYSICS = "SAC-LB (input_scale (15.0, 15.0, 1.1, 1.1))"
PARTS = {
    "without-scale": "the unit of length",
    "without-novelty": "the bonus for new states",
    "without-share": "the share of random actions",
    "without-horizon": "bootstrapping at the time limit",
    "without-streak": "streak cost",
    "without-brown": "brown random actions",
    "without-speed": "its own step sizes and batches",
    "margin": "streak cost, but with a margin: a limit of 3.5",
}
"""Parts that SAC-LB-Streak was trained without, by the suffix of the folder's name."""
NESTED = {
    "units of length": UNITS,
    "+ streak cost": "SAC-LB (input_scale 15.0, streak_weight 0.25)",
    "+ the bonus for new states": "SAC-LB (input_scale 15.0, novelty_bonus 1.0, "
    "streak_weight 0.25)",
    "+ bootstrapping at the time limit": "SAC-LB (input_scale 15.0, time_limit terminal_cost, "
    "novelty_bonus 1.0, streak_weight 0.25)",
    "+ its own step sizes and batches": "SAC-LB (learning_rate 0.001, temperature_lr 0.00015, "
    "batch_size 128, gradient_steps 10, input_scale 15.0, time_limit terminal_cost, "
    "novelty_bonus 1.0, streak_weight 0.25)",
    "+ random share, brown noise: all": "SAC-LB-Streak",
}
"""SAC-LB with more and more parts of SAC-LB-Streak, by their names on the page."""


@functools.cache
def report(grid: str) -> pd.DataFrame:
    """Return the lines of a grid's report.csv."""
    return pd.read_csv(RESULTS / grid / "report.csv")


def runs(lines: pd.DataFrame, task: str, algorithm: str) -> pd.DataFrame:
    """Return the runs of an algorithm, named as in the report, on a task."""
    return lines[(lines.kind == "run") & (lines.task == task) & (lines.algorithm == algorithm)]


def paper(lines: pd.DataFrame, task: str, algorithm: str) -> pd.DataFrame:
    """Return the line with the paper's numbers."""
    at = (lines.kind == "paper") & (lines.task == task) & (lines.algorithm == algorithm)
    return lines[at]


def within(found: pd.DataFrame) -> pd.Series:
    """Whether each run satisfies the cost limit."""
    return found.J_C <= LIMIT


def solved(found: pd.DataFrame) -> pd.Series:
    """Whether each run ends in the corridor and satisfies the cost limit."""
    return found.ends_in.fillna("").str.startswith("corridor") & within(found)


def count(chosen: pd.Series) -> str:
    """Return how many runs are chosen, as "K of N"."""
    return f"{int(chosen.sum())} of {len(chosen)}"


def short(value: float, digits: int = 2) -> str:
    """Return a number without the 0 before the decimal point."""
    text = f"{round(float(value), digits) + 0.0:.{digits}f}"  # no -0
    return text.replace("0.", ".", 1) if text.lstrip("-").startswith("0.") else text


def p_value(value: float) -> str:
    """Return a p value in words."""
    if value < 0.001:
        return "p < .001"
    return "p = 1" if value > 0.9995 else f"p = {short(value, 3)}"


def holm(tests: Mapping[Key, float]) -> dict[Key, float]:
    """Return the p values of a table's tests, corrected for their number by Holm's method."""
    return dict(zip(tests, emcc.holm(list(tests.values())).tolist(), strict=True))


def difference(usual: Levels, other: Levels, measure: str) -> tuple[float, float]:
    """Return how much higher a mean over levels is in the other runs, and the p value of a
    permutation test that exchanges runs within levels."""
    sides = [np.transpose([own[measure].to_numpy() for own in side]) for side in (usual, other)]
    p = emcc.permutation_test(*sides, rng=np.random.default_rng(0))
    return sides[1].mean() - sides[0].mean(), p


def gap_cells(sides: Mapping[Key, tuple[Levels, Levels]]) -> dict[Key, list[str]]:
    """Return by key how much higher the means over levels of `SAFETY_MEASURES` are on the second
    side, with p values as in `difference`, corrected for all keys and measures (Holm)."""
    found = {(k, m): difference(*pair, m) for k, pair in sides.items() for m in SAFETY_MEASURES}
    p = holm({key: value for key, (_, value) in found.items()})
    return {k: [f"{_gap(found[k, m][0])} ({_p(p[k, m])})" for m in SAFETY_MEASURES] for k in sides}


def means(found: pd.DataFrame, digits: int = 2) -> list[str]:
    """Return means: EMCC by third and cost rate with the given digits, J_R, and J_C."""
    mean = found[[*SAFETY_MEASURES, "J_R", "J_C"]].mean()
    thirds = " ".join(short(mean[name], digits) for name in EMCC)
    return [thirds, short(mean.cost_rate, digits), short(mean.J_R, 1), short(mean.J_C, 1)]


def grid() -> list[str]:
    """Return a row for each level and algorithm with preset settings: means, with the paper's in
    brackets, and how many of ten runs solve the level and satisfy the limit."""
    lines, rows = report("circle2d"), []
    for task in LEVELS:
        for name in ALGORITHMS:
            own = runs(lines, task, name)
            beside = _beside(own, paper(lines, task, name))
            rows.append(_row(task[9], name, *beside, _counts(own)))
    return rows


def later_library() -> list[str]:
    """Return a row for each algorithm as in the later library and each level: means, with the
    paper's in brackets, and the numbers of `nearer_as_later`."""
    lines, rows = report("circle2d"), []
    for title in LIBRARY:
        for task in LEVELS:
            printed = paper(lines, task, title.split(",")[0])
            counts = ", ".join(map(str, nearer_as_later(title, task)))
            rows.append(_row(title, task[9], *_beside(runs_as_later(title, task), printed), counts))
    return rows


def runs_as_later(title: str, task: str) -> pd.DataFrame:
    """Return the runs of an algorithm as in the later library; WCSAC's are in the grid's report."""
    return runs(report("circle2d" if title == "WCSAC" else "library"), task, LIBRARY[title])


def nearer_as_later(title: str, task: str) -> tuple[int, int]:
    """Count the measures in which the library's choice is nearer to the paper than the preset, and
    those in which the preset is nearer, by means rounded to the paper's two digits."""
    lines, usual = report("circle2d"), title.split(",")[0]
    printed = paper(lines, task, usual)[MEASURES].iloc[0]
    library, preset = (
        (own[MEASURES].mean() - printed).abs().round(2)
        for own in (runs_as_later(title, task), runs(lines, task, usual))
    )
    return int((library < preset).sum()), int((preset < library).sum())


def _place(name: str) -> int:
    return ALGORITHMS.index(name.split(" (")[0])


def safety() -> list[str]:
    """Return a row for each of the paper's Safety tasks and algorithm with runs of the paper's
    length: means, with the paper's in brackets, and runs that satisfy the limit. Additional rows
    have other choices of what the paper does not specify."""
    lines, rows = report("safety"), []
    for task in (POINT_CIRCLE, POINT_GOAL, HOPPER):
        ended = map(TERMINAL.format, ALGORITHMS)
        for name in sorted((*ALGORITHMS, SGD, *ended), key=_place):
            own = runs(lines, task, name)
            if len(own):
                title = name.replace("(multiplier_optimizer sgd)", "with plain ascent")
                title = title.replace("(time_limit terminal)", "with `terminal`")
                beside = _beside(own, paper(lines, task, name.split(" (")[0]))
                rows.append(_row(task[18:-3], title, *beside, count(own.J_C <= SAFETY_LIMIT)))
    return rows


def physics() -> list[str]:
    """Return a row for each algorithm: EMCC by third on each level with physics, and in brackets
    without physics."""
    lines, kinematic, rows = report("physics"), report("circle2d"), []
    for name in ALGORITHMS:
        pairs = [
            (runs(lines, task, name), runs(kinematic, same, name)) for task, same in PHYSICS.items()
        ]
        rows.append(_row(name, *(_beside(own, other)[0] for own, other in pairs)))
    return rows


def physics_against_kinematic() -> list[str]:
    """Return a row for each algorithm over levels 1 to 3, and one on level 0: how much higher means
    are with physics, and the runs that solve their level and that satisfy the limit, in brackets
    without physics. p values: permutation tests that exchange runs within levels, corrected for the
    whole table (Holm)."""
    lines, kinematic, sides, counts = report("physics"), report("circle2d"), {}, {}
    level_0, *others = PHYSICS.items()
    levels = {"1 to 3": others, "0": [level_0]}
    for words, name in itertools.product(levels, ALGORITHMS):
        having = [runs(lines, task, name) for task, _ in levels[words]]
        without = [runs(kinematic, task, name) for _, task in levels[words]]
        sides[name, words] = without, having
        counts[name, words] = [
            f"{count(chosen(pd.concat(having)))} ({int(chosen(pd.concat(without)).sum())})"
            for chosen in (solved, within)
        ]
    return [_row(*key, *cells, *counts[key]) for key, cells in gap_cells(sides).items()]


def forces() -> list[str]:
    """Return a row for each algorithm on level 0 with physics, over all steps of training: the
    share of steps with a force; median, 99th percentile and maximum of forces above 0, N; and EMCC
    by third, where steps with more than each of `FORCES` cost."""
    rows = {}
    for group in read_groups([RESULTS / "physics" / "level-0.zip"], []):
        runs = [run.recorded("contact_force") for run in group.runs]
        felt = np.concatenate([force.above_0() for force in runs])
        steps, most = sum(run.steps.sum() for run in runs), max(run.most.max() for run in runs)
        told = (*(f"{value:.3g}" for value in np.percentile(felt, (50, 99))), f"{most:.0f}")
        thirds = []
        for limit in FORCES:
            above = [[*force.emcc_above(limit).values()] for force in runs]
            thirds.append("/".join(map(short, np.mean(above, axis=0))))
        name = algorithms.title(group.config.algorithm)
        rows[name] = _row(name, short(len(felt) / steps), *told, *thirds)
    return [rows[name] for name in ALGORITHMS]


def baselines() -> list[str]:
    """Return a row for each algorithm of the benchmark: means over levels, runs that solve their
    level and that satisfy the limit, and mean ranks over levels by late EMCC and by the cost rate,
    with 95 % intervals. Rows are sorted by the first rank."""
    lines, rows = report("baselines"), []
    for name, ranks in baseline_ranks().items():
        found = pd.concat([runs(lines, task, name) for task in LEVELS])
        thirds, *others = means(found)
        rows.append(_row(name, thirds.replace(" ", "/"), *others, _counts(found), *ranks))
    return rows


def benchmarked(task: str) -> list[str]:
    """Return a row for each algorithm on a Safety task: means of EMCC by third and cost rate; late
    EMCC, J_R and J_C with ranges; runs that satisfy the limit. Rows are sorted by late EMCC."""
    digits, of_return = (3, 0) if task == HALF_CHEETAH else (2, 1)
    lines, rows = on_safety_task(task), []
    for name in lines.groupby("algorithm")["EMCC_0.99"].mean().sort_values(kind="stable").index:
        own = lines[lines.algorithm == name]
        thirds, rate, *_ = means(own, digits)
        places = {"EMCC_0.99": digits, "J_R": of_return, "J_C": 1}
        cells = (with_range(own[measure], places[measure]) for measure in places)
        kept = int((own.J_C <= SAFETY_LIMIT).sum())
        rows.append(_row(name, thirds.replace(" ", "/"), rate, *cells, str(kept)))
    return rows


def on_safety_task(task: str) -> pd.DataFrame:
    """Return the benchmark's runs on a Safety task, with algorithms' names without a suffix."""
    lines = report("baselines/safety")
    lines = lines[(lines.kind == "run") & (lines.task == task)]
    return lines.assign(algorithm=lines.algorithm.str.removesuffix(BENCHMARK_STEPS))


def on_policy(lines: pd.DataFrame) -> pd.DataFrame:
    """Return the lines of the twelve on-policy algorithms."""
    return lines[~lines.algorithm.str.contains(OFF_POLICY)]


@functools.cache
def late_costs(task: str) -> pd.DataFrame:
    """Return means over seeds by algorithm for the last third of training on a Safety task: "rate",
    the cost rate, and "longest", the share of costs that are in their episode's longest streak."""
    rows = []
    for group in read_groups(
        [RESULTS / "baselines" / "safety" / name for name in SAFETY_TASKS[task]], []
    ):
        for run in group.runs:
            late = run.records.by_part(run.total_steps)[0.99]
            longest = late.longest_streak.sum() / max(late.cost.sum(), 1.0)
            shares = {"longest": longest, "rate": run.measures["rate_0.99"]}
            rows.append({"algorithm": algorithms.title(group.config.algorithm), **shares})
    return pd.DataFrame(rows).groupby("algorithm").mean()


def ends(values: pd.Series, digits: int = 2) -> str:
    """Return the lowest and the highest value in words, each with its algorithm."""
    both = (values.idxmin(), values.idxmax())
    return " to ".join(f"{short(values[name], digits)} ({name})" for name in both)


def safety_orders() -> list[str]:
    """Return a row for each Safety task of the benchmark, from the twelve on-policy algorithms'
    means: Kendall's tau of late EMCC and cost rate, Spearman's rho of late EMCC and J_R, tau of
    late EMCC and late cost rate, and the range of "longest" in `late_costs`. p values: two-sided,
    corrected (Holm) over all tasks but the first, from which the hypotheses come.
    """
    told, beside = {}, {}
    for task in SAFETY_TASKS:
        own = on_policy(on_safety_task(task))
        means = own.groupby("algorithm")[["EMCC_0.99", "cost_rate", "J_R"]].mean()
        late, of_late = means["EMCC_0.99"], late_costs(task)
        tau = scipy.stats.kendalltau(late, of_late["rate"][means.index]).statistic
        beside[task] = short(tau), ends(of_late["longest"][means.index])
        told[task] = (
            scipy.stats.kendalltau(late, means.cost_rate),
            scipy.stats.spearmanr(late, means.J_R),
        )
    asked = [(task, k) for task in told if task != POINT_GOAL for k in range(2)]
    p = holm({(task, k): told[task][k].pvalue for task, k in asked})
    return [
        _row(
            task.split("/")[1],
            *(
                f"{short(one.statistic)} ({_p(p.get((task, k), one.pvalue))})"
                for k, one in enumerate(pair)
            ),
            *beside[task],
        )
        for task, pair in told.items()
    ]


def with_range(values: pd.Series | np.ndarray, digits: int) -> str:
    """Return the mean, with the lowest and the highest value in brackets."""
    mean, low, high = (
        short(value, digits) for value in (values.mean(), values.min(), values.max())
    )
    return f"{mean} ({low} to {high})"


def baseline_ranks() -> dict[str, tuple[str, str]]:
    """Return by algorithm the mean ranks over levels by late EMCC and by the cost rate, with
    intervals, as strings of the report; sorted by rank."""
    table = page_table("baselines", "Ranks over tasks").iloc[::2]  # the others are probabilities
    columns = table[[table.columns[0], "EMCC_0.99", "cost rate"]].to_numpy()
    found = {name.split(",")[0]: (late, rate) for name, late, rate in columns}
    return dict(sorted(found.items(), key=lambda pair: [*map(mean_rank, pair[1])]))


def mean_rank(text: str) -> float:
    """Return the rank without its interval."""
    return float(text.split()[0])


def page_table(grid: str, heading: str) -> pd.DataFrame:
    """Return the first table below a heading of a grid's report.md, with cells as strings."""
    text = (RESULTS / grid / "report.md").read_text().split(f"## {heading}\n", 1)[1]
    lines = [line for line in text.split("\n## ", 1)[0].splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return pd.DataFrame(cells[2:], columns=cells[0])


def _beside(own: pd.DataFrame, other: pd.DataFrame) -> list[str]:
    """Return means of some lines, with those of others in brackets."""
    pairs = list(zip(means(own), means(other), strict=True))
    (ours, theirs), *others = pairs
    first = f"{ours.replace(' ', '/')} ({theirs.replace(' ', '/')})"
    return [first, *(f"{a} ({b})" for a, b in others)]


def _counts(own: pd.DataFrame) -> str:
    return f"{int(solved(own).sum())}, {int(within(own).sum())}"


def equal_rates() -> list[str]:
    """Return a row for each level where an equivalence test shows with p < .001 that SAC-LB and
    SAC-LB-Streak have equal cost rates: both means of each measure."""
    rows = []
    for task in LEVELS[1:3]:
        sides = (("circle2d", "SAC-LB"), ("solve", "SAC-LB-Streak"))
        pair = [runs(report(grid), task, name) for grid, name in sides]
        both = {
            name: " and ".join(short(side[name].mean(), 3) for side in pair)
            for name in SAFETY_MEASURES
        }
        rng = np.random.default_rng(0)
        equal = emcc.equivalence_test(*(side.cost_rate.to_numpy() for side in pair), 0.02, rng=rng)
        if p_value(equal) == "p < .001":
            rows.append(_row(task[9], both["cost_rate"], *(both[k] for k in EMCC)))
    return rows


def solving() -> list[str]:
    """Return a row for each level and judged algorithm: how many of ten runs solve the level and
    satisfy the limit, and means."""
    lines, rows = report("solve"), []
    for task in (*LEVELS, *PHYSICS):
        for name in (UNITS, UNITS_WITH_PHYSICS, "SAC-LB-Streak"):
            own = runs(lines, task, name)
            if len(own):
                title = "in units of length" if "input_scale" in name else name
                level = task[9] if task in LEVELS else f"{task[15]}, physics"
                thirds, *others = means(own)
                rows.append(_row(level, title, _counts(own), thirds.replace(" ", "/"), *others))
    return rows


def compared() -> list[str]:
    """Return a row for each measure: means over levels for SAC-LB in units of length and for
    SAC-LB-Streak, and the p value of a permutation test that exchanges runs within levels,
    corrected for the number of rows (Holm)."""
    lines, both, tests = report("solve"), {}, {}
    sides = [[runs(lines, task, which) for task in LEVELS] for which in (UNITS, "SAC-LB-Streak")]
    for name in (*SAFETY_MEASURES, "mean_streak", "J_R", "J_C"):
        both[name] = [short(pd.concat(side)[name].mean(), 3) for side in sides]
        _, tests[name] = difference(*sides, name)
    corrected = holm(tests)
    return [_row(name, *both[name], p_value(corrected[name])) for name in both]


def parts() -> list[str]:
    """Return a row for each part of SAC-LB-Streak: runs that solve their level without the part,
    and how much higher means are without it. p values: Fisher's exact test for counts, the
    permutation test over levels for means, each corrected for the whole table (Holm)."""
    lines, counts, sides_of, of_counts = report("solve"), {}, {}, {}
    for part in PARTS:
        levels = [task for task in LEVELS if len(_part(lines, task, f"-{part}"))]
        sides = [[_part(lines, task, end) for task in levels] for end in (f"-{part}", "")]
        good = [pd.concat([solved(side) for side in of_levels]) for of_levels in sides]
        counts[part] = count(good[0])
        table = [[int(chosen.sum()), int((~chosen).sum())] for chosen in good]
        of_counts[part] = float(scipy.stats.fisher_exact(table).pvalue)
        sides_of[part] = sides[1], sides[0]
    cells, p = gap_cells(sides_of), holm(of_counts)
    return [
        _row(title, f"{counts[part]} ({_p(p[part])})", *cells[part])
        for part, title in PARTS.items()
    ]


def nested() -> list[str]:
    """Return a row for each stage from SAC-LB in units of length to SAC-LB-Streak: how many of ten
    runs solve each level (empty if not trained there), and EMCC by third on level 2."""
    lines, rows = report("solve"), []
    for title, name in NESTED.items():
        own = [runs(lines, task, name) for task in LEVELS]
        solving = (str(int(solved(level).sum())) if len(level) else "" for level in own)
        rows.append(_row(title, *solving, means(own[2])[0].replace(" ", "/")))
    return rows


def _part(lines: pd.DataFrame, task: str, end: str) -> pd.DataFrame:
    return lines[(lines.kind == "run") & (lines.folder == f"{task}-sac-lb-streak{end}")]


def _p(value: float) -> str:
    return p_value(value).removeprefix("p ").removeprefix("= ").replace("< ", "<")


def _gap(value: float) -> str:
    rounded = round(value, 3) + 0.0  # no -0
    return f"{rounded:+.3f}".replace("0.", ".", 1)


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


PAGES = {
    "README.md": (grid, equal_rates),
    "safety/README.md": (safety,),
    "physics/README.md": (physics, physics_against_kinematic, forces),
    "baselines/README.md": (
        baselines,
        *(functools.partial(benchmarked, task) for task in SAFETY_TASKS),
        safety_orders,
    ),
    "solve/README.md": (solving, compared, parts, nested),
}
"""Tables of the pages whose text is written by hand; `results_pages` generates the others."""

if __name__ == "__main__":
    for tables in PAGES.values():
        print("\n\n".join("\n".join(table()) for table in tables), end="\n\n")
