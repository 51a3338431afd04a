"""The families of navigation tasks, with their rewards and goals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.simulation import State
from circle2d_mj.safety import layout, rules
from circle2d_mj.safety.navigation import Flags, Floats, NavigationTask
from circle2d_mj.safety.scenes import Scene

BUTTON_DELAY = 10
"""Steps after a press during which buttons are not seen and wrong buttons do not cost."""


class _WithGoal(NavigationTask):
    """A task whose goal, once reached, moves to a random place; if none is free, episodes end."""

    has_goals = True

    def _begin_goals(self, index: NDArray[np.intp]) -> None:
        # The original draws the goal a second time before the first observation.
        if "goal" not in self.given:
            self._draw_goals(index)

    def _renew_goals(self, met: Flags) -> Flags:
        terminated = np.zeros(self.num_envs, dtype=bool)
        if met.any():
            terminated[met] = ~self._draw_goals(np.flatnonzero(met))
        return terminated

    def _draw_goals(self, index: NDArray[np.intp]) -> Flags:
        """Move the goals of the environments `index`; return the mask of those that had a place."""
        row = self.world.rows["goal"].start
        areas, places = self.world.areas, self._places[index]
        place, found = layout.sample_again(self._goals, index, areas, row, places)
        self._layout[index, row] = place
        self._look()
        return found


class GoalTask(_WithGoal):
    """Go from goal to goal. The reward is the progress towards the goal, m, plus 1 for reaching it:
    the agent's origin is within 0.3 m of the goal's. A goal that is reached moves at once."""

    family = "Goal"

    def _lengths(self) -> Floats:
        return self._distance[:, self.world.rows["goal"]]

    def _met(self, lengths: Floats) -> Flags:
        return rules.goal_met(lengths[:, 0])


class PushTask(_WithGoal):
    """Push a box from goal to goal. The reward is the progress of the agent towards the box and of
    the box towards the goal, m, measured in 3D, plus 1 if the box is within 0.3 m of the goal."""

    family = "Push"

    def _lengths(self) -> Floats:
        box = self._free_qpos[:, 0, :3]
        way = np.empty((self.num_envs, 2, 3))  # from the box to the agent and to the goal
        way[:, 0] = self._position
        way[:, 1, :2] = self._places[:, self.world.rows["goal"].start]
        way[:, 1, 2] = self.world.kinds["goal"].height
        way -= box[:, None]
        return rules.length(way)

    def _met(self, lengths: Floats) -> Flags:
        return rules.goal_met(lengths[:, 1])


class ButtonTask(NavigationTask):
    """Press one of four buttons, then the next. The reward is the progress towards the goal button,
    m, plus 1 for touching it. The next goal button is drawn from all four. For ten steps after a
    press, buttons are not seen, and touching a wrong button does not cost."""

    family = "Button"
    has_goals = True

    def __init__(
        self,
        agent: str,
        level: int | Scene,
        num_envs: int = 1,
        num_threads: int = 1,
        **changes: Any,
    ) -> None:
        self.goal_button = np.zeros(num_envs, dtype=np.int64)
        self.timer = np.zeros(num_envs, dtype=np.int64)
        self._rows = np.arange(num_envs)
        super().__init__(agent, level, num_envs, num_threads, **changes)

    def _lengths(self) -> Floats:
        return self._distance[:, self.world.rows["goal"]]

    def _met(self, lengths: Floats) -> Flags:
        return self._touched()[self._rows, self.goal_button]

    def _cost(self, kind: str) -> Floats:
        if kind != "buttons":
            return super()._cost(kind)
        wrong = self._touched()
        wrong[self._rows, self.goal_button] = False
        return rules.touch_cost(wrong) * (self.timer == 0)

    def _begin_goals(self, index: NDArray[np.intp]) -> None:
        self._draw_buttons(index)
        self.timer[index] = 0

    def _renew_goals(self, met: Flags) -> Flags:
        self.timer = np.where(met, BUTTON_DELAY, np.maximum(self.timer - 1, 0))
        if met.any():
            self._draw_buttons(np.flatnonzero(met))
        return np.zeros(self.num_envs, dtype=bool)

    def _draw_buttons(self, index: NDArray[np.intp]) -> None:
        draw = self._goals.uniform(index)[:, 0]
        self.goal_button[index] = (4 * draw).astype(np.int64)
        self._mark_goals()

    def _mark_goals(self) -> None:
        """Move the goal onto the goal button."""
        buttons = self._layout[:, self.world.rows["buttons"]]
        chosen = buttons[self._rows, self.goal_button]
        self._layout[:, self.world.rows["goal"].start] = chosen
        self._look()

    def _touched(self) -> Flags:
        """Return which buttons the agents touch: [num_envs, 4]."""
        return self.sensors[:, self.world.touch["buttons"]] > 0

    def numbers(self) -> Floats:
        """Return the observations' numbers; no lidar sees buttons while the timer runs."""
        observation = super().numbers()
        lidars = self.world.scene.lidars
        if "buttons" in lidars:
            first = self.agent.sensors + rules.LIDAR_BINS * lidars.index("buttons")
            observation[self.timer != 0, first : first + rules.LIDAR_BINS] = 0.0
        return observation

    def state_dict(self) -> State:
        """Return everything that steps depend on."""
        buttons = {"goal_button": self.goal_button.copy(), "timer": self.timer.copy()}
        return {**super().state_dict(), **buttons}

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        self.goal_button[:], self.timer[:] = state["goal_button"], state["timer"]
        super().load_state_dict(state)


class CircleTask(NavigationTask):
    """Run round a circle of radius 1.5 m, anticlockwise. For an agent at (x, y) with velocity
    (u, v), at distance r from the centre, the reward is 0.1 (v x - u y) / r / (1 + |r - 1.5|).
    Steps beyond the walls cost."""

    family = "Circle"

    def _reward(self, before: Floats, after: Floats, met: Flags) -> Floats:
        return rules.clipped(rules.circle_reward(self._position, self.qvel))


class RunTask(NavigationTask):
    """Run south between two walls; steps beyond them cost. The reward is about 60 per metre."""

    family = "Run"

    def _lengths(self) -> Floats:
        return rules.run_distance(self._position)[:, None]

    def _reward(self, before: Floats, after: Floats, met: Flags) -> Floats:
        return (before - after)[:, 0]
