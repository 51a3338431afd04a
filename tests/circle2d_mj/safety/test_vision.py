"""Tasks with a picture in the observation: spaces are the original's, numbers those of the flat
tasks, pictures those of the camera, and vector environments equal single ones."""

import copy
import importlib
import json
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from safety_golden import FOLDER

import agents
import circle2d_mj.safety_gymnasium as safety_gymnasium
from agents import UserError
from circle2d_mj.safety.envs import SafetyEnv, SafetyVectorEnv
from circle2d_mj.safety.tasks import NAMES, TASKS, VISION

pytestmark = [
    pytest.mark.usefixtures("opengl"),
    # Unbounded observations, and matrices among them, are the original's.
    pytest.mark.filterwarnings("ignore:.*A Box observation space"),
]
equal = np.testing.assert_array_equal
SPACES = json.loads((FOLDER / "vision_spaces.json").read_text())
"""Recorded from safety-gymnasium 1.0.0: [name, shape, type] of each part, in order."""
SMALL = (24, 16)


def assert_alike(mine, its):
    assert data_equivalence(mine, its, exact=True)


@pytest.mark.filterwarnings("ignore:.*For Box action spaces")  # the Racecar's
@pytest.mark.parametrize("name", [name for name in SPACES if name in VISION])
def test_spaces_are_the_originals(name):
    env = gym.make(f"circle2d_mj/{name}")
    spaces = env.observation_space.items()
    assert [[part, [*box.shape], str(box.dtype)] for part, box in spaces] == SPACES[name]
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("name", ["SafetyPointButton1", "SafetyCarGoal2", "SafetyDoggoPush1"])
def test_numbers_are_the_flat_tasks_and_the_picture_is_the_cameras(name):
    env = safety_gymnasium.make(f"{name}Vision-v0")
    flat = safety_gymnasium.make(f"{name}-v0", render_mode="rgb_array", camera_name="vision")
    seen, other = env.reset(seed=4)[0], flat.reset(seed=4)[0]
    env.action_space.seed(0)
    for _ in range(12):
        *numbers, picture = seen.values()
        equal(np.concatenate([part.ravel() for part in numbers]), other)
        equal(picture, flat.render())
        action = env.action_space.sample()
        (seen, *mine), (other, *its) = env.step(action), flat.step(action)
        assert mine == its
    assert env.task.observe_vision and not flat.task.observe_vision
    env.close(), flat.close()


def small(steps=6):
    return SafetyEnv("SafetyCarButton1", max_episode_steps=steps, vision_size=SMALL)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_the_vector_environment_equals_gymnasiums_own(mode):
    """Every value, also final observations, bit for bit."""
    native = SafetyVectorEnv(
        "SafetyCarButton1", 3, max_episode_steps=6, vision_size=SMALL, autoreset_mode=mode
    )
    sync = SyncVectorEnv([small] * 3, autoreset_mode=mode)
    assert native.observation_space == sync.observation_space
    assert_alike(native.reset(seed=3), sync.reset(seed=3))
    assert native.observation_space["vision"].shape == (3, 16, 24, 3)
    for _ in range(14):
        actions = native.action_space.sample()
        ours, theirs = native.step(actions), sync.step(actions)
        for mine, its in zip(ours[:4], theirs[:4], strict=True):
            assert_alike(mine, its)
        done = ours[2] | ours[3]
        if mode is AutoresetMode.SAME_STEP and done.any():
            assert_alike(list(ours[4]["final_obs"]), list(theirs[4]["final_obs"]))
        if mode is AutoresetMode.DISABLED and done.any():
            again = [e.reset(options={"reset_mask": done.copy()})[0] for e in (native, sync)]
            assert_alike(*again)
    native.close(), sync.close()


def test_copies_and_states_go_on_alike():
    env, new = (
        SafetyVectorEnv("SafetyPointGoal2", 2, max_episode_steps=8, vision_size=SMALL)
        for _ in range(2)
    )
    env.reset(seed=1)
    for _ in range(3):
        env.step(env.action_space.sample())
    new.load_state_dict(env.state_dict())
    twins = [env, new, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for _ in range(12):
        action = env.action_space.sample()
        first, *others = [twin.step(action) for twin in twins]
        for other in others:
            assert_alike(first, other)
    for twin in twins:
        twin.close()


def test_vector_environments_of_the_drop_in():
    arguments = {"num_envs": 2, "vision_size": SMALL}
    together = safety_gymnasium.vector.make("SafetyPointGoal1Vision-v0", **arguments)
    one_by_one = safety_gymnasium.vector.make(
        "SafetyPointGoal1Vision-v0", wrappers=lambda env: env, **arguments
    )
    assert_alike(together.reset(seed=0)[0], one_by_one.reset(seed=0)[0])
    action = together.action_space.sample()
    assert_alike(together.step(action)[:5], one_by_one.step(action)[:5])
    together.close(), one_by_one.close()
    five = gym.make("SafetyPointGoal1VisionGymnasium-v0", vision_size=SMALL)
    assert five.observation_space["vision"].shape == (16, 24, 3)


def test_every_navigation_task_has_a_vision_task():
    navigation = {name for name in TASKS if "Velocity" not in name}
    assert set(VISION) == {NAMES[name].replace("-", "Vision-") for name in navigation}
    for name in VISION:
        assert gym.spec(name).max_episode_steps == gym.spec(f"{VISION[name]}-v0").max_episode_steps


@pytest.mark.parametrize("size", [64, (64,), (64, 0), (64, 6.5), "ab"])
def test_bad_sizes_are_named(size):
    with pytest.raises((TypeError, ValueError), match="vision_size"):
        gym.make("SafetyPointGoal1-v0", vision_size=size)


def test_a_training_says_that_it_needs_flat_observations():
    with pytest.raises(UserError, match=r"Vision-v0' must be a flat Box.*SafetyPointGoal1-v0"):
        agents.train("cpo", "SafetyPointGoal1Vision-v0", steps=1000)


@pytest.mark.filterwarnings("ignore:Your action space has dtype float64")  # see `action_space`
def test_stable_baselines3_takes_it():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make("SafetyPointGoal1Vision-v0")
    checker.check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.filterwarnings("ignore")  # torchrl's own FutureWarnings
def test_torchrl_takes_it():
    envs = pytest.importorskip("torchrl.envs")
    env = envs.GymEnv("circle2d_mj/SafetyCarGoal1Vision-v0")
    env.auto_register_info_dict()
    importlib.import_module("torchrl.envs.utils").check_env_specs(env)
    assert env.rollout(3)["vision"].shape == (3, 256, 256, 3)
    env.close()
