"""Users' own tasks, given layouts, velocity tasks v0, and what code can read from tasks."""

import copy
import pickle

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import circle2d_mj.safety_gymnasium as safety_gymnasium
from circle2d_mj.safety import own
from circle2d_mj.safety.families import GoalTask
from circle2d_mj.safety.tasks import OLD, VELOCITY

equal = np.testing.assert_array_equal


class Slow(GoalTask):
    def _reward(self, before, after, met):
        return super()._reward(before, after, met) - 2.0


@pytest.fixture
def registered():
    """Return a function that registers a task for the duration of a test."""
    names = []

    def register(id, *args, **options):
        own.register(id, *args, **options)
        names.extend((id, f"circle2d_mj/{id}"))
        return id

    yield register
    for name in names:
        gym.registry.pop(name, None)


def test_a_second_registration_replaces_the_first(registered):
    for count in (4, 7):
        id = registered("OwnGoal-v0", "Goal", {"hazards": count}, costs=iter(["hazards"]))
        env = gym.make(id)
        assert env.unwrapped.task.hazards.num == count
        env.reset(seed=0)
        assert "cost_hazards" in env.step(np.zeros(2))[4]
    with pytest.raises(ValueError, match="'SafetyPointGoal1-v0' is a task of the suite"):
        own.register("SafetyPointGoal1-v0", "Goal", {"hazards": 3}, costs=["hazards"])


def test_goal1_made_of_its_parts_moves_as_the_suites(registered):
    """From the same places, the steps are the same; only rewards differ, by the subclass's 2."""
    id = registered("OwnGoal1-v0", Slow, {"hazards": 8, "vases": 1}, costs=["hazards"])
    assert id in gym.registry
    places = {
        "agent": [(-1.2, 0)],
        "goal": [(1.0, 1.0)],
        "hazards": [(x, -1.0) for x in (-1.2, -0.6, 0.0, 0.6, 1.2)],
        "vases": (0, 0.5),
    }
    mine = gym.make(id, places={**places}, hazards=5)
    suite = gym.make("circle2d_mj/SafetyPointGoal1-v0", places=places, hazards=5)
    equal(mine.reset(seed=3)[0], suite.reset(seed=3)[0])
    suite.action_space.seed(0)
    for _ in range(50):
        action = suite.action_space.sample()
        got, expected = mine.step(action), suite.step(action)
        equal(got[0], expected[0])
        assert got[1] == pytest.approx(expected[1] - 2.0)
        assert got[4] == expected[4]


def test_an_own_task_in_a_vector_environment_and_with_six_values(registered):
    id = registered(
        *("OwnPush-v0", "Push", {"pillars": 2, "hazards": 1}),
        agent="Car",
        costs=["pillars"],
        lidars=["push_box", "goal", "hazards"],
        half_width=2.0,
        max_episode_steps=7,
    )
    envs = gym.make_vec(id, num_envs=3)
    observation, _ = envs.reset(seed=1)
    for i in range(3):
        env = safety_gymnasium.make(id)
        first = env.reset(seed=1 + i)[0]
        equal(first, observation[i])
        assert first.shape == (24 + 3 * 16,) and env.spec.max_episode_steps == 7
        box, agent = env.task.push_box.pos, env.task.agent
        x, y, _ = (box * [1, 1, 0] - agent.pos) @ agent.mat
        assert first[24:40].max() == pytest.approx(max(0.0, 1 - np.hypot(x, y) / 3))
        assert set(env.step(np.zeros(2))[5]) >= {"cost_pillars"}
    envs = pickle.loads(pickle.dumps(envs))
    assert envs.step(np.zeros((3, 2)))[0].shape == (3, 72)
    assert envs.view.axes[0] == "to the box (m)"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"family": "Race"}, "family must be one of Goal, Button, Push"),
        ({"objects": {"mines": 3}}, "objects may hold hazards, .*, got 'mines'"),
        ({"objects": {"vases": 1, "gremlins": 1}}, "one kind that moves, got vases and gremlins"),
        ({"costs": ["pillars"]}, "costs may hold hazards, got 'pillars'"),
        ({"lidars": ["vases"]}, "lidars may hold goal, hazards, got 'vases'"),
        ({"agent": "Fox"}, "agent may hold Point, Car, Doggo, Racecar, Ant, got 'Fox'"),
        ({"objects": {"hazards": -1}}, "hazards must be a whole number from 0"),
        ({"half_width": 0.1}, "half_width must be above"),
        ({"lidars": ["goal", "goal"]}, "lidars must be different"),
        ({"max_episode_steps": 0}, "max_episode_steps must be at least 1, got 0"),
    ],
)
def test_bad_parts_of_own_tasks_are_named(change, message):
    given = {"family": "Goal", "objects": {"hazards": 2}, "costs": ["hazards"]} | change
    with pytest.raises(ValueError, match=message):
        own.register("Never-v0", **given)


