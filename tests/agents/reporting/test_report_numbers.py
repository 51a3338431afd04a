"""Every number of a report, recomputed from the raw steps of its runs.

The environments write down what they give; what follows knows the paper's definitions and no code
of the package: lists, loops and fractions instead of its arrays.
"""

import csv
import math
import re
from collections import Counter
from itertools import product
from statistics import fmean

import pytest

from agents.cli.main import main
from agents.paper import presets
from agents.reporting.report import report
from circle2d_mj.core.single_env import TaskEnv

TASK, SEEDS, STEPS, EVALUATED, LIMIT = "Circle2D-3-v0", (3, 4, 5), 3000, 100, 5
TIME_LIMIT = 50  # kept by gymnasium's wrapper, above what is written down
EPISODES = {"cpo": 10, "wcsac": 1}  # an epoch
PRINTED = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")
MEASURES = (*PRINTED, "mean_streak")
PAPER = {  # tables Circle2DResults and EMCC of the paper, level 3
    "cpo": (0.47, 0.31, 0.20, 0.11, -19.22, 8.28, 12.00),
    "wcsac": (0.56, 0.57, 0.50, 0.11, -15.40, 0.01, 0.01),
}
TITLES = {"cpo": "CPO", "wcsac": "WCSAC"}


class Episode:
    """From a reset to the first step that ends it; what an environment gives later is nobody's."""

    def __init__(self):
        self.rewards, self.costs, self.last, self.over = [], [], None, False

    def add(self, observation, reward, terminated, truncated, info):
        if not self.over:
            self.rewards.append(float(reward))
            self.costs.append(float(info["cost"]))
            self.last = [float(x) for x in observation]
            self.over = terminated or truncated or len(self.costs) == TIME_LIMIT


@pytest.fixture(scope="module")
def written():
    """The episodes of every environment, in the order in which environments were first reset."""
    environments, patch = {}, pytest.MonkeyPatch()
    reset, step = TaskEnv.reset, TaskEnv.step

    def noted_reset(self, *, seed=None, options=None):
        environments.setdefault(self, []).append(Episode())
        return reset(self, seed=seed, options=options)

    def noted_step(self, action):
        given = step(self, action)
        environments[self][-1].add(*given)
        return given

    patch.setattr(TaskEnv, "reset", noted_reset)
    patch.setattr(TaskEnv, "step", noted_step)
    yield environments
    patch.undo()


@pytest.fixture(scope="module")
def raw(written, tmp_path_factory):
    """A report's folder, and by algorithm and choice the numbers of each run."""
    out = tmp_path_factory.mktemp("raw")
    numbers = {}
    runs = [("cpo", "", []), ("wcsac", "", []), ("wcsac", "b", ["--time-limit", "bootstrap"])]
    for name, choice, options in runs:
        written.clear()
        command = ["train", "--algorithm", name, "--task", TASK, "--steps", str(STEPS)]
        command += ["--seeds", *map(str, SEEDS), "--vectorization", "sync", "--backend", "eager"]
        assert main([*command, *options, "--out", str(out / (name + choice))]) == 0
        numbers[name + choice] = numbers_of(list(written.values()), EPISODES[name])
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(presets.PAPER_STEPS, TASK, STEPS)
        report(out)
    return out, numbers


