"""Which unprinted settings give the paper's numbers? The rule: results/identification/README.md.

    python benchmarks/identification.py screen --out FOLDER
    python benchmarks/identification.py full --out FOLDER
    python benchmarks/identification.py rank

`screen` trains the settings that the rule proposes, one after the other, and writes their runs to
results/identification/screening.csv; `full` trains the nearest settings at full length (full.csv).
Both continue where they were interrupted, also in another session: the files hold what is done,
FOLDER the current setting. Runs that two settings share are trained once. `rank` writes
results/identification/ranking.md.
"""

import argparse
import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

import agents
from agents.algorithms import algorithm, title
from agents.errors import RunsFailed, UserError
from agents.paper.evidence import paper_results
from agents.paper.grid import LIBRARY, PAPER_ALGORITHMS
from agents.presets import LENGTHS
from agents.reporting.table import markdown_rows
from agents.training.config import CONFIG, finished
from agents.training.files import write_whole
from circle2d_mj.registration import KINEMATIC

RESULTS = Path(__file__).parents[1] / "results" / "identification"
TASKS = tuple(KINEMATIC.values())
CUT_OUT = TASKS[2:]
"""Tasks with cut-outs; the depth changes nothing on the others."""
SCREENING = {"steps": 300_000, "seeds": (300, 301, 302)}
FULL = {"steps": 1_000_000, "seeds": tuple(range(310, 315))}
MOST_SETTINGS, NEAREST = 40, 5
FLOORS = {"cost_rate": 0.01, "J_R": 0.5, "J_C": 0.5, "CVaR_0.5": 0.5}
"""Measures that enter the distance, each with the least spread to assume, in its unit."""
HELD_BACK = {"EMCC_0.33": 0.02, "EMCC_0.66": 0.02, "EMCC_0.99": 0.02}
"""Measures held back to judge settings, each with the least spread to assume."""
MOST = 5.0
"""Cap on the deviation of a number, in spreads."""
CLEARLY = 0.25
"""How much nearer, in spreads, another geometry must be to become a task."""


@dataclasses.dataclass(frozen=True, order=True)
class Setting:
    """A choice of what the paper does not specify; the defaults are today's preset."""

    depth: float = 0.5  # of the cut-outs, in radii
    step: float = 0.11  # of a full action, in radii
    units: str = "arena"  # of observations: the half arena, or "length"
    limit: str = "terminal"  # off-policy at the time limit
    reward: str = "none"  # scale of the reward off-policy
    follows: str = "replay"  # what multipliers of SAC-Lag and WCSAC follow
    optimizer: str = "adam"  # of multipliers
    on_policy_limit: str = "bootstrap"  # on-policy at the time limit
    wcsac: str = "paper"  # or "library": target and damping of the group's later code

    @property
    def name(self):
        """The choices that differ from today's, in words."""
        own, usual = dataclasses.asdict(self), dataclasses.asdict(Setting())
        return ", ".join(f"{k} {v}" for k, v in own.items() if v != usual[k]) or "today's"

    @property
    def geometry(self):
        """Keyword arguments for the task."""
        return {"cutout_depth": self.depth, "step_length": self.step}

    def training(self, name, task):
        """Return what an algorithm's runs on a task depend on, besides seeds and length."""
        depth = self.depth if task in CUT_OUT else None
        return self.step, depth, self.hyperparameters(name)

    def hyperparameters(self, name):
        """Return an algorithm's hyper-parameters that replace its preset's."""
        chosen = {"multiplier_optimizer": self.optimizer}
        if self.units == "length":
            chosen["input_scale"] = LENGTHS[TASKS[0]]
        if algorithm(name).off_policy:
            chosen |= {"time_limit": self.limit, "reward_scale": self.reward}
            chosen["multiplier_of"] = self.follows
        else:
            chosen["time_limit"] = self.on_policy_limit
        if name == "wcsac" and self.wcsac == "library":
            chosen |= LIBRARY
        known = {field.name for field in dataclasses.fields(algorithm(name).config)}
        return {k: v for k, v in chosen.items() if k in known}


