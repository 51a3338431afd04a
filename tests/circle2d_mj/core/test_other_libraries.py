"""The tasks pass the environment checkers of Stable-Baselines3 and TorchRL."""

import warnings

import gymnasium as gym
import pytest

import emcc
from circle2d_mj.registration import CIRCLE2D, SAFETY
from circle2d_mj.safety.robots import AGENTS

IDS = [
    name
    for name in (*CIRCLE2D, *SAFETY)
    if "Velocity" in name or name.endswith(("1-v0", "Run0-v0"))
]
"""One level of each agent and family: all its levels have spaces of the same kind."""


@pytest.mark.parametrize("task", IDS)
def test_stable_baselines3(task):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make(task)
    with warnings.catch_warnings():
        if any(f"Safety{agent}" in task for agent in AGENTS):  # see `agents.action_space`
            warnings.filterwarnings("ignore", "Your action space has dtype float64")
        if "Humanoid" in task or "Racecar" in task:  # torques up to 0.4; rad/s and rad
            warnings.filterwarnings("ignore", "We recommend you to use a symmetric")
        checker.check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("task", IDS)
@pytest.mark.filterwarnings("ignore")  # torchrl's own FutureWarnings
def test_torchrl(task):
    envs = pytest.importorskip("torchrl.envs")
    from torchrl.envs.utils import check_env_specs

    env = envs.GymEnv(task)
    env.auto_register_info_dict()
    check_env_specs(env)
    batch = env.rollout(8)
    records = emcc.from_tensordict(batch)
    assert records.total_steps == 8
    assert records.cost.sum() == batch["next", "cost"].sum()
    env.close()
