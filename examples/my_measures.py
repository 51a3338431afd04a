"""A measure of reports: the share of training's episodes without any cost."""

from agents.results.measures import Measure, register


def clean(run):
    """The share, of the training's records, one row for each episode."""
    return float((run.records.cost == 0).mean())


register(Measure("clean", "clean episodes", "share", 2, "higher", clean))
