"""Record costs against the longest streak and CVaR; the wrapper LongestStreak against a plain loop
over scripted episodes, in every autoreset mode."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest

pytest.importorskip("gymnasium", minversion="1.1")

import gymnasium as gym
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given
from hypothesis import strategies as st
from scripted import Noisy, Scripted, TwoCosts, follow

from emcc import LongestStreak, RecordCosts, StreakCost, cvar, longest_streaks, streaks
from emcc.streaks import record

SCRIPTS = (
    [[0.0, 1.0, 1.0, 0.0, 2.0, 1.0, 1.0], [2.0], [1.0, 0.0, 1.0]],
    [[1.0, 1.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0]],
)
SCALE = 4.0


def expected(script, above=0):
    """Return (record cost, k, m) after each step of each episode, computed by a plain loop."""
    episodes = []
    for costs in script:
        streak, longest, rows = 0, 0, []
        for cost in costs:
            streak = streak + 1 if cost > 0 else 0
            broken = streak > longest and streak > above
            longest = max(longest, streak)
            rows.append((float(broken), streak, longest))
        episodes.append(rows)
    return episodes


def test_record_costs_by_hand():
    costs = [0, 1, 1, 0, 2, 1, 1, 0, 1]
    assert record(costs).tolist() == [0, 1, 1, 0, 0, 0, 1, 0, 0]
    assert record(costs, above=2).tolist() == [0, 0, 0, 0, 0, 0, 1, 0, 0]
    assert record(costs, threshold=1.5).tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0]
    assert record([1, 1, 1, 1], lengths=[3, 1]).tolist() == [1, 1, 1, 1]


trajectories = st.lists(
    st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=1, max_size=30), min_size=1, max_size=20
)


@given(trajectories, st.integers(0, 6), st.integers(1, 9))
def test_record_costs_add_up_to_the_longest_streak(costs, above, block):
    """They are also those of the plain loop in each step, whatever the size of blocks."""
    lengths = [len(own) for own in costs]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streaks, "_BLOCK", block)
        found = record(np.concatenate(costs), lengths, above)
    sums = np.add.reduceat(found, np.cumsum([0, *lengths[:-1]]))
    excess = longest_streaks(np.concatenate(costs), lengths) - above
    assert sums.tolist() == np.maximum(excess, 0).tolist()
    assert found.tolist() == [row[0] for rows in expected(costs, above) for row in rows]


@given(trajectories, st.integers(1, 20))
def test_the_minimum_over_above_is_cvar_and_the_quantile_attains_it(costs, parts):
    """Rockafellar & Uryasev 2000, theorem 1, for α = parts / 20."""
    alpha, count = Fraction(parts, 20), len(costs)
    longest = [int(longest_streaks(own, [len(own)])[0]) for own in costs]

    def bound(above):
        total = sum(record(own, above=above).sum() for own in costs)
        return above + Fraction(int(total), count) / alpha

    least = min(map(bound, range(max(longest) + 1)))
    assert cvar(longest, float(alpha), ties="split") == pytest.approx(float(least))
    quantile = sorted(longest)[-(-(1 - alpha) * count // 1) - 1] if alpha < 1 else 0
    assert bound(quantile) == least


@pytest.mark.parametrize("above", [0, 2])
def test_one_environment(above):
    env = LongestStreak(Scripted(SCRIPTS[0]), above, scale=SCALE)
    for episode, rows in enumerate(expected(SCRIPTS[0], above)):
        observation, _ = env.reset()
        assert observation.tolist() == [episode, 0, 0, 0]
        for at, (cost, streak, longest) in enumerate(rows, 1):
            observation, _, *ends, info = env.step(0)
            assert observation.tolist() == [episode, at, streak / SCALE, longest / SCALE]
            assert (info["record_cost"], info["longest_streak"]) == (cost, longest)
            assert info["cost"] == SCRIPTS[0][episode][at - 1]
            assert observation in env.observation_space
        assert any(ends)


def test_a_resetting_step_has_no_record_cost():
    """The longest streak is 2 in the first episode and 1 in the second."""
    env = LongestStreak(gym.wrappers.Autoreset(Scripted([[0.0, 1.0, 1.0], [1.0, 0.0]])))
    env.reset()
    seen = [env.step(0)[4] for _ in range(7)]
    assert [info["record_cost"] for info in seen] == [0, 1, 1, 0, 1, 0, 0]
    assert [info["longest_streak"] for info in seen] == [0, 1, 2, 0, 1, 1, 0]


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("above", [0, 1])
def test_vector_environments(mode, above):
    envs = SyncVectorEnv([partial(Scripted, script) for script in SCRIPTS], autoreset_mode=mode)
    envs = LongestStreak(envs, above, scale=SCALE)
    assert envs.single_observation_space.shape == (4,)
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    rows = [
        [[((cost, m), (k / SCALE, m / SCALE)) for cost, k, m in steps] for steps in episodes]
        for episodes in (expected(script, above) for script in SCRIPTS)
    ]
    info = follow(envs, rows, ("record_cost", "longest_streak"))
    assert info["longest_streak"].dtype == np.int64


def test_several_costs():
    """RecordCosts records record costs like any cost; inside of StreakCost, the cost is plain."""
    other = [[[float(cost == 0) for cost in costs] for costs in script] for script in SCRIPTS]
    env = LongestStreak(LongestStreak(TwoCosts(Scripted(SCRIPTS[0]))), cost="cost_2", observe=False)
    env = RecordCosts(StreakCost(env, 3.0), costs=("cost", "record_cost", "record_cost_2"))
    names = ("record_cost", "longest_streak", "record_cost_2", "longest_streak_cost_2")
    pairs = zip(expected(SCRIPTS[0]), expected(other[0]), strict=True)
    for first, second in pairs:
        assert env.reset()[0].shape == (5,)  # k and m of one wrapper, k of StreakCost
        for a, b in zip(first, second, strict=True):
            info = env.step(0)[4]
            assert [info[name] for name in names] == [a[0], a[2], b[0], b[2]]
    sums = {name: env.records_by_cost[name].cost.tolist() for name in names[::2]}
    assert sums == {"record_cost": [3, 1, 1], "record_cost_2": [1, 0, 1]}


def test_stable_baselines3():
    """In its vector environments, which reset in an episode's last step; its checker accepts it."""
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_checker import check_env as check
    from stable_baselines3.common.vec_env import DummyVecEnv

    logs = [[], []]
    check(LongestStreak(Noisy([])))

    class Sums(BaseCallback):
        """Record costs of each finished episode."""

        def _on_training_start(self):
            self.sums, self.found = np.zeros(2), []

        def _on_step(self):
            for k, info in enumerate(self.locals["infos"]):
                self.sums[k] += info["record_cost"]
                if self.locals["dones"][k]:
                    assert info["longest_streak"] == self.sums[k]
                    self.found.append((k, self.sums[k]))
                    self.sums[k] = 0
            return True

    makers = [lambda k=k: LongestStreak(Noisy(logs[k], k)) for k in range(2)]
    callback, model = Sums(), PPO("MlpPolicy", DummyVecEnv(makers), n_steps=64, device="cpu")
    model.learn(256, callback)
    for k, log in enumerate(logs):
        ends = np.flatnonzero([row[3] for row in log])
        lengths, costs = np.diff(ends, prepend=-1), [row[1] for row in log][: ends[-1] + 1]
        assert [s for i, s in callback.found if i == k] == longest_streaks(costs, lengths).tolist()


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.filterwarnings("ignore:.*maximum value is infinity")  # as in tasks of MuJoCo
def test_gymnasium_accepts_it():
    env = pytest.importorskip("circle2d_mj").Circle2DEnv()
    check_env(LongestStreak(env), skip_render_check=True)


