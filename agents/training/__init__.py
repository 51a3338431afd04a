"""Training runs and what they leave behind: folders, records, checkpoints, evaluations."""
