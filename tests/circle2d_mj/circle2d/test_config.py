"""What a task's parameters may be, and the one clear error for what they may not."""

import copy
import pickle

import gymnasium as gym
import pytest

from circle2d_mj import Circle2DConfig, Circle2DEnv, Circle2DVectorEnv


def test_defaults_are_the_papers():
    config = Circle2DConfig()
    assert config == Circle2DConfig(
        level=1,
        constraint_radius=10.0,
        init_radius_multiplier=1.5,
        corridor_height_factor=0.5,
        init_region_size=0.5,
        optima_perturbation=(0, 0),
        infeasible_region_penetratable=True,
        reset_on_cost=False,
        allow_infeasible_init=False,
        sparse_reward=False,
    )
    assert Circle2DConfig(level=0).infeasible_region_penetratable is False
    assert Circle2DConfig(
        level=0, infeasible_region_penetratable=True
    ).infeasible_region_penetratable


@pytest.mark.parametrize(
    ("parameters", "error", "message"),
    [
        ({"level": 4}, ValueError, r"level must be one of \(0, 1, 2, 3\), got 4"),
        ({"level": "1"}, TypeError, "level must be an integer, got '1'"),
        ({"level": True}, TypeError, "level must be an integer, got True"),
        (
            {"constraint_radius": -1.0},
            ValueError,
            r"constraint_radius must be at least 1e-100 .* got -1\.0",
        ),
        ({"constraint_radius": "3"}, TypeError, "constraint_radius must be a number, got '3'"),
        ({"constraint_radius": float("nan")}, ValueError, "constraint_radius must be finite"),
        ({"init_radius_multiplier": 0}, ValueError, "init_radius_multiplier must be above 0"),
        ({"corridor_height_factor": 0}, ValueError, "corridor_height_factor must be above 0"),
        ({"corridor_height_factor": 2.1}, ValueError, r"at most 2, got 2\.1"),
        ({"init_region_size": -0.1}, ValueError, "init_region_size must be at least 0"),
        ({"init_region_size": 4}, ValueError, "puts the start area outside the arena"),
        ({"init_radius_multiplier": 0.5}, ValueError, "puts the start area outside the arena"),
        ({"optima_perturbation": (10, 0)}, ValueError, r"inside the disc.*got \(10, 0\)"),
        ({"optima_perturbation": 3}, TypeError, "optima_perturbation must be two finite numbers"),
        ({"optima_perturbation": (1, 2, 3)}, ValueError, "must be two finite numbers"),
        ({"optima_perturbation": (1, "a")}, TypeError, "must be two finite numbers"),
        ({"sparse_reward": 1}, TypeError, "sparse_reward must be True or False, got 1"),
        ({"infeasible_region_penetratable": "no"}, TypeError, "infeasible_region_penetratable"),
        ({"init_radius_multiplier": 0.9}, ValueError, "no feasible start is left"),
    ],
)
def test_refused(parameters, error, message):
    with pytest.raises(error, match=message):
        Circle2DConfig(**parameters)


def test_no_feasible_start_is_fine_where_infeasible_starts_are_allowed():
    assert Circle2DConfig(init_radius_multiplier=0.9, allow_infeasible_init=True)


def test_unknown_parameter_names_the_nearest():
    message = (
        "got an unexpected keyword argument 'constraint_radus': did you mean 'constraint_radius'"
    )
    for make in (
        lambda: Circle2DEnv(constraint_radus=3),
        lambda: Circle2DVectorEnv(2, constraint_radus=3),
        lambda: gym.make("Circle2D-1-v0", constraint_radus=3),
        lambda: gym.make_vec("Circle2D-1-v0", num_envs=2, constraint_radus=3),
    ):
        with pytest.raises(TypeError, match=message):
            make()


def test_config_or_parameters_but_not_both():
    assert Circle2DEnv(Circle2DConfig(level=3)).config.level == 3
    # A registered id gives the level, too.
    small = Circle2DConfig(level=3, constraint_radius=2.0)
    assert gym.make("Circle2D-3-v0", config=small).unwrapped.config is small
    assert gym.make_vec("Circle2D-3-v0", 2, config=small).unwrapped.config is small
    with pytest.raises(TypeError, match=r"give either config or parameters, not both: .*, level="):
        Circle2DEnv(Circle2DConfig(level=3), level=2)
    with pytest.raises(TypeError, match="config must be a Circle2DConfig, got 3"):
        Circle2DEnv(3)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"num_envs": 0}, ValueError, "num_envs must be at least 1, got 0"),
        ({"num_envs": 2.0}, TypeError, r"num_envs must be an integer, got 2\.0"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps must be at least 1"),
        ({"autoreset_mode": "Never"}, ValueError, "Never"),
        ({"render_mode": "ansi"}, ValueError, "render_mode must be None or one of"),
    ],
)
def test_vector_arguments(arguments, error, message):
    with pytest.raises(error, match=message):
        Circle2DVectorEnv(**arguments)


def test_a_config_is_a_value():
    config = Circle2DConfig(level=2, optima_perturbation=[1, 2])
    assert config.optima_perturbation == (1.0, 2.0)
    assert hash(config) == hash(Circle2DConfig(level=2, optima_perturbation=(1, 2)))
    assert pickle.loads(pickle.dumps(config)) == copy.deepcopy(config) == config
