"""Optuna: find the barrier factor of SAC-LB with the lowest EMCC, here with far too few steps.

To keep the study, use SQLite: `optuna.create_study(storage="sqlite:///study.db", ...)`.
"""

import numpy as np
import optuna

import agents
import emcc


def emcc_of(trial: optuna.Trial) -> float:
    factor = trial.suggest_float("log_barrier_factor", 0.5, 10.0, log=True)
    runs = agents.train("sac-lb", seeds=(0, 1), steps=1500, random_steps=500, gradient_steps=1,
        log_barrier_factor=factor)  # fmt: skip
    return float(np.mean([records.emcc() for records in runs.records.values()]))


study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
study.optimize(emcc_of, n_trials=3)
best = agents.train(
    "sac-lb", seeds=9, steps=1500, random_steps=500, gradient_steps=1, **study.best_params
)
print(emcc.panel(best.records[best.folder, 9], limit=5.0).to_markdown())
