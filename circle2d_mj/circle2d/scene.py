"""The MuJoCo scene of a task: the ball, its actuators, and the region as convex prisms."""

# mujoco has no stubs for MjSpec.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.physics_config import (
    BASE_RADIUS,
    PhysicsConfig,
    base_scene,
    completed,
    full_action,
    softness,
    span,
)
from circle2d_mj.circle2d.region import CostRegion
from circle2d_mj.core.engine import mujoco

HEIGHT = 0.1
"""Height of the prisms as a multiple of R. The ball moves at half height and touches only sides."""
SHEER = 0.35
"""Opacity of a region that the ball can enter."""
OVERLAP = 0.2
"""How far a soft region's prisms reach into each other, as a multiple of R."""
VERTICES = 256
"""Number of vertices of the polygon that replaces the disc and has the disc's area."""
OVERHANG = 1e-4
"""Greatest distance of that polygon's edge from the circle, as a multiple of R."""
# The height that the orthographic top camera sees, a length, is checked as an angle: below 180.
_MAX_FOVY = 179.0
# A contact is listed within margin + gap, but its force starts at the margin: a margin of -R lies
# too deep in the region to be reached. Not deeper, since XML keeps six digits of the sum.
_NEVER = -1.0


def scene(
    config: Circle2DConfig, physics: PhysicsConfig | None = None, *, with_region: bool = True
) -> mujoco.MjSpec:
    """Return the scene of a task, to be compiled or written out (`.to_xml()`).

    A rigid region pushes the ball off, a soft region pushes like a spring. With contact "none" the
    region never pushes: contacts are only listed, while the ball's centre is inside.
    with_region=False leaves the region out. Raises ValueError like `completed`.
    """
    physics = completed(config, physics or PhysicsConfig())
    spec = base_scene(physics)
    _scale(spec, config)
    spec.option.timestep = physics.timestep
    spec.body("agent").mass = physics.mass
    spec.geom("agent").size[0] = physics.ball_radius
    _actuate(spec, physics)
    _light(spec, config)
    if with_region:
        _set_contact(spec, physics)
        _add_region(spec, config, physics)
    return spec


