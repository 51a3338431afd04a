"""The MuJoCo scene of a task: the ball, its actuators, and the region as convex prisms."""

# mujoco has no stubs for MjSpec.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.assets import asset
from circle2d_mj.circle2d.config import Circle2DConfig, PhysicsConfig
from circle2d_mj.circle2d.region import CostRegion
from circle2d_mj.core.engine import mujoco

BASE = "xml/circle2d.xml"
BASE_RADIUS = 10.0
"""R of the scene in that file; a scene of another R is that much larger or smaller."""
HEIGHT = 0.1
"""Height of the prisms as a multiple of R. The ball moves at half of it and touches sides only."""
SHEER = 0.35
"""Opacity of a region in which the ball can be"""
OVERLAP = 0.2
"""How far a soft region's prisms reach into each other, as a multiple of R"""
DRAG, STIFFNESS = 10.0, 200.0
"""Defaults of a motor's damping, N·s/m, and of a soft region's stiffness, N/m."""
VERTICES = 256
"""Vertices of the polygon that stands for the disc and has the disc's area"""
OVERHANG = 1e-4
"""Greatest distance of that polygon's edge from the circle, as a multiple of R"""
# Radii for which lengths, their squares and MuJoCo's float32 meshes keep their digits.
_RADII = (1e-3, 1e6)
# MuJoCo takes the height that the top camera sees, a length, for an angle: below 180.
_MAX_FOVY = 179.0
# A contact is listed within margin + gap; its force sets in at the margin, which lies too deep
# inside the region to be reached. It lies no deeper, since XML keeps six digits of the sum.
_NEVER = -1.0
# Impedance of the stiffest and the least stiff contact: see `softness`.
_IMPEDANCE = (1e-4, 0.9999)
# Share of the ball's radius that it may cover in a physics step where the region is rigid.
_LARGEST_STEP = 0.8


def scene(
    config: Circle2DConfig, physics: PhysicsConfig | None = None, *, with_region: bool = True
) -> mujoco.MjSpec:
    """The scene of a task, to be compiled or written out (`.to_xml()`).

    A rigid region pushes the ball off, a soft one as a spring does. One without force never pushes:
    its contacts are listed, and only while the ball's centre is inside. with_region=False leaves
    the region out. Raises ValueError as `completed` does.
    """
    physics = completed(config, physics or PhysicsConfig())
    spec = mujoco.MjSpec.from_file(str(asset(BASE)))
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


def completed(config: Circle2DConfig, physics: PhysicsConfig) -> PhysicsConfig:
    """The physics with what it leaves open: numbers of the base scene, and defaults of the task.

    Raises ValueError for a constraint_radius outside [1e-3, 1e6], a contact that contradicts
    infeasible_region_penetratable, a rigid corridor that the ball does not fit into, a ball so fast
    that it could pass into a rigid region, and a stiffness that the timestep does not resolve.
    """
    low, high = _RADII
    radius, penetratable = config.constraint_radius, config.infeasible_region_penetratable
    if not low <= radius <= high:
        raise ValueError(
            f"constraint_radius must be in [{low:g}, {high:g}] in the MuJoCo mode, got {radius!r}"
        )
    contact = physics.contact or ("none" if penetratable else "rigid")
    if (contact == "rigid") == penetratable:
        raise ValueError(
            f"contact {contact!r} contradicts infeasible_region_penetratable={penetratable}"
        )
    base = mujoco.MjSpec.from_file(str(asset(BASE)))
    ball, [servo, _], [joint, _] = base.geom("agent"), base.actuators, base.joints
    given: dict[str, Any] = {"contact": contact}

    def complete(name: str, value: Any) -> None:
        if getattr(physics, name) is None:
            given[name] = float(value)

    complete("timestep", base.option.timestep)
    complete("mass", base.body("agent").mass)
    complete("ball_radius", ball.size[0] * (radius / BASE_RADIUS))
    if contact != "none":
        complete("friction", ball.friction[0] if ball.condim > 1 else 0.0)
    if contact == "soft":
        complete("stiffness", STIFFNESS)
        complete("damping_ratio", 1.0)
    moves_by_force = physics.actuation == "force"
    complete("damping", DRAG if moves_by_force else joint.damping[0])
    timestep = given.get("timestep", physics.timestep)
    speed = config.full_step / (physics.substeps * timestep)
    if not moves_by_force:
        complete("gain", servo.gainprm[0])
        complete("max_speed", speed)
    elif physics.max_force is None:
        speed = speed if physics.max_speed is None else physics.max_speed
        given |= {"max_force": speed * given.get("damping", physics.damping), "max_speed": None}
    whole = replace(physics, **given)
    _check(config, whole)
    return whole


