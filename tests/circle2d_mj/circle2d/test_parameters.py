"""Parameters of task and physics, against closed forms, plain MuJoCo and single environments."""

import copy
import pickle

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from agents.cli.main import main
from circle2d_mj import Circle2DConfig, Circle2DEnv
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.physics_config import DRAWN

SOFT = {"level": 1, "contact": "soft"}
BALL = 0.25  # its radius at R = 10


def made(num_envs=1, position=None, velocity=None, **parameters):
    """Return environments without a time limit, and their physics; balls are placed if asked."""
    how = {"max_episode_steps": None, "autoreset_mode": "Disabled"}
    envs = Circle2DMuJoCoVectorEnv(num_envs, **how, **parameters)
    envs.reset(seed=0)
    physics = envs._dynamics
    if position is not None:
        physics.place(np.arange(num_envs), np.atleast_2d(position))
    if velocity is not None:
        physics._qvel[:] = velocity
    return envs, physics


def steps(envs, action, count):
    """Take `count` equal steps; return the info of the last."""
    action = np.broadcast_to(np.array(action, dtype=float), (envs.num_envs, 2))
    for _ in range(count):
        info = envs.step(action)[-1]
    return info


# x, y and the sum of forces and penetrations over 30 steps, recorded with version 0.2.
GOLDEN = {
    ("velocity", 0): (0.1785052209698267, 10.246709126171428, 4455.14732490273),
    ("velocity", 1): (-15.104537316393326, 3.398173186911562, 23.620075427761744),
    ("force", 0): (1.176285519473396, 10.18391342456047, 2722.3713475459604),
    ("force", 1): (-14.764616145939165, 3.5042898451533255, 24.07562757404907),
}


@pytest.mark.parametrize(("actuation", "level"), GOLDEN)
def test_defaults_move_as_in_version_0_2(actuation, level):
    envs = Circle2DMuJoCoVectorEnv(1, level=level, actuation=actuation)
    envs.reset(seed=7)
    total = 0.0
    for t in range(30):
        info = envs.step(np.array([[-0.9, 0.4 * np.cos(0.3 * t)]]))[-1]
        total += info["contact_force"][0] + info["penetration"][0]
    np.testing.assert_allclose([*envs.position[0], total], GOLDEN[actuation, level], rtol=1e-9)


@pytest.mark.parametrize("contact", ["none", "soft"])
@pytest.mark.parametrize("actuation", ["force", "velocity"])
def test_the_integrators_recurrence(actuation, contact):
    """v' = (m v + h F) / (m + h d) and x' = x + h v'; a servo's force k (u - v) adds k to d."""
    m, d, h, n = 2.0, 3.0, 0.005, 7
    own = {"max_force": 40.0} if actuation == "force" else {"gain": 6.0, "max_speed": 9.0}
    more = {"mass": m, "damping": d, "timestep": h, "substeps": n, "actuation": actuation, **own}
    envs, physics = made(1, (14.0, 12.0), level=1, contact=contact, **more)
    force, drag = (40.0, d) if actuation == "force" else (6.0 * 9.0, d + 6.0)
    v, x = np.zeros(2), np.array([14.0, 12.0])
    for t in range(12):
        action = np.array([-0.5, np.sin(t)])
        envs.step(action[None])
        for _ in range(n):
            v = (m * v + h * force * action) / (m + h * drag)
            x = x + h * v
        np.testing.assert_allclose(physics._qvel[0], v, rtol=1e-10)
        np.testing.assert_allclose(envs.position[0], x, rtol=1e-10)


@pytest.mark.parametrize("contact", ["rigid", "soft"])
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.5])
def test_sliding_along_the_corridors_wall(friction, contact):
    """50 N press and 60 N pull along: the pull minus friction balances the damping."""
    own = {"level": 1, "contact": contact, "friction": friction, "actuation": "force"}
    envs, physics = made(1, (-9.0, 2.5 - BALL), max_force=100.0, **own)
    steps(envs, (0.6, 0.5), 4)
    rows = physics._batch.rollout(50, record=("sensordata", "qvel"))
    assert -8.0 < envs.position[0, 0] < -1.0
    along, against = np.abs(rows["sensordata"][0, :, :2]).T  # of every physics step
    # The ball still bounces off the rigid wall.
    assert against.mean() == pytest.approx(50.0, rel=0.1)
    np.testing.assert_allclose(along, friction * against, rtol=1e-3, atol=0.05)
    speed = rows["qvel"][0, -20:, 0].mean()
    assert speed == pytest.approx((60.0 - friction * 50.0) / 10.0, rel=0.05)


