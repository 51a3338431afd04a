"""Parameters of a Circle2D task and of its physics, with their checks."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from numbers import Integral, Real
from typing import Any, Literal, get_args

from circle2d_mj.circle2d.region import CostRegion, Rectangle, StartArea

LEVELS = (0, 1, 2, 3)
_STEP = 0.11
_BOUNDS = {  # lowest value, whether it is allowed, and highest value
    "constraint_radius": (1e-100, True, 1e100),  # squares must stay finite
    "init_radius_multiplier": (0.0, False, 1e6),
    "corridor_height_factor": (0.0, False, 2.0),
    "init_region_size": (0.0, True, math.inf),
}
_SWITCHES = (
    "infeasible_region_penetratable",
    "reset_on_cost",
    "allow_infeasible_init",
    "sparse_reward",
)


@dataclass(frozen=True)
class Circle2DConfig:
    """One Circle2D task: its level and the paper's nine customization parameters.

    Lengths are in world units; a factor multiplies `constraint_radius`, so the task is the same at
    any radius. Source: safe_exploration.tex, table "Circle2D environment customization parameters".

    Raises TypeError or ValueError, naming the parameter, for a value that is not allowed;
    ValueError where no feasible start is left.
    """

    level: int = 1
    """0: the region cannot be entered. 1: it can, at a cost. 2, 3: two and four more cut-outs."""
    constraint_radius: float = 10.0
    """Radius R of the circular cost region."""
    init_radius_multiplier: float = 1.5
    """Half-width of the square arena, and the farthest start, as a multiple of R."""
    corridor_height_factor: float = 0.5
    """Height of the left corridor as a multiple of R, in (0, 2]; resizes the cut-outs as well."""
    init_region_size: float = 0.5
    """Height of the start area on the right as a multiple of R; half of it is its depth into R."""
    optima_perturbation: tuple[float, float] = (0.0, 0.0)
    """Offset of the optimum from the centre, world units; the optimum must lie in the disc."""
    infeasible_region_penetratable: bool | None = None
    """Whether the region can be entered. None means the level's default (False for level 0). It is
    resolved when the config is made: `dataclasses.replace(config, level=...)` must give it anew."""
    reset_on_cost: bool = False
    """Whether a step with cost ends the episode."""
    allow_infeasible_init: bool = False
    """Whether an episode may start inside the cost region."""
    sparse_reward: bool = False
    """Whether reward is given only inside the corridor and the cut-outs."""

    def __post_init__(self) -> None:
        if not isinstance(self.level, Integral) or isinstance(self.level, bool):
            raise TypeError(f"level must be an integer, got {self.level!r}")
        if self.level not in LEVELS:
            raise ValueError(f"level must be one of {LEVELS}, got {self.level!r}")
        self._set("level", int(self.level))
        for name, (low, low_allowed, high) in _BOUNDS.items():
            value = _number(name, getattr(self, name))
            if not (value >= low if low_allowed else value > low) or value > high:
                lower = f"{'at least' if low_allowed else 'above'} {low:g}"
                upper = f" and at most {high:g}" if high < math.inf else ""
                raise ValueError(f"{name} must be {lower}{upper}, got {value!r}")
            self._set(name, value)
        self._set("optima_perturbation", self._optimum())
        if self.infeasible_region_penetratable is None:
            self._set("infeasible_region_penetratable", self.level > 0)
        for name in _SWITCHES:
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise TypeError(f"{name} must be True or False, got {value!r}")
        depth, reach = self.init_region_size / 2, self.init_radius_multiplier
        if not (depth <= reach and -reach <= 1 - depth <= reach):
            raise ValueError(
                f"init_region_size {self.init_region_size:g} puts the start area outside the arena "
                f"of init_radius_multiplier {reach:g}: size / 2 and |1 - size / 2| must be at most "
                "the multiplier"
            )
        _ = self.start_area  # refuses a task without a feasible start here, not at its reset

    @cached_property
    def region(self) -> CostRegion:
        """Cost region of this task."""
        return CostRegion(self)

    @cached_property
    def start_area(self) -> StartArea:
        """Start area of this task's episodes."""
        avoid = None if self.allow_infeasible_init else self.region
        return StartArea(self.start_rectangle, avoid)

    @property
    def arena(self) -> float:
        """Half-width of the arena, the square `[-arena, arena]²`, in world units."""
        return self.init_radius_multiplier * self.constraint_radius

    @property
    def full_step(self) -> float:
        """Distance that a full action moves the agent along each axis in a step, world units."""
        return _STEP * self.constraint_radius

    @property
    def start_rectangle(self) -> Rectangle:
        """Lower and upper corner of the start area, ((x, y), (x, y)), in world units."""
        radius, half_height = self.constraint_radius, self.init_region_size / 2
        return (
            ((1 - half_height) * radius, -half_height * radius),
            (self.arena, half_height * radius),
        )

    @classmethod
    def of(cls, config: Circle2DConfig | None, parameters: dict[str, Any]) -> Circle2DConfig:
        """Return the given configuration, or make one of named parameters.

        Both may be given if the only parameter is `level`, as a registered id passes it, and equals
        the configuration's. Raises TypeError for an unknown name (with the nearest valid one) and
        where both are given otherwise.
        """
        if config is not None and not isinstance(config, cls):
            raise TypeError(f"config must be a Circle2DConfig, got {config!r}")
        if config is not None and parameters and parameters != {"level": config.level}:
            given = ", ".join(f"{name}={value!r}" for name, value in sorted(parameters.items()))
            raise TypeError(f"give either config or parameters, not both: got {config}, {given}")
        check_names(parameters, cls)
        return config or cls(**parameters)

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _optimum(self) -> tuple[float, float]:
        name, given = "optima_perturbation", self.optima_perturbation
        try:
            x, y = (_number(name, v) for v in given)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name} must be two finite numbers, got {given!r}") from None
        if math.hypot(x, y) >= self.constraint_radius:
            raise ValueError(
                f"{name} must keep the optimum inside the disc of constraint_radius "
                f"{self.constraint_radius:g}, got {given!r}"
            )
        return x, y


