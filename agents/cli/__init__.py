"""The command `circle2d`: one file a command."""