FACTORS = tuple(field.name for field in dataclasses.fields(Setting))
GEOMETRIES = [
    Setting(depth, step, units)
    for units in ("arena", "length")
    for depth in (0.5, 0.55, 0.6)
    for step in (0.1, 0.11, 0.115)
]
OFF_POLICY = tuple(
    {"limit": limit, "reward": reward, "follows": follows}
    for limit in ("terminal", "bootstrap")
    for reward in ("none", "running")
    for follows in ("replay", "start", "episode")
)
SINGLE = ({"optimizer": "sgd"}, {"on_policy_limit": "terminal"}, {"wcsac": "library"})
OTHERS = 3
"""Number of other geometries on which the best options are tried."""


def proposed(distance: Mapping[Setting, float]) -> list[Setting]:
    """Return the settings to screen, given the distances of those already screened.

    First depths, steps and units; then, on the nearest of these, all options of the SAC family;
    then single changes of the nearest so far, and its options on the next geometries.
    """
    found = list(GEOMETRIES)
    if not distance.keys() >= set(found):
        return found
    first = sorted(found, key=distance.__getitem__)
    found += [dataclasses.replace(first[0], **values) for values in OFF_POLICY]
    found = list(dict.fromkeys(found))
    if not distance.keys() >= set(found):
        return found
    best = min(found, key=distance.__getitem__)
    found += [dataclasses.replace(best, **values) for values in SINGLE]
    options = {k: getattr(best, k) for k in FACTORS if k not in ("depth", "step", "units")}
    others = first[1 : 1 + OTHERS]
    found += [dataclasses.replace(own, **options) for own in others]
    return list(dict.fromkeys(found))


def in_full(distance):
    """Return the settings to run at full length: the nearest, today's, and the nearest with today's
    geometry."""
    order = sorted(distance, key=distance.__getitem__)
    at_home = [own for own in order if own.geometry == Setting().geometry]
    return list(dict.fromkeys([*order[:NEAREST], *at_home[:1], Setting()]))


def rows_of(folder, setting):
    """Return a row for each complete run below a folder."""
    rows = []
    for group in agents.load_runs(folder).results:
        for run in group.runs:
            own = {"setting": setting.name, **dataclasses.asdict(setting)}
            own |= {"algorithm": group.config.algorithm, "task": group.task, "seed": run.seed}
            rows.append(own | {name: run.measures[name] for name in (*FLOORS, *HELD_BACK)})
    return rows


def cells(floors=FLOORS):
    """Return the paper's numbers by (algorithm, task, measure)."""
    printed = {(a, t): paper_results(t, title(a)) for a in PAPER_ALGORITHMS for t in TASKS}
    return {(a, t, m): of[m] for (a, t), of in printed.items() for m in floors}


def deviations(runs, spread, floors=FLOORS):
    """Return for each cell the deviation, in spreads, of a setting's mean over runs from the paper.

    It is at most `MOST`, which is also the value of a cell that lacks a seed. The spread is the
    standard deviation over seeds of the published runs, but at least the measure's floor."""
    cells_of = runs.groupby(["algorithm", "task"])
    means, count = cells_of[list(floors)].mean(), cells_of["seed"].nunique()
    seeds = runs["seed"].nunique()
    found = {}
    for (name, task, measure), value in cells(floors).items():
        unit = max(spread[name, task, measure], floors[measure])
        known = count.get((name, task), 0) == seeds
        gap = abs(means.loc[(name, task), measure] - value) / unit if known else math.inf
        found[name, task, measure] = min(gap, MOST) if gap == gap else MOST
    return found


def distance_of(runs, spread, floors=FLOORS):
    """Return the mean of `deviations` over all cells."""
    return float(np.mean(list(deviations(runs, spread, floors).values())))


def distances(table, spread, floors=FLOORS):
    """Return `distance_of` each setting of a table."""
    by = table.groupby(list(FACTORS)) if len(table) else {}
    return {Setting(*values): distance_of(own, spread, floors) for values, own in by}


def clearly_nearer(table, spread, draws=2_000):
    """Return the setting of another geometry that becomes a task, and how much nearer it is: the
    2.5, 50 and 97.5 % quantiles of a bootstrap over seeds. None if the rule selects none."""
    near = distances(table, spread)
    order = sorted(near, key=near.__getitem__)
    away = [own for own in order if own.geometry != Setting().geometry]
    home = [own for own in order if own.geometry == Setting().geometry]
    if not away or not home:
        return None
    rng, gains = np.random.default_rng(0), []
    pair = [_arrays(table, own) for own in (home[0], away[0])]
    printed, unit = _units(spread)
    for _ in range(draws):
        gaps, drawn = [], rng.integers(pair[0].shape[1], size=pair[0].shape[:2])
        for values in pair:  # with the same draws, since they share runs
            means = np.take_along_axis(values, drawn[..., None], axis=1).mean(axis=1)
            off = np.nan_to_num(np.abs(means - printed) / unit, nan=MOST)
            gaps.append(np.minimum(off, MOST).mean())
        gains.append(gaps[0] - gaps[1])
    low, middle, high = np.quantile(gains, (0.025, 0.5, 0.975))
    judge = distances(table, spread, HELD_BACK)
    clear = near[home[0]] - near[away[0]] >= CLEARLY and low > 0
    return (away[0], (low, middle, high)) if clear and judge[away[0]] <= judge[home[0]] else None


