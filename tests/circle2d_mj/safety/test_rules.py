"""The three tasks against episodes and models recorded from the original: see safety_golden.py."""

import mujoco
import numpy as np
import pytest
from safety_golden import Golden, parameters, world

from circle2d_mj.safety import models, rules
from circle2d_mj.safety.circle import SafetyPointCircle
from circle2d_mj.safety.goal import SafetyPointGoal

CIRCLE, GOAL, HOPPER = "SafetyPointCircle1-v0", "SafetyPointGoal1-v0", "SafetyHopperVelocity-v1"
EXACT = {"rtol": 0, "atol": 1e-12}
CLOSE = {"rtol": 0, "atol": 1e-8}
GROUPS = np.array((0, *[1] * 8, 2))
same = np.testing.assert_allclose


def goal_targets(golden, when):
    """Goal, hazards and vase, [steps, 10, 2]."""
    read = golden.before if when == "before" else golden.after
    places = read("goal_pos")[:, None], golden.of_episode("hazards_pos"), read("vase_pos")[:, None]
    return np.concatenate(places, axis=1)[..., :2]


def test_circle_rules():
    golden = Golden(CIRCLE)
    qpos, qvel = world(golden, "after")
    position, velocity = qpos[:, :2], qvel[:, :2]
    same(position, golden.after("agent_pos")[:, :2], **EXACT)
    same(rules.circle_reward(position, velocity), golden.of_step("reward"), **EXACT)
    same(rules.circle_cost(position), golden.of_step("cost"), **EXACT)
    centre = golden.of_episode("circle_center")[:, None, :2]
    seen = rules.lidar(rules.sight(position, centre), qpos[:, 2], 6.0)
    same(seen, golden.after("obs")[:, 12:], **EXACT)
    assert 0 < golden.of_step("cost").mean() < 1
    assert not golden.of_step("terminated").any()


def test_goal_rules():
    golden = Golden(GOAL)
    pose, _ = world(golden, "after")
    position, targets = pose[:, :2], goal_targets(golden, "after")
    old = goal_targets(golden, "before")
    before = rules.sight(world(golden, "before")[0][:, :2], old).distance[:, 0]
    distance = rules.sight(position, old).distance
    same(rules.goal_reward(before, distance[:, 0]), golden.of_step("reward"), **EXACT)
    same(rules.goal_met(distance[:, 0]), golden.of_step("goal_met"))
    same(rules.goal_cost(distance[:, 1:9]), golden.of_step("cost"), **EXACT)
    seen = rules.lidar(rules.sight(position, targets), pose[:, 2], 3.0, GROUPS)
    same(seen, golden.after("obs")[:, 12:], **EXACT)
    assert golden.of_step("goal_met").sum() == 10
    assert 0 < golden.of_step("cost").mean() < 1


def test_hopper_rules():
    golden = Golden(HOPPER)
    qpos, qvel = golden.after("qpos"), golden.after("qvel")
    velocity = (qpos[:, 0] - golden.before("qpos")[:, 0]) / 0.008
    same(velocity, golden.of_step("x_velocity"), **EXACT)
    same(
        rules.hopper_reward(velocity, golden.of_step("actions")), golden.of_step("reward"), **EXACT
    )
    same(rules.hopper_cost(velocity), golden.of_step("cost"), **EXACT)
    np.testing.assert_array_equal(rules.hopper_fell(qpos, qvel), golden.of_step("terminated"))
    same(rules.hopper_observation(qpos, qvel), golden.after("obs"), **EXACT)
    assert golden.of_step("terminated").sum() == 12