PLACES = {  # position in contact, direction of the push
    "rim": ((10.0 + BALL, 0.0), (-1.0, 0.0)),
    "top": ((0.0, 10.0 + BALL), (0.0, -1.0)),
    "wall": ((-5.0, 2.5 - BALL), (0.0, 1.0)),
    "end": ((-0.5 - BALL, 0.0), (1.0, 0.0)),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    "more",
    [{"actuation": "force"}, {"mass": 0.3}, {"gain": 50.0, "mass": 4.0}, {"max_force": 20.0}],
)
def test_force_at_rest_is_stiffness_times_depth(place, more):
    (position, push), stiffness = PLACES[place], 700.0
    envs, _ = made(1, position, stiffness=stiffness, **SOFT, **more)
    info = steps(envs, 0.1 * np.array(push), 60)
    force = {"actuation": 11.0, "gain": 55.0}.get(next(iter(more)), 22.0)
    force = min(force, more.get("max_force", np.inf))
    assert info["contact_force"] == pytest.approx(force, rel=2e-3)
    assert info["penetration"] == pytest.approx(force / stiffness, rel=5e-3)
    assert info["cost"] == 1


@pytest.mark.parametrize(("level", "damping_ratio"), [(1, 0.0), (3, 0.0), (3, 0.3), (1, 1.0)])
def test_energy_does_not_grow(level, damping_ratio):
    """Balls without actuation and drag are shot into the region from all sides, also at seams."""
    rng, n = np.random.default_rng(level), 300
    angle, aim = rng.uniform(0, 2 * np.pi, n), rng.normal(0, 0.3, n)
    place = 12.0 * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    speed = rng.uniform(1, 12, n)
    heading = np.stack((np.cos(angle + np.pi + aim), np.sin(angle + np.pi + aim)), axis=-1)
    own = {"level": level, "contact": "soft", "stiffness": 150.0, "damping_ratio": damping_ratio}
    more = {"actuation": "force", "max_force": 1.0, "damping": 0.0}
    envs, physics = made(n, place, speed[:, None] * heading, **own, **more)
    # A symplectic integrator keeps the energy of an undamped spring to the order of its step.
    most, deepest = 1.06 if damping_ratio == 0 else 1.0 + 1e-9, np.zeros(n)
    for _ in range(30):
        info = steps(envs, (0.0, 0.0), 1)
        free = physics._sensors[:, 3] == 0
        assert (np.hypot(*physics._qvel.T) <= most * speed)[free].all()
        deepest = np.maximum(deepest, info["penetration"])
    assert (deepest > 0.1).sum() > 100


RANGES = {"mass": (0.5, 2.0), "friction": (0.1, 0.8), "damping": (0.0, 4.0)}
MANY = [
    {"level": 1, "contact": "soft", "actuation": "velocity", "max_force": 300.0},
    {"level": 0, "actuation": "force"},
    {"level": 2, "actuation": "velocity"},
]
RANGE_OF = {"gain": (10.0, 30.0), "max_speed": (6.0, 11.0), "stiffness": (50.0, 5e3)}
RANGE_OF |= {"damping_ratio": (0.2, 1.5), "max_force": (50.0, 90.0)}