def _check(config: Circle2DConfig, physics: PhysicsConfig) -> None:
    if physics.contact == "rigid":
        assert physics.ball_radius is not None
        assert physics.timestep is not None
        narrowest = 2 * physics.ball_radius / config.constraint_radius
        factor = config.corridor_height_factor
        if factor <= narrowest:
            raise ValueError(
                f"corridor_height_factor must be above {narrowest:g} where the region is rigid, "
                f"so that the agent's body fits into the corridor, got {factor!r}"
            )
        fastest = _LARGEST_STEP * physics.ball_radius / (math.sqrt(2) * physics.timestep)
        if (speed := top_speed(config, physics)) > fastest:
            raise ValueError(
                f"the ball may reach {speed:g} m/s on each axis, with which it could pass into the "
                f"rigid region: at most {fastest:g} with ball_radius {physics.ball_radius:g} and "
                f"timestep {physics.timestep:g}; lower max_speed, max_force or timestep"
            )
    if physics.contact == "soft":
        stiffest, lightest = span(physics, "stiffness")[1], span(physics, "mass")[0]
        ratio = span(physics, "damping_ratio")[1]
        most = lightest * _fastest_spring(physics.timestep, ratio) / (1 - _IMPEDANCE[1])
        if stiffest > most:
            raise ValueError(
                f"stiffness must be at most {most:g} with mass {lightest:g}, damping_ratio "
                f"{ratio:g} and timestep {physics.timestep:g}, got {stiffest!r}"
            )


def span(physics: PhysicsConfig, name: str) -> tuple[float, float]:
    """Least and greatest value of a parameter, which may be drawn."""
    value = getattr(physics, name)
    return physics.randomize.get(name, (value, value))


def top_speed(config: Circle2DConfig, physics: PhysicsConfig) -> float:
    """Greatest speed along an axis that the actuators can give the ball, m/s."""
    if physics.actuation == "velocity":
        return span(physics, "max_speed")[1]
    force, drag = span(physics, "max_force")[1], span(physics, "damping")[0]
    without_drag = math.sqrt(2 * force * 2 * config.arena / span(physics, "mass")[0])
    return min(force / drag, without_drag) if drag > 0 else without_drag


def full_action(physics: PhysicsConfig) -> str:
    """The parameter that is the control of a full action."""
    return "max_speed" if physics.actuation == "velocity" else "max_force"


def softness(
    physics: PhysicsConfig, stiffness: Any, damping_ratio: Any, mass: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """MuJoCo's solref [..., 2] and impedance [...] of a spring and damper: floats or arrays [...].

    In contact at rest MuJoCo's force is `m·k·depth / (1 - d)`, with solref (-k, -b) and constant
    impedance d; so `k = K (1 - d) / m`. The contact also takes a share d off other forces: d is
    next to 0. Where a spring of stiffness K would be faster than two physics steps, the shortest
    time constant of MuJoCo's own contacts, d is as near to 1 as keeps k there: the law at rest
    stays, and the limit is a rigid region. Source: MuJoCo's documentation, "Solver parameters".
    """
    low, high = _IMPEDANCE
    fastest = _fastest_spring(physics.timestep, damping_ratio)
    slack = np.clip(fastest * mass / stiffness, 1.0 - high, 1.0 - low)
    rate = np.asarray(stiffness * slack / mass)
    return np.stack((-rate, -2.0 * damping_ratio * np.sqrt(rate)), axis=-1), 1.0 - slack


def _fastest_spring(timestep: float | None, damping_ratio: Any) -> Any:
    """Greatest stiffness over mass that physics steps resolve, 1/s²."""
    assert timestep is not None
    return np.square(0.5 / (timestep * np.maximum(damping_ratio, 1.0)))


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
        joint.solimp_limit[2] *= scale  # a width, as the next one
    agent.solimp[2] *= scale
    spec.stat.extent, spec.stat.center = 2 * arena, [0.0, 0.0, 0.0]
    # A length and an energy per mass: absolute tolerances make small worlds less exact.
    spec.option.ccd_tolerance *= scale
    spec.option.tolerance *= scale**2


def _light(spec: mujoco.MjSpec, config: Circle2DConfig) -> None:
    """Add the cameras beside "top", a light that casts shadows, and the size of force arrows."""
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
    spec.visual.map.zfar = 200.0  # nearer, shadows have holes
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=16, height=96)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.75, 0.82, 0.9], [0.97, 0.97, 0.97]
    spec.visual.map.force = 0.02 * radius / BASE_RADIUS  # m for each N
    spec.visual.rgba.contactforce = [0.95, 0.5, 0.0, 1.0]
    spec.stat.meansize, spec.stat.meanmass = 0.15 * radius, 1.0


