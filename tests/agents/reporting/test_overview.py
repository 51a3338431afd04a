"""Figures, tables and ranks over all tasks, against counts and means worked out here."""

import re
from dataclasses import replace
from itertools import product
from statistics import fmean

import numpy as np
import pytest
from matplotlib.axes import Axes
from small_runs import cells

import agents
from agents import algorithms
from agents.cli.main import main
from agents.paper.evidence import printed
from agents.presets import preset
from agents.reporting import overall
from agents.reporting.figures import intervals_figure, profiles_figure
from agents.reporting.overall import TASKS as TOGETHER
from agents.reporting.overall import over_tasks, separated_table, tables_over_tasks
from agents.results.archive import write_archive
from agents.results.groups import Group, RunResult
from agents.results.measures import measured
from agents.results.reading import read_groups
from agents.results.statistics import ACROSS_WORDS, comparisons
from agents.training.config import TrainConfig
from emcc import EpisodeRecords
from emcc.parts import PARTS

TASKS = ("Circle2D-1-v0", "Circle2D-2-v0")
STEPS, EPISODES = 3000, 60


def run(seed, cost, streak, end="corridor"):
    """60 episodes of 50 steps, each with as many cost steps, and a longest streak; the last third
    costs nothing."""
    start = 50 * np.arange(EPISODES)
    costs = np.where(start < 0.66 * STEPS, cost, 0)
    streaks = np.minimum(costs, streak)
    length = np.full(EPISODES, 50)
    records = EpisodeRecords(np.arange(EPISODES), start, length, -1.0 * length, costs, streaks)
    evaluation = {"deterministic": {"J_R": -9.0 - seed, "J_C": 1.0, "CVaR_0.5": 1.0}}
    found = RunResult(seed, {}, 100, {end: 100}, records, evaluation)
    return replace(found, measures=measured(found, ""))


def group(task, name, runs):
    seeds = tuple(of.seed for of in runs)
    config = TrainConfig(name, (task,), seeds, STEPS, preset(name, task))
    return Group(f"{task}/{name}", task, config, list(runs), [])


@pytest.fixture
def groups():
    """CPO and WCSAC with equal cost rates of about .2 and longest streaks of about 2 and 8 steps;
    TRPO-Lag with a cost rate of .4 and streaks of 8."""
    found = []
    for task in TASKS:
        for name, cost, streak in (("trpo-lag", 20, 8), ("cpo", 10, 2), ("wcsac", 10, 8)):
            # Cost rates and streaks of other seeds are a little higher.
            runs = [run(seed, cost + seed % 2, streak + seed % 3) for seed in range(6)]
            found.append(group(task, name, runs))
    return found


def test_thirds_of_a_run_by_hand():
    measures = run(0, 10, 4).measures
    assert [measures[f"rate_{part}"] for part in PARTS] == [0.2, 0.2, 0.0]
    assert [measures[f"EMCC_{part}"] for part in PARTS] == pytest.approx([0.08, 0.08, 0.0])


