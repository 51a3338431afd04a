"""A measure of reports: the share of training's episodes without any cost."""

from agents.results.measures import Measure, register


def clean(run):
    """Return the share, from the training's records, which have one row per episode."""
    return float((run.records.cost == 0).mean())


register(Measure("clean", "clean episodes", "share", 2, "higher", clean))
