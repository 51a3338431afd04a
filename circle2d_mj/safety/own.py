"""Tasks of your own, made from the suite's robots, objects, costs, lidars and rewards."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import gymnasium as gym

from circle2d_mj import registration
from circle2d_mj.core.simulation import positive_integer
from circle2d_mj.safety import scenes
from circle2d_mj.safety.families import ButtonTask, GoalTask, PushTask
from circle2d_mj.safety.navigation import NavigationTask
from circle2d_mj.safety.robots import AGENTS
from circle2d_mj.safety.scenes import KINDS, Placed, Scene
from circle2d_mj.safety.tasks import SafetyTask

FAMILIES: dict[str, type[NavigationTask]] = {
    "Goal": GoalTask,
    "Button": ButtonTask,
    "Push": PushTask,
}
_OF_FAMILY = {
    "Goal": {"goal": 1},
    "Button": {"buttons": 4, "goal": 1},
    "Push": {"goal": 1, "push_box": 1},
}
"""Objects that every task of a family has."""
OBJECTS = ("hazards", "vases", "pillars", "gremlins")
COSTS = {
    "hazards": "hazards",
    "vases_contact": "vases",
    "vases_velocity": "vases",
    "pillars": "pillars",
    "gremlins": "gremlins",
    "buttons": "buttons",
}
"""Kinds of costs, and the objects that cause them: by the agent being inside (hazards), by touch
(of buttons: a wrong one), or by their speed."""
KEEPOUTS = {"goal": 0.4, "hazards": 0.18, "vases": 0.15, "pillars": 0.3, "buttons": 0.2}
KEEPOUTS |= {"gremlins": 0.4, "push_box": scenes.BOX["Point"][0]}


def register(
    id: str,
    family: str | type[NavigationTask],
    objects: Mapping[str, int],
    *,
    costs: Sequence[str],
    agent: str = "Point",
    lidars: Sequence[str] | None = None,
    half_width: float = 1.5,
    max_episode_steps: int = 1000,
) -> None:
    """Register a task with Gymnasium, as in `register("MyGoal-v0", "Goal", {"hazards": 4}, ...)`.

    The task supports everything that the suite's tasks do: `gym.make`, the native vector
    environment, infos, parameters, pictures, the six values of `safety_gymnasium.make`, training.

    family: "Goal", "Button" or "Push", which adds its goal, box or four buttons and its reward; or
    a class derived from one in `circle2d_mj.safety.families`, which may replace `_reward`.
    objects: number of each of `OBJECTS`, in the order of placement; at most one of the kinds that
    move (box, vases, gremlins). costs: names from `COSTS`. agent: Point, Car, Doggo, Racecar or
    Ant. lidars: kinds of objects that are observed besides the agent's sensors, by default all.
    half_width: of the square in which everything is placed, m. Raises ValueError for names and
    values that are not allowed; `gymnasium.make` raises TypeError for unknown parameters.
    """
    task = FAMILIES.get(family) if isinstance(family, str) else family
    if task is None or getattr(task, "family", None) not in FAMILIES:
        raise ValueError(
            f"family must be one of {', '.join(FAMILIES)} or a subclass of one, got {family!r}"
        )
    _check("agent", [agent], AGENTS)
    _check("objects", objects, OBJECTS)
    counts = {**_OF_FAMILY[task.family], **objects}
    moving = [kind for kind in counts if kind == "push_box" or KINDS[kind].physics in _MOVES]
    if len(moving) > 1:
        raise ValueError(f"objects may hold one kind that moves, got {' and '.join(moving)}")
    costs, lidars = tuple(costs), tuple(counts if lidars is None else lidars)
    _check("costs", costs, [cost for cost, kind in COSTS.items() if kind in counts])
    _check("lidars", lidars, counts)
    placed = tuple(Placed(kind, number, KEEPOUTS[kind]) for kind, number in counts.items())
    changes = (*objects.items(), ("half_width", half_width))
    scene = scenes.scene(Scene(placed, half_width, lidars, costs), agent, changes)
    arguments = {"agent": agent, "level": scene}
    own = SafetyTask("", positive_integer("max_episode_steps", max_episode_steps), task, arguments)
    for name in (f"circle2d_mj/{id}", id):  # a second call replaces the first, as in Gymnasium
        if name in gym.registry and isinstance(gym.registry[name].kwargs.get("task"), SafetyTask):
            del gym.registry[name]
    if f"circle2d_mj/{id}" in gym.registry:
        raise ValueError(f"id {id!r} is a task of the suite: choose another")
    registration.add_safety(id, own, own)


_MOVES = ("free", "driven")


def _check(name: str, given: Collection[str], allowed: Collection[str]) -> None:
    for one in given:
        if one not in allowed:
            raise ValueError(f"{name} may hold {', '.join(allowed)}, got {one!r}")
    if len({*given}) < len(given):
        raise ValueError(f"{name} must be different, got {given!r}")
