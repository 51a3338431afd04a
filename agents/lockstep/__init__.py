"""Training many runs in step with each other: everything with a run axis."""
