"""The gymnasium side of any task: environments and random streams."""
