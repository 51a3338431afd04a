"""TensorBoard event files of a training: what `episodes.csv` and `updates.csv` hold, live."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from agents.errors import UserError
from agents.runs.config import run_folder

if TYPE_CHECKING:
    from agents.runs.train import Training


def require_tensorboard() -> None:
    """Raise UserError, saying how to install it, where TensorBoard is missing."""
    try:
        import torch.utils.tensorboard  # noqa: F401  # an extra, and slow to import
    except ImportError:
        raise UserError(
            "TensorBoard is not installed: pip install 'circle2d-mj[tensorboard]'"
        ) from None


class Events:
    """Writes the epochs of a training, each run into `tensorboard` in its folder.

    Event files hold times of day, unlike the other records. After a resume, what an interrupted
    training had written beyond its checkpoint is marked as void.
    """

    def __init__(self, folder: Path, training: Training) -> None:
        require_tensorboard()
        from torch.utils.tensorboard import SummaryWriter

        self._writers = [
            SummaryWriter(str(run_folder(folder, seed) / "tensorboard"), purge_step=int(steps) + 1)
            for seed, steps in zip(training.config.seeds, training.steps, strict=True)
        ]

    def write(self, training: Training) -> None:
        """Write the last epoch, at the environment steps that each run has taken."""
        episodes, updates = training.log.latest
        for run, writer in enumerate(self._writers):
            rows = episodes[run]
            if np.isnan(rows).any():
                continue
            _, length, returns, cost, streak = rows.T
            values = {
                "rollout/return": returns.mean(),
                "rollout/cost": cost.mean(),
                "rollout/length": length.mean(),
                "rollout/mcc": (streak / length).max(),
            }
            metrics = zip(training.log.metrics, updates[run], strict=True)
            values |= {f"update/{name}": v for name, v in metrics if not np.isnan(v)}
            for name, v in values.items():
                writer.add_scalar(name, v, int(training.steps[run]))

    def close(self) -> None:
        """Write what is held back."""
        for writer in self._writers:
            writer.close()
