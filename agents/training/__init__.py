"""Training of runs and their files: folders, records, checkpoints, evaluations, policies."""
