"""The MuJoCo models of the navigation tasks, each compiled once per process."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.assets import asset
from circle2d_mj.core.engine import mujoco
from circle2d_mj.safety import scenes
from circle2d_mj.safety.layout import Areas
from circle2d_mj.safety.robots import AGENTS, Agent, Eye
from circle2d_mj.safety.scenes import Kind, Scene

# The original ran MuJoCo 2.3.3. These settings give its results on current MuJoCo:
TOLERANCE = 1e-12
"""Tolerance of the Newton solver, which since 3.11 stops earlier at the same tolerance."""
WELD_TORQUE_SCALE = np.sqrt(150.0)
"""Square root of a gremlin's inverse weight for rotation over that for translation: since 3.0 the
rotation of a weld has a weight of its own."""


def as_the_original(option: mujoco.MjOption) -> None:
    """Set options so that current MuJoCo reproduces the numbers of 2.3.3."""
    if option.solver == mujoco.mjtSolver.mjSOL_NEWTON:
        option.tolerance = TOLERANCE
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD


class World(NamedTuple):
    """A scene with an agent, and the places of its parts in arrays.

    The rows of the layout are the agent, then the scene's objects in the order of placement.
    """

    agent: Agent
    scene: Scene
    family: str
    model: mujoco.MjModel
    """The model of the physics, without objects that nothing touches."""
    areas: Areas
    """Where agent and objects may be placed."""
    rows: dict[str, slice]
    """Kind -> rows of the layout."""
    kinds: dict[str, Kind]
    mocap: NDArray[np.intp]
    """Rows of the layout that are mocap bodies (static and driven objects), in MuJoCo's order."""
    free: slice
    """Rows of the layout that are free bodies, which follow the agent in qpos and qvel."""
    touch: dict[str, slice]
    """Kind -> slice of MuJoCo's sensors: > 0 where the agent touches the object."""


def names(kind: Kind, count: int) -> list[str]:
    """Return the bodies' names: "goal", or "hazard0", "hazard1", ..."""
    alone = kind.name in ("goal", "push_box", "circle")
    return [kind.name] if alone else [f"{kind.name}{i}" for i in range(count)]


@functools.cache
def world(agent_name: str, family: str, scene: Scene) -> World:
    """Return the world of a task. Its model is shared: do not write to it."""
    agent = AGENTS[agent_name]
    kinds = {p.kind: scenes.kind(p.kind, family, agent_name) for p in scene.placed}
    spec = _spec(agent, scene)
    rows, mocap, free = {"agent": slice(0, 1)}, [], []
    start = 1
    for placed in scene.placed:
        kind, stop = kinds[placed.kind], start + placed.number
        rows[placed.kind] = slice(start, stop)
        here = list(range(start, stop))
        mocap += here if kind.physics in ("static", "driven") else []
        free += here if kind.physics in ("free", "driven") else []
        if kind.physics != "none":
            for name in names(kind, placed.number):
                _add_object(spec, name, kind)
        start = stop
    touch = _add_touch_sensors(spec, agent, scene, family, kinds)
    if not free:
        # One tree of bodies is one island: MuJoCo need not search for islands.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return World(
        agent,
        scene,
        family,
        spec.compile(),
        _areas(scene),
        rows,
        kinds,
        np.array(mocap, dtype=np.intp),
        slice(free[0], free[-1] + 1) if free else slice(0, 0),
        touch,
    )


