"""Trainings as version 0.3.0 (commit 81307c5) trained them, in PyTorch: the records of their first
epochs, which the kernel must give within 1e-4.

FOCOPS and CUP are not among them: since then they follow their authors' code, with standardised
cost advantages and a multiplier of the discounted cost.
"""

import contextlib
import json
from dataclasses import replace
from pathlib import Path

import pytest

from agents.lockstep import backend
from agents.presets import preset
from agents.training.config import TrainConfig
from agents.training.trainer import Trainer

TASK = "Circle2D-1-v0"
GOLDEN = json.loads(
    (Path(__file__).parents[2] / "golden" / "trainings_0_3_0.json").read_text("utf-8")
)


def records(algorithm, epochs, folder):
    """Records of the first epochs of a training of seed 0."""
    config = preset(algorithm, TASK)
    if hasattr(config, "random_steps"):
        config = replace(config, random_steps=0)
    training = TrainConfig(algorithm, (TASK,), (0,), 10**6, config)
    training.write(folder)
    with contextlib.closing(Trainer(folder, training)) as trainer:
        for _ in range(epochs):
            trainer.run_epoch()
            (latest,) = trainer.recorder.latest.values()
            yield {name: float(value) for name, value in latest.items()}


@pytest.mark.parametrize("algorithm", GOLDEN)
def test_first_epochs(algorithm, tmp_path):
    expected = GOLDEN[algorithm]
    with backend.restored():
        backend.configure(backend.choose("c++")[0])
        for found, then in zip(records(algorithm, len(expected), tmp_path), expected, strict=True):
            assert found == pytest.approx(then, rel=1e-4, abs=1e-4)
    assert "critic_loss" in expected[-1]
