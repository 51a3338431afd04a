"""The zoo: its table, recipes and policies agree, and `train("zoo")` trains a task's recipe."""

import dataclasses
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas
import pytest

import agents
from agents.cli.main import main
from agents.presets import ZOO, limit_of, preset, recipe
from agents.training.config import TrainConfig
from agents.training.policy import FOLDER

ROOT = Path(__file__).parents[2]
GOAL = "SafetyPointGoal1-v0"
COLUMNS = "task algorithm steps seeds J_R J_C J_R_stochastic J_C_stochastic EMCC_0.33 EMCC_0.66 "
COLUMNS += "EMCC_0.99 steps_per_second commit policy published_J_R published_J_C "
COLUMNS += "published_algorithm"


def test_rows_recipes_and_policies_are_of_the_same_tasks():
    table = agents.zoo()
    assert table.columns.tolist() == COLUMNS.split()
    folders = sorted(path.name for path in (FOLDER / "zoo").iterdir())
    assert folders == sorted(table.task) == sorted(task.rpartition("/")[2] for task in ZOO)


def test_rows_are_the_means_of_the_published_seeds():
    """If a task has a second try, with seeds from 200, its row has the means of that."""
    seeds = pandas.read_csv(ROOT / "results/zoo/seeds.csv")
    means = ["J_R", "J_C", "J_R_stochastic", "J_C_stochastic"]
    rows = agents.zoo().set_index("task")
    checked = [task for task in rows.index if task in set(seeds.task)]
    assert len(checked) >= 10
    for task in checked:
        own = seeds[seeds.task == task]
        last = own[own.seed >= own.seed.max() // 100 * 100]
        assert len(last) == rows.loc[task].seeds
        np.testing.assert_allclose(
            rows.loc[task][means].astype(float), last[means].mean(), atol=0.006
        )


@pytest.mark.parametrize("row", [row for _, row in agents.zoo().iterrows()], ids=lambda r: r.task)
def test_a_policy_was_trained_by_its_recipe_and_does_what_its_row_says(row):
    """The bounds are wide, since ten episodes determine a mean only roughly: costs of single
    episodes are between 0 and over 100, and SafetyPointGoal2 has about one goal an episode."""
    config = TrainConfig.read(agents.pretrained("zoo", row.task))
    own = recipe(row.task)
    assert (row.algorithm, row.steps) == (own.algorithm, own.steps)
    assert (config.algorithm, config.steps) == (own.algorithm, own.steps)
    usual = dataclasses.asdict(preset(own.algorithm, row.task, "zoo"))
    assert usual == dataclasses.asdict(config.hyperparameters)
    found = agents.evaluate(row.policy, episodes=10)
    assert found.mean_return == pytest.approx(row.J_R, rel=0.25, abs=1.0)
    assert found.mean_cost <= 2.4 * limit_of(row.task)
    assert limit_of(row.task) >= row.J_C


def test_the_name_trains_the_recipe(tmp_path):
    out = tmp_path / "runs"
    few = {"steps": 1000, "episodes": 1, "critic_iterations": 1, "hidden": (8,), "seeds": 0}
    config = agents.train("zoo", GOAL, out=out, evaluation_episodes=1, **few).config
    own = recipe(GOAL)
    assert config.algorithm == own.algorithm
    assert config.hyperparameters.pid_kp == own.values["pid_kp"]
    assert config.hyperparameters.normalize_observations
    assert (config.hyperparameters.episodes, config.steps) == (1, 1000)


def test_mistakes(capsys, tmp_path):
    out = ["--out", str(tmp_path / "a")]
    for args, words in (
        (
            ["train", "zoo", "--task", "SafetyCarPush2-v0", *out],
            "the zoo has no agent for SafetyCarPush2-v0: ",
        ),
        (["train", "zoo", "--task", "SafetyPointGoal9-v0", *out], "SafetyPointGoal9"),
        (["train", "zoo", "--task", GOAL, "--preset", "none", *out], "zoo has its own preset"),
        (
            ["train", "trpo-lag", "--task", GOAL, "--preset", "zoo", *out],
            f"the zoo's settings for {GOAL} are of trpo-pid, not of trpo-lag: choose the preset",
        ),
        (
            ["train", "trpo-pid", "--task", "SafetyCarPush2-v0", "--preset", "zoo", *out],
            "the zoo has no agent for SafetyCarPush2-v0: ",  # once trained with the defaults
        ),
        (
            ["grid", "trpo-pid", "ppo-lag", "--task", GOAL, "--preset", "zoo", *out],
            "are of trpo-pid, not of ppo-lag",
        ),
        (["zoo", "--task", "SafetyPointRun0-v0"], "the zoo has no agent for"),
    ):
        assert main(args) == 2
        assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_lists_a_task(capsys):
    assert main(["zoo", "--task", GOAL]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if GOAL in line]
    shown = [float(cell) for cell in row.split("|")[2:4]]
    of_row = agents.zoo().set_index("task").loc[GOAL]
    np.testing.assert_allclose(shown, [of_row.J_R, of_row.J_C])
    assert (files("agents") / "policies" / "zoo" / GOAL).is_dir()
