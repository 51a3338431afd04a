"""Study of the longest streak as a constraint; question and rule: results/streaks/README.md.

    python benchmarks/streaks.py screen --out FOLDER
    python benchmarks/streaks.py train --out FOLDER [--tasks TASK ...] [--arms ARM ...]
    python benchmarks/streaks.py table --out FOLDER
    python benchmarks/streaks.py analyse

`screen` trains the candidates for the base learner and writes results/streaks/screening.csv, from
which the rule chooses one; `train` trains arms, on all cores. Both continue where they were
interrupted, so tasks and arms may be trained in several sessions, in one folder or in several (for
these, `table --out A B`). `table` adds a row for each run to results/streaks/runs.csv, and writes
an archive for each arm into the folder; `analyse` writes results/streaks/analysis.md and curves.png
from the rows of complete tasks.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.stats

import agents
from agents.errors import UserError
from agents.reporting.table import markdown_rows
from agents.results.statistics import LEVEL
from emcc import cost_rate, emcc
from emcc.statistics import holm, mean_interval, permutation_test

RESULTS = Path(__file__).parents[1] / "results" / "streaks"
STEPS, WINDOW, ALPHA = 1_000_000, 10, 0.1
COST_LIMIT = 25.0
SHARED = {"preset": "none", "normalize_observations": True, "episodes": 10}
SHARED |= {"evaluation_episodes": 20}
"""Settings of every training."""

CANDIDATES = {
    "PPO-Lag": ("ppo-lag", {}),
    "PPO-Lag, .1": ("ppo-lag", {"multiplier_lr": 0.1}),
    "TRPO-Lag, .035": ("trpo-lag", {"multiplier_lr": 0.035}),
    "TRPO-Lag, .1": ("trpo-lag", {"multiplier_lr": 0.1}),
    "TRPO-PID": ("trpo-pid", {}),
    "TRPO-PID, gentle": ("trpo-pid", {"pid_kp": 0.05, "pid_ki": 0.003, "pid_kd": 0.01}),
}
"""Candidates for the base learner, with the settings of their multipliers."""
SCREENED_TASKS = ("SafetyPointGoal1-v0", "SafetyPointPush1-v0")
"""Tasks on which the constraint was designed."""
SCREENED_SEEDS = (100, 101, 102)
MEETS = 1.1
"""A candidate satisfies its limit if the cost is at most this many times the limit."""

TASKS = (
    *("SafetyPointCircle1-v0", "SafetyCarGoal1-v0", "SafetyPointButton1-v0"),
    *("SafetyHopperVelocity-v1", "SafetyHalfCheetahVelocity-v1", *SCREENED_TASKS),
)
SEEDS = tuple(range(200, 210))
CONTROL = {f"plain {limit:g}": {"cost_limit": limit} for limit in (25.0, 20.0, 15.0, 10.0, 5.0)}
STREAKS = {f"streak {n:g}": {"streak_limit": n} for n in (20.0, 10.0, 5.0)}
STREAKS |= {"tail 20": {"streak_limit": 20.0, "streak_alpha": 0.1}}
ARMS = CONTROL | {"weight .1": {"streak_weight": 0.1}} | STREAKS
PRIMARY = "streak 10"
"""The arm that decides the study."""
ENOUGH_TASKS = 4
RETURN_MARGIN = 0.1
"""A return counts as equal if it is lower by at most this share of the return of `plain 25`."""
FAMILIES = {"plain": tuple(CONTROL), "streak": ("plain 25", *STREAKS)}
"""Arms that form the front of each family: five each."""
VOLUMES = {"EMCC and return": ("EMCC", "return"), "EMCC and cost rate": ("EMCC", "rate")}


def rows_of(folder, steps=None, **about):
    """Return a row for each complete run below a folder: measures of the last third of training,
    EMCC of the other thirds, and J_R and J_C of the trained policy. steps: only runs of so many."""
    rows = []
    for group in agents.load_runs(folder).results:
        if group.cost != "cost" or steps not in (None, group.config.steps):
            continue
        for run in group.runs:
            parts = run.records.windows(WINDOW).by_part(run.total_steps)
            tails = {k: emcc(part.mcc_per_rollout()[0], ALPHA) for k, part in parts.items()}
            late = parts[0.99]
            task = group.task.rpartition("/")[2]
            own = {"task": task, **about, "seed": run.seed, "EMCC": tails[0.99]}
            own |= {"rate": cost_rate(late.cost, late.length), "return": late.reward.mean()}
            own |= {"cost": late.cost.mean(), "longest": late.longest_streak.mean()}
            own |= {"EMCC_0.33": tails[0.33], "EMCC_0.66": tails[0.66]}
            rows.append(own | {name: run.measures[name] for name in ("J_R", "J_C")})
    return rows


def choose(screening):
    """Choose a candidate from a table with the columns candidate, task, seed, cost and return.

    Of the candidates whose mean cost is at most `MEETS` times the limit on every task, it is the
    one with the highest return relative to the task's best, averaged over tasks; if there are none,
    the one with the lowest largest cost.
    """
    means = screening.groupby(["candidate", "task"])[["cost", "return"]].mean()
    cost = means["cost"].unstack().max(axis=1)
    returns = means["return"].unstack()
    score = (returns / returns.max()).mean(axis=1)
    meets = cost[cost <= MEETS * COST_LIMIT].index
    return score[meets].idxmax() if len(meets) else cost.idxmin()


def complete(table):
    """Return the tasks of a table that have all arms with all seeds."""
    asked = table[table["arm"].isin(ARMS) & table["seed"].isin(SEEDS)]
    count = asked.drop_duplicates(["task", "arm", "seed"])["task"].value_counts()
    return [task for task in TASKS if count.get(task, 0) == len(ARMS) * len(SEEDS)]


def gaps(own, arm, column):
    """Return the column of an arm's runs on a task minus the control's curve of the same seed,
    [seeds]. The curve interpolates the control's five runs linearly in the cost rate, and is
    constant outside them."""
    found = []
    for _, of_seed in own[own["seed"].isin(SEEDS)].groupby("seed"):
        control = of_seed[of_seed["arm"].isin(CONTROL)].sort_values("rate")
        run = of_seed[of_seed["arm"] == arm].iloc[0]
        found.append(run[column] - np.interp(run["rate"], control["rate"], control[column]))
    return np.array(found)


def sign_test(values):
    """Return the p value of the two-sided test of mean 0, exact over all sign flips of [seeds]."""
    how = {"permutation_type": "samples", "n_resamples": np.inf}
    return float(scipy.stats.permutation_test((values,), np.mean, **how).pvalue)


def judge(table):
    """Return a row for each complete task and each arm that is not a control.

    rate, low_rate, high_rate: the arm's mean cost rate, and the lowest and highest of the controls;
    gap, low, high, p: mean over seeds of `gaps` of EMCC, with its 95 % interval and p value, which
    is corrected over tasks for the primary arm, and over arms and tasks for the others. return_gap,
    return_low: the same for the return. success: see the rule.
    """
    rows = []
    for task in complete(table):
        own = table[table["task"] == task]
        means = own.groupby("arm")[["rate", "return"]].mean()
        control = means.loc[list(CONTROL), "rate"]
        for arm in [name for name in ARMS if name not in CONTROL]:
            tails, returns = (gaps(own, arm, column) for column in ("EMCC", "return"))
            by, of_return = mean_interval(tails), mean_interval(returns)
            row = {"task": task, "arm": arm, "rate": means.loc[arm, "rate"]}
            row |= {"low_rate": control.min(), "high_rate": control.max()}
            row |= {"gap": by.value, "low": by.low, "high": by.high, "p": sign_test(tails)}
            row |= {"return_gap": of_return.value, "return_low": of_return.low}
            rows.append(row | {"margin": RETURN_MARGIN * abs(means.loc["plain 25", "return"])})
    found = pd.DataFrame(rows)
    primary = found["arm"] == PRIMARY
    for part in (primary, ~primary):
        found.loc[part, "p"] = holm(found.loc[part, "p"])
    found["lower"] = (found["p"] <= LEVEL) & (found["gap"] < 0)
    found["comparable"] = found["rate"].between(found["low_rate"], found["high_rate"])
    found["as_good"] = found["return_low"] >= -found["margin"]
    found["success"] = found["lower"] & found["comparable"] & found["as_good"]
    return found


def hypervolume(points):
    """Return the share of the unit square that the points [N, 2] dominate: where both coordinates
    are at least those of some point (lower is better)."""
    area, lowest = 0.0, 1.0
    for x, y in sorted(map(tuple, np.clip(points, 0.0, 1.0))):
        area += max(lowest - y, 0.0) * (1.0 - x)
        lowest = min(lowest, y)
    return area


def volumes(table):
    """Return both families' hypervolumes for each pair of measures, [seeds, tasks]. Measures are
    scaled to [0, 1] by the lowest and highest run of a task over all arms; returns are negated."""
    tasks = complete(table)
    found = {name: {f: np.zeros((len(SEEDS), len(tasks))) for f in FAMILIES} for name in VOLUMES}
    for column, task in enumerate(tasks):
        own = table[table["task"] == task].set_index(["arm", "seed"])
        numbers = own[["EMCC", "rate"]].assign(**{"return": -own["return"]})
        spread = (numbers.max() - numbers.min()).replace(0, 1)
        scaled = (numbers - numbers.min()) / spread
        for name, pair in VOLUMES.items():
            for family, arms in FAMILIES.items():
                for row, seed in enumerate(SEEDS):
                    points = scaled.loc[[(arm, seed) for arm in arms], list(pair)].to_numpy()
                    found[name][family][row, column] = hypervolume(points)
    return found


def volume_rows(table):
    """Return a row for each pair of measures: both families' mean hypervolumes over seeds and
    tasks, and the p value of a test stratified by tasks, corrected for the number of pairs."""
    rng, rows = np.random.default_rng(0), []
    for name, of in volumes(table).items():
        p = permutation_test(of["plain"], of["streak"], rng=rng)
        rows.append({"measures": name, "plain": of["plain"].mean(), "streak": of["streak"].mean()})
        rows[-1]["p"] = p
    found = pd.DataFrame(rows)
    found["p"] = holm(found["p"])
    return found


def verdict(judged):
    """Return the study's answer in a sentence. A failure is final as soon as the remaining tasks
    cannot avert it: with more tasks, Holm's correction can only raise the p values."""
    primary = judged[judged["arm"] == PRIMARY]
    successes = primary.loc[primary["success"], "task"].tolist()
    done, left = len(primary), len(TASKS) - len(primary)
    if left and len(successes) + left >= ENOUGH_TASKS:
        return f"Undecided: {done} of {len(TASKS)} tasks are complete."
    answer = "Success" if len(successes) >= ENOUGH_TASKS else "No success"
    names = f" ({', '.join(successes)})" if successes else ""
    return (
        f"{answer}: `{PRIMARY}` succeeds on {len(successes)} of {done} tasks{names}; "
        f"{ENOUGH_TASKS} of {len(TASKS)} are asked."
    )


