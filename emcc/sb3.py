"""EMCC of a training with Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from emcc.arrays import as_count, as_names, as_number
from emcc.panels import MOVING_WINDOW, Panel, measures_of, panel
from emcc.parts import ALPHA, worst
from emcc.recorder import CostRecorder, cost_of
from emcc.records import EpisodeRecords

try:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
except ModuleNotFoundError as error:
    raise ImportError("emcc.sb3 needs stable-baselines3: pip install stable-baselines3") from error


class EMCCCallback(BaseCallback):
    """Records the costs of a training, and logs EMCC and the measures beside it as emcc/*.

    Works with every algorithm and VecEnv. The numbers go to SB3's logger, so also to TensorBoard
    and to W&B's synchronised TensorBoard: during training the measures of the last rollouts, at its
    end EMCC of the thirds of training.
    costs: keys of info, such as ("cost", "cost_2"). `records`, `episodes`, `panel()` and the limit
    refer to the first, `records_by_cost` and `episodes_by_cost` to all; the measures of a further
    cost are logged as emcc/cost_2/*.
    rollout: "auto" is "update" for on-policy algorithms (a rollout is collected between two updates
    and cuts running episodes) and "episode" for all others; a number of environment steps is
    possible too, as in `CostRecorder`.
    Each `learn` starts new records, except with reset_num_timesteps=False, which continues the
    records and running episodes; episodes that were reset in between are kept up to the reset.
    alpha: share of the rollouts with the highest MCC. window: number of last rollouts whose
    measures are logged. limit: cost limit of an episode, for the measures that need one; None omits
    these. Measures of whole episodes are logged once an episode has ended. threshold: a step whose
    cost exceeds it is a cost step.
    ValueError: arguments that are not allowed. KeyError: no such cost in the info of a step.
    """

    def __init__(
        self,
        rollout: int | str = "auto",
        alpha: float = ALPHA,
        window: int = MOVING_WINDOW,
        limit: float | None = None,
        threshold: float = 0.0,
        verbose: int = 0,
        costs: Sequence[str] = ("cost",),
    ) -> None:
        super().__init__(verbose)
        if not isinstance(rollout, str):
            rollout = as_count(rollout, "rollout")
        elif rollout not in ("auto", "update", "episode"):
            allowed = '"auto", "update", "episode" or a number'
            raise ValueError(f"rollout must be {allowed}, got {rollout!r}")
        worst([0.0], alpha)  # checks alpha before training starts
        self.rollout, self.alpha, self.window = rollout, alpha, as_count(window, "window")
        self.limit = None if limit is None else as_number(limit, "limit", low=0)
        self.threshold = as_number(threshold, "threshold", low=0)
        self.costs = as_names(costs, "costs")
        self._started: dict[str, tuple[CostRecorder, CostRecorder]] | None = None
        self._last_obs: Any = None  # the observation that the model would continue from

    @property
    def _recorders(self) -> dict[str, tuple[CostRecorder, CostRecorder]]:
        """By cost, a recorder of the rollouts and one of whole episodes, which nothing cuts."""
        if self._started is None:
            raise RuntimeError(
                "nothing is recorded: give the callback to model.learn(callback=...)"
            )
        return self._started

    @property
    def records(self) -> EpisodeRecords:
        """Trajectories of the rollouts, followed by the running trajectories up to now."""
        return self.records_by_cost[self.costs[0]]

    @property
    def records_by_cost(self) -> dict[str, EpisodeRecords]:
        """`records` of each cost, by name."""
        return {name: of_rollouts.snapshot for name, (of_rollouts, _) in self._recorders.items()}

    @property
    def episodes(self) -> EpisodeRecords:
        """Whole episodes; running ones are left out."""
        return self.episodes_by_cost[self.costs[0]]

    @property
    def episodes_by_cost(self) -> dict[str, EpisodeRecords]:
        """`episodes` of each cost, by name."""
        return {name: whole.records for name, (_, whole) in self._recorders.items()}

    def panel(self, limit: float | None = None) -> Panel:
        """Return `emcc.panel` of the training so far. limit: by default the callback's."""
        limit = self.limit if limit is None else limit
        return self._panel(self.costs[0], limit)

    def _panel(self, name: str, limit: float | None) -> Panel:
        of_rollouts, whole = self._recorders[name]
        how = {"total_steps": of_rollouts.steps, "episodes": whole.records}
        return panel(of_rollouts.snapshot, limit, self.alpha, **how)

    def _on_training_start(self) -> None:
        if self._started is not None and not self.locals["reset_num_timesteps"]:
            if self.model._last_obs is not self._last_obs:  # the environment was reset in between
                for recorders in self._started.values():
                    for recorder in recorders:
                        recorder.cut()
            return
        rollout = self.rollout
        if rollout == "auto":
            rollout = "update" if isinstance(self.model, OnPolicyAlgorithm) else "episode"
        self._by_update = rollout == "update"
        envs, kind = self.training_env.num_envs, "manual" if self._by_update else rollout
        self._started = {
            name: (
                CostRecorder(envs, kind, self.threshold),
                CostRecorder(envs, "episode", self.threshold),
            )
            for name in self.costs
        }

    def _on_step(self) -> bool:
        norm = self.model.get_vec_normalize_env()
        rewards = self.locals["rewards"] if norm is None else norm.get_original_reward()
        for name, recorders in self._recorders.items():
            costs = [cost_of(info, name) for info in self.locals["infos"]]
            for recorder in recorders:
                recorder.step(costs, rewards, self.locals["dones"])
        if not self._by_update and np.any(self.locals["dones"]):
            self._log()
        return True

    def _on_rollout_end(self) -> None:
        if self._by_update:
            self._end_rollout()
            self._log()

    def _on_training_end(self) -> None:
        self._last_obs = self.model._last_obs
        if self._by_update:  # otherwise the running episodes continue in the next `learn`
            self._end_rollout()
        for name, (recorder, _) in self._recorders.items():
            if not recorder.steps:
                return
            for part, measures in self._panel(name, self._limit_of(name)).parts.items():
                if measures is not None:
                    self.logger.record(f"{self._prefix(name)}emcc_{part}", measures.emcc)
        self.logger.dump(self.num_timesteps)

    def _log(self) -> None:
        for cost, recorders in self._recorders.items():
            recent, episodes = (recorder.recent(self.window) for recorder in recorders)
            if not len(recent):
                return
            how = (self._limit_of(cost), self.alpha, self.window, "split")
            for name, value in vars(measures_of(recent, episodes, recent, *how)).items():
                if isinstance(value, (int, float)):
                    self.logger.record(f"{self._prefix(cost)}{name}", value)

    def _end_rollout(self) -> None:
        for of_rollouts, _ in self._recorders.values():
            of_rollouts.end_rollout()

    def _limit_of(self, cost: str) -> float | None:
        return self.limit if cost == self.costs[0] else None

    def _prefix(self, cost: str) -> str:
        """Return the prefix of a cost's measures in the logger."""
        return "emcc/" if cost == self.costs[0] else f"emcc/{cost}/"
