"""RecordCosts for gymnasium. This is the only file of the package that imports gymnasium."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from emcc.arrays import as_array
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords


def RecordCosts(
    env: gym.Env | VectorEnv, rollout: int | str = "episode", threshold: float = 0.0
) -> Any:
    """Wrap an Env or VectorEnv whose info has "cost", and record its trajectories.

    The wrapper is a gymnasium.Wrapper or a gymnasium.vector.VectorWrapper, with
      .records        EpisodeRecords of the trajectories finished so far
      .end_rollout()  cut the running episodes and begin the next rollout (`CostRecorder`)
    rollout and threshold: as in `CostRecorder`.

    A vector environment's autoreset step is no step; its mode is read from
    env.metadata["autoreset_mode"]. A reset in the middle of an episode keeps what ran so far as a
    trajectory. Sub-environments must give the cost as a float: gymnasium's vector environments make
    an array of the type of the first cost they see, which would round others.
    TypeError: no gymnasium environment, or such an array of whole numbers or bools. ValueError: a
    vector environment without an autoreset mode, an environment that steps without giving a cost.
    KeyError: no cost in info at all.
    """
    if isinstance(env, VectorEnv):
        return RecordVectorCosts(env, rollout, threshold)
    if isinstance(env, gym.Env):
        return RecordEnvCosts(env, rollout, threshold)
    raise TypeError(f"env must be a gymnasium Env or VectorEnv, got {type(env).__name__}")


class _Recorded:
    """What both wrappers offer of their recorder."""

    recorder: CostRecorder

    @property
    def records(self) -> EpisodeRecords:
        """The trajectories finished so far."""
        return self.recorder.records

    def end_rollout(self) -> None:
        """Cut the running episodes and begin the next rollout."""
        self.recorder.end_rollout()


class RecordEnvCosts(_Recorded, gym.Wrapper, RecordConstructorArgs):
    """What `RecordCosts` makes of an Env."""

    def __init__(
        self, env: gym.Env, rollout: int | str = "episode", threshold: float = 0.0
    ) -> None:
        RecordConstructorArgs.__init__(self, rollout=rollout, threshold=threshold)
        gym.Wrapper.__init__(self, env)
        self.recorder = CostRecorder(1, rollout, threshold)
        self._finished = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; an episode that was running is kept as far as it got."""
        result = super().reset(seed=seed, options=options)
        self.recorder.cut()
        self._finished = False
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and record the cost."""
        result = super().step(action)
        _, reward, terminated, truncated, info = result
        done = bool(terminated or truncated)
        if not self._finished:  # else it is the resetting step of gymnasium.wrappers.Autoreset
            _require_cost(info)
            self.recorder.step([info["cost"]], [float(reward)], [done])
        self._finished = done
        return result


class RecordVectorCosts(_Recorded, VectorWrapper):
    """What `RecordCosts` makes of a VectorEnv."""

    def __init__(
        self, env: VectorEnv, rollout: int | str = "episode", threshold: float = 0.0
    ) -> None:
        super().__init__(env)
        self._mode = _autoreset_mode(env)
        self.recorder = CostRecorder(env.num_envs, rollout, threshold)
        self._waiting = np.zeros(env.num_envs, dtype=bool)  # finished, and not reset yet

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, or those in options["reset_mask"]; what was running is kept."""
        mask = (options or {}).get("reset_mask")
        where = np.ones(self.num_envs, dtype=bool) if mask is None else np.array(mask)
        result = super().reset(seed=seed, options=options)
        self.recorder.cut(where)
        self._waiting &= ~where
        return result

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments and record the costs of those that took a step."""
        result = super().step(actions)
        _, rewards, terminated, truncated, infos = result
        active = ~self._waiting
        done = as_array(terminated, "terminated") | as_array(truncated, "truncated")
        if active.any():
            self.recorder.step(_costs(infos, active, done), rewards, done, active)
        if self._mode == AutoresetMode.NEXT_STEP:
            self._waiting = done & active
        elif self._mode == AutoresetMode.DISABLED:
            self._waiting |= done
        return result


def _autoreset_mode(env: VectorEnv) -> AutoresetMode:
    mode = env.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(mode)
    except ValueError:
        raise ValueError(
            f"{env}: metadata['autoreset_mode'] must be a gymnasium.vector.AutoresetMode, "
            f"got {mode!r}; without it, steps cannot be told from resets"
        ) from None


def _costs(
    infos: dict[str, Any], active: NDArray[np.bool_], done: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The cost of this step in each environment.

    In SAME_STEP mode infos belong to the next episode's reset already; those of the episode's
    last step are in infos["final_info"].
    """
    final = infos.get("final_info", {})
    finals = active & done & ("cost" in final)
    others = active & ~finals
    costs = np.zeros(len(active))
    if finals.any():
        costs[finals] = _given_costs(final, finals)[finals]
    if others.any():
        _require_cost(infos)
        costs[others] = _given_costs(infos, others)[others]
    return costs


def _given_costs(infos: dict[str, Any], needed: NDArray[np.bool_]) -> NDArray[Any]:
    """infos["cost"], whose mask infos["_cost"], where there is one, must cover those needed; with a
    mask, which is gymnasium's own, no array of whole numbers or bools."""
    missing = needed & ~np.asarray(infos.get("_cost", needed), dtype=bool)
    if missing.any():
        raise ValueError(f"sub-environment {int(np.argmax(missing))} gave no 'cost' in its info")
    costs = as_array(infos["cost"], "info['cost']")
    if "_cost" in infos and costs.dtype.kind in "biu":
        raise TypeError(
            f"info['cost'] came as {costs.dtype}: gymnasium's vector environments give all costs "
            "the type of the first, which may have rounded others; let every one give a float"
        )
    return costs


def _require_cost(info: dict[str, Any]) -> None:
    if "cost" not in info:
        raise KeyError(f"the environment's info has no 'cost'; it has {sorted(info)}")
