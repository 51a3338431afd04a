"""Conversions between gymnasium's five values of a step and Safety-Gymnasium's six."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from circle2d_mj import Circle2DEnv, FromSafetyGymnasium, SafetyGymnasiumAPI


def old_box(bound, dtype):
    """Return a Box that is not gymnasium's, as of another package."""
    low, high = np.full(2, -bound, dtype), np.full(2, bound, dtype)
    return SimpleNamespace(low=low, high=high, shape=(2,), dtype=np.dtype(dtype))


class Six:
    """An environment like Safety-Gymnasium's, but no gymnasium.Env: the cost is 3 beyond 0.5.

    cost: given instead of that cost. result: given instead of all six values.
    """

    def __init__(self, cost=None, result=None, render_mode=None):
        self.observation_space = old_box(9.0, np.float64)
        self.action_space = old_box(1.0, np.float32)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
        self.render_mode, self.cost, self.result = render_mode, cost, result
        self.seeds, self.closed, self.options = [], False, None
        self.random = np.random.RandomState()

    def reset(self, *, seed=None, options=None):
        if seed is not None:
            self.seeds.append(seed)
            self.random = np.random.RandomState(seed)
        self.options = options
        self.position = self.random.uniform(-0.3, 0.3, 2)
        return self.position.copy(), {"start": True}

    def step(self, action):
        if self.result is not None:
            return self.result
        self.position = np.clip(self.position + 0.1 * np.asarray(action), -9, 9)
        cost = np.int64(3) * (self.position[0] > 0.5) if self.cost is None else self.cost
        return self.position.copy(), np.float64(1.5), cost, np.bool_(False), np.False_, {"more": 1}

    def render(self):
        return np.zeros((4, 4, 3), np.uint8)

    def close(self):
        self.closed = True


def test_five_values_of_an_environment_with_six():
    env = FromSafetyGymnasium(Six())
    assert isinstance(env, gym.Env)
    assert env.observation_space == gym.spaces.Box(-9.0, 9.0, (2,), np.float64)
    assert env.action_space == gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
    observation, info = env.reset(seed=4, options={"a": 1})
    assert info == {"start": True, "cost": 0.0}
    assert env.env.options == {"a": 1}
    for k in range(12):
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        expected = 3.0 if observation[0] + 0.1 * (k + 1) > 0.5 else 0.0
        assert info == {"more": 1, "cost": expected}
        kinds = [type(value) for value in (reward, terminated, truncated, info["cost"])]
        assert kinds == [float, bool, bool, np.float64]
    assert info["cost"] == 3.0
    assert env.render().shape == (4, 4, 3)
    env.close()
    assert env.env.closed


@pytest.mark.parametrize("options", [{}, {"reset_on_cost": True}])
def test_six_values_and_back(options):
    """An environment of this package, to a termination or a truncation, as six values; converted
    back, it is what it was."""
    own, six, back = (Circle2DEnv(level=1, **options) for _ in range(3))
    six, back, over = SafetyGymnasiumAPI(six), FromSafetyGymnasium(SafetyGymnasiumAPI(back)), False
    assert isinstance(six, gym.Wrapper)
    assert back.observation_space is back.env.observation_space
    six.reset(seed=3)
    assert data_equivalence(back.reset(seed=3), own.reset(seed=3), exact=True)
    while not over:
        expected = own.step([-1.0, 0.2])
        assert data_equivalence(back.step([-1.0, 0.2]), expected, exact=True)
        *values, terminated, truncated, info = expected
        expected_six = (*values, info["cost"], terminated, truncated, info)
        assert data_equivalence(six.step([-1.0, 0.2]), expected_six, exact=True)
        over = terminated or truncated
    assert (terminated, truncated) == (bool(options), not options)


def test_seeds_beyond_32_bits_are_hashed():
    env = FromSafetyGymnasium(Six())
    large = 2**63 + 11
    for seed in (0, 2**32 - 1, 2**32, large):
        env.reset(seed=seed)
    env.reset()
    small = [int(np.random.SeedSequence(s).generate_state(1)[0]) for s in (2**32, large)]
    assert env.env.seeds == [0, 2**32 - 1, *small]
    first = env.reset(seed=large)[0]
    env.reset(seed=large + 1)
    np.testing.assert_array_equal(env.reset(seed=large)[0], first)


