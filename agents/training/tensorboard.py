"""TensorBoard event files of a training: the content of `episodes.csv` and `updates.csv`, live."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.training.records import Log


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

    folders: one a run; steps: [R], environment steps taken when the training begins or goes on.

    Event files hold times of day, unlike the other records. After a resume, the events that an
    interrupted training had written beyond its checkpoint are marked as void.
    """

    def __init__(self, folders: Sequence[Path], steps: NDArray[np.int64]) -> None:
        require_tensorboard()
        from torch.utils.tensorboard import SummaryWriter

        self._writers = [
            SummaryWriter(str(folder / "tensorboard"), purge_step=int(taken) + 1)
            for folder, taken in zip(folders, steps, strict=True)
        ]

    def write(self, log: Log, steps: NDArray[np.int64]) -> None:
        """Write the last epoch; steps: [R], environment steps taken by its end."""
        for writer, numbers, step in zip(self._writers, log.latest_numbers(), steps, strict=True):
            for name, value in numbers.items():
                of = "update" if name in log.metrics else "rollout"
                writer.add_scalar(f"{of}/{name}", value, int(step))

    def close(self) -> None:
        """Write out what is buffered."""
        for writer in self._writers:
            writer.close()