def page(table):
    """Return the analysis as Markdown."""
    judged, means = judge(table), table[table["task"].isin(complete(table))]
    order = [(task, arm) for task in complete(table) for arm in ARMS]
    means = means.groupby(["task", "arm"])[["EMCC", "rate", "return", "longest", "J_R", "J_C"]]
    parts = [f"# The longest streak as a constraint: analysis\n\n{verdict(judged)}\n"]
    parts += ["## EMCC beside the control's curve\n", _markdown(judged)]
    parts += ["## Hypervolumes\n", _markdown(volume_rows(table))]
    parts += ["## Means over seeds\n", _markdown(means.mean().loc[order].reset_index())]
    return "\n".join(parts)


def _markdown(frame):
    cells = frame.map(lambda value: f"{value:.3f}" if isinstance(value, float) else str(value))
    return markdown_rows([*cells], cells.to_numpy()) + "\n"


def draw(table, path):
    """Draw EMCC against return and against cost rate: the control's curve and the other arms."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    tasks = complete(table)
    size = (2.6 * len(tasks), 5.5)
    figure, axes = plt.subplots(2, len(tasks), squeeze=False, figsize=size, layout="constrained")
    for column, task in enumerate(tasks):
        own = table[table["task"] == task].groupby("arm")[["EMCC", "rate", "return"]].mean()
        for row, name in enumerate(("return", "rate")):
            axis, curve = axes[row, column], own.loc[list(CONTROL)].sort_values("rate")
            axis.plot(curve[name], curve["EMCC"], "o-", color="0.5", label="plain cost, by limit")
            for arm in [name for name in ARMS if name not in CONTROL]:
                axis.plot(own.loc[arm, name], own.loc[arm, "EMCC"], "s", label=arm)
            axis.set_xlabel({"return": "return", "rate": "cost rate"}[name])
        axes[0, column].set_title(task.removeprefix("Safety"), fontsize=9)
    for axis in axes[:, 0]:
        axis.set_ylabel("EMCC, last third")
    named = axes[0, 0].get_legend_handles_labels()
    figure.legend(*named, loc="outside lower center", ncols=1 + len(tasks), fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def base():
    """Return the algorithm and settings that the screening chose. Raises UserError if there was no
    screening."""
    if not (RESULTS / "screening.csv").exists():
        raise UserError("the base learner is not chosen yet: run 'benchmarks/streaks.py screen'")
    return CANDIDATES[choose(pd.read_csv(RESULTS / "screening.csv"))]


def screen(options):
    """Train the plain arm of the candidates, and write their table."""
    rows = []
    for name, (algorithm, values) in CANDIDATES.items():
        out = options.out / "screening" / name
        settings = {**SHARED, **values, "cost_limit": COST_LIMIT, "steps": options.steps}
        agents.grid(algorithm, SCREENED_TASKS, out=out, seeds=SCREENED_SEEDS, **settings)
        rows += rows_of(out, candidate=name)
    screening = pd.DataFrame(rows)
    screening.to_csv(RESULTS / "screening.csv", index=False, float_format="%.6g")
    print(screening.groupby(["candidate", "task"])[["cost", "return", "EMCC"]].mean())
    print("chosen:", choose(screening))


def train(options):
    """Train arms on tasks."""
    algorithm, values = base()
    for arm in options.arms:
        settings = {**SHARED, **values, "cost_limit": COST_LIMIT, **ARMS[arm]}
        settings |= {"steps": options.steps, "seeds": SEEDS, "out": options.out / "arms" / arm}
        agents.grid(algorithm, options.tasks, **settings)


def merged(before, rows):
    """Add rows to a table. Of a run that was trained twice the first row counts, so that nobody can
    choose between them."""
    table = pd.concat([before, pd.DataFrame(rows)])
    table = table.drop_duplicates(["task", "arm", "seed"], keep="first")
    return table.sort_values(["task", "arm", "seed"], ignore_index=True)


def table(options):
    """Add rows for all runs so far, and write the arms' archives."""
    rows, path = [], RESULTS / "runs.csv"
    for out in options.out:
        for arm in ARMS:
            if (folder := out / "arms" / arm).exists():
                try:
                    rows += rows_of(folder, STEPS, arm=arm)
                    agents.report(folder, archive=out / f"{arm}.zip", out=out / "pages" / arm)
                except UserError as error:  # no run is complete yet
                    print(f"{arm}: {error}")
    before = pd.read_csv(path) if path.exists() else pd.DataFrame()
    merged(before, rows).to_csv(path, index=False, float_format="%.6g")


def analyse(options):
    """Write the analysis of the complete tasks."""
    runs = pd.read_csv(RESULTS / "runs.csv")
    if not complete(runs):
        raise UserError(f"no task of {RESULTS / 'runs.csv'} has all arms and seeds yet")
    (RESULTS / "analysis.md").write_text(page(runs))
    draw(runs, RESULTS / "curves.png")


def main():
    """Run a part of the study."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parts = parser.add_subparsers(required=True)
    for part in (screen, train, table, analyse):
        own = parts.add_parser(part.__name__, help=part.__doc__)
        own.set_defaults(part=part)
        if part is table:
            own.add_argument("--out", type=Path, nargs="+", required=True)
        elif part is not analyse:
            own.add_argument("--out", type=Path, required=True)
            own.add_argument("--steps", type=int, default=STEPS, help="for a trial of the script")
        if part is train:
            own.add_argument("--tasks", nargs="+", default=TASKS, choices=TASKS)
            own.add_argument("--arms", nargs="+", default=ARMS, choices=ARMS)
    options = parser.parse_args()
    options.part(options)


if __name__ == "__main__":
    main()
