"""The compiled MuJoCo models, each built once in a process however many environments use it."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are compiled in, where pyright does not see them.

from __future__ import annotations

import functools
import importlib.resources

import mujoco

from circle2d_mj.assets import asset

NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
"""For a model's `opt.disableflags`. Contacts are the only constraints that ours have, and the flag
for all constraints leaves more work out than that for contacts."""


@functools.cache
def point_circle() -> mujoco.MjModel:
    """Of SafetyPointCircle1-v0. Nothing collides in it."""
    return mujoco.MjModel.from_xml_path(str(asset("xml/safety_point_circle.xml")))


@functools.cache
def point_goal() -> mujoco.MjModel:
    """Of SafetyPointGoal1-v0."""
    return mujoco.MjModel.from_xml_path(str(asset("xml/safety_point_goal.xml")))


@functools.cache
def hopper() -> mujoco.MjModel:
    """Of SafetyHopperVelocity-v1: the hopper.xml that the installed gymnasium ships."""
    xml = importlib.resources.files("gymnasium").joinpath("envs/mujoco/assets/hopper.xml")
    model = mujoco.MjModel.from_xml_string(xml.read_text())
    # One tree of bodies is one island: looking for others is a tenth of the time of a step.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return model
