"""Every number of a report, recomputed from the raw steps of its runs.

Patched environments record every step, from which `by_hand` computes the numbers.
"""

import re
from collections import Counter
from statistics import fmean

import pytest
from by_hand import (
    Episode,
    clopper_pearson,
    interval,
    is_mean,
    near,
    of_evaluation,
    of_training,
    share_words,
)
from small_runs import cells as cells_of
from small_runs import few_episodes, lines_of

from agents import presets
from agents.cli.main import main
from agents.paper.sections import STUDY
from agents.reporting.report import report
from circle2d_mj.core.envs import TaskEnv

TASK, SEEDS, STEPS, EVALUATED, LIMIT = "Circle2D-3-v0", (3, 4, 5, 6, 7), 1500, 20, 5
EPISODES = {"cpo": 10, "wcsac": 1}  # in an epoch
PRINTED = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")
MEASURES = (*PRINTED, "mean_streak")
N = len(SEEDS)
PAPER = {  # from the paper's tables Circle2DResults and EMCC, level 3
    "cpo": (0.47, 0.31, 0.20, 0.11, -19.22, 8.28, 12.00),
    "wcsac": (0.56, 0.57, 0.50, 0.11, -15.40, 0.01, 0.01),
}
TITLES = {"cpo": "CPO", "wcsac": "WCSAC"}


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
    """A report's folder, and the numbers of each run by algorithm and choice."""
    out = tmp_path_factory.mktemp("raw")
    numbers = {}
    runs = [("cpo", "", []), ("wcsac", "", []), ("wcsac", "b", ["--time-limit", "bootstrap"])]
    for name, choice, options in runs:
        written.clear()
        command = ["train", name, "--task", TASK, "--steps", str(STEPS)]
        command += ["--seeds", *map(str, SEEDS), "--vectorization", "sync", "--backend", "numpy"]
        with few_episodes(EVALUATED):
            assert main([*command, *options, "--out", str(out / (name + choice))]) == 0
        numbers[name + choice] = numbers_of(list(written.values()), EPISODES[name])
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(presets.PAPER_STEPS, TASK, STEPS)
        report(out, study=STUDY)
    return out, numbers