def _scale(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    """Scale all lengths of the base scene to the task's radius and arena."""
    scale, arena = config.constraint_radius / BASE_RADIUS, config.arena
    floor, agent, top = spec.geom("floor"), spec.geom("agent"), spec.camera("top")
    floor.size = [arena, arena, floor.size[2] * scale]
    body = spec.body("agent")
    body.pos = [0.0, 0.0, HEIGHT * config.constraint_radius / 2]
    top.pos, top.fovy = [0.0, 0.0, 2 * config.constraint_radius], min(2 * arena, _MAX_FOVY)
    for joint in spec.joints:
        joint.range = [-arena, arena]
        joint.solimp_limit[2] *= scale  # a width, like solimp[2] below
    agent.solimp[2] *= scale
    spec.stat.extent, spec.stat.center = 2 * arena, [0.0, 0.0, 0.0]
    # A length and an energy per mass; unscaled tolerances would make small worlds less exact.
    spec.option.ccd_tolerance *= scale
    spec.option.tolerance *= scale**2


def _light(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    """Add the cameras "side" and "follow" and a light with shadows; set the size of arrows."""
    radius, arena, ball = config.constraint_radius, config.arena, spec.body("agent")
    for parent, name, place, fovy in (
        (spec.worldbody, "side", np.array([0.0, -2.4, 1.5]) * arena, 38.0),
        (ball, "follow", np.array([0.35, -0.5, 0.45]) * radius, 50.0),
    ):
        backwards = place / np.linalg.norm(place)
        right = np.cross([0.0, 0.0, 1.0], backwards) / np.hypot(*backwards[:2])
        axes, quat = np.column_stack((right, np.cross(backwards, right), backwards)), np.empty(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        camera = parent.add_camera(name=name, pos=place, quat=quat, fovy=fovy)
        if parent is ball:
            camera.mode = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    sun = spec.worldbody.add_light(pos=[-0.2 * arena, -0.2 * arena, arena], dir=[0.2, 0.2, -1.0])
    sun.type, sun.castshadow = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, True
    sun.diffuse, sun.specular = [0.5] * 3, [0.0] * 3
    spec.visual.headlight.diffuse, spec.visual.headlight.ambient = [0.2] * 3, [0.45] * 3
    spec.visual.quality.offsamples, spec.visual.map.shadowclip = 4, 0.75
    spec.visual.map.zfar = 200.0  # with less, shadows have holes
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=16, height=96)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.75, 0.82, 0.9], [0.97, 0.97, 0.97]
    spec.visual.map.force = 0.02 * radius / BASE_RADIUS  # m per N
    spec.visual.rgba.contactforce = [0.95, 0.5, 0.0, 1.0]
    spec.stat.meansize, spec.stat.meanmass = 0.15 * radius, 1.0


def _actuate(spec: mujoco.MjSpec, physics: PhysicsConfig) -> None:
    """Set drag and actuators; a full action is the actuators' greatest control."""
    most = getattr(physics, full_action(physics))
    for joint in spec.joints:
        joint.damping[0] = physics.damping
    for actuator in spec.actuators:
        if physics.gain is None:
            actuator.set_to_motor()
        else:
            actuator.gainprm[0], actuator.biasprm[2] = physics.gain, -physics.gain
            if (limit := physics.max_force) is not None or "max_force" in physics.randomize:
                limit = physics.randomize["max_force"][1] if limit is None else limit
                actuator.forcelimited, actuator.forcerange = True, [-limit, limit]
        actuator.ctrlrange = [-most, most]


def _set_contact(spec: mujoco.MjSpec, physics: PhysicsConfig) -> None:
    """Set the parameters of the ball's contacts with the region that differ from the base scene."""
    ball, slides = spec.geom("agent"), span(physics, "friction")[1] == 0.0
    if physics.contact == "none" or (physics.contact == "rigid" and slides):
        return
    ball.priority = 1  # the ball's contact parameters apply, not the prisms'
    if physics.contact == "soft":
        # With mjINT_DISCRETE, forces at rest would depend on damping, gain and force limits.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        numbers = physics.stiffness, physics.damping_ratio, physics.mass
        ball.solref, impedance = softness(physics, *numbers)
        ball.solimp[:2] = impedance
    ball.condim, ball.friction[0] = 1 if slides else 3, physics.friction
    if not slides:  # a pyramidal cone would give less friction than its coefficient
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


def _add_region(spec: mujoco.MjSpec, config: Circle2DConfig, physics: PhysicsConfig) -> None:
    height, radius = HEIGHT * config.constraint_radius, config.constraint_radius
    agent, soft = spec.geom("agent"), physics.contact == "soft"

    def prisms(name: str, pieces: list[NDArray], low: float, high: float, **more: Any) -> Any:
        for k, piece in enumerate(pieces):
            prism = [np.column_stack((piece, np.full(len(piece), z))) for z in (low, high)]
            # The inertia is unused, but must exist; a shell's does in small worlds too.
            shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            spec.add_mesh(name=f"{name}{k}", uservert=np.concatenate(prism).ravel(), inertia=shell)
            yield spec.worldbody.add_geom(
                spec.find_default("region"),
                name=f"{name}{k}",
                meshname=f"{name}{k}",
                solimp=agent.solimp,
                **more,
            )

    if soft:  # even deep inside, the nearest side must be nearer than top and bottom
        overlapping = convex_pieces(config.region, OVERLAP * radius)
        for geom in prisms("region", overlapping, height / 2 - radius, height / 2 + radius):
            geom.group, geom.rgba = 3, [0.62, 0.62, 0.62, 0.2]
    disjoint = convex_pieces(config.region)
    no_contact = {"contype": 0, "conaffinity": 0} if soft else {}
    for geom in prisms("look" if soft else "region", disjoint, 0.0, height, **no_contact):
        if physics.contact != "rigid":
            geom.rgba[3] = SHEER
        if physics.contact == "none":
            geom.margin = _NEVER * radius
            geom.gap = -geom.margin - agent.size[0]


def convex_pieces(region: CostRegion, overlap: float = 0.0) -> list[NDArray[np.float64]]:
    """Split the region into convex polygons: [vertices, 2] each, world units.

    Each strip is cut out of every piece that it meets. The parts to the strip's left, to its right
    and beyond its inner end remain; the part beyond the end reaches `overlap`, world units, into
    the other two. There are 3 pieces on level 1, 7 on level 2 and 11 on level 3, or more with an
    overlap.
    """
    half_angle = math.pi / VERTICES
    radius = region.radius * math.sqrt(2 * half_angle / math.sin(2 * half_angle))
    angles = 2 * half_angle * np.arange(VERTICES)
    pieces = [radius * np.column_stack((np.cos(angles), np.sin(angles)))]
    for cut in region.cutouts:
        for sin in dict.fromkeys((cut.sin, -cut.sin)):
            along, across = np.array([cut.cos, sin]), np.array([-sin, cut.cos])
            how = (along, across, *cut[-2:], overlap)
            pieces = [part for piece in pieces for part in _less(piece, *how)]
    # Drop slivers: their area does not matter, and their volume is too small for a convex hull.
    return [piece for piece in pieces if _area(piece) > 1e-9 * region.radius**2]


def _less(
    piece: NDArray,
    along: NDArray,
    across: NDArray,
    inner: float,
    half_width: float,
    overlap: float,
) -> list[NDArray]:
    """Cut the strip `p·along >= inner`, `|p·across| <= half_width` out of a convex polygon; return
    the convex parts that remain."""
    between = _clip(_clip(piece, across, -half_width), -across, -half_width)
    if not len(_clip(between, along, inner)):
        return [piece]
    wide = _clip(_clip(piece, across, -half_width - overlap), -across, -half_width - overlap)
    sides = [_clip(piece, across, half_width), _clip(piece, -across, half_width)]
    return [part for part in (_clip(wide, -along, -inner), *sides) if len(part)]


def _clip(polygon: NDArray, normal: NDArray, bound: float) -> NDArray:
    """Return the part of a convex polygon with `p·normal >= bound`; [0, 2] if it is empty."""
    beyond = polygon @ normal - bound
    vertices = []
    for k in range(len(polygon)):
        here, there = beyond[k - 1], beyond[k]
        if here * there < 0:
            vertices.append(polygon[k - 1] + (polygon[k] - polygon[k - 1]) * here / (here - there))
        if there >= 0:
            vertices.append(polygon[k])
    return np.array(vertices) if len(vertices) > 2 else np.empty((0, 2))


def _area(polygon: NDArray) -> float:
    x, y = polygon.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
