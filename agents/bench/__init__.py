"""The paper's experiments: presets, its printed numbers, tables."""
