"""Allowed values of a task's parameters, and one clear error for each other."""

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
    ("name", "values"),
    [
        ("level", (4, "1", True)),
        ("constraint_radius", (-1.0, "3", float("nan"))),
        ("corridor_height_factor", (0, 2.1)),
        ("init_region_size", (-0.1, 4)),
        ("init_radius_multiplier", (0, 0.5, 0.9)),  # 0.9 leaves no feasible start
        ("optima_perturbation", ((10, 0), 3, (1, 2, 3), (1, "a"))),
        ("sparse_reward", (1,)),
        ("infeasible_region_penetratable", ("no",)),
    ],
)
def test_what_is_refused_is_named(name, values):
    for value in values:
        with pytest.raises((TypeError, ValueError), match=f"{name}.*"):
            Circle2DConfig(**{name: value})


def test_no_feasible_start_is_fine_where_infeasible_starts_are_allowed():
    assert Circle2DConfig(init_radius_multiplier=0.9, allow_infeasible_init=True)


def test_unknown_parameter_names_the_nearest():
    message = "unexpected keyword argument 'constraint_radus': did you mean 'constraint_radius'"
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


def test_a_config_is_a_value():
    config = Circle2DConfig(level=2, optima_perturbation=[1, 2])
    assert config.optima_perturbation == (1.0, 2.0)
    assert hash(config) == hash(Circle2DConfig(level=2, optima_perturbation=(1, 2)))
    assert pickle.loads(pickle.dumps(config)) == copy.deepcopy(config) == config
