"""Parameters of a Circle2D task, with their checks."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Integral, Real
from typing import Any, Literal

from circle2d_mj.circle2d.region import CostRegion, Rectangle, StartArea

LEVELS = (0, 1, 2, 3)
Camera = Literal["top", "side", "follow"]
"""Camera of MuJoCo's frames: above, at the side of, or behind the agent."""
_BOUNDS = {  # lowest value, whether that value is allowed, and highest value
    "constraint_radius": (1e-100, True, 1e100),  # squares must stay finite
    "init_radius_multiplier": (0.0, False, 1e6),
    "corridor_height_factor": (0.0, False, 2.0),
    "cutout_depth": (0.0, False, 0.8),
    "step_length": (0.0, False, 2.0),
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
    """One Circle2D task: its level, the paper's nine customization parameters, `cutout_depth` and
    `step_length`.

    Lengths are in world units or multiples of `constraint_radius`; with multiples alone, the task
    is the same at any radius. Source: safe_exploration.tex, table "Circle2D environment
    customization parameters".

    Raises TypeError or ValueError, naming the parameter, for a value that is not allowed, and
    ValueError if no feasible start is left.
    """

    level: int = 1
    """0: the region cannot be entered. 1: entering it costs. 2, 3: two and four more cut-outs."""
    constraint_radius: float = 10.0
    """Radius R of the circular cost region."""
    init_radius_multiplier: float = 1.5
    """Half-width of the square arena, and largest x of a start, as a multiple of R."""
    corridor_height_factor: float = 0.5
    """Height of the left corridor as a multiple of R, in (0, 2]; resizes the cut-outs as well."""
    init_region_size: float = 0.5
    """Height of the start area on the right as a multiple of R; it reaches half of that into R."""
    optima_perturbation: tuple[float, float] = (0.0, 0.0)
    """Offset of the optimum from the centre in world units; the optimum must lie in the disc."""
    infeasible_region_penetratable: bool | None = None
    """Whether the region can be entered. None: the level's default (False for level 0), resolved
    when the config is made, so that `dataclasses.replace(config, level=...)` must set it again."""
    reset_on_cost: bool = False
    """Whether a step with cost ends the episode."""
    allow_infeasible_init: bool = False
    """Whether an episode may start inside the cost region."""
    sparse_reward: bool = False
    """Whether reward is given only inside the corridor and the cut-outs."""
    cutout_depth: float = 0.5
    """Depth of the top and bottom cut-outs (levels 2 and 3) as a multiple of R, in (0, 0.8]; the
    diagonal cut-outs (level 3) are 0.6 times as deep. The paper specifies neither."""
    step_length: float = 0.11
    """Distance per environment step along each axis with a full action, as a multiple of R, in
    (0, 2]. The paper does not specify it."""

    def __post_init__(self) -> None:
        if not isinstance(self.level, Integral) or isinstance(self.level, bool):
            raise TypeError(f"level must be an integer, got {self.level!r}")
        if self.level not in LEVELS:
            raise ValueError(f"level must be one of {LEVELS}, got {self.level!r}")
        self._set("level", int(self.level))
        for name, (low, low_allowed, high) in _BOUNDS.items():
            value = finite(name, getattr(self, name))
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
        _ = self.start_area  # raises if there is no feasible start, before any reset

    @cached_property
    def region(self) -> CostRegion:
        """Cost region of this task."""
        return CostRegion(self)

    @cached_property
    def start_area(self) -> StartArea:
        """Area in which this task's episodes start."""
        avoid = None if self.allow_infeasible_init else self.region
        return StartArea(self.start_rectangle, avoid)

    @property
    def arena(self) -> float:
        """Half-width of the arena, the square `[-arena, arena]²`, in world units."""
        return self.init_radius_multiplier * self.constraint_radius

    @property
    def full_step(self) -> float:
        """`step_length` in world units."""
        return self.step_length * self.constraint_radius

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
        """Return the given configuration, or make one from named parameters.

        Both may be given if the only parameter is `level`, which a registered id passes, and equals
        the configuration's. Raises TypeError if both are given otherwise, and for an unknown name,
        suggesting the nearest valid one.
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
            x, y = (finite(name, v) for v in given)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name} must be two finite numbers, got {given!r}") from None
        if math.hypot(x, y) >= self.constraint_radius:
            raise ValueError(
                f"{name} must keep the optimum inside the disc of constraint_radius "
                f"{self.constraint_radius:g}, got {given!r}"
            )
        return x, y


def check_names(given: Iterable[str], valid: type | Iterable[str], where: str = "") -> None:
    """Raise TypeError, suggesting the nearest valid name, for a name that is not valid. valid: the
    names, or a dataclass with fields of these names."""
    names = [f.name for f in fields(valid)] if isinstance(valid, type) else list(valid)
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            # Python's own words: TorchRL recognises them and drops the argument.
            raise TypeError(
                f"{where}got an unexpected keyword argument {name!r}: {hint}"
                f"the parameters are {', '.join(names)}"
            )


def finite(name: str, value: Any) -> float:
    """Return a finite number as a float. Raises TypeError or ValueError, naming it, otherwise."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number, got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {value!r}")
    return number