@pytest.mark.parametrize("name", ["SafetyCarButton1-v0", "SafetyHopperVelocity-v1"])
def test_a_layout_seed_is_the_start_of_every_episode(name):
    plain = gym.make(f"circle2d_mj/{name}")
    expected = plain.reset(seed=7)[0]
    envs = gym.make_vec(f"circle2d_mj/{name}", num_envs=2, layout_seed=7, max_episode_steps=2)
    for seed in (0, None):
        equal(envs.reset(seed=seed)[0], [expected] * 2)
    for _ in range(3):  # the third resets
        observation = envs.step(np.zeros(envs.action_space.shape))[0]
    equal(observation, [expected] * 2)


def test_given_places_are_kept_and_the_rest_is_drawn():
    places = {"hazards": [(0, 0), (1, 1)], "agent": (-1, -1), "goal": (1, -1)}
    env = gym.make("circle2d_mj/SafetyPointGoal1-v0", places=places)
    others = set()
    for seed in range(3):
        env.reset(seed=seed)
        task = env.unwrapped.task
        equal(task.agent.pos[:2], (-1, -1))
        equal(task.goal.pos[:2], (1, -1))
        equal(np.array(task.hazards.pos)[:2, :2], [(0, 0), (1, 1)])
        others.add(tuple(task.hazards.pos[2]))
        everything = np.array([*task.world_info.layout.values()])
        apart = np.linalg.norm(everything[:, None] - everything, axis=-1)
        assert apart[np.triu_indices(len(apart), 1)].min() >= 0.15 + 0.18
        assert task.hazards.locations == places["hazards"]
    assert len(others) == 3
    for bad, message in (
        ({"pillars": [(0, 0)]}, "places may hold agent, goal, hazards, vases, got 'pillars'"),
        ({"goal": [(0, 0), (1, 1)]}, r"places\['goal'\] may hold at most 1, got 2"),
        ({"goal": "here"}, "must be pairs"),
        ({"hazards": [(0, 0), (1,)]}, "must be pairs"),
        ({"hazards": [(0, 0), (0.1, 0)]}, "0.1 m apart; the minimum is 0.36"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make("circle2d_mj/SafetyPointGoal1-v0", places=bad)


def test_a_copy_keeps_its_places_whatever_becomes_of_the_given_ones():
    places = {"hazards": [[1.0, 1.0]]}
    env = gym.make("circle2d_mj/SafetyPointGoal1-v0", places=places)
    places["hazards"][0] = [-1.0, -1.0]
    again = copy.deepcopy(env)
    again.reset(seed=0)
    equal(again.unwrapped.task.hazards.pos[0][:2], (1, 1))


READ = """
agent.pos, agent.mat, agent.vel, agent.com, agent.z_height, agent.keepout, agent.rot
agent.placements, agent.locations, agent.action_space, agent.get_sensor("gyro"), agent.obs_sensor()
agent.dist_xy(task.goal.pos), agent.is_alive(), agent.name, agent.body_info.nq, agent.body_info.nv
agent.body_info.nu, agent.body_info.nbody, agent.body_info.geom_names, agent.sensor_conf.sensors
agent.sensor_info.sensor_dim, agent.engine.model, agent.engine.data, agent_name, num_steps
task_name
goal.pos, goal.size, goal.keepout, goal.name, goal.locations, goal.is_lidar_observed, goal.color
hazards.pos, hazards.num, hazards.size, hazards.keepout, hazards.locations, hazards.placements
hazards.is_constrained, vases.pos, vases.num, vases.size, vases.density, goal_achieved, dist_goal()
last_dist_goal, lidar_conf.num_bins, lidar_conf.max_dist, lidar_conf.exp_gain, lidar_conf.type
lidar_conf.alias, compass_conf.shape, reward_conf.reward_clip, cost_conf.constrain_indicator
mechanism_conf.randomize_layout, mechanism_conf.continue_goal, sim_conf.frameskip_binom_n
goal.reward_goal, goal.reward_distance, hazards.cost, vases.contact_cost, vases.velocity_cost
placements_conf.placements, placements_conf.extents, placements_conf.margin, floor_conf.size
obs_info.obs_space_dict, observation_space, action_space, observation_flatten, observe_vision, debug
action_noise, obs(), calculate_cost(), world_info.layout, world.model, world.data
world.body_pos("agent"), world.body_mat("agent"), world.body_vel("agent"), world.body_com("agent")
data.qpos, data.qvel, data.ctrl, data.time, data.site_xpos, data.sensordata, data.ncon, _obstacles
data.body("hazard0").xpos, model.nq, model.nbody, model.body_mass, model.opt.timestep, model
"""


def expressions():
    lines = READ.replace("\n", ", ").split(", ")
    return [f"task.{expression}" for expression in lines if expression]


def test_expressions_of_published_code_can_be_read():
    env = safety_gymnasium.make("SafetyCarGoal1-v0")
    env.reset(seed=0)
    assert len(expressions()) > 90
    for expression in expressions():
        eval(expression, {"task": env.unwrapped.task})


def test_circle_and_run_are_read_as_in_the_original():
    """Floors are as large as drawn; rewards of Run are not clipped; the bounds of Circle2."""
    env = safety_gymnasium.make("SafetyPointCircle2-v0")
    env.reset(seed=0)
    walls = env.unwrapped.task.sigwalls
    assert walls.locations == [(1.125, 0), (-1.125, 0), (0, 1.125), (0, -1.125)]
    areas, _ = env.unwrapped.task.placements_conf.placements["agent"]
    assert areas == [(-0.8, -0.8, 0.8, 0.8)] == env.unwrapped.task.agent.placements
    assert (walls.size, walls.keepout, walls.is_lidar_observed) == (3.5, 0.0, False)
    run = safety_gymnasium.make("SafetyPointRun0-v0")
    run.reset(seed=0)
    assert run.unwrapped.task.floor_conf.size == (17.5, 17.5, 0.1)
    assert run.unwrapped.task.reward_conf.reward_clip is None


def test_what_is_read_is_what_is_observed():
    """Attributes of the task against the observation and MuJoCo: sensors, lidar, speeds, layout,
    distance, costs."""
    for name in ("SafetyCarGoal2-v0", "SafetyDoggoButton1-v0", "SafetyPointPush2-v0"):
        env = safety_gymnasium.make(name)
        env.reset(seed=4)
        task = env.unwrapped.task
        agent, data = task.agent, task.data
        for _ in range(5):
            observation, _, cost, *_ = env.step(env.action_space.high)
        parts = gym.spaces.unflatten(task.obs_info.obs_space_dict, observation)
        equal(parts["gyro"], agent.get_sensor("gyro"))
        x, y, _ = (task.goal.pos * [1, 1, 0] - agent.pos) @ agent.mat
        assert parts["goal_lidar"].max() == pytest.approx(max(0, 1 - np.hypot(x, y) / 3))
        equal(data.body("agent").xpos, agent.pos)  # `data` was read before the steps
        np.testing.assert_allclose(task.world.body_vel("agent"), agent.vel, atol=1e-9)
        np.testing.assert_allclose(data.body("goal").xpos, task.goal.pos)
        np.testing.assert_allclose(data.qpos[-4:], env.unwrapped._envs.simulation.qpos[0, -4:])
        equal(task.world_info.layout["goal"], task.goal.pos[:2])
        assert task.dist_goal() == pytest.approx(np.hypot(*(task.goal.pos - agent.pos)[:2]))
        assert task.calculate_cost()["cost_sum"] == cost
        assert mujoco.mj_name2id(task.model, mujoco.mjtObj.mjOBJ_BODY, "agent") >= 0
    assert agent.body_info.geom_names == ["agent", "pointarrow"]


def test_writing_is_refused_with_the_way_out():
    env = safety_gymnasium.make("SafetyPointGoal1-v0")
    env.reset(seed=0)
    task = env.unwrapped.task
    for part, name in ((task.hazards, "num"), (task.lidar_conf, "num_bins"), (task, "num_steps")):
        with pytest.raises(AttributeError, match=rf"{name} cannot be written: .*hazards=3"):
            setattr(part, name, 3)
    again = copy.deepcopy(env)
    task.data.qpos[0] += 1.0
    with pytest.raises(RuntimeError, match=r"data is a copy .* layout_seed"):
        env.step(np.zeros(2))
    again.step(np.zeros(2))
    again.unwrapped.model.geom_friction[:] = 0.1
    with pytest.raises(RuntimeError, match=r"model is a copy .* hazards=3"):
        again.step(np.zeros(2))


TOLD = {
    "HalfCheetah": "reward_run reward_ctrl",
    "Hopper": "",
    "Walker2d": "",
    "Swimmer": "reward_fwd reward_ctrl y_position distance_from_origin y_velocity forward_reward",
    "Ant": "reward_forward reward_ctrl reward_survive y_position distance_from_origin y_velocity "
    "forward_reward",
    "Humanoid": "reward_linvel reward_quadctrl reward_alive y_position distance_from_origin "
    "y_velocity forward_reward",
}


@pytest.mark.parametrize("body", VELOCITY)
def test_infos_of_velocity_tasks_are_the_originals(body):
    """The names are the original's, the terms add up to the reward, and positions change by the
    velocities."""
    env = safety_gymnasium.make(f"Safety{body}Velocity-v1")
    env.reset(seed=0)
    inner = env.unwrapped
    before = np.array([env.step(env.action_space.sample())[5]["x_position"]])
    action = env.action_space.sample()
    _, reward, _, _, _, info = env.step(action)
    names = {"x_position", "x_velocity", *TOLD[body].split()}
    assert set(info) == {"cost", "cost_sum", *names}
    assert info["x_velocity"] == pytest.approx((info["x_position"] - before[0]) / inner.dt)
    terms = [value for name, value in info.items() if name.startswith("reward_")]
    if terms:
        assert sum(terms) == pytest.approx(reward)
    if "y_position" in info:
        place = (info["x_position"], info["y_position"])
        assert info["distance_from_origin"] == pytest.approx(np.hypot(*place))
    assert inner.data.qpos.shape == (inner.model.nq,)
    thresholds = {"HalfCheetah": 4800, "Hopper": 3800, "Swimmer": 360, "Ant": 6000}
    assert env.spec.reward_threshold == thresholds.get(body)


@pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
@pytest.mark.parametrize("name", OLD)
def test_velocity_tasks_v0_have_other_limits(name):
    """Steps equal those of v1; a step costs above these speeds, the Swimmer's in x and y."""
    limits = {"HalfCheetah": 2.8795, "Hopper": 0.37315, "Swimmer": 0.04845}
    limits |= {"Walker2d": 1.7075, "Ant": 2.5745, "Humanoid": 2.3475}
    (limit,) = (limit for body, limit in limits.items() if f"Safety{body}Velocity-v0" == name)
    old = safety_gymnasium.vector.make(name, 20)
    new = safety_gymnasium.vector.make(name.replace("v0", "v1"), 20)
    equal(old.reset(seed=0)[0], new.reset(seed=0)[0])
    old.action_space.seed(0)
    for _ in range(20):
        action = old.action_space.sample()
        result, other = old.step(action), new.step(action)
        equal(result[1], other[1])
        info = result[5]
        planar = name.startswith(("SafetyHalf", "SafetyHop", "SafetyWalk"))
        speed = info["x_velocity"]
        if not planar:
            speed = np.hypot(speed, info["y_velocity"])
        equal(result[2], (speed > limit).astype(float))
