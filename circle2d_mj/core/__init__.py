"""The gymnasium side of any task: environments, random streams, wrappers."""
