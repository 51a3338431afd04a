"""The cut-outs as read off the paper's figures; uses no code of the package."""

STRIPS = {
    0: [(180, 0.95, 1.0)],
    1: [(180, 0.95, 1.0)],
    2: [(180, 0.95, 1.0), (90, 0.5, 1.0), (-90, 0.5, 1.0)],
    3: [(180, 0.95, 1.0), (90, 0.5, 1.0), (-90, 0.5, 1.0), (45, 0.3, 0.5), (-45, 0.3, 0.5)],
}
"""Level -> strips: angle in degrees, depth / R, width / R per corridor height factor."""
