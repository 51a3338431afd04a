"""Results of runs: measures, statistics, and where they are read from."""

from agents.results.frame import read

__all__ = ["read"]