def test_hopper_rules_where_nothing_was_recorded():
    """Nobody runs too fast in the recordings, nor is any number out of bounds."""
    np.testing.assert_array_equal(rules.hopper_cost(np.array([0.7402, 0.7403, -5])), [0, 1, 0])
    assert rules.hopper_reward(np.array(2.0), np.array([1.0, -2.0, 3.0])) == 3 - 0.014
    upright, still = np.array([9e9, 1.25, 0, 0, 0, 0]), np.zeros(6)
    assert not rules.hopper_fell(upright, still)
    for column, value in [(1, 0.7), (2, 0.2), (2, -0.2), (3, 100), (5, -100), (1, np.nan)]:
        qpos = upright.copy()
        qpos[column] = value
        assert rules.hopper_fell(qpos, still), (column, value)
    assert rules.hopper_fell(upright, still + 100)
    seen = rules.hopper_observation(upright, np.array([-11.0, 11, 1, 2, 3, 4]))
    np.testing.assert_array_equal(seen, [1.25, 0, 0, 0, 0, -10, 10, 1, 2, 3, 4])


def test_point_rules_where_nothing_was_recorded():
    assert rules.circle_reward(np.zeros(2), np.ones(2)) == 0
    assert rules.goal_cost(np.array([0.2, 5.0])) == 0  # the rim does not count
    assert rules.goal_cost(np.array([0.2 - 1e-9, 5.0])) == 1
    assert rules.goal_reward(np.array(0.4), np.array(0.3)) == pytest.approx(1.1)


@pytest.mark.parametrize("task", [CIRCLE, GOAL])
def test_sensors(task):
    """MuJoCo's mj_forward on our model, with the control of the step, at the recorded states."""
    golden = Golden(task)
    model = models.point_circle() if task == CIRCLE else models.point_goal()
    data = mujoco.MjData(model)
    qpos, qvel = world(golden, "after")
    sensed = np.empty((len(qpos), 12))
    for i, action in enumerate(golden.of_step("actions")):
        data.qpos[:3], data.qvel[:3] = qpos[i], qvel[i]
        data.qpos[3:], data.qvel[3:] = golden.after("qpos")[i, 3:], golden.after("qvel")[i, 3:]
        data.ctrl[:] = np.clip(action, -1, 1)
        mujoco.mj_forward(model, data)
        sensed[i] = data.sensordata
    same(sensed, golden.after("obs")[:, :12], **EXACT)


def test_one_step_of_circle():
    golden = Golden(CIRCLE)
    qpos, qvel = world(golden, "before")
    task = SafetyPointCircle(len(qpos))
    task.qpos[:], task.qvel[:] = qpos, qvel
    outcome = task.step(golden.of_step("actions"))
    same(task.qpos, world(golden, "after")[0], **CLOSE)
    same(task.qvel, world(golden, "after")[1], **CLOSE)
    same(task.observe(), golden.after("obs"), **CLOSE)
    same(outcome.reward, golden.of_step("reward"), **CLOSE)
    same(outcome.info["cost"], golden.of_step("cost"))
    assert not outcome.terminated.any()


def test_one_step_of_goal():
    golden = Golden(GOAL)
    qpos, qvel = world(golden, "before")
    task = SafetyPointGoal(len(qpos))
    task.qpos[:] = np.column_stack((qpos, golden.before("qpos")[:, 3:]))
    task.qvel[:] = np.column_stack((qvel, golden.before("qvel")[:, 3:]))
    targets = goal_targets(golden, "before")
    places = np.concatenate((qpos[:, None, :2], targets), axis=1)
    task.load_state_dict({**task.state_dict(), "places": places})
    outcome = task.step(golden.of_step("actions"))
    after, after_vel = world(golden, "after")
    same(task.qpos, np.column_stack((after, golden.after("qpos")[:, 3:])), **CLOSE)
    same(task.qvel, np.column_stack((after_vel, golden.after("qvel")[:, 3:])), **CLOSE)
    same(outcome.reward, golden.of_step("reward"), **CLOSE)
    same(outcome.info["cost"], golden.of_step("cost"))
    met = golden.of_step("goal_met")
    same(outcome.info["goal_met"], met)
    same(task.observe()[~met], golden.after("obs")[~met], **CLOSE)
    # A reached goal is drawn anew: other numbers here, but by the same rule.
    same(
        np.delete(task.observe(), slice(12, 28), 1),
        np.delete(golden.after("obs"), slice(12, 28), 1),
        **CLOSE,
    )
    moved = (task.state_dict()["places"][:, 1] != targets[:, 0]).any(axis=1)
    np.testing.assert_array_equal(moved, met)
    assert not outcome.terminated.any()


