"""Run folders as trainings leave them, written by hand; and rows of records."""

import json

import numpy as np


def arrays_of(costs, name="cost"):
    """The arrays of a run of one episode a rollout, as a run folder has them; name: of its cost."""
    joined = np.concatenate([*costs, []]).astype(float)
    length = np.array([len(episode) for episode in costs])
    arrays = {"rollouts": np.ones(len(costs), int), "length": length, "return": -0.5 * length}
    arrays[f"costs/{name}/steps"] = np.array(len(joined))
    arrays[f"costs/{name}/unsafe"] = np.packbits(joined != 0)
    if (joined > 1).any():
        arrays[f"costs/{name}/values"] = joined[joined != 0]
    return arrays


def write_run(folder, runs, **config):
    """A run folder. runs: (task, seed) -> arrays."""
    folder.mkdir(parents=True)
    tasks, seeds = (list(dict.fromkeys(key[k] for key in runs)) for k in (0, 1))
    settings = {"algorithm": "cpo", "tasks": tasks, "seeds": seeds, "steps": 10_000}
    (folder / "config.json").write_text(json.dumps(settings | {"costs": ["cost"]} | config))
    arrays = {
        f"{task.replace('/', '-')}/{seed}/{name}": array
        for (task, seed), named in runs.items()
        for name, array in {**named, "updates": np.zeros(3)}.items()
    }
    np.savez(folder / "results.npz", **arrays)
    return folder


def rows(kept_by):
    """(rollout, start step, length, cost, longest streak) of a recorder's or wrapper's records."""
    kept = kept_by.records
    columns = (kept.rollout, kept.start_step, kept.length, kept.cost, kept.longest_streak)
    return list(zip(*(column.tolist() for column in columns), strict=True))