def _arrays(table, setting):
    """Return the values of a setting's runs, [algorithms and tasks, seeds, measures]."""
    own = _of(table, setting)
    seeds = sorted(own["seed"].unique())
    index = pd.MultiIndex.from_product([PAPER_ALGORITHMS, TASKS, seeds])
    runs = own.set_index(["algorithm", "task", "seed"])[list(FLOORS)].reindex(index)
    values = runs.to_numpy().reshape(-1, len(seeds), len(FLOORS))
    return np.where(np.isnan(values).any(axis=1, keepdims=True), np.nan, values)


def _units(spread):
    pairs, of = [(a, t) for a in PAPER_ALGORITHMS for t in TASKS], cells()
    printed = np.array([[of[*pair, m] for m in FLOORS] for pair in pairs])
    unit = [[max(spread[*pair, m], floor) for m, floor in FLOORS.items()] for pair in pairs]
    return printed, np.array(unit)


def page(screened, full, spread):
    """Return the ranking as Markdown."""
    near = distances(screened, spread)
    order = sorted(near, key=near.__getitem__)
    parts = ["# Settings by their distance from the paper's numbers\n"]
    parts += [f"Screened: {len(order)} settings, 300 000 steps, three seeds.\n"]
    columns = ["setting", "distance", *map(title, PAPER_ALGORITHMS)]
    rows = []
    for setting in order:
        own = deviations(_of(screened, setting), spread)
        each = [np.mean([v for (a, *_), v in own.items() if a == n]) for n in PAPER_ALGORITHMS]
        rows.append([setting.name, near[setting], *each])
    parts += [_markdown(columns, rows), "\n## What each choice moves\n"]
    rows = [[k, *cell] for k in FACTORS for cell in moved(near, k)]
    parts += ["Distance less that of the same setting with today's value.\n"]
    parts += [_markdown(["choice", "value", "pairs", "mean", "least", "greatest"], rows)]
    parts += ["\n## Numbers that no screened setting comes within two spreads of\n"]
    every = [deviations(_of(screened, setting), spread) for setting in order]
    printed = cells()
    rows = [
        [title(cell[0]), *cell[1:], printed[cell], min(own[cell] for own in every)]
        for cell in printed
        if min(own[cell] for own in every) > 2
    ]
    parts += [_markdown(["algorithm", "task", "measure", "paper", "nearest, spreads"], rows)]
    if len(full):
        near, judge = distances(full, spread), distances(full, spread, HELD_BACK)
        parts += ["\n## In full: five seeds, 1 000 000 steps; EMCC was held back\n"]
        rows = [[s.name, near[s], judge[s]] for s in sorted(near, key=near.__getitem__)]
        parts += [_markdown(["setting", "distance", "distance of EMCC"], rows)]
        nearer = clearly_nearer(full, spread)
        words = "No other geometry is clearly nearer: Circle2D-L-v0 stays alone."
        if lacking := set(in_full(distances(screened, spread))) - near.keys():
            words = f"Undecided: {len(lacking)} settings are not run in full yet."
        elif nearer:
            low, _, high = nearer[1]
            words = f"{nearer[0].name} is clearly nearer, by [{low:.2f}, {high:.2f}]: it becomes v1"
        parts += [f"\n{words}\n"]
    return "\n".join(parts)


def _of(table, setting):
    return table[table["setting"] == setting.name]


def moved(near, factor):
    """Yield for each value of a factor but today's: the value, the number of pairs of settings that
    differ in this value alone, and the mean, least and greatest of their distances less those with
    today's value."""
    usual = getattr(Setting(), factor)
    for value in sorted({getattr(own, factor) for own in near} - {usual}):
        own = [setting for setting in near if getattr(setting, factor) == value]
        pairs = [(setting, dataclasses.replace(setting, **{factor: usual})) for setting in own]
        if gaps := [near[one] - near[other] for one, other in pairs if other in near]:
            yield [str(value), len(gaps), float(np.mean(gaps)), min(gaps), max(gaps)]


