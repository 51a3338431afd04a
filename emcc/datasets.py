"""Records from the data of other libraries: Minari's data sets, TorchRL's batches.

The objects are used as they come; neither library is imported.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_array
from emcc.recorder import CostRecorder
from emcc.records import EpisodeRecords


def from_minari(dataset: Any, threshold: float = 0.0) -> EpisodeRecords:
    """Records of a Minari data set, each episode a rollout, in the data set's order.

    dataset: a minari.MinariDataset recorded with `record_infos=True`, with "cost" in the infos.
    Infos have an entry more than an episode has steps, that of the reset: its cost is dropped.
    threshold: a step whose cost exceeds it is a cost step.
    ValueError: no episode, or one whose costs are missing, of another length, negative or NaN.
    """
    costs, lengths, rewards = [], [], []
    for episode in dataset.iterate_episodes():
        if "cost" not in (episode.infos or {}):
            raise ValueError(
                f"episode {episode.id} has no 'cost' in its infos (it has "
                f"{sorted(episode.infos or {})}): record with record_infos=True from an "
                "environment whose info has a cost"
            )
        steps = len(episode.rewards)
        cost = as_array(episode.infos["cost"], f"costs of episode {episode.id}").reshape(-1)
        if len(cost) != steps + 1:
            raise ValueError(
                f"episode {episode.id} has {steps} steps and {len(cost)} costs; needed are those "
                "of the reset and of every step"
            )
        costs.append(cost[1:])
        rewards.append(as_array(episode.rewards, f"rewards of episode {episode.id}"))
        lengths.append(steps)
    if not lengths:
        raise ValueError("the data set has no episode")
    joined = np.concatenate(costs), lengths, np.concatenate(rewards)
    return EpisodeRecords.from_costs(*joined, threshold=threshold)


def from_tensordict(
    batches: Any, rollout: str = "batch", threshold: float = 0.0
) -> EpisodeRecords:  # fmt: skip
    """Records of a TensorDict of TorchRL, or of those that a collector yields one after another.

    batches: a TensorDict [time] or [..., time] with ("next", "cost"), ("next", "reward") and
    ("next", "done"), or an iterable of them. The environment has to tell its cost:
    `env.auto_register_info_dict()` for a GymEnv. Every leading index is an environment, stepped
    together with the others; the dimension named "time" is the last, unless the names say another.
    rollout: "batch" where the policy is updated after each batch: running episodes are cut there;
    "episode" where each episode is a rollout: they go on in the next batch. Episodes that have not
    ended with the last batch are trajectories as well.
    threshold: a step whose cost exceeds it is a cost step.
    KeyError: no cost. ValueError: no batch, another rollout, batches of different environments.
    """
    if rollout not in ("batch", "episode"):
        raise ValueError(f'rollout must be "batch" or "episode", got {rollout!r}')
    recorder = None
    for batch in [batches] if hasattr(batches, "batch_size") else _iterable(batches):
        cost, reward, done = (_steps(batch, name) for name in ("cost", "reward", "done"))
        if recorder is None:
            kind = "manual" if rollout == "batch" else "episode"
            recorder = CostRecorder(cost.shape[1], kind, threshold)
        if cost.shape[1] != recorder.num_envs:
            raise ValueError(
                f"a batch has {cost.shape[1]} environments, the first has {recorder.num_envs}"
            )
        for step in range(len(cost)):
            recorder.step(cost[step], reward[step], done[step])
        if rollout == "batch":
            recorder.end_rollout()
    if recorder is None:
        raise ValueError("there is no batch")
    recorder.cut()  # the episodes that are still running
    return recorder.records


def _iterable(batches: Any) -> Iterable[Any]:
    if isinstance(batches, Iterable):
        return batches
    raise TypeError(f"batches must be a TensorDict or several, got {type(batches).__name__}")


def _steps(batch: Any, name: str) -> NDArray[Any]:
    """[time, environments] of ("next", name)."""
    values = batch.get(("next", name), None)
    if values is None:
        following = batch.get("next", None)
        keys = [] if following is None else sorted(map(str, following.keys()))
        raise KeyError(
            f"the batch has no ('next', {name!r}); next has {keys}. For a cost, call "
            "env.auto_register_info_dict() before collecting"
        )
    dimensions = len(batch.batch_size)
    if dimensions == 0:
        raise ValueError("the batch must have a time dimension, got batch_size []")
    names = list(getattr(batch, "names", None) or [])
    time = names.index("time") if "time" in names else dimensions - 1
    array = as_array(values, name)
    array = array.reshape(tuple(batch.batch_size))  # drops the last axis, of one value
    return np.moveaxis(array, time, 0).reshape(array.shape[time], -1)