def _actuate(spec: mujoco.MjSpec, physics: PhysicsConfig) -> None:
    """Set up drag and actuators. Their greatest control is a full action."""
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
    """Set what the ball's contacts with the region are like, where they differ from the base's."""
    ball, slides = spec.geom("agent"), span(physics, "friction")[1] == 0.0
    if physics.contact == "none" or (physics.contact == "rigid" and slides):
        return
    ball.priority = 1  # its numbers hold, not the prisms'
    if physics.contact == "soft":
        # With "discrete", forces at rest would depend on damping and gain, and on their limits.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        numbers = physics.stiffness, physics.damping_ratio, physics.mass
        ball.solref, impedance = softness(physics, *numbers)
        ball.solimp[:2] = impedance
    ball.condim, ball.friction[0] = 1 if slides else 3, physics.friction
    if not slides:  # with a pyramid for a cone, friction would stay below its coefficient
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC


def _add_region(spec: mujoco.MjSpec, config: Circle2DConfig, physics: PhysicsConfig) -> None:
    height, radius = HEIGHT * config.constraint_radius, config.constraint_radius
    agent, soft = spec.geom("agent"), physics.contact == "soft"

    def prisms(name: str, pieces: list[NDArray], low: float, high: float, **more: Any) -> Any:
        for k, piece in enumerate(pieces):
            prism = [np.column_stack((piece, np.full(len(piece), z))) for z in (low, high)]
            # The inertia is not used; a shell's exists in small worlds too.
            shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            spec.add_mesh(name=f"{name}{k}", uservert=np.concatenate(prism).ravel(), inertia=shell)
            yield spec.worldbody.add_geom(
                spec.find_default("region"),
                name=f"{name}{k}",
                meshname=f"{name}{k}",
                solimp=agent.solimp,
                **more,
            )

    if soft:  # deep inside, the nearest side must be nearer than top and bottom
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

    Each strip is cut out of every piece that it meets. The parts to its left, to its right and
    behind its inner end remain; the latter reaches so far into the others. 3 pieces on level 1, 7
    on level 2, 11 on level 3, or more with an overlap.
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
    # A sliver's area does not matter, and its volume is too small for a convex hull.
    return [piece for piece in pieces if _area(piece) > 1e-9 * region.radius**2]


def _less(
    piece: NDArray,
    along: NDArray,
    across: NDArray,
    inner: float,
    half_width: float,
    overlap: float,
) -> list[NDArray]:
    """Split a convex polygon less the strip `p·along >= inner`, `|p·across| <= half_width`."""
    between = _clip(_clip(piece, across, -half_width), -across, -half_width)
    if not len(_clip(between, along, inner)):
        return [piece]
    wide = _clip(_clip(piece, across, -half_width - overlap), -across, -half_width - overlap)
    sides = [_clip(piece, across, half_width), _clip(piece, -across, half_width)]
    return [part for part in (_clip(wide, -along, -inner), *sides) if len(part)]


def _clip(polygon: NDArray, normal: NDArray, bound: float) -> NDArray:
    """Return the part of a convex polygon where `p·normal >= bound`; no vertices if empty."""
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
