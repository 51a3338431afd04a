"""Whole episodes of every run, collected in lockstep, and as algorithms learn from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from agents.errors import TaskFailure, UserError
from emcc.streaks import weighted


class Rollout(NamedTuple):
    """Episodes side by side; steps from an episode's `length` on do not belong to it."""

    observation: NDArray[np.float32]
    """[T, N, observation size]"""
    action: NDArray[np.float32]
    """[T, N, action size]: as the policy chose it; the environment got it clipped to [-1, 1]"""
    reward: NDArray[np.float64]
    """[T, N]"""
    cost: NDArray[np.float64]
    """[T, N, C]: each of the costs"""
    next_observation: NDArray[np.float32]
    """[T, N, observation size]"""
    terminated: NDArray[np.bool_]
    """[T, N]: the episode ended in a terminal state"""
    truncated: NDArray[np.bool_]
    """[T, N]: the episode was truncated, for example by a time limit"""
    length: NDArray[np.int64]
    """[N]: environment steps of each episode; 0 where there was no episode"""
    failure: NDArray[np.object_]
    """[N]: why the episode is void: the name of what was not finite in float32 ("action",
    "observation", "reward" or the name of a cost), or the TaskFailure of its environment; "" for a
    valid episode"""

    def of(self, episodes: slice) -> Rollout:
        """Return some of the episodes."""
        *columns, length, failure = self
        columns = [column[:, episodes] for column in columns]
        return Rollout._make([*columns, length[episodes], failure[episodes]])

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Mask of the void episodes, [N]."""
        return self.failure != ""

    @property
    def during(self) -> NDArray[np.bool_]:
        """Mask of the steps that belong to the episodes, [T, N]."""
        return np.arange(len(self.reward))[:, None] < self.length

    def terminal(self, time_limit: str) -> NDArray[np.bool_]:
        """Return the mask of terminal steps, [T, N]; with "terminal" truncated ones count too."""
        return self.terminated | self.truncated if time_limit == "terminal" else self.terminated

    @property
    def returns(self) -> NDArray[np.float64]:
        """Undiscounted return of each episode, [N]."""
        return self._sums(self.reward)

    @property
    def cost_returns(self) -> NDArray[np.float64]:
        """Undiscounted return of each cost and episode, [N, C]."""
        return self._sums(self.cost)

    def discounted_costs(self, discount: float) -> NDArray[np.float64]:
        """Return the discounted return of each cost and episode, [N, C]."""
        return self._sums(self.cost * discount ** np.arange(len(self.cost))[:, None, None])

    def _sums(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum over each episode in the order of time, [N, ...]. The order in which `sum` adds
        depends on the array's shape, and so on the length of the other episodes."""
        sums = np.cumsum(values, axis=0)[self.length - 1, np.arange(len(self.length))]
        sums[self.length == 0] = 0.0
        return sums


FAILURE = "agents.failure"
"""Key of the info for failures of single environments, [N]: TaskFailure, or None."""