def numbers_of(environments, of_epoch):
    """Return the numbers of each run from the episodes of all environments.

    Environments come run by run: each run has `of_epoch` of them in training, and then ten for its
    evaluation. These take turns with the evaluated episodes, the deterministic policy's first.
    """
    evaluating = environments[-10 * len(SEEDS) :]
    training = environments[: -10 * len(SEEDS)][-of_epoch * len(SEEDS) :]
    numbers = []
    for run in range(len(SEEDS)):
        of_run = training[run * of_epoch : (run + 1) * of_epoch]
        epochs = list(zip(*of_run, strict=True))
        turns = evaluating[10 * run : 10 * run + 10]
        played = [turns[k % 10][k // 10] for k in range(EVALUATED)]
        numbers.append(of_training(epochs, STEPS) | of_evaluation(played))
    return numbers


def column(runs, name):
    return [run[name] for run in runs]


def check_rows(rows, numbers):
    """Assert that the rows are the expected ones and that every number in them is right."""
    preset, other = "terminal (preset)", "bootstrap"
    means = {f"{TITLES[name]}, mean of {N}": numbers[name] for name in EPISODES}
    means[f"{TASK}, WCSAC, {preset}, mean of {N}"] = numbers["wcsac"]
    means[f"{TASK}, WCSAC, {other}, mean of {N}"] = numbers["wcsacb"]
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
            assert cells[7:] == ["–", "–", ""]
        elif name in means:
            runs = means[name]
            for measure, cell in measured.items():
                assert is_mean(cell, measure, column(runs, measure), runs), (name, measure, cell)
            assert cells[8] == share_words(sum(run["J_C"] <= LIMIT for run in runs), N)
            places = Counter(run["ends"].partition(" (")[0] for run in runs)
            assert cells[9] == "; ".join(
                f"{p} {share_words(n, N)}" for p, n in places.most_common()
            )
        else:
            run = singles[name]
            for measure, cell in measured.items():
                assert near(cell, run[measure]), (name, measure, cell, run[measure])
            assert cells[8:] == [f"{int(run['J_C'] <= LIMIT)} of 1", run["ends"]]
    assert {name for name, *_ in rows} == {*means, *singles, *papers}


def table_after(out, start, head):
    """Return the rows of the first table whose head begins with `head`, after the text `start`."""
    text = (out / "report.md").read_text()
    _, _, text = text[text.index(start) :].partition(f"| {head}")
    return cells_of("| " + text.partition("\n\n")[0].replace("**", ""))


def test_the_numbers_in_tables_and_on_the_page(raw):
    out, numbers = raw
    rows = table_after(out, "EMCC: alpha", TASK)
    rows += table_after(out, "Other choices", "task, algorithm and choice")
    check_rows(rows, numbers)
    page = (out / "index.html").read_text()
    for row in rows:
        own = [re.escape(cell) for cell in row]
        own = [re.sub(r"\\ (\\\[|range\\ )", r"(?:<br><small>| )\1", cell) for cell in own]
        start = r"<td(?: class=\"(?:best|words)\")?>"
        between = rf"(?:</small>)?</td>{start}"
        assert re.search(f"{start}{between.join(own)}(?:</small>)?</td>", page), row


def test_the_table_of_all_ties_instead_of_split_ones(raw):
    out, numbers = raw
    rows = table_after(out, "EMCC is the mean of the highest tenth", "task, algorithm and ties")
    found = {name: cells for name, *cells in rows}
    assert len(found) == 6
    for name, runs in ((name, numbers[name]) for name in EPISODES):
        for way, key in (("split", "EMCC"), ("all", "all")):
            cells = found[f"{TASK}, {TITLES[name]}, ties {way}, mean of {N}"]
            for part, cell in zip(("0.33", "0.66", "0.99"), cells, strict=True):
                of = f"{key}_{part}"
                assert is_mean(cell, of, column(runs, of), runs), (name, way, cell)


def test_the_numbers_in_report_csv(raw):
    """They are those of the tables, to the precision of float32."""
    out, numbers = raw
    names = {"cpo": "CPO", "wcsac": "WCSAC", "wcsacb": "WCSAC (time_limit bootstrap)"}
    expected = {}
    for key, name in names.items():
        for seed, run in zip(SEEDS, numbers[key], strict=True):
            expected[name, "run", str(seed)] = [run[m] for m in MEASURES]
        values = {m: column(numbers[key], m) for m in MEASURES}
        form = interval("J_R", values["J_R"], numbers[key])[0]
        ends = ("mean lowest", "mean highest") if "range" in form else ("mean low", "mean high")
        expected[name, "mean", ""] = list(map(fmean, values.values()))
        expected[name, "iqm", ""] = [  # without the lowest and the highest of five
            fmean(sorted(of)[1:-1]) for of in values.values()
        ]
        for k, kind in enumerate(ends, 1):
            expected[name, kind, ""] = [
                interval(m, of, numbers[key])[k] for m, of in values.items()
            ]
    for key, values in PAPER.items():
        expected[TITLES[key], "paper", ""] = [*values, ""]
    everything = lines_of(out / "report.csv")
    lines = [line for line in everything if not line["share"]]
    check_shares([line for line in everything if line["share"]], numbers, names)
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
        assert line["seeds"] == (str(len(SEEDS)) if key[1] == "mean" else "")
    for key, name in names.items():
        for seed, run in zip(SEEDS, numbers[key], strict=True):
            assert found[name, "run", str(seed)]["ends_in"] == run["ends"]


def check_shares(lines, numbers, names):
    expected = {}
    for key, name in names.items():
        runs = numbers[key]
        expected[name, "within limit", ""] = sum(run["J_C"] <= LIMIT for run in runs)
        for place, count in Counter(run["ends"].partition(" (")[0] for run in runs).items():
            expected[name, "ends in", place] = count
    found = {(x["algorithm"], x["kind"], x["ends_in"]): x for x in lines}
    assert found.keys() == expected.keys()
    for key, line in found.items():
        told = [float(line[name]) for name in ("share", "share_low", "share_high")]
        assert told == pytest.approx([expected[key] / N, *clopper_pearson(expected[key], N)])
        assert int(line["seeds"]) == N
