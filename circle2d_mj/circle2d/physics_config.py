"""The physics of a Circle2D task: its parameters, their checks and their defaults."""

# mujoco has no stubs for MjSpec.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.assets import asset
from circle2d_mj.circle2d.config import Circle2DConfig, check_names, finite
from circle2d_mj.core.engine import mujoco

BASE = "xml/circle2d.xml"
BASE_RADIUS = 10.0
"""R of the scene in that file; for any other R the scene is scaled."""
DRAG, STIFFNESS = 10.0, 200.0
"""Defaults: damping with motors, N·s/m, and stiffness of a soft region, N/m."""
# Radii for which lengths, their squares and MuJoCo's float32 meshes keep their precision.
_RADII = (1e-3, 1e6)
# Lowest and highest impedance of a soft contact: see `softness`.
_IMPEDANCE = (1e-4, 0.9999)
# Largest distance that the ball may cover in a physics step, over its radius, if the region is
# rigid.
_LARGEST_STEP = 0.8
Actuation = Literal["velocity", "force"]
Contact = Literal["rigid", "soft", "none"]
CostRule = Literal["contact", "force"]
DRAWN = ("mass", "friction", "damping", "gain", "max_speed", "max_force", "stiffness")
DRAWN = (*DRAWN, "damping_ratio")
"""Parameters of the physics that `randomize` may draw."""


