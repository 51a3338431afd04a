"""The part that all tasks share: Gymnasium environments and random streams."""
