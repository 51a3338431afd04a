"""The off-policy family: soft actor-critic with cost critics."""
