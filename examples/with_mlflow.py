"""MLflow: log metrics of every epoch, and the panel at the end, to the file mlflow.db."""

import mlflow

import agents
import emcc


def log(epoch: agents.Epoch) -> None:
    for seed, numbers in epoch.runs.items():
        values = {f"seed {seed}/{name}": numbers[name] for name in ("return", "cost", "mcc")}
        mlflow.log_metrics(values, step=int(numbers["step"]))


mlflow.set_tracking_uri("sqlite:///mlflow.db")
with mlflow.start_run():
    runs = agents.train("trpo-lag", seeds=0, steps=10_000, on_epoch=log)
    panel = emcc.panel(runs.records[runs.folder, 0], limit=5.0)
    mlflow.log_dict(panel.to_dict(), "panel.json")
print(panel.to_markdown())
