"""EMCC of a training with Stable-Baselines3."""

from typing import Any

import numpy as np

from emcc.arrays import as_count, as_number
from emcc.panels import WINDOW, Panel, measures_of, panel
from emcc.parts import ALPHA, worst
from emcc.recorder import CostRecorder, cost_of
from emcc.records import EpisodeRecords

try:
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
except ModuleNotFoundError as error:
    raise ImportError("emcc.sb3 needs stable-baselines3: pip install stable-baselines3") from error


class EMCCCallback(BaseCallback):
    """Records the costs of a training, and logs EMCC and its companions as emcc/*.

    Works with every algorithm and VecEnv; the cost is info["cost"] of every step. The numbers go to
    SB3's logger, so to TensorBoard and to W&B's synchronised TensorBoard: while training those of
    the last rollouts, at its end EMCC of the thirds of training.

    rollout: "auto" is "update" for on-policy algorithms (a rollout is what is collected between two
    updates, and cuts running episodes), and "episode" for all others; a number of environment steps
    as in `CostRecorder` is possible too.
    `learn` starts new records, but for reset_num_timesteps=False, which goes on with the old ones
    and with the running episodes; those that were reset in between are kept as far as they got.
    alpha: share of the rollouts with the highest MCC. window: rollouts whose numbers are logged
    while training. limit: cost limit of an episode, for the measures that need one; None omits
    them. Measures of whole episodes are logged once one has ended. threshold: a step whose cost
    exceeds it is a cost step.
    ValueError: arguments that are not allowed. KeyError: no cost in the info of a step.
    """

    def __init__(
        self,
        rollout: int | str = "auto",
        alpha: float = ALPHA,
        window: int = WINDOW,
        limit: float | None = None,
        threshold: float = 0.0,
        verbose: int = 0,
    ) -> None:
        super().__init__(verbose)
        if isinstance(rollout, str) and rollout not in ("auto", "update", "episode"):
            allowed = '"auto", "update", "episode" or a number'
            raise ValueError(f"rollout must be {allowed}, got {rollout!r}")
        worst([0.0], alpha)  # which checks it, before any training
        self.rollout, self.alpha, self.window = rollout, alpha, as_count(window, "window")
        self.limit = None if limit is None else as_number(limit, "limit", low=0)
        self.threshold = as_number(threshold, "threshold", low=0)
        self._started: tuple[CostRecorder, CostRecorder] | None = None
        self._last_obs: Any = None  # from which the model would go on after training

    @property
    def _recorders(self) -> tuple[CostRecorder, CostRecorder]:
        """Recorders of the rollouts, and of whole episodes, whatever cuts the rollouts."""
        if self._started is None:
            raise RuntimeError(
                "nothing is recorded: give the callback to model.learn(callback=...)"
            )
        return self._started

    @property
    def records(self) -> EpisodeRecords:
        """Trajectories of the rollouts; behind them the running ones, as far as they are."""
        return self._recorders[0].snapshot

    @property
    def episodes(self) -> EpisodeRecords:
        """Whole episodes; running ones are left out."""
        return self._recorders[1].records

    def panel(self, limit: float | None = None) -> Panel:
        """All measures of the training so far: `emcc.panel`. limit: by default the callback's."""
        limit = self.limit if limit is None else limit
        steps = self._recorders[0].steps
        return panel(self.records, limit, self.alpha, total_steps=steps, episodes=self.episodes)

    def _on_training_start(self) -> None:
        if self._started is not None and not self.locals["reset_num_timesteps"]:
            if self.model._last_obs is not self._last_obs:  # the environment was reset in between
                for recorder in self._started:
                    recorder.cut()
            return
        rollout = self.rollout
        if rollout == "auto":
            rollout = "update" if isinstance(self.model, OnPolicyAlgorithm) else "episode"
        self._by_update = rollout == "update"
        envs, kind = self.training_env.num_envs, "manual" if self._by_update else rollout
        whole = CostRecorder(envs, "episode", self.threshold)
        self._started = CostRecorder(envs, kind, self.threshold), whole

    def _on_step(self) -> bool:
        costs = [cost_of(info) for info in self.locals["infos"]]
        norm = self.model.get_vec_normalize_env()
        rewards = self.locals["rewards"] if norm is None else norm.get_original_reward()
        for recorder in self._recorders:
            recorder.step(costs, rewards, self.locals["dones"])
        if not self._by_update and np.any(self.locals["dones"]):
            self._log()
        return True

    def _on_rollout_end(self) -> None:
        if self._by_update:
            self._recorders[0].end_rollout()
            self._log()

    def _on_training_end(self) -> None:
        self._last_obs = self.model._last_obs
        recorder, _ = self._recorders
        if self._by_update:  # an episode that is a rollout goes on with the next `learn`
            recorder.end_rollout()
        if not recorder.steps:
            return
        for part, measures in self.panel().parts.items():
            if measures is not None:
                self.logger.record(f"emcc/emcc_{part}", measures.emcc)
        self.logger.dump(self.num_timesteps)

    def _log(self) -> None:
        recent, episodes = (recorder.recent(self.window) for recorder in self._recorders)
        if not len(recent):
            return
        measures = measures_of(recent, episodes, self.limit, self.alpha, self.window, "all")
        for name, value in vars(measures).items():
            if isinstance(value, (int, float)):
                self.logger.record(f"emcc/{name}", value)
