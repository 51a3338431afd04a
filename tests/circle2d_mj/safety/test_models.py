"""The compiled models against the original's parameters, recorded as safety_golden.py says."""

import mujoco
import numpy as np
import pytest
from safety_golden import parameters

from circle2d_mj.safety import scenes, velocity, worlds
from circle2d_mj.safety.tasks import NAMES, TASKS

SPHERE, MESH = 2, 7
BODY = ("mass", "ipos")
JOINT = ("type", "axis", "pos", "limited", "range", "stiffness", "margin", "solref", "solimp")
DOF = ("damping", "armature", "frictionloss", "invweight0")
GEOM = ("type", "size", "friction", "condim", "contype", "conaffinity", "margin", "gap", "solref")
GEOM += ("solimp", "solmix", "priority", "pos", "quat")
ACTUATOR = ("trntype", "gear", "ctrlrange", "ctrllimited", "forcerange", "forcelimited")
ACTUATOR += ("gaintype", "gainprm", "biastype", "biasprm", "dyntype")
OF_A_FRAME = {"size", "pos", "quat"}
"""Parameters of a mesh that depend on the frame that MuJoCo chose for it."""
OPTION = ("timestep", "integrator", "solver", "iterations", "cone", "jacobian", "gravity", "wind")
OPTION += ("magnetic", "density", "viscosity", "impratio", "enableflags")


def model_of(task):
    family = TASKS[task].simulation.rpartition(":")[2].removesuffix("Task")
    arguments = TASKS[task].arguments
    if family == "Velocity":
        return velocity.model(**arguments)
    agent = arguments["agent"]
    scene = scenes.scene(f"{family}{arguments['level']}", agent)
    return worlds.world(agent, family, scene).model


def inertia(principal, quaternion):
    """Return the inertia tensor in the body's frame: principal axes may be ambiguous."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, np.asarray(quaternion))
    axes = axes.reshape(3, 3)
    return axes @ np.diag(principal) @ axes.T


def check(ours, recorded, names, what):
    for name in names:
        mine = np.asarray(getattr(ours, name), dtype=float).ravel()
        its = np.asarray(recorded[name], dtype=float).ravel()
        mine = mine[: its.size]  # gainprm and biasprm: the rest is unused
        if name == "quat" and mine @ its < 0:
            mine = -mine
        np.testing.assert_allclose(mine, its, rtol=1e-9, atol=1e-12, err_msg=f"{what} {name}")


def hull(model, geom):
    """Return the corners of a mesh in its body's frame, [k, 3], in any order."""
    first, axes = model.mesh_vertadr[geom.dataid[0]], np.empty(9)
    corners = model.mesh_vert[first : first + model.mesh_vertnum[geom.dataid[0]]]
    mujoco.mju_quat2Mat(axes, geom.quat)
    return geom.pos + corners @ axes.reshape(3, 3).T


@pytest.mark.parametrize("task", TASKS)
def test_physical_parameters(task):
    """All parameters that act: ours lack what is only drawn and the masses of fixed bodies."""
    recorded, model = parameters(NAMES[task]), model_of(task)
    for row in recorded["body"] + recorded["geom"] + recorded["joint"]:
        if "Racecar" in task and not row["name"]:  # its geoms and its axle in the original
            row["name"] = row.get("body", "axle")
        row["name"] = row["name"] and row["name"].removesuffix("obj")  # gremlin0obj
        if row.get("type") == SPHERE and "size" in row:
            row["size"] = row["size"][:1]
    # The bodies of gymnasium's own files have the original's numbers, and some no name.
    key = "id" if "Velocity" in task else "name"
    moving = [row for row in recorded["body"] if row["invweight0"][0] > 0]
    geoms = [row for row in recorded["geom"] if row["contype"] or row["conaffinity"]]
    check(model.opt, recorded["opt"], OPTION, "option")
    assert (model.nq, model.nv, model.nu) == tuple(recorded["sizes"][k] for k in ("nq", "nv", "nu"))
    assert len(moving) == (model.body_invweight0[:, 0] > 0).sum()
    for row in moving:
        # The Doggo's shins have no name in the original; they follow their thighs.
        row["name"] = row["name"] or recorded["body"][row["id"] - 1]["name"].replace("aux", "shin")
        body = model.body(row[key])
        check(body, row, BODY if row["mass"] else BODY[:1], row["name"])
        tensors = inertia(body.inertia, body.iquat), inertia(row["inertia"], row["iquat"])
        np.testing.assert_allclose(*tensors, rtol=1e-9, atol=1e-12)
    for row in recorded["joint"]:
        check(model.joint(row[key]), row, JOINT, row["name"])
    for name in DOF:
        mine = getattr(model, f"dof_{name}")
        np.testing.assert_allclose(mine, recorded["dof"][name], rtol=1e-8, atol=1e-12)
    if task == "SafetySwimmerVelocity":  # nothing collides: here by contype, there by an option
        geoms = [row | {"contype": 0, "conaffinity": 0} for row in geoms]
    for row in geoms:
        # Later versions add the margins of two geoms, the original took the larger.
        halved = row | {"margin": row["margin"] / 2}
        if row["name"] == "floor":  # the Ant's has 3, but no geom has contype 2
            halved["conaffinity"] = min(row["conaffinity"], 1)
        geom, shape = model.geom(row[key]), OF_A_FRAME if row["type"] == MESH else set()
        check(geom, halved, sorted(set(GEOM) - shape), row["name"])
        if shape:
            near = np.linalg.norm(hull(model, geom)[:, None] - np.array(row["hull"]), axis=2)
            assert near.shape == (78, 78)
            assert max(near.min(axis=0).max(), near.min(axis=1).max()) < 2e-8
    colliding = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    assert colliding.sum() == sum(row["contype"] or row["conaffinity"] for row in geoms)
    for row in recorded["actuator"]:
        names = set(ACTUATOR) - ({"biasprm"} if row["biastype"] == 0 else set())
        check(model.actuator(row["id"]), row, sorted(names), f"actuator {row['id']}")
    for row in recorded["equality"]:
        assert "gremlin" in row["name"] or "Racecar" in task  # its front wheels
        np.testing.assert_allclose(model.eq_solref[row["id"]], row["solref"])
    assert model.neq == len(recorded["equality"])
