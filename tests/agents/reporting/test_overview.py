"""Figures, tables and ranks over all tasks, against counts and means computed here."""

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
    """Return a run of 60 episodes of 50 steps, each with this cost and longest streak.

    The last third of training costs nothing.
    """
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
    """CPO and WCSAC with equal cost rates of about .2 and longest streaks of about 2 and 8 steps,
    and TRPO-Lag with a cost rate of .4 and streaks of 8, each on two tasks."""
    found = []
    for task in TASKS:
        for name, cost, streak in (("trpo-lag", 20, 8), ("cpo", 10, 2), ("wcsac", 10, 8)):
            # Cost rates and streaks of some seeds are a little higher.
            runs = [run(seed, cost + seed % 2, streak + seed % 3) for seed in range(6)]
            found.append(group(task, name, runs))
    return found


def test_rollouts_of_several_episodes_stay_together():
    """Rollouts have two episodes of 100 steps. The last third begins within the third rollout,
    which belongs to the second third as a whole."""
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
    columns = 7  # these runs have no mean streak
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
    thresholds, shares = drawn[3]  # CPO in the first third, where all rollouts of a run are alike
    streaks = [2 + k % 3 for k in range(6)]
    expected = [fmean(streak / 50 > tau for streak in streaks) for tau in thresholds]
    assert shares == pytest.approx(expected)


def test_pairs_of_equal_cost_rates_and_different_emcc(groups):
    """Such are CPO and WCSAC in the first two thirds of both tasks; the last has no costs."""
    pairs = comparisons(groups)
    found = pairs[pairs.equal_rates & (pairs.emcc_p <= 0.05)].itertuples()
    named = [(x.a.task, x.part, x.a.config.algorithm, x.b.config.algorithm) for x in found]
    assert named == [(task, part, "cpo", "wcsac") for task in TASKS for part in (0.33, 0.66)]
    table = separated_table(groups)
    # 2 tasks x 3 thirds x 3 pairs; all six pairs in the last thirds have equal rates and EMCC.
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
    # The most extreme of 924 permutations and its mirror; 12 of 18 pairs are that extreme.
    assert values[7] == pytest.approx(18 * 2 / 924, rel=0.4)


def test_unequal_spreads_are_not_equal_rates(groups):
    """Rates with so large a spread that no test tells them apart are not equivalent, either."""
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


def test_runs_are_only_compared_by_the_same_cost(groups):
    other = [replace(of, cost="cost_2") for of in groups]
    assert len(comparisons([*groups, *other])) == 2 * len(comparisons(groups))


def test_tables_over_tasks_are_of_one_cost(groups):
    """Runs of another cost, here WCSAC's, are not ranked, and change nothing but a note."""
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
    # CPO's streaks are 2 3 4 2 3 4 on each task; the interquartile mean is of the middle six.
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
    assert max(p_values[:2]) < 0.01  # the most extreme of 924² permutations within the tasks
    assert p_values[2:] == [1, 1]  # the last third has no costs
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
    """CPO has the highest return. WCSAC, with a cost of 4 an episode, violates no limit of 5 and
    costs least. A longer training of CPO is left out, since no other algorithm has its length."""
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
    """The means are 1, 2, 3 on task 1 and 2 (of the runs 1 and 3), 2, 1 on task 2: the mean ranks
    are (1 + 2.5)/2, (2 + 2.5)/2 and (3 + 1)/2.

    The first is better than the others with probability 1 on task 1. On task 2 it is better than
    the second with ½ and than the third, with one tie, with ¼: in the mean (1 + .375)/2.
    """
    first = [np.array(v) for v in ([1.0, 1.0], [2.0], [3.0, 3.0, 3.0])]
    second = [np.array(v) for v in ([1.0, 3.0], [2.0, 2.0], [1.0, 1.0])]
    ranks, wins = overall.ranks_and_wins([first, second])
    assert ranks[0].tolist() == [1.75, 2.25, 2.0]
    assert wins[0, 0] == pytest.approx(0.6875)
    # A bootstrap sample of the runs (1, 3) is (1, 1) with ¼, which ties with the third for rank 1.
    assert np.mean(ranks[1:, 0] == (1 + 1.5) / 2) == pytest.approx(0.25, abs=0.05)
    assert wins[1:].sum(axis=1) == pytest.approx(1.5)  # each of three pairs adds 1 / 2


def test_pairs_that_emcc_orders_otherwise_than_the_cost_rate():
    """One of three pairs: A's rate of .1 is below B's .2, but its EMCC of .5 is above B's .2.
    Kendall's tau is (2 - 1)/3."""
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
def test_a_user_defined_algorithm_is_ranked_beside_published_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(algorithms._algorithms, "registered", {})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_method.py").write_text(MINE)
    tasks = ["Circle2D-0-v0", "Circle2D-1-v0"]
    more = {"seeds": (0, 1), "steps": 1100, "backend": "numpy"}
    for name in ("cpo", "trpo-lag"):
        agents.train(name, tasks, out=tmp_path / "published" / name, **more)
    published = read_groups([tmp_path / "published"], [])
    write_archive(tmp_path / "published.zip", published)
    assert overall.RANKS not in overall.tables_over_tasks(published)  # too few: two algorithms
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
    """Without costs in the last third all have rank 2 by EMCC; by the cost rate 3, 1.5 and 1.5."""
    table = overall.ranks_table(overall.comparable(groups), [])
    values = [[cell.value for cell in row.numbers] for row in table.rows]
    assert [row[-1] for row in values[::2]] == [-1, 0.5, 0.5]
    assert [row[3] for row in values[1::2]] == pytest.approx([0, 0.75, 0.75])


def test_the_table_of_pairs_that_emcc_orders_otherwise(groups):
    runs = [run(seed, 10 + seed % 2, 12) for seed in range(6)]
    changed = [replace(g, runs=runs) if g.config.algorithm == "wcsac" else g for g in groups]
    row = overall.orders_table(overall.comparable(changed)).rows[0]
    assert row.ends == "WCSAC, TRPO-Lag"  # cost rates of .21 and .41, EMCC of .21 and .18
    counted, _, rate, emcc = (cell.value for cell in row.numbers)
    assert (counted, rate, emcc) == (1, pytest.approx(-0.2), pytest.approx(10.5 / 50 - 9 / 50))


def test_the_emcc_of_a_third_is_of_its_worst_tenth():
    streaks = np.array([10, 20, 30, *[0] * 57])
    records = replace(run(0, 20, 20).records, longest_streak=streaks)
    values = measured(RunResult(0, {}, 0, {}, records), "")
    assert values["EMCC_0.33"] == pytest.approx(25 / 50)  # the two highest of 20


def test_violation_rates_and_intervals_by_hand():
    assert overall.ranked(run(0, 5, 4), 5.0)["violation rate"] == 0
    assert overall.ranked(run(0, 5, 4), 4.5)["violation rate"] == pytest.approx(40 / 60)
    found = overall.cell(np.array([7.0, *range(1001)]), True, 2)
    assert (found.value, found.low, found.high) == (7, 25, 975)


def test_of_several_groups_of_an_algorithm_the_one_with_most_runs_is_ranked(groups):
    more = replace(groups[1], runs=[run(seed, 10, 2) for seed in range(8)])
    for order in ([*groups, more], [more, *groups]):
        assert len(overall.comparable(order)["CPO"][TASKS[0]].runs) == 8
