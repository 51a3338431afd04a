"""SafetyPointGoal1-v0: go from goal to goal without crossing hazards."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.simulation import Outcome, State
from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import layout, models, rules
from circle2d_mj.safety.circle import (
    SUBSTEPS,
    point_action_space,
    point_observation_space,
    point_position,
)
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.views import PointGoalView

VASE_HEIGHT = 0.09996
OUT_OF_REACH = 0.4
"""Distance in m beyond which agent and vase cannot meet within a step. Their outermost corners are
0.158 m and 0.142 m from their centres, and the agent moves at most 0.03 m in a step."""
AT_REST = 1e-8
"""Speed in m/s and rad/s below which a vase stands"""

# Rows of the sight, which holds all objects but the agent.
_GOAL, _HAZARDS, _VASE = 0, slice(1, 9), 9
_LIDAR_OF_TARGET = np.array((0, *[1] * 8, 2))
_GEOMS = {"goal": layout.GOAL, **{f"hazard{i}": layout.HAZARDS.start + i for i in range(8)}}


class SafetyPointGoal(MuJoCoTask):
    """`num_envs` copies of the task. Positions in metres, steps of 0.02 s, 1000 steps an episode.

    | observation | meaning |
    | --- | --- |
    | 0-11 | the agent's sensors, as in `SafetyPointCircle` |
    | 12-27 | lidar of the goal, reach 3 m: see `rules.lidar` |
    | 28-43 | lidar of the eight hazards, reach 3 m |
    | 44-59 | lidar of the vase, reach 3 m |

    | info | meaning | unit |
    | --- | --- | --- |
    | cost | 1.0 where the step ended in a hazard, else 0.0 | |
    | goal_met | 1.0 where the step reached the goal, else 0.0 | |
    | x_position, y_position | where the agent is in the world | m |

    Actions: as in `SafetyPointCircle`. Reward and cost: `rules.goal_reward`, `rules.goal_cost`.
    A goal that is reached moves at once, and the episode continues; it terminates only if no place
    for a goal is found. Starts: `layout.sample_layout`, all headings uniform, at rest.

    A vase that stands out of the agent's reach keeps its state, and that environment is stepped
    without contacts, which do not act on the agent's joints: most of the time would otherwise go
    into the contact of vase and floor. Source: safety-gymnasium 1.0.0.
    """

    info_keys = ("cost", "goal_met", "x_position", "y_position")
    view = PointGoalView()

    def __init__(self, num_envs: int = 1, num_threads: int = 1) -> None:
        super().__init__(models.point_goal(), num_envs, num_threads, SUBSTEPS)
        self.observation_space = point_observation_space(lidars=3)
        self.action_space = point_action_space()
        self._disabled = self.batch.expand("opt.disableflags")
        self._vase = self.qpos[:, 3:], self.qvel[:, 3:]
        # Where everything is now, m: [num_envs, 11, 2]; see `layout`.
        self._places = np.zeros((self.num_envs, len(layout.KEEPOUT), 2))
        self._update_sight()
        # New goals are drawn in the middle of an episode, from streams which `start` seeds.
        self._goals = Streams(np.zeros(self.num_envs, dtype=np.uint64))

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Lay the environments `index` out anew, everything at rest."""
        draw = streams.uniform(index)
        words = (draw[:, :2] * 2.0**32).astype(np.uint64)
        self._goals.reseed(index, words[:, 0] << np.uint64(32) | words[:, 1])
        places = layout.sample_layout(streams, index)
        self._places[index] = places
        # The original draws the goal a second time before anyone sees it.
        self._move_goals(index)
        qpos = np.zeros((len(index), self.model.nq))
        qpos[:, :2], qpos[:, 2] = places[:, layout.AGENT], 2.0 * np.pi * draw[:, 2]
        qpos[:, 3:5], qpos[:, 5] = places[:, layout.VASE], VASE_HEIGHT
        qpos[:, 6], qpos[:, 9] = np.cos(np.pi * draw[:, 3]), np.sin(np.pi * draw[:, 3])
        self._disabled[index] = 0  # so that a start does not depend on the episode before
        self.begin(index, qpos)

    def step(self, action: NDArray[np.float64]) -> Outcome:
        """Move all agents by their actions, [num_envs, 2], and the goals that they reach."""
        before = self._seen.distance[:, _GOAL]
        self._move(action)
        after = self._seen.distance[:, _GOAL]
        reward = rules.goal_reward(before, after)
        met = rules.goal_met(after)
        cost = rules.goal_cost(self._seen.distance[:, _HAZARDS])
        terminated = np.zeros(self.num_envs, dtype=bool)
        if met.any():
            terminated[met] = ~self._move_goals(np.flatnonzero(met))
        return Outcome(reward, terminated, {"cost": cost, "goal_met": met.astype(np.float64)})

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the agents' positions."""
        return point_position(self.qpos)

    def observe(self) -> NDArray[np.float64]:
        """Return the observations: [num_envs, 60]."""
        heading, reach = self.qpos[:, 2], rules.GOAL_LIDAR_REACH
        lidars = rules.lidar(self._seen, heading, reach, _LIDAR_OF_TARGET)
        return np.concatenate((self.sensors, lidars), axis=1)

    def state_dict(self) -> State:
        """Return all that steps depend on."""
        goals = {"goal_keys": self._goals.keys.copy(), "goal_counters": self._goals.counters.copy()}
        return {**super().state_dict(), "places": self._places.copy(), **goals}

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        super().load_state_dict(state)
        self._places[:] = state["places"]
        self._update_sight()
        self._goals.keys[:] = state["goal_keys"]
        self._goals.counters[:] = state["goal_counters"]

    def data(self, index: int) -> Any:
        """Return environment `index` as MuJoCo's own MjData, to render it.

        Goal and hazards are at their places, until mj_forward puts them where the model has them.
        """
        data = super().data(index)
        for name, row in _GEOMS.items():
            data.geom(name).xpos[:2] = self._places[index, row]
        return data

    def _move(self, control: NDArray[np.float64]) -> None:
        pose, speed = self._vase
        # The speed is 0 exactly at the start, where the vase has yet to settle by micrometres.
        fastest = np.maximum.reduce(np.abs(speed), axis=1)
        stands = (fastest > 0.0) & (fastest < AT_REST)
        stands &= self._seen.distance[:, _VASE] > OUT_OF_REACH
        self._disabled[:] = stands * models.NO_CONTACTS
        kept = pose.copy(), speed.copy()
        self.advance(control)
        np.copyto(pose, kept[0], where=stands[:, None])
        np.copyto(speed, kept[1], where=stands[:, None])
        self._places[:, layout.AGENT] = self.qpos[:, :2]
        self._places[:, layout.VASE] = pose[:, :2]
        self._update_sight()

    def _move_goals(self, index: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Move the goals of the environments `index`; return where a place was found, [n] bool."""
        goal, found = layout.sample_goal(self._goals, index, self._places[index])
        self._places[index, layout.GOAL] = goal
        self._update_sight()
        return found

    def _update_sight(self) -> None:
        self._seen = rules.sight(self._places[:, layout.AGENT], self._places[:, 1:])
