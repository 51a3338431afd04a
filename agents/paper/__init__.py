"""The paper: its presets, grid, printed numbers and claims."""
