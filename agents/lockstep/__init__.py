"""Training of many runs in lockstep: everything that has a run axis."""