def test_the_spec_makes_the_same_wrapper_again():
    env = LongestStreak(gym.make("CartPole-v1"), 3, threshold=0.5)
    kwargs = {"above": 3, "cost": "cost", "scale": 20.0, "threshold": 0.5}
    assert env.spec.additional_wrappers[-1].kwargs == kwargs
    assert gym.make(env.spec).observation_space.shape == (6,)


BAD = {
    "env": (lambda: LongestStreak(3), TypeError, "env must be a gymnasium"),
    "above": (lambda: LongestStreak(Scripted([]), 1.5), ValueError, "above must be whole numbers"),
    "below 0": (lambda: record([1], above=-1), ValueError, "above must be finite and >= 0, got -1"),
    "scale": (lambda: LongestStreak(Scripted([]), scale=0), ValueError, "scale must be above 0"),
    "cost": (lambda: LongestStreak(Scripted([]), cost=1), TypeError, "cost must be a key of info"),
    "no cost": (
        lambda: stepped(LongestStreak(Scripted([[0.0]]), cost="cost_2")),
        KeyError,
        "no 'cost_2'",
    ),
    "NaN": (
        lambda: stepped(LongestStreak(Scripted([[np.nan]]))),
        ValueError,
        "cost must be finite",
    ),
}


def stepped(env):
    env.reset()
    env.step(0)


@pytest.mark.parametrize(("call", "error", "message"), BAD.values(), ids=BAD)
def test_bad_input_is_named(call, error, message):
    with pytest.raises(error, match=message):
        call()
