"""States recorded from safety-gymnasium 1.0.0 and loaded here, to compare step by step.

original.load(env, state)
observation, reward, terminated, truncated, info = env.step(action)
after = original.state(env)
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.core.envs import TaskEnv
from circle2d_mj.safety.families import ButtonTask
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.navigation import NavigationTask
from circle2d_mj.safety.velocity import VelocityTask

Floats = NDArray[np.float64]

_frames: weakref.WeakKeyDictionary[MuJoCoTask, Floats] = weakref.WeakKeyDictionary()
"""x, y and heading of the frame in which the joints of the original's Point act."""


def load(env: gym.Env, state: Mapping[str, ArrayLike]) -> None:
    """Put a single environment, already reset, into a state of the original.

    state: arrays by the original's names, as far as the task has them.

    | name | shape | meaning |
    | --- | --- | --- |
    | qpos, qvel | [nq], [nv] | the original's: agent, then vases, gremlins or box by number |
    | time | | since the reset, s |
    | agent_body_pos0, agent_body_quat0 | [3], [4] | pose of the agent's body in the model (Point) |
    | qpos0 | [nq] | qpos at the reset: where gremlins circle, and how they are turned |
    | hazards_pos, pillars_pos, buttons_pos | [k, 2 or 3] | places |
    | goal_pos | [2 or 3] | place of the goal |
    | mocap_pos | [k, 3] | offsets of the gremlins' targets from their places; may be missing |
    | goal_button, timer | | number of the goal button, steps for which buttons are off |
    | torso_xpos, mass_center | [2 or 3] | place from which Ant's, Humanoid's speed is measured |

    Without the last, the place follows from qpos, and the speed of the next step is slightly off.
    The time limit of `gymnasium.make` is not changed. Raises TypeError for any other environment,
    and ValueError if a name is missing or an array has a wrong shape.
    """
    task = _simulation(env)
    _load(task, state)
    env.unwrapped._envs._follow()  # pyright: ignore[reportAttributeAccessIssue]


def _load(task: Any, state: Mapping[str, ArrayLike]) -> None:
    given = _Given(state)
    qpos, qvel = given.array("qpos", task.model.nq), given.array("qvel", task.model.nv)
    if isinstance(task, VelocityTask):
        task.place(np.array([0]), qpos[None], qvel[None])
        stale = {"torso": "torso_xpos", "centre of mass": "mass_center"}.get(task.body.measured)
        if stale in state:
            task.put_measured(0, given.places(str(stale), 1)[0])
        return
    if task.agent.name == "Point":
        position, quat = given.array("agent_body_pos0", 3), given.array("agent_body_quat0", 4)
        frame = np.array([*position[:2], 2.0 * np.arctan2(quat[3], quat[0])])
        _frames[task] = frame
        qpos, qvel = _into_world(frame, qpos, qvel)
    if isinstance(task, ButtonTask):
        button = given.array("goal_button", None)
        if button not in range(4):
            raise ValueError(f"state['goal_button'] must be in 0..3, got {button:g}")
        task.goal_button[0] = button
        task.timer[0] = given.array("timer", None)
    places = _places(task, given)
    free = qpos[task.agent.nq :].reshape(-1, 7)
    places[task.world.free] = free[:, :2]
    half_turns = np.zeros(len(free))
    if "gremlins" in task.world.rows:
        rest = given.array("qpos0", task.model.nq)[task.agent.nq :].reshape(-1, 7)
        places[task.world.free] = rest[:, :2]
        half_turns = np.arctan2(rest[:, 6], rest[:, 3])
    index = np.array([0])
    task.place(index, places[None], np.zeros(1), half_turns[None])
    task.qpos[0], task.qvel[0] = qpos, qvel
    task.put_clock(0, float(given.array("time", None)))
    if "mocap_pos" in state:
        task.put_gremlins(0, given.array("mocap_pos", len(free), 3))
    task.settle(index)


def state(env: gym.Env) -> dict[str, Floats]:
    """Return qpos [nq] and qvel [nv] in the original's layout and frame.

    The Point's frame is that of the last `load`; before any `load` it is the world's.
    """
    task = _simulation(env)
    qpos, qvel = task.qpos[0].copy(), task.qvel[0].copy()
    if isinstance(task, NavigationTask) and task.agent.name == "Point":
        frame = _frames.get(task, np.zeros(3))
        qpos[:2] = _turned(qpos[:2] - frame[:2], -frame[2])
        qpos[2] -= frame[2]
        qvel[:2] = _turned(qvel[:2], -frame[2])
    return {"qpos": qpos, "qvel": qvel}


class _Given:
    """The given state, whose arrays are checked when they are read."""

    def __init__(self, state: Mapping[str, ArrayLike]) -> None:
        self._state = state

    def array(self, name: str, *shape: int | None) -> Floats:
        """Return an array and check its shape; a single None stands for one number."""
        if name not in self._state:
            raise ValueError(f"state must hold {name!r}, got {sorted(self._state)}")
        expected = () if shape == (None,) else shape
        found = np.asarray(self._state[name], dtype=np.float64)
        if found.shape != expected:
            raise ValueError(f"state[{name!r}] must have shape {expected}, got {found.shape}")
        return found

    def places(self, name: str, count: int) -> Floats:
        """Return places [count, 2] from an array [count, 2 or 3] or a single place [2 or 3]."""
        if name not in self._state:
            raise ValueError(f"state must hold {name!r}, got {sorted(self._state)}")
        found = np.atleast_2d(np.asarray(self._state[name], dtype=np.float64))
        if found.ndim != 2 or len(found) != count or found.shape[1] not in (2, 3):
            raise ValueError(f"state[{name!r}] must be {count} places, got shape {found.shape}")
        return found[:, :2]


def _places(task: NavigationTask, given: _Given) -> Floats:
    """Return the layout: [objects, 2]."""
    places = task.places[0]
    placed = ("hazards", "pillars", "buttons", "goal")
    for kind, rows in task.world.rows.items():
        if kind == "goal" and isinstance(task, ButtonTask):
            places[rows] = given.places("buttons_pos", 4)[task.goal_button[0]]
        elif kind in placed:
            places[rows] = given.places(f"{kind}_pos", rows.stop - rows.start)
    return places


def _simulation(env: gym.Env) -> Any:
    inner = env.unwrapped
    task = inner._envs.simulation if isinstance(inner, TaskEnv) else None
    if not isinstance(task, MuJoCoTask):
        raise TypeError(f"env must be one of this package's Safety tasks, got {env!r}")
    return task


def _into_world(frame: Floats, qpos: Floats, qvel: Floats) -> tuple[Floats, Floats]:
    """Convert states of the Point from a frame to joints along the world's axes."""
    qpos, qvel = qpos.copy(), qvel.copy()
    qpos[:2] = frame[:2] + _turned(qpos[:2], frame[2])
    qpos[2] += frame[2]
    qvel[:2] = _turned(qvel[:2], frame[2])
    return qpos, qvel


def _turned(vector: Floats, angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])