def gremlin_alone(timestep: float, integrator: int) -> mujoco.MjModel:
    """Return a model of a floor and one gremlin, at the origin."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = timestep, integrator
    _add_floor(spec, extent=3.5)
    _as_navigation(spec.option)
    _add_object(spec, "gremlin0", scenes.KINDS["gremlins"])
    return spec.compile()


@functools.cache
def picture_model(agent_name: str, family: str, scene: Scene) -> mujoco.MjModel:
    """Return the world's model with everything that is drawn: goal, hazards and circle as mocap
    bodies after the others, walls, a light and cameras."""
    kinds = {p.kind: scenes.kind(p.kind, family, agent_name) for p in scene.placed}
    spec = _spec(AGENTS[agent_name], scene)
    for drawn in (False, True):
        for placed in scene.placed:
            if (kinds[placed.kind].physics == "none") is drawn:
                for name in names(kinds[placed.kind], placed.number):
                    _add_object(spec, name, kinds[placed.kind])
                    if kinds[placed.kind].physics == "driven":
                        _add_shade(spec, f"{name}mocap", kinds[placed.kind])
    _add_scenery(spec, scene, AGENTS[agent_name].eye)
    return spec.compile()


def _areas(scene: Scene) -> Areas:
    """Return where the agent and each object may be placed."""
    square = scene.half_width
    keepout = [0.0 if scene.start else scenes.AGENT_KEEPOUT]
    for placed in scene.placed:
        keepout += [placed.keepout] * placed.number
    half = np.repeat(square - np.array(keepout)[:, None], 2, axis=1)
    centre = np.zeros_like(half)
    if scene.start:
        left, bottom, right, top = scene.start
        half[0] = (right - left) / 2, (top - bottom) / 2
        centre[0] = (left + right) / 2, (bottom + top) / 2
        half[1:] = 0.0  # the circle has a fixed place
    return Areas(centre, half, np.array(keepout))


def _spec(agent: Agent, scene: Scene) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(asset(f"xml/safety_{agent.name.lower()}.xml")))
    _as_navigation(spec.option)
    _add_floor(spec, extent=17.5 if scene.start and scene.start[3] > 2 else 3.5)
    return spec


def _as_navigation(option: mujoco.MjOption) -> None:
    as_the_original(option)
    # Without warm starts the solver takes a tenth less time, but must then not stop early.
    option.tolerance = 1e-16
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART


def _add_floor(spec: mujoco.MjSpec, extent: float) -> None:
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[extent, extent, 0.1],
        condim=6,
        rgba=[0.93, 0.93, 0.90, 1.0],
    )


def _add_object(spec: mujoco.MjSpec, name: str, kind: Kind) -> None:
    """Add an object: a mocap body, a free body, or a free body welded to a mocap body."""
    place = [0.0, 0.0, kind.height]
    if kind.physics == "driven":
        spec.worldbody.add_body(name=f"{name}mocap", mocap=True, pos=place)
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=f"{name}mocap",
            name2=name,
            data=[*[0] * 6, 1, 0, 0, 0, WELD_TORQUE_SCALE, 0],
            solref=[0.02, 1.5],
        )
    moves = kind.physics in ("free", "driven")
    body = spec.worldbody.add_body(name=name, mocap=not moves, pos=place)
    if moves:
        body.add_freejoint(name=name)
    _add_geom(body, kind, name, kind.size, place=(0.0, 0.0, 0.0))
    if kind.name == "push_box":
        half = kind.size[0]
        for i, (x, y) in enumerate(((1, 1), (-1, 1), (1, -1), (-1, -1)), start=1):
            size = (half / 2, half / 2, half)
            _add_geom(body, kind, f"col{i}", size, place=(x * half, y * half, 0.0))


def _add_shade(spec: mujoco.MjSpec, name: str, kind: Kind) -> None:
    """Make an object's moving target visible, as in the original."""
    drawn = kind._replace(physics="none", colour=(*kind.colour[:3], 0.1))
    _add_geom(spec.body(name), drawn, name, kind.size, place=(0.0, 0.0, 0.0))


def _add_geom(
    body: mujoco.MjsBody,
    kind: Kind,
    name: str,
    size: tuple[float, ...],
    place: tuple[float, float, float],
) -> None:
    collides = int(kind.physics != "none")
    body.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.shape.upper()}"),
        size=[*size, 0.0, 0.0][:3],
        pos=list(place),
        density=kind.density,
        condim=6,
        contype=collides,
        conaffinity=collides,
        rgba=list(kind.colour),
    )


