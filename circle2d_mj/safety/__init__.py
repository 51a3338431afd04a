"""The paper's other three tasks, ported from Safety-Gymnasium 1.0: a point agent on a circle, the
same agent among hazards, and a hopper that must not run too fast.

Only `gymnasium.make` loads what is in here, and with it MuJoCo.
"""
