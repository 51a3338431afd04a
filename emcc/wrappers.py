"""RecordCosts for Gymnasium: the wrappers of single and of vector environments."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, overload

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from emcc.arrays import as_array, as_flag, as_names, as_one
from emcc.recorder import CostRecorder, cost_of, costs_of
from emcc.records import EpisodeRecords

OLD = gym.__version__.startswith("0.")
if TYPE_CHECKING or not OLD:
    from gymnasium.vector import VectorWrapper
else:
    from gymnasium.vector import VectorEnvWrapper as VectorWrapper

Observation = TypeVar("Observation")
Action = TypeVar("Action")


@overload
def RecordCosts(env: VectorEnv, *args: Any, **options: Any) -> "RecordVectorCosts": ...
@overload
def RecordCosts(
    env: gym.Env[Observation, Action], *args: Any, **options: Any
) -> "RecordEnvCosts[Observation, Action]": ...
def RecordCosts(
    env: gym.Env | VectorEnv,
    rollout: int | str = "episode",
    threshold: float = 0.0,
    costs: Sequence[str] = ("cost",),
) -> "RecordEnvCosts | RecordVectorCosts":
    """Wrap an Env or VectorEnv whose info has costs, and record its trajectories.

    The wrapper is a gymnasium.Wrapper or a gymnasium.vector.VectorWrapper, with
      .records          EpisodeRecords of the finished trajectories, with the first cost
      .records_by_cost  the same records for each cost, by name
      .end_rollout()    cut the running episodes and begin the next rollout (`CostRecorder`)
    rollout, threshold: as in `CostRecorder`. costs: keys of info, such as ("cost", "cost_2").

    A vector environment's autoreset step does not count as a step; the autoreset mode is read from
    env.metadata["autoreset_mode"]. A reset in the middle of an episode keeps the steps so far as a
    trajectory. Sub-environments must return the cost as a float: Gymnasium's vector environments
    make an array with the type of the first cost, which would round others.
    TypeError: not a Gymnasium environment, or an array of whole numbers or bools made so.
    ValueError: a vector environment without an autoreset mode, a step that does not return five
    values, a sub-environment without a cost, a negative or non-finite cost, costs that are not
    different names. KeyError: no such cost in info. RuntimeError: a step after an episode's end
    without a reset.
    """
    return of_kind(env, RecordEnvCosts, RecordVectorCosts)(env, rollout, threshold, costs)


def of_kind(env: Any, single: Any, vector: Any) -> Any:
    """Return `single` if env is an Env, `vector` if it is a VectorEnv. TypeError: neither."""
    if not isinstance(env, (gym.Env, VectorEnv)):
        raise TypeError(f"env must be a gymnasium Env or VectorEnv, got {type(env).__name__}")
    return vector if isinstance(env, VectorEnv) else single


def resets_itself(env: gym.Env) -> bool:
    """Return True if Gymnasium's Autoreset resets in the step after an episode's end.

    RuntimeError: nothing resets, so the step belongs to no episode.
    """
    wrapped = env
    while isinstance(wrapped, gym.Wrapper):
        if type(wrapped).__name__ == "Autoreset":  # gymnasium 1.0 or newer
            return True
        wrapped = wrapped.env
    raise RuntimeError(
        f"{env} was stepped after its episode had ended: call reset() first; if a wrapper hides "
        "the end of episodes, record costs outside of it"
    )


def five(env: Any, values: tuple[Any, ...]) -> Any:
    """Return a step's five values. ValueError: another number, such as Safety-Gymnasium's six."""
    if len(values) != 5:
        raise ValueError(
            f"step of {env} must return gymnasium's five values, got {len(values)}; for the six of "
            "Safety-Gymnasium use circle2d_mj.FromSafetyGymnasium or, for vector environments, "
            "emcc.CostRecorder"
        )
    return values


class _Recorded:
    """Mixin of both wrappers that holds a recorder for each cost."""

    recorders: dict[str, CostRecorder]

    def _record(self, num_envs: int, rollout: int | str, threshold: float, costs: Any) -> None:
        names = as_names(costs, "costs")
        self.recorders = {name: CostRecorder(num_envs, rollout, threshold) for name in names}

    @property
    def recorder(self) -> CostRecorder:
        """The recorder of the first cost."""
        return next(iter(self.recorders.values()))

    @property
    def records(self) -> EpisodeRecords:
        """Finished trajectories, with the first cost."""
        return self.recorder.records

    @property
    def records_by_cost(self) -> dict[str, EpisodeRecords]:
        """Finished trajectories with each cost, by its name."""
        return {name: recorder.records for name, recorder in self.recorders.items()}

    def end_rollout(self) -> None:
        """Cut the running episodes and begin the next rollout."""
        for recorder in self.recorders.values():
            recorder.end_rollout()

    def _cut(self, where: ArrayLike | None = None) -> None:
        for recorder in self.recorders.values():
            recorder.cut(where)


class RecordEnvCosts(
    _Recorded, gym.Wrapper[Observation, Action, Observation, Action], RecordConstructorArgs
):
    """`RecordCosts` of an Env."""

    def __init__(self, env: gym.Env, rollout: int | str, threshold: float, costs: Any) -> None:
        RecordConstructorArgs.__init__(self, rollout=rollout, threshold=threshold, costs=costs)
        gym.Wrapper.__init__(self, env)
        self._record(1, rollout, threshold, costs)
        self._finished = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset the environment; the steps of a running episode are kept."""
        result = super().reset(seed=seed, options=options)
        self._cut()
        self._finished = False
        return result

    def step(self, action: Action) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Step the environment and record the cost."""
        resets = self._finished and resets_itself(self.env)
        result = _, reward, terminated, truncated, info = five(self.env, super().step(action))
        done = as_flag(terminated, "terminated") | as_flag(truncated, "truncated")
        if not resets:
            for name, recorder in self.recorders.items():
                recorder.step([cost_of(info, name)], [as_one(reward, "reward")], [done])
        self._finished = done
        return result


class VectorSteps(VectorWrapper):
    """Tracks which environments take a step, in every autoreset mode.

    Subclasses decide what `reset` and `step` return. where, active, done: masks [num_envs] of the
    environments that were reset, that took a step, and whose episode ended with this step.
    """

    def __init__(self, env: VectorEnv) -> None:
        super().__init__(env)
        # Gymnasium before 1.0 has a single mode.
        mode = (env.metadata or {}).get("autoreset_mode", "SameStep" if OLD else None)
        self._mode = getattr(mode, "value", mode)
        if self._mode not in ("NextStep", "SameStep", "Disabled"):
            raise ValueError(
                f"{env}: metadata['autoreset_mode'] must be a gymnasium.vector.AutoresetMode, "
                f"got {mode!r}; without it, steps cannot be told from resets"
            )
        self._finished = np.zeros(env.num_envs, dtype=bool)  # episode ended, not reset yet

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, or those in options["reset_mask"]."""
        mask = (options or {}).get("reset_mask")
        where = np.ones(self.num_envs, dtype=bool) if mask is None else np.array(mask)
        result = super().reset(seed=seed, options=options)
        self._finished &= ~where
        return self._after_reset(where, *result)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments."""
        result, active = five(self.env, super().step(actions)), ~self._finished
        if not isinstance(result[4], Mapping):
            raise TypeError(
                f"infos of {self.env} must be a dict, got a {type(result[4]).__name__}: set "
                "DictInfoToList outside of this wrapper"
            )
        done = as_array(result[2], "terminated") | as_array(result[3], "truncated")
        if self._mode == "NextStep":
            self._finished = done & active
        elif self._mode == "Disabled":
            self._finished |= done
        return self._after_step(active, done, *result)

    def _after_reset(self, where: NDArray[np.bool_], *result: Any) -> Any:
        raise NotImplementedError

    def _after_step(self, active: NDArray[np.bool_], done: NDArray[np.bool_], *result: Any) -> Any:
        raise NotImplementedError


class RecordVectorCosts(_Recorded, VectorSteps):
    """`RecordCosts` of a VectorEnv; if a reset ends an episode, its steps are kept."""

    def __init__(self, env: VectorEnv, rollout: int | str, threshold: float, costs: Any) -> None:
        super().__init__(env)
        self._record(env.num_envs, rollout, threshold, costs)

    def _after_reset(self, where: NDArray[np.bool_], *result: Any) -> Any:
        self._cut(where)
        return result

    def _after_step(self, active: NDArray[np.bool_], done: NDArray[np.bool_], *result: Any) -> Any:
        _, rewards, _, _, infos = result
        rewards = as_array(rewards, "reward")
        if rewards.size == self.num_envs:  # possibly of shape [num_envs, 1]
            rewards = rewards.reshape(self.num_envs)
        for name, recorder in self.recorders.items() if active.any() else ():
            recorder.step(costs_of(infos, active, done, name), rewards, done, active)
        return result
