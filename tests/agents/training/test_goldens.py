"""Golden records of the first epochs of every algorithm, reproduced within 1e-4.

Those of five algorithms were recorded by version 0.3.0 (commit 81307c5), which trained in PyTorch,
the others by version 0.4.0. FOCOPS and CUP are among the latter, since they follow their authors'
code since then, with standardised cost advantages and a multiplier of the discounted cost.

    python tests/agents/training/test_goldens.py     # records those of 0.4.0 anew
"""

import contextlib
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from agents.algorithms import BUILT_IN
from agents.lockstep import backend
from agents.presets import preset
from agents.training.config import TrainConfig
from agents.training.trainer import Trainer

TASK = "Circle2D-1-v0"
FOLDER = Path(__file__).parents[2] / "golden"
OF_0_3_0 = json.loads((FOLDER / "trainings_0_3_0.json").read_text("utf-8"))
OF_0_4_0 = json.loads((FOLDER / "trainings_0_4_0.json").read_text("utf-8"))
GOLDEN = OF_0_3_0 | OF_0_4_0


def records(algorithm, epochs, folder):
    """Yield the records of the first epochs of a training of seed 0."""
    config = preset(algorithm, TASK)
    if hasattr(config, "random_steps"):
        config = replace(config, random_steps=300 if config.random_share else 0)
    training = TrainConfig(algorithm, (TASK,), (0,), 10**6, config)
    training.write(folder)
    with contextlib.closing(Trainer(folder, training)) as trainer:
        for _ in range(epochs):
            trainer.run_epoch()
            (latest,) = trainer.recorder.latest.values()
            yield {name: float(f"{value:.7g}") for name, value in latest.items()}


@pytest.mark.parametrize("algorithm", GOLDEN)
def test_first_epochs(algorithm, tmp_path):
    expected = GOLDEN[algorithm]
    with backend.restored():
        backend.configure(backend.choose("c++")[0])
        for found, then in zip(records(algorithm, len(expected), tmp_path), expected, strict=True):
            assert found == pytest.approx(then, rel=1e-4, abs=1e-4)
    assert "critic_loss" in expected[-1]


def test_every_algorithm_has_golden_records():
    assert set(GOLDEN) == set(BUILT_IN)


def main():
    """Record the trainings of version 0.4.0 anew."""
    backend.configure("c++")
    found = {}
    for algorithm in BUILT_IN:
        if algorithm not in OF_0_3_0:
            epochs = 7 if hasattr(preset(algorithm, TASK), "random_steps") else 3
            with tempfile.TemporaryDirectory() as folder:
                found[algorithm] = list(records(algorithm, epochs, Path(folder)))
    lines = (
        f'"{name}": [\n' + ",\n".join(map(json.dumps, of)) + "\n]" for name, of in found.items()
    )
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    (FOLDER / "trainings_0_4_0.json").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
