"""Weights & Biases, offline: log metrics of every epoch, and EMCC at the end."""

import wandb

import agents
import emcc


def log(epoch: agents.Epoch) -> None:
    for seed, numbers in epoch.runs.items():
        values = {f"seed {seed}/{name}": numbers[name] for name in ("return", "cost", "mcc")}
        run.log(values, step=int(numbers["step"]))


with wandb.init(project="safe-exploration", mode="offline") as run:
    runs = agents.train("trpo-lag", seeds=0, steps=10_000, on_epoch=log)
    panel = emcc.panel(runs.records[runs.folder, 0], limit=5.0)
    run.summary.update({"emcc": panel.emcc, "cost rate": panel.cost_rate})
print(panel.to_markdown())