Actuation = Literal["velocity", "force"]
Contact = Literal["rigid", "soft", "none"]
CostRule = Literal["contact", "force"]
Camera = Literal["top", "side", "follow"]
"""Where MuJoCo's frames are seen from: above, the side, or behind the agent"""
DRAWN = ("mass", "friction", "damping", "gain", "max_speed", "max_force", "stiffness")
DRAWN = (*DRAWN, "damping_ratio")
"""Parameters of the physics that `randomize` may draw."""


@dataclass(frozen=True)
class PhysicsConfig:
    """The physics of a Circle2D task in MuJoCo.

    None is what assets/xml/circle2d.xml holds, or what the text says. A parameter that has no
    effect beside the others (a stiffness of a rigid region) must stay None. Raises TypeError or
    ValueError, naming the parameter, for a value that is not allowed.
    """

    mass: float | None = None
    """Mass of the ball, kg; None: 1."""
    friction: float | None = None
    """Coulomb's coefficient between ball and region; None: 0, it slides freely."""
    damping: float | None = None
    """Drag of the medium on the ball, N·s/m; None: 0 with velocity, 10 with force."""
    actuation: Actuation = "velocity"
    """velocity: servos whose target is the action; force: motors whose thrust is the action."""
    gain: float | None = None
    """Servo: force per difference of speed, N·s/m; None: 20."""
    max_speed: float | None = None
    """Speed that a full action asks for on each axis, m/s, with force that it reaches against the
    damping; None: 0.11 R in a step."""
    max_force: float | None = None
    """Greatest force of each actuator, N; None: servos have no limit, motors the thrust that holds
    max_speed against the damping."""
    substeps: int = 10
    """Physics steps in a step of the task."""
    timestep: float | None = None
    """Length of a physics step, s; None: 0.01."""
    ball_radius: float | None = None
    """Radius of the ball, m; None: 0.025 R."""
    contact: Contact | None = None
    """rigid: the region cannot be entered; soft: it pushes back like a spring; none: it is detected
    without force; None: the level's, rigid on level 0 and none on levels 1 to 3."""
    stiffness: float | None = None
    """Soft region: its force per depth of the ball in it, N/m; None: 200."""
    damping_ratio: float | None = None
    """Soft region: its damping over the critical one of the ball; None: 1."""
    cost: CostRule = "contact"
    """contact: a step costs 1 where the ball touched a region that pushes, or where its centre
    ended in one that does not; force: where the region's force exceeded force_limit."""
    force_limit: float | None = None
    """Largest force of the region that costs nothing, N."""
    randomize: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges, lower and upper end, from which parameters are drawn anew, uniformly, at every
    reset."""

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
        self._refuse_without_effect()
        if (self.cost == "force") != (self.force_limit is not None):
            given = f"got cost={self.cost!r}, force_limit={self.force_limit!r}"
            raise ValueError(f"force_limit must be given with cost='force', and only then, {given}")
        if self.cost == "force" and self.contact == "none":
            raise ValueError("cost 'force' needs a region that pushes: contact 'rigid' or 'soft'")
        object.__setattr__(self, "randomize", self._ranges())

    def _checked(self, name: str, value: Any) -> float:
        number = _number(name, value)
        zero = name in ("friction", "damping", "damping_ratio", "force_limit")
        if number < 0 or (number == 0 and not zero):
            raise ValueError(f"{name} must be {'at least' if zero else 'above'} 0, got {value!r}")
        return number

    def _refuse_without_effect(self) -> None:
        """ValueError for a parameter that is given though nothing depends on it."""
        by_force, contact = self.actuation == "force", f"contact={self.contact!r}"
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


def check_names(given: Iterable[str], valid: type | Iterable[str], where: str = "") -> None:
    """Raise TypeError for a name that is none of the valid ones, or of the fields of a dataclass,
    with the nearest of them."""
    names = [f.name for f in fields(valid)] if isinstance(valid, type) else list(valid)
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            # Python's own words, by which callers (TorchRL) see that they may do without it.
            raise TypeError(
                f"{where}got an unexpected keyword argument {name!r}: {hint}"
                f"the parameters are {', '.join(names)}"
            )


def _number(name: str, value: Any) -> float:
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number, got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {value!r}")
    return number