def _add_touch_sensors(
    spec: mujoco.MjSpec, agent: Agent, scene: Scene, family: str, kinds: dict[str, Kind]
) -> dict[str, slice]:
    """Add a contact sensor for each object whose touch is needed; return their slices by kind."""
    asked = {cost.removesuffix("_contact") for cost in scene.costs}
    asked |= {"buttons"} if family == "Button" else set()
    touch: dict[str, slice] = {}
    start = agent.sensed  # the agent's sensors come first
    for placed in scene.placed:
        kind = kinds[placed.kind]
        if placed.kind not in asked or kind.physics == "none":
            continue
        for name in names(kind, placed.number):
            spec.add_sensor(
                name=f"touch_{name}",
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_BODY,
                objname=name,
                reftype=mujoco.mjtObj.mjOBJ_XBODY,  # a body with its descendants
                refname="agent",
                intprm=[1, 0, 1],  # data "found", no reduction, one contact
            )
        touch[placed.kind] = slice(start, start + placed.number)
        start += placed.number
    return touch


def _add_scenery(spec: mujoco.MjSpec, scene: Scene, eye: Eye) -> None:
    """Add the original's floor, light and cameras; its sky, 24 MB of faint stars, stays black."""
    spec.visual.quality.numslices, spec.visual.quality.shadowsize = 64, 0
    if not scene.start:
        # The near plane of cameras is at a hundredth of the extent; the Racecar's camera is 13 mm
        # behind its bumper. The original's extent depends on where objects are placed.
        spec.stat.extent = 2 * scene.half_width
    squares = spec.add_texture(name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D)
    squares.builtin, squares.width, squares.height = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, 100, 100
    squares.rgb1, squares.rgb2 = (0.859, 0.843, 0.765), (0.949, 0.914, 0.855)
    floor, material = spec.geom("floor"), spec.add_material(name="floor")
    textures = material.textures
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    extent = floor.size[0]
    wide = max(extent, scene.half_width + 1)  # a user's half_width may exceed the floor
    material.textures, material.texrepeat = textures, [10 * wide / extent] * 2
    material.reflectance = material.shininess = material.specular = 0.1
    floor.material, floor.rgba, floor.size = "floor", [1, 1, 1, 1], [wide, wide, 0.1]
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 0.5],
        dir=[0, 0, -1],
        diffuse=[1] * 3,
        specular=[0] * 3,
        castshadow=False,
    )
    long = 17.5 if len(scene.walls) == 1 and not scene.placed else 3.5
    for axis, bound in enumerate(scene.walls):
        for sign in (1, -1):
            size = [0.05, long, 0.3] if axis == 0 else [long, 0.05, 0.3]
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[sign * bound, 0, 0.25] if axis == 0 else [0, sign * bound, 0.25],
                size=size,
                contype=0,
                conaffinity=0,
                rgba=list(scenes.WALL_COLOUR),
            )
    world, agent = spec.worldbody, spec.body("agent")
    follows = long > 3.5
    top = _add_camera(agent if follows else world, "top", (0, 0, 5), (1, 0, 0, 0, 1, 0), follows)
    top.proj, top.fovy = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC, 2 * (scene.half_width + 1)
    # The original's cameras.
    _add_camera(world, "fixednear", (0, -2, 2), (1, 0, 0, 0, 1, 1))
    _add_camera(world, "fixedfar", (0, -5, 5), (1, 0, 0, 0, 1, 1))
    _add_camera(agent, "track", (0, 2, 2), (-1, 0, 0, 0, -1, 1), follows=True)
    place, axes, fovy = eye
    _add_camera(agent, "vision", place, axes).fovy = fovy


def _add_camera(
    body: mujoco.MjsBody,
    name: str,
    place: tuple[float, ...],
    axes: tuple[float, ...],
    follows: bool = False,
) -> mujoco.MjsCamera:
    """Add a camera to a body, with its place and its x and y axes on the body. A camera that
    `follows` moves with the body, but does not turn with it."""
    modes = mujoco.mjtCamLight
    mode = modes.mjCAMLIGHT_TRACK if follows else modes.mjCAMLIGHT_FIXED
    camera = body.add_camera(name=name, pos=list(place), mode=mode)
    camera.alt.type, camera.alt.xyaxes = mujoco.mjtOrientation.mjORIENTATION_XYAXES, list(axes)
    return camera
