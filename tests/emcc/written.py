"""Write run folders as trainings do; read records as rows."""

import json

import numpy as np


def arrays_of(costs, name="cost"):
    """Return the arrays of a run, as `results.npz` holds them; each episode is a rollout.

    costs: the costs of the steps of each episode. name: of the cost.
    """
    joined = np.concatenate([*costs, []]).astype(float)
    length = np.array([len(episode) for episode in costs])
    arrays = {"rollouts": np.ones(len(costs), int), "length": length, "return": -0.5 * length}
    arrays[f"costs/{name}/steps"] = np.array(len(joined))
    arrays[f"costs/{name}/unsafe"] = np.packbits(joined != 0)
    if (joined > 1).any():
        arrays[f"costs/{name}/values"] = joined[joined != 0]
    return arrays


def write_run(folder, runs, **config):
    """Write a run folder and return its path. runs: (task, seed) -> arrays of that run."""
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
    """Return (rollout, start step, length, cost, longest streak) of each record of a recorder."""
    kept = kept_by.records
    columns = (kept.rollout, kept.start_step, kept.length, kept.cost, kept.longest_streak)
    return list(zip(*(column.tolist() for column in columns), strict=True))
