"""The paper's other three tasks, ported from Safety-Gymnasium 1.0: a point agent on a circle, the
same agent among hazards, and a hopper with a speed limit.

`gymnasium.make` loads these modules, and MuJoCo with them; `import circle2d_mj` loads `tasks` only.
"""