@pytest.mark.parametrize("scene", MANY)
def test_copies_with_drawn_values_equal_single_environments_with_these_values(scene):
    ranges = dict(RANGES)
    if scene["level"] == 2:
        del ranges["friction"]
    if scene["actuation"] == "velocity":
        ranges |= {name: RANGE_OF[name] for name in ("gain", "max_speed")}
    else:
        ranges |= {"max_force": RANGE_OF["max_force"], "damping": (8.0, 9.0)}
    if scene.get("contact") == "soft":
        assert set(ranges | RANGE_OF) == set(DRAWN)
        ranges |= RANGE_OF
    envs = Circle2DMuJoCoVectorEnv(5, randomize=ranges, max_episode_steps=15, **scene)
    physics = envs._dynamics
    rng, seen, touched = np.random.default_rng(0), [], 0
    observation, _ = envs.reset(seed=4)
    for episode in range(2):
        drawn = [dict(zip(physics.physics.randomize, map(float, row))) for row in physics.drawn]  # noqa: B905
        seen += [tuple(values.values()) for values in drawn]
        for values in drawn:
            assert all(ranges[k][0] <= v <= ranges[k][1] for k, v in values.items())
        single = [made(1, envs.position[k], **scene | values)[0] for k, values in enumerate(drawn)]
        for _ in range(15):
            drift = np.array([-0.8, -0.3]) * np.sign(envs.position)
            action = np.clip(drift + rng.normal(size=(5, 2)) * 0.3, -1, 1)
            observation, *_, info = envs.step(action)
            for k, one in enumerate(single):
                alone, *_, told = one.step(action[[k]])
                np.testing.assert_array_equal(alone[0], observation[k])
                for key in ("cost", "contact_force", "penetration"):
                    assert told[key][0] == info[key][k]
            touched += info["contact_force"].sum() + info["cost"].sum()
        envs.step(np.zeros((5, 2)))  # only resets
        assert episode or physics.drawn.tolist() != [list(values.values()) for values in drawn]
    assert len(set(seen)) == 10
    assert touched > 0


def test_a_step_costs_above_the_force_limit():
    ours = {"cost": "force", "force_limit": 15.0, "actuation": "force", **SOFT}
    for push, cost in ((0.1, 0.0), (0.2, 1.0)):  # of 110 N
        envs, _ = made(1, (10.0 + BALL, 0.0), **ours)
        info = steps(envs, (-push, 0.0), 40)
        assert (info["cost"][0], info["contact_force"][0] > 15.0) == (cost, cost > 0)
        assert info["penetration"] > 0
    env = Circle2DMuJoCoEnv(level=0, cost="force", force_limit=1e9)
    env.reset(seed=0)
    told = [env.step([-1.0, 0.0])[-1] for _ in range(12)]
    assert max(info["contact_force"] for info in told) > 0 == sum(info["cost"] for info in told)


PRINTED = {
    "Circle2DMuJoCo-0-v0": {},
    "Circle2DMuJoCo-2-v0": {"actuation": "force", "mass": 0.7},
    "Circle2DMuJoCo-1-v0": {"contact": "soft", "stiffness": 300, "friction": 0.3},
}


@pytest.mark.parametrize(("task", "parameters"), PRINTED.items())
def test_the_printed_scene_stepped_by_mujoco_alone(task, parameters, capsys):
    """It moves as the environment does, up to the six digits of XML."""
    words = [str(word) for pair in parameters.items() for word in pair]
    assert main(["scene", task, *(["--task-parameters", *words] if words else [])]) == 0
    model = mujoco.MjModel.from_xml_string(capsys.readouterr().out)
    data, env = mujoco.MjData(model), gym.make(task, **parameters)
    env.reset(seed=1)
    data.qpos[:] = env.unwrapped.position
    touched = 0
    for t in range(25):
        action = np.array([-0.7, 0.3 * np.sin(t)])
        info = env.step(action)[-1]
        data.ctrl[:] = action * model.actuator_ctrlrange[:, 1]
        mujoco.mj_step(model, data, nstep=10)
        np.testing.assert_allclose(data.qpos, env.unwrapped.position, atol=2e-3)
        touched += info["cost"]
    assert touched > 3


