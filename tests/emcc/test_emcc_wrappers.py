"""RecordCosts on scripted environments, whose episodes are known, in every autoreset mode."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("gymnasium", minversion="1.1")

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from scripted import Scripted, TwoCosts
from written import rows

from emcc import EpisodeRecords, RecordCosts, StreakCost

SCRIPTS = ([[0.0, 1.0, 1.0], [2.0], [0.0, 1.0]], [[1.0, 1.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
NEXT, SAME, DISABLED = AutoresetMode


def vector(mode, kind=SyncVectorEnv, **options):
    makers = [partial(Scripted, script, **options) for script in SCRIPTS]
    return kind(makers, autoreset_mode=mode)


def play(envs, steps):
    envs.reset(seed=0)
    finished = np.zeros(2, bool)
    for _ in range(steps):
        if envs.metadata["autoreset_mode"] == DISABLED and finished.any():
            envs.reset(options={"reset_mask": finished})
        _, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
        finished = terminated | truncated


# Worked out by hand from SCRIPTS. Columns: rollout, start step, length, cost, longest streak.
EIGHT_STEPS = [(0, 0, 3, 2.0, 2), (1, 6, 1, 2.0, 1), (2, 0, 5, 4.0, 3)]
EIGHT_STEPS += [(3, 8, 2, 1.0, 1), (4, 10, 3, 1.0, 1)]
# Steps that only reset: 4, 6 and 9 of environment 0, 6 of environment 1.
NINE_STEPS_WITH_RESETS = [(0, 0, 3, 2.0, 2), (1, 7, 1, 2.0, 1), (2, 0, 5, 4.0, 3)]
NINE_STEPS_WITH_RESETS += [(3, 9, 2, 1.0, 1), (4, 9, 3, 1.0, 1)]
KNOWN = {  # steps of the vector environment, trajectories, environment steps
    NEXT: (9, NINE_STEPS_WITH_RESETS, 14),
    SAME: (8, EIGHT_STEPS, 16),
    DISABLED: (8, EIGHT_STEPS, 16),
}


@pytest.mark.parametrize("reset_cost", [True, False], ids=["reset_cost", "no_reset_cost"])
@pytest.mark.parametrize("kind", [SyncVectorEnv, AsyncVectorEnv])
@pytest.mark.parametrize("mode", KNOWN, ids=str)
def test_vector_environments(mode, kind, reset_cost):
    steps, expected, env_steps = KNOWN[mode]
    envs = RecordCosts(vector(mode, kind, reset_cost=reset_cost))
    assert isinstance(envs, gym.vector.VectorWrapper)
    play(envs, steps)
    envs.close()
    assert rows(envs) == expected
    assert envs.recorder.steps == env_steps
    assert envs.records.reward.tolist() == [0.5 * row[2] for row in expected]


def test_infos_in_a_list_are_refused_with_the_way_out():
    """DictInfoToList loses the mask of environments that gave a cost, unless it is outside."""
    lists = pytest.importorskip("gymnasium.wrappers.vector").DictInfoToList
    inside = RecordCosts(vector(SAME, SyncVectorEnv))
    play(lists(inside), 8)
    assert rows(inside) == EIGHT_STEPS
    with pytest.raises(TypeError, match=r"must be a dict, got a list: set DictInfoToList outside"):
        play(RecordCosts(lists(vector(SAME, SyncVectorEnv))), 1)


class Native(gym.vector.VectorEnv):
    """A native vector environment: info["cost"] has no mask, and there is no final_info."""

    num_envs = 2

    def __init__(self, mode):
        self.metadata = {"autoreset_mode": mode}
        self.at = np.zeros(2, int)

    def reset(self, *, seed=None, options=None):
        self.at[(options or {}).get("reset_mask", slice(None))] = 0
        return np.zeros(2), {}

    def step(self, actions):
        self.at += 1
        done = self.at == [2, 3]
        info = {"cost": np.array([1.0, 2.0])}
        if self.metadata["autoreset_mode"] in (SAME, SAME.value):
            self.at[done] = 0
        return np.zeros(2), np.zeros(2), done, np.zeros(2, bool), info


def test_native_vector_environments():
    envs = RecordCosts(Native(DISABLED))
    envs.reset()
    for _ in range(4):  # env 0 is done in step 2, env 1 in step 3; then nothing counts
        envs.step(None)
    assert envs.recorder.steps == 5
    envs.reset(options={"reset_mask": np.array([True, False])})
    envs.step(None)
    assert envs.recorder.steps == 6
    envs.end_rollout()
    assert rows(envs) == [(0, 0, 2, 2.0, 2), (1, 0, 3, 6.0, 3), (2, 5, 1, 1.0, 1)]
    for mode in (SAME, SAME.value):
        envs = RecordCosts(Native(mode))
        envs.reset()
        for _ in range(3):
            envs.step(None)
        assert rows(envs) == [(0, 0, 2, 2.0, 2), (1, 0, 3, 6.0, 3)]


def run_single(env, episodes=3):
    for _ in range(episodes):
        env.reset()
        while not any(env.step(0)[2:4]):
            pass
    return env


def test_single_environment():
    env = run_single(RecordCosts(Scripted(SCRIPTS[0])))
    assert isinstance(env, gym.Wrapper)
    assert isinstance(env.records, EpisodeRecords)
    assert rows(env) == [(0, 0, 3, 2.0, 2), (1, 3, 1, 2.0, 1), (2, 4, 2, 1.0, 1)]
    mcc_values, start_steps = env.records.mcc_per_rollout()
    assert mcc_values.tolist() == [2 / 3, 1.0, 1 / 2]  # the one-step episode has MCC 1
    assert start_steps.tolist() == [0, 3, 4]
    resets_itself = RecordCosts(gym.wrappers.Autoreset(Scripted(SCRIPTS[0])))
    resets_itself.reset()
    for _ in range(8):  # 3 steps, reset, 1 step, reset, 2 steps
        resets_itself.step(0)
    assert rows(resets_itself) == rows(env)


def test_a_reset_in_the_middle_of_an_episode_keeps_its_steps():
    env = RecordCosts(Scripted(SCRIPTS[1]))
    env.reset()
    for _ in range(3):
        env.step(0)
    env.reset()
    assert rows(env) == [(0, 0, 3, 3.0, 3)]
    envs = RecordCosts(vector(NEXT))
    envs.reset()
    envs.step([0, 0])
    envs.reset(options={"reset_mask": np.array([False, True])})
    assert rows(envs) == [(0, 0, 1, 1.0, 1)]


def test_the_spec_makes_the_same_wrapper_again():
    env = RecordCosts(StreakCost(gym.make("CartPole-v1"), 2.0), rollout=7)
    inner, outer = (wrapper.kwargs for wrapper in env.spec.additional_wrappers[-2:])
    assert inner == {"weight": 2.0, "scale": 10.0, "threshold": 0.0}
    assert outer == {"rollout": 7, "threshold": 0.0, "costs": ("cost",)}


def test_a_second_cost_has_its_own_records():
    costs = ("cost", "cost_2")
    env = run_single(RecordCosts(TwoCosts(Scripted(SCRIPTS[1])), costs=costs), episodes=2)
    assert env.records.longest_streak.tolist() == [3, 1]
    assert list(env.records_by_cost) == list(costs)
    assert env.records_by_cost["cost"].to_csv() == env.records.to_csv()
    assert env.records_by_cost["cost_2"].longest_streak.tolist() == [1, 2]
    makers = [lambda script=script: TwoCosts(Scripted(script)) for script in SCRIPTS]
    envs = RecordCosts(SyncVectorEnv(makers, autoreset_mode=SAME), costs=costs)
    play(envs, 8)
    envs.end_rollout()
    by_cost = envs.records_by_cost
    assert rows(envs)[: len(EIGHT_STEPS)] == EIGHT_STEPS
    assert by_cost["cost_2"].longest_streak.tolist()[:5] == [1, 0, 1, 1, 2]
    assert by_cost["cost_2"].start_step.tolist() == by_cost["cost"].start_step.tolist()


def test_costs_that_gymnasium_may_have_rounded_are_refused():
    whole, half = [[0, 0, 0]], [[0.5, 0.5, 0.5]]  # gymnasium makes both 0
    envs = RecordCosts(SyncVectorEnv([partial(Scripted, script) for script in (whole, half)]))
    envs.reset()
    with pytest.raises(TypeError, match=r"came as int64: .* return every cost as a float"):
        envs.step([0, 0])


def test_a_cost_may_be_an_array_of_one_number_but_not_of_two():
    scripts = [[[np.array([c]) for c in costs] for costs in script] for script in SCRIPTS]
    makers = [partial(Scripted, script, reset_cost=False) for script in scripts]
    envs = RecordCosts(SyncVectorEnv(makers))
    steps, expected, _ = KNOWN[NEXT]
    play(envs, steps)
    assert rows(envs) == expected
    maker = partial(Scripted, [[np.zeros(2), np.zeros(2)]], reset_cost=False)
    two = RecordCosts(SyncVectorEnv([maker, maker]))
    two.reset()
    with pytest.raises(TypeError, match=r"one number for each environment, got \(2, 2\)"):
        two.step([0, 0])


ONES = {
    "array of one": lambda x: np.array([x]),
    "0-d array": np.array,
    "numpy's bool": lambda x: np.bool_(x),
    "list": lambda x: [x],
    "float32": np.float32,
}
BITS = [[0.0, 1.0, 1.0], [1.0]]


class Boxed(gym.Wrapper):
    """Gives the cost, and if asked the reward and the ends, in another form of one number."""

    def __init__(self, kind, all_of_them=False):
        super().__init__(Scripted(BITS, reset_cost=False))
        self.kind, self.all = kind, all_of_them

    def step(self, action):
        observation, _, *ends, info = self.env.step(action)
        reward = self.kind(1.0) if self.all else 1.0
        ends = [self.kind(end) if self.all else end for end in ends]
        return observation, reward, *ends, {"cost": self.kind(info["cost"])}


@pytest.mark.parametrize("kind", ONES.values(), ids=ONES)
def test_one_number_is_one_number_in_any_form(kind):
    """Single and vector environments, with episodes of 3 and 1 steps."""
    single, both = RecordCosts(Boxed(kind, all_of_them=True)), [partial(Boxed, kind)] * 2
    several = RecordCosts(SyncVectorEnv(both, autoreset_mode=SAME))
    single.reset()
    several.reset()
    for step in range(4):
        if step == 3:
            single.reset()
        single.step(0)
        several.step([0, 0])
    assert rows(single) == [(0, 0, 3, 2.0, 2), (1, 3, 1, 1.0, 1)]
    assert single.records.reward.tolist() == [3.0, 1.0]
    assert several.records.cost.tolist() == [2.0, 2.0, 1.0, 1.0]


@pytest.mark.parametrize("end", [np.nan, "no", None, 2, np.zeros(2)])
def test_an_end_is_true_or_false(end):
    class Odd(gym.Wrapper):
        def step(self, action):
            return *self.env.step(action)[:2], end, False, {"cost": 1.0}

    for wrapper in (RecordCosts, StreakCost):
        env = wrapper(Odd(Scripted([[1.0]])))
        env.reset()
        with pytest.raises((TypeError, ValueError), match="terminated must be"):
            env.step(0)


def test_what_cannot_be_recorded_is_named():
    step = {"step": lambda self, action: (*self.env.step(action), "a sixth")}
    single, several = (
        type("Six", (base,), step) for base in (gym.Wrapper, gym.vector.VectorWrapper)
    )
    for six, action in ((single(Scripted(SCRIPTS[0])), 0), (several(vector(NEXT)), [0, 0])):
        six = RecordCosts(six)
        six.reset()
        with pytest.raises(ValueError, match=r"gymnasium's five values, got 6; .*CostRecorder"):
            six.step(action)
    for silent, action in (
        (Scripted(SCRIPTS[0], step_cost=False), 0),
        (vector(NEXT, step_cost=False), [0, 0]),
    ):
        silent = RecordCosts(silent)
        silent.reset()
        with pytest.raises(KeyError, match="the environment's info has no 'cost'"):
            silent.step(action)
    makers = [partial(Scripted, SCRIPTS[0], step_cost=give) for give in (True, False)]
    half_silent = RecordCosts(SyncVectorEnv(makers))
    half_silent.reset()
    with pytest.raises(ValueError, match="sub-environment 1 gave no 'cost'"):
        half_silent.step([0, 0])
    for costs in ("cost_2", (), ("cost", "cost")):
        with pytest.raises(ValueError, match="costs must be different names"):
            RecordCosts(Scripted(SCRIPTS[0]), costs=costs)
    with pytest.raises(ValueError, match=r"metadata\['autoreset_mode'\] must be .* got None"):
        RecordCosts(Native(None))
    with pytest.raises(TypeError, match="env must be a gymnasium Env or VectorEnv, got str"):
        RecordCosts("Circle2D-1-v0")  # pyright: ignore[reportArgumentType]
    for wrapper in (RecordCosts, StreakCost):
        env = wrapper(Scripted([[1.0]]))
        env.reset()
        env.step(0)
        with pytest.raises(RuntimeError, match="after its episode had ended: call reset"):
            env.step(0)