def _markdown(columns, rows):
    cells = ([f"{c:.2f}" if isinstance(c, float) else str(c) for c in row] for row in rows)
    return markdown_rows(columns, cells) + "\n"


def read(name):
    """Read a table of results/identification; it is empty if there is no file yet."""
    path = RESULTS / f"{name}.csv"
    return pd.read_csv(path) if path.exists() else pd.DataFrame()


def read_spread():
    """Return by cell the standard deviation over seeds of the published runs."""
    published = pd.read_csv(RESULTS.parent / "circle2d" / "report.csv")
    runs = published[published["kind"] == "run"].groupby(["algorithm", "task"])
    spread = runs[[*FLOORS, *HELD_BACK]].std()
    return {
        (name, task, measure): spread.loc[(title(name), task), measure]
        for name in PAPER_ALGORITHMS
        for task in TASKS
        for measure in spread.columns
    }


def shared(setting, table):
    """Return, by algorithm and task, rows for the runs that a setting shares with others."""
    found, own = {}, {"setting": setting.name, **dataclasses.asdict(setting)}
    for key, rows in table.groupby([*FACTORS, "algorithm", "task"]) if len(table) else ():
        *factors, name, task = key
        if Setting(*factors).training(name, task) == setting.training(name, task):
            found[name, task] = rows.assign(**own)
    return found


def train(setting, length, out, table):
    """Return the rows of a setting's runs; train those that neither a table of other settings nor
    the setting's folder has. A failed run, such as one that diverged, has no row, which counts as
    the greatest deviation."""
    there, folder = shared(setting, table), out / setting.name
    for name in PAPER_ALGORITHMS:
        settings = length | setting.hyperparameters(name)
        if not (lacking := [task for task in TASKS if (name, task) not in there]):
            continue
        try:
            agents.grid(name, lacking, out=folder, task_parameters=setting.geometry, **settings)
        except RunsFailed as error:
            if any(not finished(path.parent) for path in folder.rglob(CONFIG)):
                raise  # a process ended, not a run: given again, the command continues it
            print(error, flush=True)
    own = rows_of(folder, setting) if folder.exists() else []
    return pd.concat([*there.values(), pd.DataFrame(own)])


def _train_all(name, length, out, settings_of):
    """Train settings and save their rows until the rule proposes no more."""
    while True:
        table, of = read(name), read_spread()
        near = distances(table, of)
        lacking = [own for own in settings_of(near) if own not in near]
        if not lacking:
            return
        rows = train(lacking[0], length, out / name, table)
        table = pd.concat([table, rows])
        text = table.to_csv(index=False, float_format="%.5g")
        write_whole(RESULTS / f"{name}.csv", text.encode())
        print(f"{lacking[0].name}: {distance_of(rows, of):.3f}", flush=True)


def screen(options):
    """Train the settings that the rule proposes."""
    length = {**SCREENING, "steps": options.steps or SCREENING["steps"]}
    _train_all("screening", length, options.out, proposed)


def full(options):
    """Train the nearest settings at full length, once the screening is complete."""
    near = distances(read("screening"), read_spread())
    if lacking := [own for own in proposed(near) if own not in near]:
        raise UserError(f"the screening lacks {len(lacking)} settings: run screen first")
    length = {**FULL, "steps": options.steps or FULL["steps"]}
    _train_all("full", length, options.out, lambda _: in_full(near))


def rank(options):
    """Write the ranking of all settings so far."""
    screened = read("screening")
    if not len(screened):
        raise UserError("nothing is screened yet: run screen first")
    (RESULTS / "ranking.md").write_text(page(screened, read("full"), read_spread()))


def main():
    """Run a part of the search."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parts = parser.add_subparsers(required=True)
    for part in (screen, full, rank):
        own = parts.add_parser(part.__name__, help=part.__doc__)
        own.set_defaults(part=part)
        if part is not rank:
            own.add_argument("--out", type=Path, required=True)
            own.add_argument("--steps", type=int, help="for a trial of the script")
    options = parser.parse_args()
    options.part(options)


if __name__ == "__main__":
    main()
