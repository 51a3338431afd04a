"""The tasks as gymnasium environments; their physics against plain MuJoCo; their parameters."""

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from safety_golden import parameters

from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import worlds
from circle2d_mj.safety.envs import SafetyVectorEnv
from circle2d_mj.safety.families import ButtonTask, GoalTask, PushTask
from circle2d_mj.safety.tasks import IDS, NAMES, TASKS

equal = np.testing.assert_array_equal


def assert_alike(mine, its):
    assert data_equivalence(mine, its, exact=True), (mine, its)


# Unbounded observations are the original's.
@pytest.mark.filterwarnings("ignore:.*A Box observation space m..imum value is -?infinity")
@pytest.mark.filterwarnings("ignore:.*For Box action spaces")  # the Racecar's
@pytest.mark.parametrize("name", TASKS)
def test_spaces_and_time_limits_are_the_originals(name):
    """They are as recorded; the environment also passes gymnasium's checks."""
    recorded = parameters(NAMES[name])
    env = gym.make(IDS[name])
    check_env(env.unwrapped, skip_render_check=True)
    observation, info = env.reset(seed=0)
    assert (observation.shape, observation.dtype) == ((recorded["observation_size"],), np.float64)
    assert info["cost"] == 0.0
    numbers = [*info.values(), *env.step(np.zeros(env.action_space.shape))[4].values()]
    assert all(isinstance(number, float) and number.dtype == np.float64 for number in numbers)
    assert str(env.action_space) == recorded["action_space"]
    assert env.spec.max_episode_steps == recorded["max_episode_steps"]
    envs = gym.make_vec(IDS[name], num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(envs, SafetyVectorEnv)
    assert envs.max_episode_steps == recorded["max_episode_steps"]
    ours, originals = gym.spec(IDS[name]), gym.spec(NAMES[name])
    for what in ("entry_point", "vector_entry_point", "kwargs", "max_episode_steps"):
        assert getattr(originals, what) == getattr(ours, what)


def test_observation_bounds():
    space = SafetyVectorEnv("SafetyPointGoal1", max_episode_steps=None).single_observation_space
    assert np.isneginf(space.low[:12]).all()
    assert np.isposinf(space.high[:12]).all()
    equal(space.low[12:], 0)
    equal(space.high[12:], 1)


def scattered(cls, agent, level, n):
    """Return a task whose agents face free objects at a short distance."""
    task = cls(agent, level, n)
    task.start(Streams(np.arange(n, dtype=np.uint64)), np.arange(n))
    for _ in range(40):  # what is placed settles
        task.step(np.zeros((n, task.agent.nu)))
    places, first = task.places, task.world.free.start
    turns = np.arange(16) * 2 * np.pi / 16
    ways = np.stack((np.cos(turns), np.sin(turns)), axis=1)
    starts = places[:, first, None] - AWAY[agent] * ways
    others = np.delete(places[:, None], [0, first], axis=2)
    room = np.linalg.norm(starts[:, :, None] - others, axis=-1).min(axis=2)
    angle, place = turns[room.argmax(axis=1)], starts[np.arange(n), room.argmax(axis=1)]
    pose = task.agent.qpos(place, angle + TURN.get(agent, 0.0))
    task.qpos[:, : task.agent.nq] = pose
    task.qvel[:, : task.agent.nv] = 0.0
    task.load_state_dict(task.state_dict())
    return task


AWAY = {"Point": 0.9, "Car": 0.9, "Doggo": 0.45, "Racecar": 1.1, "Ant": 0.45}
NEAR = {"Racecar": 0.7}  # its bumper and the box reach so far
TURN = {"Car": np.pi / 2}  # its front is its -y axis
FORWARD = {
    "Point": [0.3, 0.0],
    "Car": [0.5, 0.5],
    "Racecar": [12.0, 0.0],
}  # the others get random actions


def ten_substeps(task, data, action, rest):
    """Take a step in plain MuJoCo, with all contacts and welds.

    rest: resting places of the gremlins.
    """
    data.ctrl[:] = action
    data.eq_active[:] = 1
    for _ in range(10):
        t = data.time
        for k, (x, y) in enumerate(rest, start=task.model.nmocap - len(rest)):
            data.mocap_pos[k] = x + 0.35 * np.sin(t), y + 0.35 * np.cos(t), 0.2
        if task.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            old_runge_kutta(task.model, data)
        else:
            mujoco.mj_step(task.model, data)


def old_runge_kutta(model, data):
    """Take a Runge-Kutta substep as MuJoCo did before 4.0, which averaged the stages' rates."""
    h, start, slopes = model.opt.timestep, (data.qpos.copy(), data.qvel.copy()), []

    def put(share, rates, gains):
        data.qpos[:], data.qvel[:] = start[0], start[1] + share * h * gains
        mujoco.mj_integratePos(model, data.qpos, rates, share * h)

    for share in (0.0, 0.5, 0.5, 1.0):
        if slopes:
            put(share, *slopes[-1])
        mujoco.mj_forward(model, data)
        slopes.append((data.qvel.copy(), data.qacc.copy()))
    (v1, a1), (v2, a2), (v3, a3), (v4, a4) = slopes
    put(1.0, (v1 + 2 * v2 + 2 * v3 + v4) / 6, (a1 + 2 * a2 + 2 * a3 + a4) / 6)
    data.time += h


CASES = [(agent, cls) for agent in AWAY for cls in (GoalTask, PushTask, ButtonTask)]
for agent in ("Doggo", "Ant"):
    CASES.remove((agent, PushTask))  # the box is always within their reach here


@pytest.mark.parametrize(("agent", "cls"), CASES)
def test_objects_left_alone_are_as_in_plain_mujoco(agent, cls):
    """Every step against ten of mj_step with all contacts, while agents run into objects: contacts
    that the task leaves out change nothing."""
    n = 4
    task = scattered(cls, agent, 2, n)
    left_alone, near, worst = 0, 0, []
    rng, rows = np.random.default_rng(0), task.world.free
    rest = task.state_dict()["layout"][:, rows] if cls is ButtonTask else np.zeros((n, 0, 2))
    for _ in range(90):
        plain = [task.batch.get_data(i) for i in range(n)]
        kicks = rng.uniform(-1.0, 1.0, (n, task.agent.nu))
        control = np.tile(FORWARD[agent], (n, 1)) if agent in FORWARD else kicks
        task.step(control)
        alone = task._rests._collides[0][:, :, 0] == 0
        left_alone += alone.sum()
        near += (task._distance[:, rows] < NEAR.get(agent, 0.4)).sum()
        for i, data in enumerate(plain):
            ten_substeps(task, data, control[i], rest[i])
            worst.append(np.abs(task.qpos[i] - data.qpos).max())
    assert left_alone > 40
    assert near > 20
    assert np.median(worst) < 1e-9
    # The box's columns on the Racecar's wheels amplify rounding.
    assert max(worst) < (1e-3 if (agent, cls) == ("Racecar", PushTask) else 1e-5)


def test_objects_that_push_others_are_as_in_plain_mujoco():
    """A Point pushes the first of four vases in a row; it reaches none of the others itself."""
    task, here = GoalTask("Point", 2), np.arange(1)
    task.start(Streams(np.zeros(1, dtype=np.uint64)), here)
    rows, places = task.world.rows["vases"], task.places
    line = np.outer((0.4, 0.601, 0.802, 1.003), (1.0, 0.0))  # a millimetre apart
    places[:, rows.start : rows.start + 4] = places[:, :1] + line
    task.place(here, places, np.zeros(1), np.zeros((1, rows.stop - rows.start)))
    for _ in range(40):  # they settle
        task.step(np.zeros((1, 2)))
    for _ in range(60):
        data = task.batch.get_data(0)
        task.step(np.array([[0.5, 0.0]]))
        ten_substeps(task, data, [0.5, 0.0], [])
        np.testing.assert_allclose(task.qpos[0], data.qpos, atol=1e-8)
    moved = np.linalg.norm(task.places[0, rows] - places[0, rows], axis=-1)
    assert (moved > 0.01).sum() >= 2


def test_gremlins_and_timers_go_on_from_a_state():
    """A state in the middle of gremlins' rounds and of a button's timer, in a new environment."""
    env, other = (SafetyVectorEnv("SafetyPointButton2", 6, max_episode_steps=None) for _ in "12")
    env.reset(seed=0)
    task = env.simulation
    state = env.state_dict()
    button = state["layout"][np.arange(6), 1 + state["goal_button"]]
    state["mujoco"][:, 1:3] = button - [
        0.15,
        0.0,
    ]  # beside their buttons; the first number is the time
    env.load_state_dict(state)
    met = np.zeros(6)
    for _ in range(8):
        met += env.step(np.tile([1.0, 0.0], (6, 1)))[4]["goal_met"]
    assert met.any()
    assert ((task.timer > 0) & (task.timer < 10)).any()
    other.load_state_dict(env.state_dict())
    other.reset()
    assert not other.simulation.timer.any()
    other.load_state_dict(env.state_dict())
    equal(other.simulation.observe(), task.observe())
    for k in range(60):
        action = np.tile([1.0, (-1.0) ** k], (6, 1))
        assert_alike(env.step(action), other.step(action))
    assert_alike(env.state_dict(), other.state_dict())


def test_two_kinds_of_cost_in_one_step_cost_1():
    """A Point that pushes a vase inside a hazard."""
    task, here = GoalTask("Point", 2), np.arange(1)
    task.start(Streams(np.zeros(1, dtype=np.uint64)), here)
    places, rows = task.places, task.world.rows
    places[:, rows["hazards"].start] = places[:, 0]
    places[:, rows["vases"].start] = places[:, 0] + [0.25, 0.0]
    free = rows["vases"].stop - rows["vases"].start
    task.place(here, places, np.zeros(1), np.zeros((1, free)))
    infos = [task.step(np.array([[0.5, 0.0]])).info for _ in range(20)]
    both = [i for i in infos if i["cost_vases_contact"] + i["cost_hazards"] == 2]
    assert both
    assert all(info["cost"] == 1 for info in both)


def test_mujocos_data_shows_the_state():
    for name in TASKS:
        env = SafetyVectorEnv(name, 2, max_episode_steps=None)
        env.reset(seed=0)
        before, task = env.state_dict(), env.simulation
        data = task.data(1)
        equal(data.qpos, task.qpos[1])
        if hasattr(task, "places"):
            for kind, rows in task.world.rows.items():
                bodies = ["agent"]
                if kind != "agent":
                    bodies = worlds.names(task.world.kinds[kind], rows.stop - rows.start)
                for body, place in zip(bodies, task.places[1, rows], strict=True):
                    np.testing.assert_allclose(data.body(body).xpos[:2], place, atol=1e-12)
        assert_alike(env.state_dict(), before)


LIKE_LEVEL_2 = {
    "PointGoal": {"hazards": 10, "vases": 10, "half_width": 2.0},
    "CarButton": {"hazards": 8, "gremlins": 6, "half_width": 1.8},
    "PointPush": {"hazards": 4, "pillars": 4, "half_width": 2.0},
}


@pytest.mark.parametrize("name", LIKE_LEVEL_2)
def test_level_1_with_the_objects_of_level_2_is_level_2(name):
    """Bit for bit, except for the kinds of cost."""
    first = gym.make(f"Safety{name}1-v0", **LIKE_LEVEL_2[name])
    second = gym.make(f"Safety{name}2-v0")
    for env in (first, second):
        env.action_space.seed(5)
    np.testing.assert_array_equal(*(env.reset(seed=5)[0] for env in (first, second)))
    for _ in range(200):
        (*one, info), (*other, beside) = (
            env.step(env.action_space.sample()) for env in (first, second)
        )
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
        assert info.items() - {("cost", info["cost"])} <= beside.items()


def test_none_of_a_kind():
    """The observation keeps its size; the lidar of the kind sees nothing, and it has no cost."""
    env = gym.make("SafetyPointGoal2-v0", hazards=0, vases=0, render_mode="rgb_array")
    assert env.observation_space == gym.make("SafetyPointGoal2-v0").observation_space
    env.reset(seed=0)
    for _ in range(50):
        observation, *_, info = env.step(env.action_space.sample())
        assert not observation[-32:].any() and observation[-48:-32].any()
        assert [v for k, v in info.items() if k.startswith("cost")] == [0.0] * 4
    assert env.render().shape == (640, 640, 3)
    assert env.unwrapped.task.hazards.pos == []


@pytest.mark.parametrize(
    ("task", "changes", "error", "message"),
    [
        (
            "PointGoal1-v0",
            {"hazard": 2},
            TypeError,
            "argument 'hazard'; it has hazards, vases",
        ),
        (
            "PointGoal0-v0",
            {"hazards": 2},
            TypeError,
            "SafetyPointGoal0 got .* 'hazards'; it has half_width",
        ),
        ("PointCircle1-v0", {"half_width": 2.0}, TypeError, "it has no parameters"),
        ("HopperVelocity-v1", {"hazards": 2}, TypeError, "unexpected keyword argument 'hazards'"),
        ("PointGoal1-v0", {"config": {}}, TypeError, "unexpected keyword argument 'config'"),
        ("PointGoal1-v0", {"hazards": [2]}, ValueError, r"number from 0 to 100, got \[2\]"),
        ("PointGoal1-v0", {"hazards": 2.5}, ValueError, "number from 0 to 100, got 2.5"),
        ("PointGoal1-v0", {"vases": -1}, ValueError, "vases must be .* got -1"),
        ("PointGoal1-v0", {"half_width": 0.4}, ValueError, "above 0.4 and at most 10 m, got 0.4"),
    ],
)
def test_bad_parameters_are_named(task, changes, error, message):
    with pytest.raises(error, match=message):
        gym.make(f"Safety{task}", **changes)
