"""Circle2D: its parameters, region, dynamics and environments."""
