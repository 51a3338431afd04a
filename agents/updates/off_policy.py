"""How an off-policy algorithm goes through an epoch: one episode, then some gradient steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.lockstep import tree
from agents.lockstep.nets import forward_numpy
from agents.lockstep.noise import Purpose, stream
from agents.lockstep.replay import Replay
from agents.lockstep.rollout import Rollout
from agents.updates import sac, squashed_gaussian


class OffPolicy:
    """The runs of one algorithm of the SAC family: their networks and their replay."""

    METRICS = (
        "critic_loss",
        "cost_critic_loss",
        "actor_loss",
        "temperature",
        "multiplier",
        "risk",
        "entropy",
    )

    def __init__(
        self,
        config: Any,
        rule: sac.CostRule,
        seeds: Sequence[int],
        observation_size: int,
        action_size: int,
    ) -> None:
        self.config, self.rule, self.seeds = config, rule, tuple(seeds)
        self.action_size = action_size
        self.nets = sac.make_nets(config, observation_size, action_size)
        self._state = sac.initial_state(self.nets, seeds, config.initial_multiplier)
        self._replay = Replay(len(seeds), config.replay_size, observation_size, action_size)

    @property
    def random_steps(self) -> int:
        """Environment steps of a run before its policy acts."""
        return self.config.random_steps

    def policy(self) -> Any:
        """`policy(observation [R, N, ...], noise) -> actions [R, N, ...]`, as it stands now."""
        layers = self.nets.actor.layers(self._state.actor.numpy())
        return lambda observation, noise: squashed_gaussian.act(
            forward_numpy(layers, observation), noise
        )

    def learn(self, rollout: Rollout, epoch: int, active: NDArray[np.bool_]) -> NDArray:
        """Store an epoch's episodes and take its gradient steps; active: [R], runs not yet done.

        Returns the mean of each of `METRICS` over the steps, [R, metrics]; NaN for runs that took
        none, since their replay holds less than a batch.
        """
        terminal = rollout.terminated
        if self.config.time_limit == "terminal":
            terminal = terminal | rollout.truncated
        length = np.where(active, rollout.length, 0)
        self._replay.add(rollout._replace(length=length), terminal)
        learning = active & (self._replay.size >= self.config.batch_size)
        if not learning.any():
            return np.full((len(self.seeds), len(self.METRICS)), np.nan)
        total = 0.0
        for index, noise in self._draws(epoch):
            batch = self._replay.gather(index)
            state, metrics = sac.update(
                self.nets, self.config, self.rule, self._state, batch, noise
            )
            self._state = tree.where(learning, state, self._state)
            total = total + np.stack([metrics[name].numpy() for name in self.METRICS], axis=-1)
        return np.where(learning[:, None], total / self.config.gradient_steps, np.nan)

    def _draws(self, epoch: int) -> list[tuple[NDArray[np.int64], sac.UpdateNoise]]:
        """What each gradient step of an epoch draws: slots [R, B] and action noise."""
        steps, batch = self.config.gradient_steps, self.config.batch_size
        share, normal = [], []
        for seed in self.seeds:
            rng = stream(seed, Purpose.UPDATE, epoch)
            share.append(rng.random((steps, batch)))
            normal.append(
                rng.standard_normal((steps, 2, batch, self.action_size), dtype=np.float32)
            )
        held = np.maximum(self._replay.size, 1)[:, None]
        index = (np.stack(share, axis=1) * held).astype(np.int64)
        noise = torch.from_numpy(np.stack(normal, axis=1))
        return [
            (index[k], sac.UpdateNoise(noise[k, :, 0].contiguous(), noise[k, :, 1].contiguous()))
            for k in range(steps)
        ]

    def state(self) -> dict[str, NDArray]:
        """The whole training state as named arrays."""
        replay = {f"replay.{name}": array for name, array in self._replay.state().items()}
        return {**tree.flatten(self._state), **replay}

    def restore(self, state: dict[str, NDArray]) -> None:
        """Take over what `state` returned, bit for bit."""
        self._state = tree.unflatten(self._state, state)
        self._replay.restore(
            {k.removeprefix("replay."): v for k, v in state.items() if k.startswith("replay.")}
        )
