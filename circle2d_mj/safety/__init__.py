"""Safety-Gymnasium's tasks on current MuJoCo: agents among hazards, and bodies with a speed limit.

`gymnasium.make` loads these modules and MuJoCo; `import circle2d_mj` loads only `tasks`.
`six_values` converts between Safety-Gymnasium's six values of a step and Gymnasium's five.
`original` loads states recorded from safety-gymnasium 1.0.0, to compare step by step.
"""