@dataclass(frozen=True)
class PhysicsConfig:
    """The physics of a Circle2D task in MuJoCo.

    None stands for the value in assets/xml/circle2d.xml, or for the one given below. A parameter
    that has no effect with the others (a stiffness of a rigid region) must stay None. Raises
    TypeError or ValueError, naming the parameter, for a value that is not allowed.
    """

    mass: float | None = None
    """Mass of the ball, kg; None: 1."""
    friction: float | None = None
    """Coulomb friction coefficient between ball and region; None: 0, the ball slides freely."""
    damping: float | None = None
    """Drag of the medium on the ball, N·s/m; None: 0 with velocity, 10 with force."""
    actuation: Actuation = "velocity"
    """velocity: servos whose target is the action; force: motors whose thrust is the action."""
    gain: float | None = None
    """Gain of the servos: force per difference of speed, N·s/m; None: 20."""
    max_speed: float | None = None
    """Speed on each axis that a full action sets as target, or with force reaches against the
    damping, m/s; None: `step_length` R per environment step."""
    max_force: float | None = None
    """Greatest force of each actuator, N; None: no limit for servos; for motors the thrust that
    holds max_speed against the damping."""
    substeps: int = 10
    """Physics steps per environment step."""
    timestep: float | None = None
    """Length of a physics step, s; None: 0.01."""
    ball_radius: float | None = None
    """Radius of the ball, m; None: 0.025 R."""
    contact: Contact | None = None
    """rigid: the region cannot be entered; soft: it pushes back like a spring; none: it is detected
    without force; None: the level's default, rigid on level 0 and none on levels 1 to 3."""
    stiffness: float | None = None
    """Soft region: force per depth of the ball in it, N/m; None: 200."""
    damping_ratio: float | None = None
    """Soft region: damping over the critical damping of the ball; None: 1."""
    cost: CostRule = "contact"
    """contact: a step costs 1 if the ball touched a region that pushes, or its centre ended in a
    region that does not push; force: if the region's force exceeded force_limit."""
    force_limit: float | None = None
    """Largest force of the region that costs nothing, N."""
    randomize: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges (low, high) by parameter; each parameter is drawn uniformly at every reset."""
    xml: str | os.PathLike[str] | None = None
    """Scene file that replaces assets/xml/circle2d.xml, for more geoms or other looks; it needs
    every element that the original names. Anything else that the ball touches is region too."""

    def __post_init__(self) -> None:
        for name, allowed in (("actuation", Actuation), ("contact", Contact), ("cost", CostRule)):
            value, words = getattr(self, name), get_args(allowed)
            if value not in words and not (name == "contact" and value is None):
                raise ValueError(f"{name} must be one of {words}, got {value!r}")
        if type(self.substeps) is not int or self.substeps < 1:
            raise ValueError(f"substeps must be a positive integer, got {self.substeps!r}")
        for name in (*DRAWN, "timestep", "ball_radius", "force_limit"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, self._checked(name, value))
        object.__setattr__(self, "randomize", self._ranges())
        self._refuse_without_effect()
        if (self.cost == "force") != (self.force_limit is not None):
            given = f"got cost={self.cost!r}, force_limit={self.force_limit!r}"
            raise ValueError(f"force_limit must be given with cost='force', and only then, {given}")
        if self.cost == "force" and self.contact == "none":
            raise ValueError("cost 'force' needs a region that pushes: contact 'rigid' or 'soft'")
        if self.xml is not None:
            if not isinstance(self.xml, (str, os.PathLike)):
                raise TypeError(f"xml must be the path of a file, got {self.xml!r}")
            object.__setattr__(self, "xml", os.fspath(self.xml))

    def _checked(self, name: str, value: Any) -> float:
        number = finite(name, value)
        zero = name in ("friction", "damping", "damping_ratio", "force_limit")
        if number < 0 or (number == 0 and not zero):
            raise ValueError(f"{name} must be {'at least' if zero else 'above'} 0, got {value!r}")
        return number

    def _refuse_without_effect(self) -> None:
        """Raise ValueError for a given parameter that has no effect."""
        by_force, contact = self.actuation == "force", f"contact={self.contact!r}"
        if by_force and "max_speed" in self.randomize:
            raise ValueError("randomize: with actuation='force' draw max_force, not max_speed")
        useless = {
            "gain": by_force and "actuation='force'",
            "max_speed": by_force
            and self.max_force is not None
            and "actuation='force' and max_force",
            "stiffness": self.contact != "soft" and contact,
            "damping_ratio": self.contact != "soft" and contact,
            "friction": self.contact == "none" and contact,
        }
        for name, beside in useless.items():
            if beside and (getattr(self, name) is not None or name in self.randomize):
                raise ValueError(f"{name} has no effect with {beside}: leave it out")

    def _ranges(self) -> dict[str, tuple[float, float]]:
        if not isinstance(self.randomize, Mapping):
            raise TypeError(f"randomize must be ranges by name, got {self.randomize!r}")
        check_names(self.randomize, DRAWN, "randomize: ")
        ranges = {}
        for name in sorted(self.randomize):
            given = self.randomize[name]
            try:
                low, high = given
            except (TypeError, ValueError):
                raise ValueError(f"randomize: {name} must be (low, high), got {given!r}") from None
            low, high = self._checked(name, low), self._checked(name, high)
            if low > high:
                raise ValueError(f"randomize: {name} must be (low, high), got {given!r}")
            ranges[name] = (low, high)
        return ranges


def base_scene(physics: PhysicsConfig) -> mujoco.MjSpec:
    """Return the scene before a task changes it. Raises ValueError if a user's scene lacks an
    element that a task changes or reads."""
    path = asset(BASE) if physics.xml is None else Path(physics.xml)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise ValueError(f"xml {str(path)!r} is no scene that MuJoCo reads: {error}") from error
    ball = spec.body("agent")
    there = {
        'a geom "floor"': spec.geom("floor"),
        'a camera "top"': spec.camera("top"),
        'a body "agent" with an inertial and its mass': ball is not None and ball.mass > 0,
        'in that body the two joints of all, slides "x" and "y"': _names(spec.joints) == ["x", "y"]
        and _names(ball.joints if ball else ()) == ["x", "y"],
        'the two actuators of all, velocity servos "x" and "y"': _names(spec.actuators)
        == ["x", "y"],
        'a sphere "agent"': spec.geom("agent"),
        'the first sensors "force" and "distance"': _names(spec.sensors)[:2]
        == ["force", "distance"],
        'a default class "region"': spec.find_default("region"),
        'no region, which a task adds ("region0")': spec.geom("region0") is None,
    }
    if missing := [words for words, found in there.items() if not found]:
        raise ValueError(
            f"xml {str(path)!r} needs {'; '.join(missing)}: start from a copy of {asset(BASE)}"
        )
    return spec


def _names(elements: Iterable[Any]) -> list[str]:
    return [element.name for element in elements]


def completed(config: Circle2DConfig, physics: PhysicsConfig) -> PhysicsConfig:
    """Return the physics with every None replaced by the base scene's or the task's default.

    Raises ValueError for a constraint_radius outside [1e-3, 1e6], a contact that contradicts
    infeasible_region_penetratable, a rigid corridor too narrow for the ball, a ball so fast that it
    could pass into a rigid region, and a stiffness that the timestep does not resolve.
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
    base = base_scene(physics)
    ball, [servo, _], [joint, _] = base.geom("agent"), base.actuators, base.joints
    by_force = physics.actuation == "force"
    usual = {
        "timestep": base.option.timestep,
        "mass": base.body("agent").mass,
        "ball_radius": ball.size[0] * (radius / BASE_RADIUS),
        "damping": DRAG if by_force else joint.damping[0],
    }
    speed = config.full_step / (physics.substeps * (physics.timestep or usual["timestep"]))
    if contact != "none":
        usual["friction"] = ball.friction[0] if ball.condim > 1 else 0.0
    if contact == "soft":
        usual |= {"stiffness": STIFFNESS, "damping_ratio": 1.0}
    if not by_force:
        usual |= {"gain": servo.gainprm[0], "max_speed": speed}
    given: dict[str, Any] = {k: float(v) for k, v in usual.items() if getattr(physics, k) is None}
    if by_force and physics.max_force is None:
        speed = speed if physics.max_speed is None else physics.max_speed
        given |= {"max_force": speed * given.get("damping", physics.damping), "max_speed": None}
    whole = replace(physics, contact=contact, **given)
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
                f"corridor_height_factor must be above {narrowest:g} if the region is rigid, "
                f"so that the agent's body fits into the corridor, got {factor!r}"
            )
        fastest = _LARGEST_STEP * physics.ball_radius / (math.sqrt(2) * physics.timestep)
        if (speed := top_speed(config, physics)) > fastest:
            raise ValueError(
                f"the ball may reach {speed:g} m/s on each axis, and could pass into the rigid "
                f"region: at most {fastest:g} is allowed with ball_radius {physics.ball_radius:g} "
                f"and timestep {physics.timestep:g}; lower max_speed, max_force or timestep"
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
    """Return the least and the greatest value of a parameter that may be in `randomize`."""
    value = getattr(physics, name)
    return physics.randomize.get(name, (value, value))


def top_speed(config: Circle2DConfig, physics: PhysicsConfig) -> float:
    """Return the greatest speed along an axis that the actuators can give the ball, m/s."""
    if physics.actuation == "velocity":
        return span(physics, "max_speed")[1]
    force, drag = span(physics, "max_force")[1], span(physics, "damping")[0]
    without_drag = math.sqrt(2 * force * 2 * config.arena / span(physics, "mass")[0])
    return min(force / drag, without_drag) if drag > 0 else without_drag


def full_action(physics: PhysicsConfig) -> str:
    """Return the name of the parameter whose value is the control of a full action."""
    return "max_speed" if physics.actuation == "velocity" else "max_force"


def softness(
    physics: PhysicsConfig, stiffness: Any, damping_ratio: Any, mass: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return MuJoCo's solref [..., 2] and impedance [...] for a spring and damper.

    stiffness K, damping_ratio, mass m: floats or arrays [...]. In contact at rest, MuJoCo's force
    is `m·k·depth / (1 - d)` with solref (-k, -b) and constant impedance d; so `k = K (1 - d) / m`.
    The contact also removes a share d of other forces, so d is close to 0. If a spring of stiffness
    K would be faster than two physics steps, the shortest time constant of MuJoCo's own contacts, d
    is raised until k meets it: the force at rest stays the same, and the limit is a rigid region.
    Source: MuJoCo's documentation, "Solver parameters".
    """
    low, high = _IMPEDANCE
    fastest = _fastest_spring(physics.timestep, damping_ratio)
    slack = np.clip(fastest * mass / stiffness, 1.0 - high, 1.0 - low)
    rate = np.asarray(stiffness * slack / mass)
    return np.stack((-rate, -2.0 * damping_ratio * np.sqrt(rate)), axis=-1), 1.0 - slack


def _fastest_spring(timestep: float | None, damping_ratio: Any) -> Any:
    """Return the greatest stiffness over mass that the physics steps resolve, 1/s²."""
    assert timestep is not None
    return np.square(0.5 / (timestep * np.maximum(damping_ratio, 1.0)))
