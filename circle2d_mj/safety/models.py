"""The compiled MuJoCo models, each built once in a process."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are compiled in, where pyright does not see them.

from __future__ import annotations

import functools
import importlib.resources

import mujoco

from circle2d_mj.assets import asset

NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
"""Flag for a model's `opt.disableflags`. Contacts are the only constraints of our models, and the
flag for all constraints saves more work than that for contacts."""


@functools.cache
def point_circle() -> mujoco.MjModel:
    """Return the model of SafetyPointCircle1-v0. Nothing collides in it."""
    return mujoco.MjModel.from_xml_path(str(asset("xml/safety_point_circle.xml")))


@functools.cache
def point_goal() -> mujoco.MjModel:
    """Return the model of SafetyPointGoal1-v0."""
    return mujoco.MjModel.from_xml_path(str(asset("xml/safety_point_goal.xml")))


@functools.cache
def hopper() -> mujoco.MjModel:
    """Return the model of SafetyHopperVelocity-v1, from the installed gymnasium's hopper.xml."""
    xml = importlib.resources.files("gymnasium").joinpath("envs/mujoco/assets/hopper.xml")
    model = mujoco.MjModel.from_xml_string(xml.read_text())
    # One tree of bodies is one island: the search for others takes a tenth of a step's time.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return model
