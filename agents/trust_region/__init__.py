"""The trust-region family: natural-gradient steps of the policy."""
