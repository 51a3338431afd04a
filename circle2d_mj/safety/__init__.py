"""Safety-Gymnasium's tasks on current MuJoCo: agents among hazards, and bodies with a speed limit.

`gymnasium.make` loads these modules, and MuJoCo with them; `import circle2d_mj` loads `tasks` only.
`six_values` converts between the steps of that package and those of gymnasium.
`original` loads states recorded from safety-gymnasium 1.0.0, to compare step by step.
"""
