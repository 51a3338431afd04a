"""Other people's tasks: their action bounds, and costs that gymnasium would change on the way."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from small_runs import steps_of
from toys import registered

import agents
from agents.errors import UserError
from agents.training.environments import make_envs, spaces_of, task_id


class Other(gym.Env):
    """Actions in [0, 4]; the cost is the int 0 at first and then the action over ten."""

    observation_space = Box(-1.0, 1.0, (3,))
    action_space = Box(0.0, 4.0, (1,))

    def __init__(self):
        self.seen = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seen = []
        return np.zeros(3, np.float32), {}

    def step(self, action):
        self.seen.append(float(action[0]))
        cost = 0 if len(self.seen) == 1 else float(action[0]) / 10
        return np.zeros(3, np.float32), 0.0, False, len(self.seen) == 5, {"cost": cost}


def test_actions_are_rescaled_and_costs_stay_what_they_are():
    with registered(Other=Other):
        envs = make_envs("Other-v0", 2, {})
        assert spaces_of(["Other-v0"], {}).sizes == (3, 1)
    envs.reset(seed=[1, 2])
    assert envs.step(np.array([[0.0], [0.5]], np.float32))[4]["cost"].tolist() == [0.0, 0.0]
    costs = envs.step(np.array([[-1.0], [0.5]], np.float32))[4]["cost"]
    np.testing.assert_allclose(costs, [0.0, 0.3])  # actions 0 and 3
    np.testing.assert_allclose(envs.unwrapped.envs[1].unwrapped.seen, [3.0, 3.0])


@pytest.mark.parametrize(("low", "high"), [(-np.inf, np.inf), (1.0, 1.0)])
def test_actions_must_have_bounds(low, high):
    wide = type("Wide", (Other,), {"action_space": Box(low, high, (1,))})
    with registered(Wide=wide), pytest.raises(UserError, match="must have finite bounds"):
        make_envs("Wide-v0", 2, {})


def test_an_id_with_its_module():
    envs = make_envs("circle2d_mj:Circle2D-2-v0", 3, {})
    assert type(envs.unwrapped).__name__ == "Circle2DVectorEnv"
    with pytest.raises(UserError, match="cannot make task 'no_such:Circle2D-2-v0'"):
        task_id("no_such:Circle2D-2-v0")
    with pytest.raises(UserError, match=r"'no_such:Mine-v0' is not registered: .*--import no_such"):
        make_envs("no_such:Mine-v0", 3, {})


class InPlace(VectorEnv):
    """Episodes of five steps, with the reward t at step t; every step writes into the same arrays
    again. The positions are a part of the observations."""

    single_observation_space, single_action_space = Box(-9.0, 9.0, (2,)), Box(-1.0, 1.0, (1,))
    metadata = {"autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012

    class view:  # an attribute of the environment
        extent, axes = (-9.0, 9.0, -9.0, 9.0), ("x", "y")

        @staticmethod
        def positions(observation, info):
            return observation

        @staticmethod
        def places(positions):
            return []

    def __init__(self, num_envs=1, autoreset_mode=AutoresetMode.DISABLED):
        self.num_envs = num_envs
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.seen, self.reward = np.zeros((num_envs, 2), np.float32), np.zeros(num_envs)
        self.over, self.cost = np.zeros((2, num_envs), bool), np.zeros(num_envs)

    def reset(self, *, seed=None, options=None):
        self.seen[(options or {}).get("reset_mask", slice(None))] = 0.0
        return self.seen, {}

    def step(self, actions):
        self.seen[:, 0] += 1
        self.reward[:], self.cost[:] = self.seen[:, 0], self.seen[:, 0] % 2
        self.over[1] = self.seen[:, 0] == 5
        return self.seen, self.reward, *self.over, {"cost": self.cost}


def test_a_vector_environment_that_writes_into_its_arrays_again():
    with registered(InPlace=Other):
        gym.spec("InPlace-v0").vector_entry_point = InPlace
        more = {"seeds": 0, "steps": 10, "episodes": 2}
        runs = agents.train("ppo-lag", "InPlace-v0", **more)
        np.testing.assert_array_equal(runs.records[runs.folder, 0].reward, [15, 15])
        np.testing.assert_array_equal(runs.records[runs.folder, 0].cost, [3, 3])
        assert set(runs.to_pandas("evaluations")["return"]) == {15}
        positions = steps_of(runs.folder, "InPlace-v0/0", "positions")
        np.testing.assert_array_equal(positions[:, 0], [1, 2, 3, 4, 5] * 2)