def numbers_of(environments, of_epoch):
    """The numbers of each run. Environments come run by run: `of_epoch` of each in training, and at
    last ten of each, which play the evaluated episodes in turns by the deterministic policy first.
    """
    evaluating = environments[-10 * len(SEEDS) :]
    training = environments[: -10 * len(SEEDS)][-of_epoch * len(SEEDS) :]
    numbers = []
    for run in range(len(SEEDS)):
        of_run = training[run * of_epoch : (run + 1) * of_epoch]
        epochs = list(zip(*of_run, strict=True))
        turns = evaluating[10 * run : 10 * run + 10]
        played = [turns[k % 10][k // 10] for k in range(EVALUATED)]
        numbers.append(of_training(epochs) | of_evaluation(played))
    return numbers


def of_training(epochs):
    """Epochs count until the steps are reached."""
    parts = {"EMCC_0.33": [], "EMCC_0.66": [], "EMCC_0.99": []}
    steps, costs, later, chains = 0, 0.0, [], []
    for episodes in epochs:
        if steps >= STEPS:
            break
        assert all(episode.over for episode in episodes)
        mcc = max(longest(episode.costs) / len(episode.costs) for episode in episodes)
        for name, low, high in (("0.33", 0, 33), ("0.66", 33, 66), ("0.99", 66, 99)):
            start = 100 * steps / STEPS
            if low <= start < high or start == high == 99:
                parts[f"EMCC_{name}"].append(mcc)
        for episode in episodes:
            if 3 * steps >= STEPS:
                later.append(sum(episode.costs))
            costs += sum(episode.costs)
            steps += len(episode.costs)
            chains += streaks(episode.costs)
    assert steps >= STEPS
    emcc = {name: highest(values, 0.1) for name, values in parts.items()}
    mean = fmean(chains) if chains else 0.0
    return emcc | {"cost_rate": costs / steps, "later": fmean(later), "mean_streak": mean}


def streaks(costs):
    """Lengths of all chains of cost steps in an episode."""
    return [len(chain) for chain in "".join("x" if c > 0 else " " for c in costs).split()]


def longest(costs):
    """Cost steps in a row, at most."""
    best = now = 0
    for cost in costs:
        now = now + 1 if cost > 0 else 0
        best = max(best, now)
    return best


def highest(values, alpha):
    """The mean of the values at or above the smallest x with P(value <= x) >= 1 - alpha."""
    ordered = sorted(values)
    at = next(x for k, x in enumerate(ordered, 1) if k >= (1 - alpha) * len(ordered) - 1e-9)
    return fmean(x for x in ordered if x >= at)


def of_evaluation(episodes):
    costs = [sum(episode.costs) for episode in episodes]
    places = [place(*(15 * x for x in episode.last)) for episode in episodes]
    (most, count), *others = Counter(places).most_common()
    return {
        "J_R": fmean(sum(episode.rewards) for episode in episodes),
        "J_C": fmean(costs),
        "CVaR_0.5": highest(costs, 0.5),
        "ends": f"{most} ({100 * count / len(places):.0f} %)" if others else most,
    }


def place(x, y):
    """On level 3: a disc of radius 10; cut-outs by direction, depth and width."""
    side = ("right" if x >= 0 else "left") if abs(x) >= abs(y) else "top" if y >= 0 else "bottom"
    if math.hypot(x, y) >= 10:
        return f"{side} rim"
    cutouts = {"corridor": (180, 9.5, 5)}
    cutouts |= {"top cut-out": (90, 5, 5), "bottom cut-out": (-90, 5, 5)}
    cutouts |= {"top diagonal cut-out": (45, 3, 2.5), "bottom diagonal cut-out": (-45, 3, 2.5)}
    for name, (angle, depth, width) in cutouts.items():
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        if x * cos + y * sin >= 10 - depth and abs(y * cos - x * sin) <= width / 2:
            return name
    return "cost region"


def is_mean(text, values):
    """Whether "1.23 [0.45, 6.78]" is a mean of three with its bootstrap interval: of 27 equally
    likely means of resamples one is the lowest and one the highest, more than 2.5 % each."""
    mean, low, high = (float(x) for x in re.fullmatch(r"(\S+) \[(\S+), (\S+)\]", text).groups())
    return near(mean, fmean(values)) and near(low, min(values)) and near(high, max(values))


def near(printed, value):
    """Two digits are printed, of sums that float32 may have rounded."""
    return abs(float(printed) - value) <= 0.00501


def is_difference(text, a, b):
    """Whether "+0.12 [-0.34, +0.56]" is mean(b) - mean(a) with the bootstrap's interval: of all 27
    x 27 resamples a quantile of 2.5 %, give or take 1 % for the resamples drawn."""
    mean, low, high = (float(x) for x in re.fullmatch(r"(\S+) \[(\S+), (\S+)\]", text).groups())
    means = [[fmean(drawn) for drawn in product(side, repeat=3)] for side in (a, b)]
    gaps = sorted(of_b - of_a for of_a in means[0] for of_b in means[1])
    at = [gaps[round(q * (len(gaps) - 1))] for q in (0.015, 0.035, 0.965, 0.985)]
    assert at[0] - 0.00501 <= low <= at[1] + 0.00501, (text, at)
    assert at[2] - 0.00501 <= high <= at[3] + 0.00501, (text, at)
    return near(mean, fmean(b) - fmean(a))


def column(runs, name):
    return [run[name] for run in runs]


def rows_of(markdown):
    """The rows of all tables, without their marks: name and cells."""
    lines = [line.split("|")[1:-1] for line in markdown.splitlines() if "|" in line]
    cells = [[cell.strip().replace("**", "") for cell in line] for line in lines]
    return [row for row in cells if row[0] and set(row[0]) != {"-"}]


def check_rows(rows, numbers):
    """Every row is known and every number right; returns how many rows there were."""
    preset, other = "terminal (preset)", "bootstrap"
    means = {f"{TITLES[name]}, mean of 3": numbers[name] for name in EPISODES}
    means[f"{TASK}, WCSAC, {preset}, mean of 3"] = numbers["wcsac"]
    means[f"{TASK}, WCSAC, {other}, mean of 3"] = numbers["wcsacb"]
    singles = {
        f"{TITLES[name]}, seed {seed}": run
        for name in EPISODES
        for seed, run in zip(SEEDS, numbers[name], strict=True)
    }
    papers = {f"{TITLES[name]}, paper (3 seeds)": PAPER[name] for name in EPISODES}
    papers[f"{TASK}, WCSAC, paper (3 seeds)"] = PAPER["wcsac"]
    for name, *cells in rows:
        measured = dict(zip(MEASURES, cells[:8], strict=True))
        if name in papers:
            assert [float(cell) for cell in cells[:7]] == list(papers[name])
            assert cells[7] == "–"
        elif name in means:
            for measure, cell in measured.items():
                assert is_mean(cell, column(means[name], measure)), (name, measure, cell)
        else:
            run = singles[name]
            for measure, cell in measured.items():
                assert near(cell, run[measure]), (name, measure, cell, run[measure])
            assert cells[8] == run["ends"]
        if preset in name or other in name:
            places = Counter(run["ends"].partition(" (")[0] for run in means[name])
            assert cells[8] == ", ".join(f"{p} {n}" for p, n in places.most_common())
    assert {name for name, *_ in rows} == {*means, *singles, *papers}


def test_the_tables(raw):
    out, numbers = raw
    tables, _, _ = (out / "report.md").read_text().partition("## The paper's claims")
    rows = [row for row in rows_of(tables) if row[0] not in (TASK, "task, algorithm and choice")]
    check_rows(rows, numbers)
    page = (out / "index.html").read_text()
    for row in rows:
        cells = [re.escape(cell).replace(r"\ \[", r"(?:<br><small>| )\[") for cell in row]
        between = r"(?:</small>)?</td><td(?: class=\"best\")?>"
        assert re.search(f"<td>{between.join(cells)}(?:</small>)?</td>", page), row


def test_the_numbers_for_a_program(raw):
    """The same as in the tables, with all digits that float32 leaves."""
    out, numbers = raw
    names = {"cpo": "CPO", "wcsac": "WCSAC", "wcsacb": "WCSAC (time_limit bootstrap)"}
    expected = {}
    for key, name in names.items():
        for seed, run in zip(SEEDS, numbers[key], strict=True):
            expected[name, "run", str(seed)] = [run[m] for m in MEASURES]
        for kind, of in (("mean", fmean), ("mean low", min), ("mean high", max)):
            expected[name, kind, ""] = [of(column(numbers[key], m)) for m in MEASURES]
    for key, values in PAPER.items():
        expected[TITLES[key], "paper", ""] = [*values, ""]
    with (out / "report.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    found = {(x["algorithm"], x["kind"], x["seed"]): x for x in lines}
    assert len(found) == len(lines)
    assert found.keys() == expected.keys()
    for key, line in found.items():
        known = [float(line[m]) if line[m] else "" for m in MEASURES]
        assert known[:7] == pytest.approx(expected[key][:7], abs=1e-5), key
        assert known[7:] == (pytest.approx(expected[key][7:]) if key[1] != "paper" else [""])
        assert line["task"] == TASK
        folders = [k for k, name in names.items() if name == key[0] and key[1] != "paper"]
        assert [line["folder"]] == (folders or [""])
    for key, name in names.items():
        for seed, run in zip(SEEDS, numbers[key], strict=True):
            assert found[name, "run", str(seed)]["ends_in"] == run["ends"]


def test_what_is_best_is_marked(raw):
    out, numbers = raw
    text, *_ = (out / "report.md").read_text().partition("task, algorithm and choice")
    marks = {}
    for line in text.splitlines():
        name, *cells = (cell.strip() for cell in line.strip("| ").split("|"))
        marks[name] = {m for m, c in zip(MEASURES, cells, strict=False) if c.startswith("**")}
    means = {
        f"{TITLES[name]}, mean of 3": [round(fmean(column(numbers[name], m)), 2) for m in PRINTED]
        for name in EPISODES
    }
    papers = {f"{TITLES[name]}, paper (3 seeds)": PAPER[name] for name in EPISODES}
    for compared in (means, papers):
        best = {name: set() for name in compared}
        for k, measure in enumerate(PRINTED[:4]):
            for name, values in compared.items():
                if values[k] == min(other[k] for other in compared.values()):
                    best[name].add(measure)
        safe = {name: values[4] for name, values in compared.items() if values[5] <= LIMIT}
        for name, value in safe.items():
            best[name] |= set(PRINTED[4:]) if value == max(safe.values()) else set()
        assert {name: marks[name] for name in compared} == best


def test_of_both_choices_the_nearer_to_the_paper_is_marked(raw):
    out, numbers = raw
    _, _, text = (out / "report.md").read_text().partition("task, algorithm and choice")
    preset, other, paper = (line.split("|") for line in text.splitlines()[2:5])
    assert paper[1].strip() == f"{TASK}, WCSAC, paper (3 seeds)"
    for k, measure in enumerate(PRINTED):
        off = [
            abs(round(fmean(column(numbers[name], measure)), 2) - PAPER["wcsac"][k])
            for name in ("wcsac", "wcsacb")
        ]
        marked = [row[2 + k].strip().startswith("**") for row in (preset, other)]
        assert marked == [far <= min(off) + 1e-9 for far in off], measure


def test_the_numbers_of_the_claims(raw):
    out, numbers = raw
    _, _, claims = (out / "report.md").read_text().partition("## The paper's claims")
    change = {
        name: [run["EMCC_0.99"] - run["EMCC_0.33"] for run in numbers[name]] for name in EPISODES
    }
    level = TASK.removesuffix("-v0")
    for name, values in change.items():
        printed = PAPER[name][2] - PAPER[name][0]
        (told,) = re.findall(rf"- {TITLES[name]}: {level} (.*?\]) \(paper {printed:.2f}\)", claims)
        assert is_mean(told, values)
    inside = {
        name: sum(run["ends"].startswith("corridor") and run["J_C"] <= LIMIT for run in runs)
        for name, runs in numbers.items()
    }
    (told,) = re.findall(rf"- {level}: in the corridor within the limit: (.*?) \(claimed", claims)
    assert told == f"CPO {inside['cpo']} of 3 runs, WCSAC {inside['wcsac']} of 3 runs"
    pattern = rf"- {level}: (\d) of 3 runs do so, J_C (.*?) \(paper 0\.01\), "
    pattern += r"episode cost after the first third (.*?\])"
    ((settled, cost, later),) = re.findall(pattern, claims)
    runs = numbers["wcsac"]
    assert int(settled) == sum(
        not run["ends"].startswith("corridor") and max(run["J_C"], run["later"]) <= LIMIT
        for run in runs
    )
    assert is_mean(cost, column(runs, "J_C"))
    assert is_mean(later, column(runs, "later"))
    gaps = re.findall(r"- (\S+): WCSAC - CPO (.*?\]) \(paper (\S+)\)", claims)
    assert [name for name, *_ in gaps] == ["cost_rate", "EMCC_0.66", "EMCC_0.99"]
    for name, told, printed in gaps:
        k = MEASURES.index(name)
        assert is_difference(told, column(numbers["cpo"], name), column(runs, name))
        assert near(printed, PAPER["wcsac"][k] - PAPER["cpo"][k])