TIGHT = {"init_radius_multiplier": 0.989, "init_region_size": 0.5}
WRONG = [
    ({"mas": 2}, "'mas': did you mean 'mass'"),
    ({"mass": 0}, "mass must be above 0, got 0"),
    ({"mass": "2"}, "mass must be a number, got '2'"),
    ({"friction": -1, **SOFT}, "friction must be at least 0, got -1"),
    ({"substeps": 2.5}, "substeps"),
    ({"contact": "hard"}, "contact"),
    ({"stiffness": 9.0}, "stiffness has no effect with contact=None"),
    ({"friction": 0.5}, "friction has no effect with contact='none'"),
    ({"actuation": "torque"}, "actuation"),
    ({"actuation": "force", "gain": 9}, "gain has no effect with actuation='force'"),
    ({"actuation": "force", "max_speed": 9, "max_force": 9}, "max_speed has no effect"),
    ({"cost": "force"}, "force_limit"),
    ({"force_limit": 5.0}, "force_limit"),
    ({"cost": "force", "force_limit": 5.0}, "cost 'force' needs a region that pushes"),
    ({"randomize": {"mas": (1, 2)}}, "randomize: .*'mas': did you mean 'mass'"),
    ({"randomize": {"mass": (2, 1)}}, "randomize: mass"),
    ({"randomize": ["mass"]}, "randomize"),
    ({"randomize": 5}, "randomize"),
    ({"actuation": "force", "randomize": {"max_speed": (5, 9)}}, "draw max_force, not max_speed"),
    ({"level": 0, "max_speed": 30}, r"may reach 30 m/s .* at most 14\.1421"),
    ({"level": 0, "contact": "rigid", "ball_radius": 3.0}, "corridor_height_factor"),
    ({**SOFT, "stiffness": 1e9}, r"stiffness must be at most 2\.5e\+07 with mass 1"),
    ({"contact": "soft", "infeasible_region_penetratable": False}, "contradicts"),
    ({"camera": "front"}, "camera"),
    ({"constraint_radius": 0.9e-3}, "constraint_radius"),
    ({"constraint_radius": 1.1e6}, "constraint_radius"),
    ({"level": 0, "corridor_height_factor": 0.05}, "corridor_height_factor must be above"),
    # The start area's far corner is 1.02 R from the centre; a body of 0.025 R does not fit.
    ({"level": 0, **TIGHT}, "no feasible start is left"),
]
FINE = [
    {"level": 0, "corridor_height_factor": 0.0501},
    {"level": 1, "corridor_height_factor": 0.01},
    {"level": 1, **TIGHT},
    {"level": 0, "allow_infeasible_init": True, **TIGHT},
]


@pytest.mark.parametrize(("parameters", "words"), WRONG)
def test_a_refused_parameter_is_named(parameters, words):
    for make in (Circle2DMuJoCoEnv, Circle2DMuJoCoVectorEnv):
        with pytest.raises((TypeError, ValueError), match=words):
            make(**parameters)


def test_parameters_that_just_fit_are_accepted():
    assert all(Circle2DMuJoCoEnv(**parameters) for parameters in FINE)
    assert Circle2DConfig(init_radius_multiplier=0.9, allow_infeasible_init=True)
    assert Circle2DConfig(level=0, infeasible_region_penetratable=True)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("level", (4, "1", True)),
        ("constraint_radius", (-1.0, "3", float("nan"))),
        ("corridor_height_factor", (0, 2.1)),
        ("cutout_depth", (0, 0.81, "0.5", float("nan"))),
        ("step_length", (0, 2.1, "0.1", float("nan"))),
        ("init_region_size", (-0.1, 4)),
        ("init_radius_multiplier", (0, 0.5, 0.9)),  # 0.9 leaves no feasible start
        ("optima_perturbation", ((10, 0), 3, (1, 2, 3), (1, "a"))),
        ("sparse_reward", (1,)),
        ("infeasible_region_penetratable", ("no",)),
    ],
)
def test_wrong_values_are_named(name, values):
    for value in values:
        with pytest.raises((TypeError, ValueError), match=f"{name}.*"):
            Circle2DConfig(**{name: value})


@pytest.mark.parametrize("make", [Circle2DEnv, Circle2DMuJoCoEnv])
def test_the_length_of_a_step(make):
    """A full step is `step_length` radii; with physics, once the agent has its full speed."""
    for factor in (0.1, 0.2):
        env, x = make(level=1, step_length=factor, constraint_radius=20.0), []
        env.reset(seed=0)
        for _ in range(6):
            env.step(np.array([-1.0, 0.0]))
            x.append(env.position[0])
        assert np.diff(x)[-1] == pytest.approx(-factor * 20.0, rel=1e-3)


def test_config_or_parameters_but_not_both():
    assert Circle2DEnv(Circle2DConfig(level=3)).config.level == 3
    assert Circle2DEnv().config.level == 1
    # A config replaces the level of a registered id.
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
