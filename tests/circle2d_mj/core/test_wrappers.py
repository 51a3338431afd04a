"""Both ways between gymnasium's five values of a step and Safety-Gymnasium's six."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence

from agents.training.environments import is_native, make_envs
from circle2d_mj import Circle2DEnv, Circle2DVectorEnv, FromSafetyGymnasium, SafetyGymnasiumAPI


class OldBox:
    """A Box of no package that gymnasium knows."""

    def __init__(self, low, high, shape, dtype):
        self.low, self.high = np.full(shape, low, dtype), np.full(shape, high, dtype)
        self.shape, self.dtype = shape, np.dtype(dtype)


class OldDiscrete:
    def __init__(self, n):
        self.n = n


class Six:
    """As Safety-Gymnasium's, but no gymnasium.Env: random walks, the cost is 3 beyond 0.5."""

    def __init__(self, cost=None, result=None, render_mode=None):
        self.observation_space = OldBox(-9.0, 9.0, (2,), np.float64)
        self.action_space = OldBox(-1.0, 1.0, (2,), np.float32)
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


def test_values():
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
def test_there_and_back(options):
    """Our own environment through six values and back is what it was, to its end of either kind."""
    env = FromSafetyGymnasium(SafetyGymnasiumAPI(Circle2DEnv(level=1, **options)))
    own, over = Circle2DEnv(level=1, **options), False
    assert env.observation_space is env.env.observation_space
    assert data_equivalence(env.reset(seed=3), own.reset(seed=3), exact=True)
    while not over:
        expected = own.step([-1.0, 0.2])
        assert data_equivalence(env.step([-1.0, 0.2]), expected, exact=True)
        over = expected[2] or expected[3]
    assert expected[2] == bool(options)


def test_seeds():
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
    *(({"cost": cost}, *NO_NUMBER) for cost in ("high", [1.0], {"cost": 1.0})),
]


@pytest.mark.parametrize(("how", "error", "message"), ODD)
def test_results_that_are_not_six_values(how, error, message):
    env = FromSafetyGymnasium(Six(**how))
    env.reset(seed=0)
    with pytest.raises(error, match=message):
        env.step(np.zeros(2))


def test_reset_of_an_old_interface():
    six = Six()
    six.reset = lambda **kwargs: np.zeros(2)
    with pytest.raises(ValueError, match=r"reset of .* must return 2 values, got ndarray"):
        FromSafetyGymnasium(six).reset(seed=0)


def test_training_takes_them():
    gym.register(
        "Six-v0", entry_point=lambda **kw: FromSafetyGymnasium(Six(**kw)), max_episode_steps=9
    )
    try:
        assert not is_native("Six-v0")
        envs = make_envs("Six-v0", 2, {})
        envs.reset(seed=[2**63, 1])
        for _ in range(9):
            *_, truncated, info = envs.step(np.full((2, 2), 1.0, np.float32))
        assert truncated.all()
        np.testing.assert_array_equal(info["cost"], [3.0, 3.0])
    finally:
        del gym.registry["Six-v0"]
    assert is_native("circle2d_mj/SafetyPointGoal1-v0")
    envs = make_envs("circle2d_mj/SafetyPointGoal1-v0", 3, {"num_threads": 2})
    assert envs.unwrapped.simulation.num_threads == 2


def test_six_values():
    env = SafetyGymnasiumAPI(Circle2DEnv(level=1))
    assert isinstance(env, gym.Wrapper)
    env.reset(seed=0)
    cost = 0.0
    for _ in range(20):
        observation, reward, step_cost, terminated, truncated, info = env.step([-1.0, 0.0])
        assert step_cost == info["cost"]
        assert observation.shape == (2,)
        assert (type(reward), terminated, truncated) == (float, False, False)
        cost += step_cost
    assert cost >= 9
    ends = [env.step([0.0, 0.0])[3:5] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]  # terminated, truncated
    env = SafetyGymnasiumAPI(Circle2DEnv(level=1, reset_on_cost=True))
    env.reset(seed=0)
    ends = [env.step([-1.0, 0.0])[3:5] for _ in range(20)]
    assert (True, False) in ends
    assert (False, True) not in ends
    envs = SafetyGymnasiumAPI(Circle2DVectorEnv(3, level=1))
    assert isinstance(envs, gym.vector.VectorWrapper)
    envs.reset(seed=0)
    values = envs.step(np.zeros((3, 2)))
    assert len(values) == 6
    np.testing.assert_array_equal(values[2], np.zeros(3))


class Rare(gym.Env):
    """Episodes of two steps at costs of 0.25 and 2; the info of a reset holds no cost."""

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
    """The cost of an episode's last step is neither lost to the reset nor asked of it."""
    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Rare, Rare], autoreset_mode=mode))
    envs.reset(seed=0)
    steps = [envs.step(np.zeros((2, 1), np.float32)) for _ in expected]
    costs = np.array([cost for _, _, cost, *_ in steps])
    np.testing.assert_array_equal(costs, np.array([expected] * 2).T)
    terminated = np.array([terminated for *_, terminated, _, _ in steps])
    np.testing.assert_array_equal(terminated, costs == 2.0)
    assert not any(truncated.any() for *_, truncated, _ in steps)


def test_six_values_where_one_environment_gives_no_cost():
    class Silent(Rare):
        silent = True

    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Rare, Silent]))
    envs.reset(seed=0)
    with pytest.raises(KeyError, match="sub-environment 1 gave no 'cost'"):
        envs.step(np.zeros((2, 1), np.float32))


def test_six_values_of_costs_that_gymnasium_may_have_rounded():
    class Whole(Rare):
        def step(self, action):
            *others, info = super().step(action)
            return *others, {"cost": int(info["cost"])}

    envs = SafetyGymnasiumAPI(gym.vector.SyncVectorEnv([Whole, Rare]))  # 0 and 0.25 become 0 and 0
    envs.reset(seed=0)
    with pytest.raises(TypeError, match=r"came as int64: .* let every one give a float"):
        envs.step(np.zeros((2, 1), np.float32))


def test_six_values_of_something_else():
    with pytest.raises(TypeError, match="env must be a gymnasium Env or VectorEnv, got 'Circle2D'"):
        SafetyGymnasiumAPI("Circle2D")
    env = SafetyGymnasiumAPI(gym.make("CartPole-v1"))
    env.reset(seed=0)
    with pytest.raises(KeyError, match="info has no 'cost'"):
        env.step(0)


def test_spaces_of_other_kinds():
    six = Six()
    six.action_space = OldDiscrete(5)
    assert FromSafetyGymnasium(six).action_space == gym.spaces.Discrete(5)
    six.action_space = {"left": 1}
    with pytest.raises(TypeError, match=r"must be a Box or Discrete, got \{'left': 1\}"):
        FromSafetyGymnasium(six)
    with pytest.raises(TypeError, match=r"'Goal' has no reset, step, observation_space"):
        FromSafetyGymnasium("Goal")