BODY = ("mass", "inertia", "ipos", "iquat")
JOINT = ("type", "axis", "pos", "limited", "range", "stiffness", "margin", "solref", "solimp")
DOF = ("damping", "armature", "frictionloss", "invweight0")
GEOM = ("type", "size", "friction", "condim", "contype", "conaffinity", "margin", "gap", "solref")
GEOM += ("solimp", "solmix", "priority")
ACTUATOR = ("trntype", "gear", "ctrlrange", "ctrllimited", "forcerange", "forcelimited")
ACTUATOR += ("gaintype", "gainprm", "biastype", "biasprm", "dyntype")
OPTION = ("timestep", "integrator", "solver", "iterations", "tolerance", "cone", "jacobian")
OPTION += ("gravity", "wind", "magnetic", "density", "viscosity", "impratio", "enableflags")


def check(ours, recorded, names, what):
    for name in names:
        mine = np.asarray(getattr(ours, name), dtype=float).ravel()
        its = np.asarray(recorded[name], dtype=float).ravel()
        mine = mine[: its.size]  # gainprm and biasprm: the rest is unused
        if name == "iquat" and mine @ its < 0:
            mine = -mine
        same(mine, its, rtol=1e-9, atol=1e-12, err_msg=f"{what} {name}")


@pytest.mark.parametrize(
    ("task", "model", "bodies"),
    [
        (CIRCLE, models.point_circle, {"agent"}),
        (GOAL, models.point_goal, {"agent", "vase0"}),
        (HOPPER, models.hopper, {"torso", "thigh", "leg", "foot"}),
    ],
)
def test_physical_parameters(task, model, bodies):
    recorded, model = parameters(task), model()
    assert {model.body(i).name for i in range(1, model.nbody)} == bodies
    check(model.opt, recorded["opt"], OPTION, "option")
    assert (model.nq, model.nv, model.nu) == tuple(recorded["sizes"][k] for k in ("nq", "nv", "nu"))
    by_body = {row["id"]: row for row in recorded["body"]}
    for row in recorded["body"]:
        if row["name"] in bodies:
            check(model.body(row["name"]), row, BODY, row["name"])
            if task == HOPPER:
                check(model.body(row["name"]), row, ("pos", "quat"), row["name"])
    for row in recorded["joint"]:
        check(model.joint(row["name"]), row, JOINT, row["name"])
    for name in DOF:
        same(getattr(model, f"dof_{name}"), recorded["dof"][name], rtol=1e-9, err_msg=name)
    assert model.ngeom == recorded["sizes"]["ngeom"]
    for row in recorded["geom"]:
        geom = model.geom(row["name"])
        check(geom, row, GEOM, row["name"])
        body = by_body[row["body"]]["name"]
        if body in bodies | {"world"}:
            check(geom, row, ("pos", "quat"), row["name"])
        elif task == CIRCLE:  # circle and walls, which are no bodies of ours
            same(geom.pos, by_body[row["body"]]["pos"], atol=2e-9)
    for row in recorded["actuator"]:
        names = set(ACTUATOR) - ({"biasprm"} if row["biastype"] == 0 else set())
        check(model.actuator(row["id"]), row, sorted(names), f"actuator {row['id']}")
    if task == HOPPER:
        same(model.qpos0, recorded["qpos0"], atol=1e-12)
    if task == GOAL:
        assert recorded["qpos0"][5] == pytest.approx(model.qpos0[5], abs=1e-12)