def test_rollouts_of_several_episodes_stay_together():
    """Rollouts of two episodes of 100 steps; the last third begins within the third one, which
    belongs to the second third as a whole."""
    cost, streak = [10, 0, 20, 0, 30, 40, 0, 0], [10, 0, 5, 0, 30, 20, 0, 0]
    number, length = np.arange(8), np.full(8, 100)
    records = EpisodeRecords(number // 2, 100 * number, length, np.zeros(8), cost, streak)
    data = RunResult(0, {}, 0, {}, records)
    rates = [measured(data, "")[f"rate_{part}"] for part in PARTS]
    # They start at 0, 25, 50 and 75 %.
    assert rates == pytest.approx([30 / 400, 70 / 200, 0.0])
    mcc = [third.mcc_per_rollout()[0].tolist() for third in data.thirds.values()]
    assert mcc == [[0.1, 0.05], [0.3], [0.0]]


def test_a_dot_for_each_run_and_a_cross_for_each_printed_value(groups):
    text = intervals_figure([*map(printed, groups)]).content.decode()
    columns = 7  # no run has a mean streak here
    for colour in ("#0072b2", "#d55e00", "#e69f00"):
        uses = re.findall(f"<use [^>]*fill: {colour}", text)
        assert len(uses) == len(TASKS) * columns * 6
    # A cross is one path with four strokes, defined once.
    (cross,) = set(re.findall(r'<path id="(\w+)" d="M -2.5 2.5 \nL 2.5 -2.5 \nM', text))
    assert len(re.findall(f'<use xlink:href="#{cross}"', text)) == len(groups) * columns
    assert text == intervals_figure([*map(printed, groups)]).content.decode()


def test_profiles_are_shares_of_rollouts(groups, monkeypatch):
    drawn = []
    plot = Axes.plot

    def noted(self, *points, **options):
        drawn.append(points)
        return plot(self, *points, **options)

    monkeypatch.setattr(Axes, "plot", noted)
    profiles_figure(groups)
    assert len(drawn) == len(groups) * 3
    thresholds, shares = drawn[3]  # CPO in the first third: all rollouts of a run are alike
    streaks = [2 + k % 3 for k in range(6)]
    expected = [fmean(streak / 50 > tau for streak in streaks) for tau in thresholds]
    assert shares == pytest.approx(expected)


def test_pairs_of_equal_cost_rates_and_different_emcc(groups):
    """In the first two thirds of both tasks CPO and WCSAC are; in the last one nobody costs."""
    pairs = comparisons(groups)
    found = pairs[pairs.equal_rates & (pairs.emcc_p <= 0.05)].itertuples()
    named = [(x.a.task, x.part, x.a.config.algorithm, x.b.config.algorithm) for x in found]
    assert named == [(task, part, "cpo", "wcsac") for task in TASKS for part in (0.33, 0.66)]
    table = separated_table(groups)
    # 2 tasks x 3 thirds x 3 pairs; of the last thirds all six have equal rates, and equal EMCC.
    assert (
        "Of 18 comparisons the cost rate does not tell 10 apart, of which EMCC tells 4 apart; 10 "
        "have equal cost rates, of which EMCC tells 4 apart: these are listed." in table.caption
    )
    assert table.head[-1] == "p, corrected for 18 (Holm)"
    (row, *_) = table.rows
    assert row.name == "Circle2D-1-v0, 0 to 33 %: CPO (3,000 steps) and WCSAC (3,000 steps)"
    rate, streaks = 10.5 / 50, (3 / 50, 9 / 50)
    values = [cell.value for cell in row.numbers]
    assert values[:3] == pytest.approx([rate, rate, 0])
    assert values[4:7] == pytest.approx([*streaks, streaks[1] - streaks[0]])
    # The most extreme of 924 divisions, and its mirror; 12 of 18 pairs differ as far as can be.
    assert values[7] == pytest.approx(18 * 2 / 924, rel=0.4)


def test_unequal_spreads_are_not_equal_rates(groups):
    """Cost rates that no test tells apart, since they differ wildly, are not equivalent."""
    wild = [run(k, 10 + 30 * (k % 2), 8) for k in range(6)]
    pair = [groups[1], group(TASKS[0], "wcsac", wild)]
    compared = comparisons(pair)
    first = compared[compared.part == 0.33].iloc[0]
    assert first.rate_p > 0.05
    assert first.equivalence_p > 0.05
    assert not first.equal_rates
    table = separated_table(pair)
    assert "of which EMCC tells 0 apart" in table.caption
    assert "| none" in table.markdown()


def test_fewer_than_five_runs_are_in_no_comparison(groups):
    few = [group(of.task, of.config.algorithm, of.runs[:4]) for of in groups]
    assert comparisons(few).empty
    assert separated_table(few) is over_tasks(few) is None


def test_runs_are_compared_by_the_same_cost(groups):
    other = [replace(of, cost="cost_2") for of in groups]
    assert len(comparisons([*groups, *other])) == 2 * len(comparisons(groups))


def test_tables_over_tasks_are_of_one_cost(groups):
    """WCSAC's runs, of another cost, are not ranked against it; they change nothing else."""
    of_other = [
        replace(of, cost="cost_2") if of.config.algorithm == "wcsac" else of for of in groups
    ]
    rest = [of for of in groups if of.config.algorithm != "wcsac"]
    mixed, alone = (tables_over_tasks(own) for own in (of_other, rest))
    assert mixed[TOGETHER].rows == alone[TOGETHER].rows
    assert (*mixed[TOGETHER].notes,) == ("Of cost alone.", ACROSS_WORDS)
    assert (*alone[TOGETHER].notes,) == ()


def test_over_tasks_by_hand(groups):
    table = over_tasks(groups)
    names = [row.name for row in table.rows]
    trpo_lag, cpo, wcsac = (f"{name} (3,000 steps)" for name in ("TRPO-Lag", "CPO", "WCSAC"))
    assert names[:3] == [f"{name}, 6 seeds" for name in (trpo_lag, cpo, wcsac)]
    pairs = ((trpo_lag, cpo), (trpo_lag, wcsac), (cpo, wcsac))
    assert names[3::2] == [f"P({a} better than {b})" for a, b in pairs]
    assert names[4::2] == ["p, corrected for 12 (Holm)"] * 3
    assert table.head[1:] == ["EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost rate"]
    # Streaks 2 3 4 2 3 4 on either task: of twelve values the middle six are 2 3 3 3 3 4 or so.
    streaks = sorted([2, 3, 4] * 4)
    assert table.rows[1].numbers[0].value == pytest.approx(fmean(streaks[3:9]) / 50)
    rates = [[40 * (cost + k % 2) / STEPS for k in range(6)] for cost in (20, 10)]
    lower = fmean(a < b or (a == b) / 2 for a, b in product(*rates))
    assert table.rows[3].numbers[3].value == pytest.approx(lower)
    cpo, wcsac = ([s + k % 3 for k in range(6)] for s in (2, 8))
    better = fmean(a < b or (a == b) / 2 for a, b in product(cpo, wcsac))
    assert table.rows[7].numbers[0].value == pytest.approx(better) == 1.0
    low, high = table.rows[7].numbers[3].low, table.rows[7].numbers[3].high
    assert low < 0.5 < high  # equal cost rates
    p_values = [number.value for number in table.rows[8].numbers]
    assert max(p_values[:2]) < 0.01  # of 924² divisions within the tasks the most extreme
    assert p_values[2:] == [1, 1]  # nobody costs in the last third
    assert "corrected for the 12 comparisons of this table" in table.caption


def test_no_interval_of_a_difference_where_runs_end_in_different_places(groups):
    (row, *_) = separated_table(groups).rows
    assert row.numbers[2].low is not None
    assert row.numbers[6].low is not None
    elsewhere = [run(seed, 10 + seed % 2, 8 + seed % 3, "left rim") for seed in range(6)]
    mixed = group(TASKS[0], "wcsac", [*elsewhere[:3], *groups[2].runs[3:]])
    (row, *_) = separated_table([groups[1], mixed]).rows
    assert [row.numbers[k].low for k in (2, 6)] == [None, None]


def test_ranks_of_what_can_be_compared(groups):
    """CPO has the highest return; WCSAC, at 4 an episode, violates no limit of 5 and costs least. A
    longer training of CPO with more runs is of a length that no other algorithm has."""
    changed = []
    for of in groups:
        runs = of.runs
        if of.config.algorithm == "cpo":
            runs = [replace(r, measures={**r.measures, "J_R": -1.0}) for r in runs]
        elif of.config.algorithm == "wcsac":
            runs = [run(seed, 4, 4) for seed in range(6)]
        changed.append(replace(of, runs=runs))
    more = group(TASKS[0], "cpo", [run(seed, 1, 1) for seed in range(8)])
    changed.append(replace(more, config=replace(more.config, steps=STEPS + 100)))
    table = overall.tables_over_tasks(changed)[overall.RANKS]
    rows = {row.name: [cell.value for cell in row.numbers[3:6]] for row in table.rows}
    assert table.head[4:7] == ["cost rate", "violation rate", "J_R"]
    assert rows["TRPO-Lag, 6 seeds"] == [3, 2.5, 2.5]
    assert rows["CPO, 6 seeds"] == [2, 2.5, 1]
    assert rows["WCSAC, 6 seeds"] == [1, 1, 2.5]


MINE = '''
"""CPO by another name."""

import agents
from agents.algorithms import cpo

agents.register("mine", cpo.ALGORITHM._replace(title="Mine"))
'''


def test_ranks_and_probability_of_improvement():
    """Task 1: means 1, 2, 3; task 2: 2 (runs 1 and 3), 2, 1. Mean ranks (1 + 2.5)/2, (2 + 2.5)/2,
    (3 + 1)/2. The first is better on task 1 with 1; on task 2 than the second with ½, than the
    third, which ties with one run, with ¼: (1 + .375)/2."""
    first = [np.array(v) for v in ([1.0, 1.0], [2.0], [3.0, 3.0, 3.0])]
    second = [np.array(v) for v in ([1.0, 3.0], [2.0, 2.0], [1.0, 1.0])]
    ranks, wins = overall.ranks_and_wins([first, second])
    assert ranks[0].tolist() == [1.75, 2.25, 2.0]
    assert wins[0, 0] == pytest.approx(0.6875)
    # Drawn again, the runs (1, 3) are (1, 1) with ¼: tied with the third for the best.
    assert np.mean(ranks[1:, 0] == (1 + 1.5) / 2) == pytest.approx(0.25, abs=0.05)
    assert wins[1:].sum(axis=1) == pytest.approx(1.5)  # of each pair one is the better


def test_what_is_ordered_otherwise():
    """One of three pairs, A and B: .1 before .2, but .5 after .2; tau = (2 - 1)/3."""
    rates = {"A": [0.1, 0.1], "B": [0.3, 0.1], "C": [0.3, 0.3]}
    emccs = {"A": [0.5, 0.5], "B": [0.1, 0.3], "C": [0.6, 0.6]}
    rates, emccs = ({k: 3 * v for k, v in of.items()} for of in (rates, emccs))
    for one_place in (True, False):
        places = dict.fromkeys("AC", True) | {"B": one_place}
        row = overall.order_row("task", rates, emccs, places)
        counted, tau, rate, emcc = (cell.value for cell in row.numbers)
        assert (counted, row.numbers[0].total, row.ends) == (1, 3, "A, B")
        assert (tau, rate, emcc) == pytest.approx((1 / 3, -0.1, 0.3))
        ends = [(cell.low, cell.high) for cell in row.numbers[2:]]
        assert ((None, None) in ends) is not one_place


@pytest.mark.slow
def test_a_method_of_ones_own_beside_published_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_method.py").write_text(MINE)
    tasks = ["Circle2D-0-v0", "Circle2D-1-v0"]
    more = {"seeds": (0, 1), "steps": 1100, "backend": "numpy"}
    for name in ("cpo", "trpo-lag"):
        agents.train(name, tasks, out=tmp_path / "published" / name, **more)
    published = read_groups([tmp_path / "published"], [])
    write_archive(tmp_path / "published.zip", published)
    assert overall.RANKS not in overall.tables_over_tasks(published)  # of two algorithms
    command = ["reproduce", "--benchmark", "--tasks", *tasks, "--quick", "--seeds", "0", "1"]
    command += ["--steps", "1100", "--workers", "1"]
    command += ["--import", "my_method", "--algorithms", "mine", "--out", "mine"]
    assert main([*command, "--beside", "nowhere.zip"]) == 2
    assert main([*command, "--beside", "published.zip"]) == 0
    report = (tmp_path / "mine" / "report.md").read_text()
    ranks = report.split(f"## {overall.RANKS}")[1].split("## ")[0]
    rows = {row[0]: row[1] for row in cells(ranks)}
    assert set(rows) >= {f"{name}, 2 seeds" for name in ("CPO", "TRPO-Lag", "Mine")}
    # Equal algorithms with equal seeds have equal ranks.
    assert rows["CPO, 2 seeds"].split("[")[0] == rows["Mine, 2 seeds"].split("[")[0]
    assert "What EMCC orders otherwise" in report


def test_rank_by_emcc_less_that_by_the_cost_rate_and_probabilities(groups):
    """Nobody costs in the last third: all have rank 2 by EMCC; by the cost rate 3, 1.5 and 1.5."""
    table = overall.ranks_table(overall.comparable(groups), [])
    values = [[cell.value for cell in row.numbers] for row in table.rows]
    assert [row[-1] for row in values[::2]] == [-1, 0.5, 0.5]
    assert [row[3] for row in values[1::2]] == pytest.approx([0, 0.75, 0.75])


def test_orders_by_hand(groups):
    runs = [run(seed, 10 + seed % 2, 12) for seed in range(6)]
    changed = [replace(g, runs=runs) if g.config.algorithm == "wcsac" else g for g in groups]
    row = overall.orders_table(overall.comparable(changed)).rows[0]
    assert row.ends == "WCSAC, TRPO-Lag"  # a cost rate of .21 before .41, MCC of .21 after .18
    counted, _, rate, emcc = (cell.value for cell in row.numbers)
    assert (counted, rate, emcc) == (1, pytest.approx(-0.2), pytest.approx(10.5 / 50 - 9 / 50))


def test_the_emcc_of_a_third_is_of_its_worst_tenth():
    streaks = np.array([10, 20, 30, *[0] * 57])
    records = replace(run(0, 20, 20).records, longest_streak=streaks)
    values = measured(RunResult(0, {}, 0, {}, records), "")
    assert values["EMCC_0.33"] == pytest.approx(25 / 50)  # of 20 the two highest


def test_violation_rates_and_intervals_by_hand():
    assert overall.ranked(run(0, 5, 4), 5.0)["violation rate"] == 0
    assert overall.ranked(run(0, 5, 4), 4.5)["violation rate"] == pytest.approx(40 / 60)
    found = overall.cell(np.array([7.0, *range(1001)]), True, 2)
    assert (found.value, found.low, found.high) == (7, 25, 975)


def test_of_several_groups_that_of_most_runs_is_ranked(groups):
    more = replace(groups[1], runs=[run(seed, 10, 2) for seed in range(8)])
    for order in ([*groups, more], [more, *groups]):
        assert len(overall.comparable(order)["CPO"][TASKS[0]].runs) == 8