NO_NUMBER = (TypeError, r"the cost from .*Six.* must be a number, got ")
ODD = [
    ({"result": (0, 0.0, False, False, {})}, ValueError, "step of .*Six.* 6 values, got 5 values"),
    ({"result": [0] * 6}, ValueError, "step of .* must return 6 values, got list"),
    ({"result": 1.5}, ValueError, "got float"),
    *(({"cost": cost}, *NO_NUMBER) for cost in ("high", [1.0])),
]


@pytest.mark.parametrize(("how", "error", "message"), ODD)
def test_results_that_are_not_six_values_are_named(how, error, message):
    env = FromSafetyGymnasium(Six(**how))
    env.reset(seed=0)
    with pytest.raises(error, match=message):
        env.step(np.zeros(2))


def test_a_reset_without_info_is_named():
    six = Six()
    six.reset = lambda **kwargs: np.zeros(2)
    with pytest.raises(ValueError, match=r"reset of .* must return 2 values, got ndarray"):
        FromSafetyGymnasium(six).reset(seed=0)


class Rare(gym.Env):
    """Episodes of two steps with the costs 0.25 and 2; the info of a reset holds no cost."""

    observation_space = action_space = gym.spaces.Box(-1, 1, (1,))
    silent = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        info = {} if self.silent else {"cost": (0.25, 2.0)[self.steps - 1]}
        return np.zeros(1, np.float32), 0.0, self.steps == 2, False, info


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (gym.vector.AutoresetMode.SAME_STEP, [0.25, 2.0, 0.25, 2.0]),
        (gym.vector.AutoresetMode.NEXT_STEP, [0.25, 2.0, 0.0, 0.25, 2.0, 0.0]),
    ],
)
def test_six_values_of_gymnasiums_vector_environments(mode, expected):
    """The reset neither hides the cost of an episode's last step nor needs a cost itself."""
    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Rare, Rare], autoreset_mode=mode))
    envs.reset(seed=0)
    steps = [envs.step(np.zeros((2, 1), np.float32)) for _ in expected]
    costs = np.array([cost for _, _, cost, *_ in steps])
    np.testing.assert_array_equal(costs, np.array([expected] * 2).T)
    terminated = np.array([terminated for *_, terminated, _, _ in steps])
    np.testing.assert_array_equal(terminated, costs == 2.0)
    assert not any(truncated.any() for *_, truncated, _ in steps)


class Silent(Rare):
    silent = True


class Whole(Rare):
    def step(self, action):
        *others, info = super().step(action)
        return *others, {"cost": int(info["cost"])}


@pytest.mark.parametrize(
    ("kinds", "error", "message"),
    [
        ([Silent], KeyError, "info has no 'cost'"),
        ([Rare, Silent], KeyError, "sub-environment 1 gave no 'cost'"),
        # Gymnasium turns 0 and 0.25 into 0 and 0.
        ([Whole, Rare], TypeError, r"came as int64: .* return every cost as a float"),
    ],
)
def test_missing_and_rounded_costs_of_vector_environments_are_named(kinds, error, message):
    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv(kinds))
    envs.reset(seed=0)
    with pytest.raises(error, match=message):
        envs.step(np.zeros((len(kinds), 1), np.float32))


def test_single_environments_without_a_cost_and_other_objects_are_named():
    with pytest.raises(TypeError, match="env must be a gymnasium Env or VectorEnv, got 'Circle2D'"):
        SafetyGymnasiumAPI("Circle2D")
    env = SafetyGymnasiumAPI(Silent())
    env.reset(seed=0)
    with pytest.raises(KeyError, match="info has no 'cost'"):
        env.step(0)


def test_discrete_spaces_are_converted_and_unknown_ones_named():
    six = Six()
    six.action_space = SimpleNamespace(n=5)
    assert FromSafetyGymnasium(six).action_space == gym.spaces.Discrete(5)
    six.action_space = {"left": 1}
    with pytest.raises(TypeError, match=r"must be a Box or Discrete, got \{'left': 1\}"):
        FromSafetyGymnasium(six)
    with pytest.raises(TypeError, match=r"'Goal' has no reset, step, observation_space"):
        FromSafetyGymnasium("Goal")
