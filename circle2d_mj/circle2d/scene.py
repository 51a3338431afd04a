"""The MuJoCo scene of a configuration: the ball, its actuators, and the region's prisms."""

# mujoco has no stubs for MjSpec.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from circle2d_mj.assets import asset
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.pieces import convex_pieces
from circle2d_mj.core.engine import mujoco

Actuation = Literal["velocity", "force"]
BASE = "xml/circle2d.xml"
BASE_RADIUS = 10.0
"""R of the scene in that file; a scene of another R is that much larger or smaller."""
SUBSTEPS = 10
"""Physics steps in a control step"""
HEIGHT = 0.1
"""Height of the prisms as a multiple of R. The ball moves at half of it and touches sides only."""
# Radii for which lengths, their squares and MuJoCo's float32 meshes keep their digits.
_RADII = (1e-3, 1e6)
# MuJoCo takes the height that the top camera sees, a length, for an angle: below 180.
_MAX_FOVY = 179.0
# A contact is listed within margin + gap; its force sets in at the margin, which lies too deep
# inside the region to be reached. It lies no deeper, since XML keeps six digits of the sum.
_NEVER = -1.0


def scene(
    config: Circle2DConfig, actuation: Actuation = "velocity", *, with_region: bool = True
) -> mujoco.MjSpec:
    """The scene of a task, to be compiled or written out (`.to_xml()`).

    actuation: "velocity", servos whose target is a full action's step in each control step;
    "force", motors against a damping that gives the same top speed, reached with a time constant
    of one control step. A rigid region pushes the ball off. One that can be entered never pushes:
    its contacts are listed, and only while the ball's centre is inside. with_region=False leaves
    the region out.

    Raises ValueError for another actuation, a constraint_radius outside [1e-3, 1e6], or a rigid
    corridor that the ball does not fit into.
    """
    if actuation not in get_args(Actuation):
        raise ValueError(f"actuation must be one of {get_args(Actuation)}, got {actuation!r}")
    low, high = _RADII
    if not low <= config.constraint_radius <= high:
        raise ValueError(
            f"constraint_radius must be in [{low:g}, {high:g}] in the MuJoCo mode, "
            f"got {config.constraint_radius!r}"
        )
    spec = mujoco.MjSpec.from_file(str(asset(BASE)))
    _scale(spec, config)
    _check_corridor(spec, config)
    _actuate(spec, config, actuation)
    if with_region:
        _add_region(spec, config)
    return spec


def _check_corridor(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    narrowest = 2 * spec.geom("agent").size[0] / config.constraint_radius
    factor = config.corridor_height_factor
    if not config.infeasible_region_penetratable and factor <= narrowest:
        raise ValueError(
            f"corridor_height_factor must be above {narrowest:g} where the region is rigid, "
            f"so that the agent's body fits into the corridor, got {factor!r}"
        )


def _scale(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    """Scale all lengths of the base scene to the task's radius and arena."""
    scale, arena = config.constraint_radius / BASE_RADIUS, config.arena
    floor, agent, top = spec.geom("floor"), spec.geom("agent"), spec.camera("top")
    floor.size = [arena, arena, floor.size[2] * scale]
    agent.size = np.array(agent.size) * scale
    body = spec.body("agent")
    body.pos = [0.0, 0.0, HEIGHT * config.constraint_radius / 2]
    top.pos, top.fovy = [0.0, 0.0, 2 * config.constraint_radius], min(2 * arena, _MAX_FOVY)
    for joint in spec.joints:
        joint.range = [-arena, arena]
        joint.solimp_limit[2] *= scale  # a width, as the next one
    agent.solimp[2] *= scale
    spec.stat.extent, spec.stat.center = 2 * arena, [0.0, 0.0, 0.0]
    # A length and an energy per mass: absolute tolerances make small worlds less exact.
    spec.option.ccd_tolerance *= scale
    spec.option.tolerance *= scale**2


def _actuate(spec: mujoco.MjSpec, config: Circle2DConfig, actuation: Actuation) -> None:
    """Set up the actuators so that their greatest control is a full action."""
    control_step = SUBSTEPS * spec.option.timestep
    most = config.full_step / control_step
    if actuation == "force":
        damping = spec.body("agent").mass / control_step
        most *= damping
        for joint in spec.joints:
            joint.damping[0] = damping
    for actuator in spec.actuators:
        if actuation == "force":
            actuator.set_to_motor()
        actuator.ctrlrange = [-most, most]


def _add_region(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    height = HEIGHT * config.constraint_radius
    agent = spec.geom("agent")
    for k, piece in enumerate(convex_pieces(config.region)):
        name = f"region{k}"
        prism = [np.column_stack((piece, np.full(len(piece), z))) for z in (0.0, height)]
        # The inertia is not used; a shell's exists in small worlds too.
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name=name, uservert=np.concatenate(prism).ravel(), inertia=shell)
        geom = spec.worldbody.add_geom(
            spec.find_default("region"), name=name, meshname=name, solimp=agent.solimp
        )
        if config.infeasible_region_penetratable:
            geom.margin = _NEVER * config.constraint_radius
            geom.gap = -geom.margin - agent.size[0]
