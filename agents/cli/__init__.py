"""The command `circle2d`."""
