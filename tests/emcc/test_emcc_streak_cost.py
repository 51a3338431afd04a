"""The wrapper StreakCost against a plain loop over scripted episodes, in every autoreset mode."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("gymnasium", minversion="1.1")

import gymnasium as gym
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from scripted import Scripted, follow

from emcc import RecordCosts, StreakCost
from emcc.streak_cost import weighted

WEIGHT, SCALE = 0.5, 4.0
SCRIPTS = (
    [[0.0, 1.0, 1.0, 2.0], [2.0], [1.0, 0.0, 1.0]],
    [[1.0, 1.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
)
NEXT, SAME, DISABLED = AutoresetMode


def expected(script):
    """Return (weighted cost, cost, streak) after each step of each episode, by a plain loop."""
    episodes = []
    for costs in script:
        streak, rows = 0, []
        for cost in costs:
            streak = streak + 1 if cost > 0 else 0
            rows.append((cost * (1 + WEIGHT * (streak - 1)) if streak else 0.0, cost, streak))
        episodes.append(rows)
    return episodes


def test_a_streak_of_eight_by_hand():
    """1 + 2 + ... + 8 = 36 with weight 1; eight separate steps cost 8; weight 0 changes nothing."""
    assert weighted(np.ones(8), np.arange(1, 9), 1.0).sum() == 36
    assert weighted(np.ones(8), np.ones(8), 1.0).sum() == 8
    assert weighted([3.0, 0.0], [5, 0], 0.0).tolist() == [3.0, 0.0]
    assert weighted(2.0, 3, 0.25) == 2.0 * 1.5


def test_one_environment():
    env = StreakCost(Scripted(SCRIPTS[0]), WEIGHT, scale=SCALE)
    for episode, rows in enumerate(expected(SCRIPTS[0])):
        observation, _ = env.reset()
        assert observation.tolist() == [episode, 0, 0]
        for at, (cost, plain, streak) in enumerate(rows, 1):
            observation, _, *ends, info = env.step(0)
            assert observation.tolist() == [episode, at, streak / SCALE]
            assert (info["cost"], info["plain_cost"]) == (cost, plain)
            assert observation in env.observation_space
        assert any(ends)


@pytest.mark.parametrize("at_reset", [{}, {"cost": 9.0}])
def test_a_resetting_step_costs_nothing_and_ends_the_streak(at_reset, monkeypatch):
    """The first episode ends in a streak of 3, the second is a streak of 1."""
    reset = Scripted.reset
    monkeypatch.setattr(Scripted, "reset", lambda env, **options: (reset(env)[0], at_reset))
    env = StreakCost(gym.wrappers.Autoreset(Scripted(SCRIPTS[0])), WEIGHT, scale=SCALE)
    env.reset()
    seen = [env.step(0) for _ in range(7)]
    costs = [(info["cost"], info["plain_cost"]) for *_, info in seen]
    assert costs == [(0, 0), (1, 1), (1.5, 1), (4, 2), (0, 0), (2, 2), (0, 0)]
    assert [of[0][2] * SCALE for of in seen] == [0, 1, 2, 3, 0, 1, 0]


@pytest.mark.parametrize("mode", AutoresetMode)
def test_vector_environments(mode):
    envs = SyncVectorEnv([partial(Scripted, script) for script in SCRIPTS], autoreset_mode=mode)
    envs = StreakCost(envs, WEIGHT, scale=SCALE)
    observations, _ = envs.reset(seed=0)
    assert observations.shape == (2, 3)
    rows = [
        [[((cost, plain), (k / SCALE,)) for cost, plain, k in steps] for steps in episodes]
        for episodes in map(expected, SCRIPTS)
    ]
    follow(envs, rows, ("cost", "plain_cost"))


def test_a_reset_of_one_environment_keeps_the_streak_of_another():
    scripts = [[[1.0], [1.0]], [[1.0] * 4]]
    envs = SyncVectorEnv([partial(Scripted, of) for of in scripts], autoreset_mode=DISABLED)
    envs = StreakCost(envs, WEIGHT, scale=SCALE)
    envs.reset()
    envs.step(np.zeros(2, int))
    observations, _ = envs.reset(options={"reset_mask": np.array([True, False])})
    assert (observations[:, 2] * SCALE).tolist() == [0, 1]
    assert envs.step(np.zeros(2, int))[4]["cost"].tolist() == [1, 1 + WEIGHT]


def test_plain_costs_are_recorded_inside_and_outside():
    inner = RecordCosts(Scripted(SCRIPTS[0]))
    env = RecordCosts(StreakCost(inner, WEIGHT))
    env.reset()
    for _ in range(4):
        env.step(0)
    for records in (inner.records, env.records):
        assert (records.cost.tolist(), records.longest_streak.tolist()) == ([4.0], [3])
    for mode in (NEXT, SAME):
        envs = SyncVectorEnv([partial(Scripted, script) for script in SCRIPTS], autoreset_mode=mode)
        envs = RecordCosts(StreakCost(envs, WEIGHT))
        envs.reset()
        for _ in range(6):
            envs.step(np.zeros(2, int))
        # The first episode of each environment, and the second of the first, which has one step.
        assert sorted(envs.records.cost.tolist()) == [2.0, 4.0, 4.0]


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.filterwarnings("ignore:.*maximum value is infinity")  # as in tasks of MuJoCo
def test_gymnasium_accepts_it():
    env = pytest.importorskip("circle2d_mj").Circle2DEnv()
    check_env(StreakCost(env), skip_render_check=True)


BAD = {
    "env": (lambda: StreakCost(3), TypeError, "env must be a gymnasium"),
    "weight": (lambda: StreakCost(Scripted([]), -1.0), ValueError, "weight must be >= 0, got -1"),
    "scale": (lambda: StreakCost(Scripted([]), scale=0), ValueError, "scale must be above 0"),
    "integers": (lambda: StreakCost(Whole([])), TypeError, "Box of floats .*, got Box.*int64"),
    "no cost": (
        lambda: stepped(StreakCost(Scripted([[0]], step_cost=False))),
        KeyError,
        "no 'cost'",
    ),
    "NaN": (lambda: stepped(StreakCost(Scripted([[np.nan]]))), ValueError, "cost must be finite"),
}


class Whole(Scripted):
    observation_space = gym.spaces.Box(0, 9, (2,), np.int64)


def stepped(env):
    env.reset()
    env.step(0)


@pytest.mark.parametrize(("call", "error", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()
