"""`circle2d evaluate`: play episodes with trained policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agents.cli.options import Folder, Imports, parse
from agents.cli.outcome import name_failures
from agents.runs import Runs
from agents.training.evaluation import EVALUATION_EPISODES
from agents.training.loop import evaluate_checkpoint
from agents.training.progress import working


@dataclass(frozen=True)
class EvaluateOptions:
    """Play episodes with the policies of a folder's last checkpoint, print their means, and replace
    evaluation.json."""

    folder: Folder
    """Folder of the runs."""
    episodes: int = EVALUATION_EPISODES
    """Episodes of each run and policy (deterministic, stochastic)."""
    imports: Imports = ()


def run(args: Sequence[str]) -> int:
    """Run `circle2d evaluate`; returns the exit status."""
    options = parse(EvaluateOptions, "evaluate", args)
    with working(f"playing {options.episodes} episodes of each run, by either policy"):
        training, results = evaluate_checkpoint(options.folder, options.episodes)
    active = ~training.failed
    taken = training.steps[active] if active.any() else training.steps
    steps = f"after {taken.min()} of {training.config.steps} steps"
    print(f"{options.folder}, {steps}: means over {options.episodes} episodes")
    for name, of_runs in results.items():
        for seed, measures in zip(training.config.seeds, of_runs, strict=True):
            numbers = ", ".join(f"{k} {v:.2f}" for k, v in measures.items() if isinstance(v, float))
            print(f"seed {seed}, {name} policy: {numbers or 'no finite numbers'}")
    return name_failures(Runs([options.folder]))
