"""Ray Tune: find the barrier factor of SAC-LB with the lowest EMCC, here with too few steps."""

import numpy as np
from ray import tune

import agents
import emcc

SMALL = {"steps": 1500, "random_steps": 500, "gradient_steps": 1}


def emcc_of(config: dict) -> dict:
    runs = agents.train("sac-lb", seeds=(0, 1), **SMALL, **config)
    return {"emcc": float(np.mean([records.emcc() for records in runs.records.values()]))}


space = {"log_barrier_factor": tune.loguniform(0.5, 10.0)}
search = tune.TuneConfig(metric="emcc", mode="min", num_samples=3)
tuner = tune.Tuner(emcc_of, param_space=space, tune_config=search)
best = tuner.fit().get_best_result().config
runs = agents.train("sac-lb", seeds=9, **SMALL, **best)
print(emcc.panel(runs.records[runs.folder, 9], limit=5.0).to_markdown())
