"""Presets against the paper's tables HP_Circle2D and HP_SafetyGymnasium, typed in here; the grid of
experiments."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import pytest

import agents
from agents import algorithms, presets
from agents.algorithms import ALGORITHMS
from agents.errors import UserError
from agents.paper import grid as papers
from agents.paper.evidence import paper_results
from agents.paper.grid import PAPER_ALGORITHMS, unprinted
from agents.presets import Rule, preset, usual_steps
from agents.training import grid

SHARED = {"batch_size": 256, "discount": 0.99, "learning_rate": 3e-4, "cost_limit": 5}
SHARED |= {"hidden": (64, 64)}
ON_POLICY = {
    "episodes": 10,
    "critic_iterations": 10,
    "gae_lambda": 0.95,
    "cg_iterations": 15,
    "line_search_steps": 15,
    "target_kl": 0.01,
    "time_limit": "bootstrap",  # not printed
}
OFF_POLICY = {
    "gradient_steps": 5,
    "random_steps": 5000,
    "replay_size": 50000,
    "time_limit": "terminal",  # not printed
}
PRINTED = {
    "trpo-lag": ON_POLICY | {"initial_multiplier": 0.001, "multiplier_lr": 0.005},
    "cpo": ON_POLICY,
    "sac-lag": OFF_POLICY | {"initial_multiplier": 0, "multiplier_lr": 3e-4},
    "sac-lb": OFF_POLICY | {"log_barrier_factor": 3},
    "wcsac": OFF_POLICY | {"risk_level": 0.5},
}


# Episodes per epoch in table HP_SafetyGymnasium.
SAFETY = {"SafetyPointCircle1-v0": 20, "SafetyPointGoal1-v0": 10, "SafetyHopperVelocity-v1": 10}
SAFETY = {f"circle2d_mj/{task}": episodes for task, episodes in SAFETY.items()}


@pytest.mark.parametrize("name", PAPER_ALGORITHMS)
@pytest.mark.parametrize("task", ["Circle2D-2-v0", *SAFETY])
def test_presets_are_the_papers(name, task):
    printed = SHARED | PRINTED[name]
    if task in SAFETY:
        printed |= {"cost_limit": 25}
    if task in SAFETY and "episodes" in printed:
        printed |= {"episodes": SAFETY[task]}
    elif task in SAFETY:
        printed |= {"random_steps": 50_000, "replay_size": 500_000, "time_limit": "bootstrap"}
    config = preset(name, task)
    for field, value in printed.items():
        assert getattr(config, field) == value, field


BASELINES = (
    "cppo-pid",
    "focops",
    "cup",
    "p3o",
    "ipo",
    "crpo",
    "pcpo",
    "c-trpo",
    "rcpo",
    "trpo-pid",
)


@pytest.mark.parametrize("name", [*BASELINES, "sac-pid", "cal"])
def test_presets_of_algorithms_that_the_paper_does_not_have(name):
    """The limits are those of the tasks, and all Safety tasks have the same hyper-parameters."""
    here = preset(name, "Circle2D-1-v0")
    assert here.cost_limit == 5.0
    assert here.time_limit == ("bootstrap" if name in BASELINES else "terminal")
    assert unprinted(name) is None
    tasks = ("PointGoal1-v0", "CarGoal1-v0", "PointButton1-v0", "PointPush1-v0")
    safety = {preset(name, f"circle2d_mj/Safety{task}") for task in tasks}
    assert len(safety | {preset(name, "circle2d_mj/SafetyHalfCheetahVelocity-v1")}) == 1
    assert safety.pop().cost_limit == 25.0


def test_presets_of_ppo_lag_and_sac_are_those_of_their_families():
    assert preset("ppo-lag", "Circle2D-1-v0").cost_limit == 5.0
    assert preset("ppo-lag", "circle2d_mj/SafetyPointCircle1-v0").episodes == 20
    assert preset("sac", "Circle2D-1-v0").time_limit == "terminal"
    assert preset("sac", "circle2d_mj/SafetyPointGoal1-v0").replay_size == 500_000


@pytest.fixture
def subclass():
    """A function that registers a copy of a built-in algorithm, with another config, as "mine"."""

    def register(name, config):
        agents.register("mine", ALGORITHMS[name]._replace(config=config))

    yield register
    algorithms._algorithms.registered.pop("mine", None)


def test_own_defaults_of_a_subclass_come_before_the_preset(subclass):
    @dataclass(frozen=True)
    class Mine(ALGORITHMS["sac-lb"].config):
        cost_limit: float = 3.0
        replay_size: int = 1000

    subclass("sac-lb", Mine)
    assert preset("mine", "Circle2D-1-v0") == Mine(time_limit="terminal")
    assert preset("mine", "circle2d_mj/SafetyPointGoal1-v0") == Mine(random_steps=50_000)


def test_the_preset_none_is_the_defaults(tmp_path):
    for name in PAPER_ALGORITHMS:
        assert preset(name, "Circle2D-1-v0", "none") == ALGORITHMS[name].config()
    with pytest.raises(UserError, match="no preset 'papr': did you mean 'paper'"):
        preset("cpo", "Circle2D-1-v0", "papr")
    few = {"seeds": 0, "steps": 50, "episodes": 1, "out": tmp_path / "runs"}
    runs = agents.train("cpo", preset="none", evaluation_episodes=1, **few)
    assert runs.config.hyperparameters.cost_limit == 25.0


def test_later_rules_come_before_earlier_ones(monkeypatch):
    rules = (
        Rule(["Walk-v0"], {"cost_limit": 1.0, "episodes": 3}),
        Rule(["Walk-v0"], {"cost_limit": 2.0}, "on-policy"),
        Rule(["Walk-v0"], {"cost_limit": 3.0}, "trpo-lag"),
        Rule(["Run-v0"], {"cost_limit": 4.0}),
    )
    monkeypatch.setitem(presets.PRESETS, "paper", rules)
    found = {name: preset(name, "Walk-v0").cost_limit for name in ("sac-lag", "cpo", "trpo-lag")}
    assert found == {"sac-lag": 1.0, "cpo": 2.0, "trpo-lag": 3.0}
    assert preset("rcpo", "Walk-v0").cost_limit == 3.0  # its config extends TRPO-Lag's
    assert preset("cpo", "Walk-v0").episodes == 3


def test_a_subclass_of_sac_lb_streak_has_its_preset(subclass):
    @dataclass(frozen=True)
    class Mine(ALGORITHMS["sac-lb-streak"].config):
        streak_weight: float = 2.0

    subclass("sac-lb-streak", Mine)
    for task in ("Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyPointGoal1-v0"):
        found = {of.name: getattr(preset("mine", task), of.name) for of in fields(Mine)}
        usual = preset("sac-lb-streak", task)
        assert found == {of: getattr(usual, of) for of in found} | {"streak_weight": 2.0}


def test_sac_lb_streak_is_sac_lb_but_for_some_values():
    """All levels and both modes have the same hyper-parameters; inputs are divided by lengths."""
    tasks = [f"Circle2D-{level}-v0" for level in range(4)] + ["Circle2DMuJoCo-0-v0"]
    changes = {"random_exponent": 2.0, "streak_weight": 0.25, "input_scale": 15.0}
    changes |= {"learning_rate": 1e-3, "temperature_lr": 1.5e-4, "batch_size": 128}
    changes |= {"gradient_steps": 10, "time_limit": "terminal_cost"}
    changes |= {"random_share": 0.25, "novelty_bonus": 1.0}
    for task in tasks:
        if "MuJoCo" in task:  # velocities are in units of .11 R = 1.1 per step
            changes = changes | {"input_scale": (15.0, 15.0, 1.1, 1.1)}
        found = asdict(preset("sac-lb-streak", task))
        assert found == asdict(preset("sac-lb", task)) | changes
    assert ALGORITHMS["sac-lb-streak"].rule is ALGORITHMS["sac-lb"].rule


def test_both_ids_of_a_safety_task_are_one_task():
    for name in ("SafetyPointCircle1-v0", "SafetyHopperVelocity-v1"):
        ours = f"circle2d_mj/{name}"
        for other in (name, f"circle2d_mj:{name}", f"circle2d_mj:{ours}"):
            assert usual_steps(other) == usual_steps(ours) == 10_000_000
            assert preset("cpo", other) == preset("cpo", ours)
            assert paper_results(other, "CPO") == paper_results(ours, "CPO") != {}


def test_on_other_tasks_observations_stay_as_they_are():
    for task in ("CartPole-v1", "circle2d_mj/SafetyPointGoal1-v0"):
        assert preset("sac-lb-streak", task).input_scale == 1.0


def test_the_papers_grid():
    tasks = papers.circle2d_tasks((0, 1, 2, 3), mujoco=False)
    algorithms = ["trpo-lag", "cpo", "sac-lag", "sac-lb", "wcsac"]
    configs = grid.grid(Path("x"), tasks, algorithms, papers.SEEDS)
    assert sum(len(config.runs) for config in configs.values()) == 60
    assert {(task, c.algorithm) for c in configs.values() for task in c.tasks} == {
        (task, name) for task in tasks for name in algorithms
    }
    for config in configs.values():
        assert config.hyperparameters == preset(config.algorithm, config.tasks[0])
        assert config.steps == 1_000_000
    # Four tasks with three runs each are one training; the longest trainings come first.
    assert [folder.name for folder in configs][-1] == "trpo-lag"
    assert len(configs) == 5


def test_alike_tasks_with_few_runs_are_one_training():
    tasks = papers.circle2d_tasks((0, 1), mujoco=False)
    assert list(grid.grid(Path("x"), tasks, ["cpo"], range(6))) == [Path("x/cpo")]
    apart = [Path("x") / task / "cpo" for task in tasks]
    assert list(grid.grid(Path("x"), tasks, ["cpo"], range(7))) == apart
    safety = "circle2d_mj/SafetyPointGoal1-v0"  # of another preset
    other = grid.grid(Path("x"), [tasks[0], safety], ["cpo"], (0,), 1000)
    assert set(other) == {apart[0], Path("x/circle2d_mj-SafetyPointGoal1-v0/cpo")}


def test_levels_must_be_given_and_keep_their_order():
    with pytest.raises(UserError, match="levels"):
        papers.circle2d_tasks((), mujoco=True)
    found = papers.circle2d_tasks((1, 0, 1), mujoco=True)
    assert found == ["Circle2DMuJoCo-1-v0", "Circle2DMuJoCo-0-v0"]


def test_shards_are_a_partition(tmp_path):
    tasks = papers.circle2d_tasks((0, 1), mujoco=False)
    whole = grid.grid(tmp_path, tasks, ["cpo", "sac-lb", "trpo-lag"], range(7), 1000)
    parts = [grid.shard(whole, part, 4) for part in (1, 2, 3, 4)]
    assert sorted(folder for part in parts for folder in part) == sorted(whole)
    assert [len(part) for part in parts] == [2, 2, 1, 1]
    assert {next(iter(part.values())).algorithm for part in parts[:2]} == {"sac-lb"}


def test_tasks_seeds_and_steps_of_the_benchmark():
    """Nine tasks; ten seeds on Circle2D, or five off-policy, and three on the others."""
    configs = papers.benchmark(Path("x"), papers.BENCHMARK, ["cpo", "cal"])
    counts = {(c.tasks[0], c.algorithm): (len(c.seeds), c.steps) for c in configs.values()}
    assert len(counts) == 18
    for (task, name), found in counts.items():
        few = 10 if name == "cpo" else 5
        assert found == (few if task.startswith("Circle2D") else 3, 1_000_000)
    quick = papers.benchmark(Path("x"), papers.BENCHMARK, ["cpo"], quick=True)
    assert {(len(c.seeds), c.steps) for c in quick.values()} == {(2, 10_000), (2, 30_000)}