def require_info(source: object, info: Mapping[str, Any], names: Sequence[str]) -> None:
    """Raise UserError, naming the source, if the info of a step lacks one of the names."""
    for name in names:
        if name not in info:
            given = sorted(key for key in info if not key.startswith("_")) or "nothing"
            raise UserError(f"{source} gives no info[{name!r}]; it gives {given}")


Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""observations [N, observation size] -> actions [N, action size]"""
Policy = Callable[[NDArray[np.float32], NDArray[np.float32] | None], NDArray[np.float32]]
"""(observations [R, N, observation size], standard normal noise [R, N, A] or None for the
deterministic policy) -> actions [R, N, A]"""


LARGEST = float(np.finfo(np.float32).max)
"""Numbers beyond this count as infinite."""
MAX_STEPS = 10_000
"""Steps after which an episode of a task without a time limit is taken to never end."""
ENDS = (
    "the task needs a time limit, such as --task-parameters max_episode_steps 1000, or in Python "
    'task_parameters={"max_episode_steps": 1000}'
)
"""Remedy for an episode that never ends."""


def collect(
    envs: VectorEnv,
    seeds: Sequence[int],
    act: Act,
    active: NDArray[np.bool_] | None = None,
    costs: Sequence[str] = ("cost",),
    most_steps: int = MAX_STEPS,
) -> Rollout:
    """Play one whole episode in every environment, each reset with its seed.

    envs: N environments that do not reset themselves (autoreset mode DISABLED); act: observations
    [N, observation size] -> actions [N, action size]; active: [N], the environments that play an
    episode, all by default; costs: their names in the infos; most_steps: number after which an
    episode is taken to never end. An environment waits for the others, and its further steps are
    left out, once its episode has ended, its action is not finite, or it alone fails (`FAILURE`).
    Raises UserError if an info lacks a cost, TaskFailure if an episode never ends or the reset of
    some environments changes others.
    """
    running = np.ones(len(seeds), dtype=bool) if active is None else active.copy()
    length = np.zeros(len(seeds), dtype=np.int64)
    failure = np.full(len(seeds), "", dtype=object)

    def note_failures(info: Mapping[str, Any]) -> None:
        if FAILURE in info:
            failed = running & (info[FAILURE] != None)  # noqa: E711  # of each
            failure[failed] = info[FAILURE][failed]
            running[failed] = False

    observation, info = _reset(envs, seed=list(seeds))
    note_failures(info)
    steps: list[tuple] = []
    while running.any() or not steps:  # at least one step, for the shapes of the arrays
        if len(steps) == most_steps:
            raise TaskFailure(
                f"an episode of {envs} has not ended after {most_steps} steps: {ENDS}"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # the next check finds them
            action = act(observation)
        if not np.isfinite(action).all():
            finite = np.all(np.isfinite(action), axis=-1)
            seen = np.isfinite(observation).all(axis=-1)  # of a reset: `_checked` finds the others
            failure[running & ~finite] = np.where(seen, "action", "observation")[running & ~finite]
            running &= finite
            action = np.where(finite[:, None], action, np.float32(0.0))
        clipped = np.minimum(np.maximum(action, -1.0), 1.0)  # `clip` takes twice as long
        following, reward, terminated, truncated, info = envs.step(clipped)
        note_failures(info)
        require_info(envs, info, costs)
        # In float64 from here on: sums over episodes in float32 lose digits.
        reward = np.array(reward, dtype=np.float64)
        cost = np.stack([info[name] for name in costs], axis=-1).astype(np.float64)
        following = np.asarray(following, dtype=np.float32)
        steps.append((observation, action, reward, cost, following, terminated, truncated))
        length += running
        ended = terminated | truncated
        running &= ~ended
        observation = following
        if ended.any() and running.any():
            observation, _ = _reset(envs, options={"reset_mask": ended.copy()})
            if not np.array_equal(observation[running], following[running], equal_nan=True):
                raise TaskFailure(
                    f"a reset of {envs} with options['reset_mask'] changes environments outside of "
                    "the mask, whose episodes go on"
                )
    columns = [np.stack(column) for column in zip(*steps, strict=True)]
    return _checked(Rollout._make([*columns, length, failure]), envs, costs)


def _reset(envs: VectorEnv, **kwargs: Any) -> tuple[NDArray[np.float32], Mapping[str, Any]]:
    observation, info = envs.reset(**kwargs)
    return np.asarray(observation, dtype=np.float32), info


def _checked(rollout: Rollout, envs: VectorEnv, costs: Sequence[str]) -> Rollout:
    """Mark episodes with negative costs, or with numbers that are not finite in float32, in which
    networks learn, as void; such numbers become NaN."""
    failure = np.full_like(rollout.failure, "")
    # In reverse, so that the first of each environment remains.
    for step, env, k in np.argwhere((rollout.cost < 0) & rollout.during[..., None])[::-1]:
        value = f"{rollout.cost[step, env, k]:g} in step {step + 1} of an episode"
        failure[env] = TaskFailure(f"{envs} gives a negative {costs[k]}: {value}")
    columns = {"observation": rollout.next_observation, "reward": rollout.reward[..., None]}
    columns |= {name: rollout.cost[..., k : k + 1] for k, name in enumerate(costs)}
    for name, values in columns.items():
        if not (finite := np.abs(values) <= LARGEST).all():
            values[~finite] = np.nan
            void = (~finite.all(axis=-1) & rollout.during).any(axis=0)
            failure[void & (failure == "")] = name
    failure = np.where(failure == "", rollout.failure, failure)  # otherwise as `collect` noted
    return rollout._replace(failure=failure)


def learned(rollout: Rollout, config: Any, costs: int) -> Rollout:
    """Return the rollout as an algorithm learns from it: as `config.relabelled` returns it, if
    there is such a method; the first `costs` of its costs; observations times `config.input_scale`.
    With a `config.streak_weight`, costs grow along a streak, and observations end with each cost's
    current streak, in steps, for the critics: see `critic_inputs`."""
    if hasattr(config, "relabelled"):
        rollout = config.relabelled(rollout)
    scale = input_scale(config)
    scaled = rollout._replace(
        observation=rollout.observation * scale,
        next_observation=rollout.next_observation * scale,
        cost=rollout.cost[..., :costs],
    )
    weight = streak_weight(config)
    if not weight:
        return scaled
    after = streaks(scaled.cost)
    before = np.concatenate([np.zeros_like(after[:1]), after[:-1]])
    return scaled._replace(
        observation=_joined(scaled.observation, before),
        next_observation=_joined(scaled.next_observation, after),
        cost=weighted(scaled.cost, after, weight),
    )


def input_scale(config: Any) -> NDArray[np.float32]:
    """Return the factor of observations: [], or one for each number, [observation size]."""
    return np.asarray(config.input_scale, np.float32)


def streak_weight(config: Any) -> float:
    """Return the weight of streaks in the learned cost; 0 for an algorithm that limits no cost."""
    return getattr(config, "streak_weight", 0.0)


def critic_inputs(config: Any, observation_size: int, costs: int) -> int:
    """Return how many numbers critics see of a state. Where costs grow along a streak, critics also
    see its length, without which the learned task would not be Markov; the policy never sees it."""
    return observation_size + costs * bool(streak_weight(config))


def streaks(costs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Count consecutive cost steps up to each step of costs [T, ...], inclusive; 0 at safe
    steps."""
    lengths = np.zeros(costs.shape)
    streak = np.zeros(costs.shape[1:])
    for t, at_step in enumerate(costs):
        streak = np.where(at_step > 0, streak + 1, 0)
        lengths[t] = streak
    return lengths


def _joined(observation: NDArray[np.float32], streak: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.concatenate([observation, streak.astype(np.float32)], axis=-1)
