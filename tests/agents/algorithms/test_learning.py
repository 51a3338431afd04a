"""Every algorithm on a problem with a known constrained optimum, and TRPO-Lag on Circle2D-1."""

from dataclasses import replace

import numpy as np
import pytest
from small_trainings import finished, trainer
from toys import register

from agents.algorithms import algorithm
from agents.lockstep.noise import Purpose, steps_of_noise, uniform
from agents.lockstep.rollout import collect
from agents.presets import preset
from agents.sac import OffPolicy
from agents.training.config import TrainConfig
from agents.training.environments import make_envs

pytestmark = pytest.mark.slow

register()
LIMIT = 0.6
SHARED = {"cost_limit": LIMIT, "learning_rate": 3e-3, "batch_size": 64, "hidden": (32, 32)}
# An epoch has one step off-policy and 64 on-policy. The reward's noise keeps the multiplier of
# TRPO-Lag bounded: without it the slope of its standardised advantages would grow as the policy's
# standard deviation falls.
EPISODES = {"episodes": 64, "critic_iterations": 2}
SGD = EPISODES | {"multiplier_lr": 0.5, "multiplier_optimizer": "sgd"}
BOUNDED = EPISODES | {"multiplier_lr": 0.5, "max_multiplier": 10.0, "initial_log_std": 0.0}
BOUNDED |= {"limit_of": "discounted"}  # the task has no time limit
SAUTE = EPISODES | {"saute_discount": 1.0, "initial_log_std": -1.5}
SETTINGS = {  # steps, settings, the reward's noise
    "trpo-lag": (6400, SGD, 1.0),
    "ppo-lag": (6400, SGD, 1.0),
    "cpo": (3200, EPISODES, 0.1),
    "sac-lag": (1200, {"multiplier_lr": 1e-2}, 0.0),
    "sac-lb": (1200, {}, 0.0),
    "wcsac": (1200, {"multiplier_lr": 1e-2}, 0.0),
    "cppo-pid": (4000, EPISODES | {"pid_kp": 1.0, "pid_ki": 0.5}, 1.0),
    "trpo-pid": (4000, EPISODES | {"pid_kp": 1.0, "pid_ki": 0.5}, 1.0),
    "focops": (6400, BOUNDED, 1.0),
    "cup": (4000, BOUNDED, 1.0),
    "p3o": (6400, EPISODES | {"discount": 0.0}, 1.0),
    "ipo": (6400, EPISODES | {"max_penalty": 10.0}, 1.0),
    "crpo": (4000, EPISODES | {"tolerance": 0.0}, 1.0),
    "pcpo": (2000, EPISODES, 0.1),
    "c-trpo": (3200, EPISODES | {"hysteresis": 1.0}, 0.1),
    "rcpo": (6400, SGD, 1.0),
    "ppo-saute": (6400, SAUTE, 0.0),
    "trpo-saute": (6400, SAUTE, 0.0),
    "sac-pid": (1200, {"pid_ki": 0.05, "pid_kd": 0.0}, 0.0),
    "cal": (2400, {"multiplier_lr": 3e-3, "convexity": 1.0, "replay_size": 128}, 0.0),
}
OPTIMUM = dict.fromkeys(SETTINGS, 0.2) | {"sac-lb": 0.05}  # see Target, and below
DISTANCE = dict.fromkeys(SETTINGS, 0.12)
DISTANCE |= {"cpo": 0.05, "sac-lag": 0.05, "sac-lb": 0.1, "wcsac": 0.07}
SEEDS = dict.fromkeys(SETTINGS, (0, 1)) | {"sac-lb": (2, 3)}  # seeds that start far from it


@pytest.mark.parametrize("name", SETTINGS)
def test_comes_close_to_the_optimum_within_the_limit(name):
    """Each run's mean deterministic action over the last third of training against a = 0.2.

    Its cost (1 + a) / 2 may exceed the limit by 0.03. SAC-LB's optimum lies within the limit: with
    t = 3 the slopes of reward and barrier, 2 (0.8 - a) and 3/2, are equal at a = 0.05.
    """
    steps, changes, noise = SETTINGS[name]
    config = replace(algorithm(name).config(), **SHARED, **changes)
    if algorithm(name).family is OffPolicy:
        kept = min(config.replay_size, 1000)
        config = replace(config, random_steps=100, gradient_steps=1, replay_size=kept)
        config = replace(config, temperature_lr=SHARED["learning_rate"])
    it = TrainConfig(name, ("Target-v0",), SEEDS[name], steps, config, {"noise": noise})
    training = trainer(it)
    actions, nothing = [], np.zeros((2, 1, 1 + ("saute" in name)), np.float32)
    nothing[..., 1:] = 1.0  # the whole budget is left
    untrained = training.learner.policy()(nothing, None)
    assert np.abs(untrained - OPTIMUM[name]).max() > DISTANCE[name]
    while not training.done:
        training.run_epoch()
        if training.steps[0] > 2 * steps // 3:
            actions.append(training.learner.policy()(nothing, None))
    found = np.mean(actions, axis=0).ravel()
    assert np.abs(found - OPTIMUM[name]).max() < DISTANCE[name], found
    assert ((1 + found) / 2).max() < LIMIT + 0.03, found


def test_improves_over_a_random_policy_on_circle2d():
    """By more than twice as much as an untrained policy without noise does."""
    name, task = "trpo-lag", "Circle2D-1-v0"
    training = finished(trainer(TrainConfig(name, (task,), (0,), 5_000, preset(name, task))))
    envs, policy = make_envs(task, 200, {}), training.learner.policy()
    noise = steps_of_noise(uniform, (0,), Purpose.EVALUATION, 0, (200, 2))
    at_random = collect(envs, range(200), lambda observation: next(noise)[0])
    trained = collect(envs, range(200), lambda observation: policy(observation[None], None)[0])
    assert trained.returns.mean() > at_random.returns.mean() + 14.0
