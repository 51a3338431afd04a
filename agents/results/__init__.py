"""Results of runs: measures, statistics, and where they are read from."""
