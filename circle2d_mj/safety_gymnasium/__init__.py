"""The API of safety-gymnasium 1.0.0, for code that was written for that package.

    import circle2d_mj.safety_gymnasium as safety_gymnasium

    env = safety_gymnasium.make("SafetyPointGoal2-v0")
    observation, reward, cost, terminated, truncated, info = env.step(action)

Code that cannot be changed finds this module by `import safety_gymnasium` in three cases: after
`install()`, if it is run by `python -m circle2d_mj.safety_gymnasium COMMAND ...`, and if the
distribution in the folder `drop_in` is installed. Importing the module also registers the suite's
ids with the suffix Gymnasium, for environments with five values, such as
`gymnasium.make("SafetyPointGoal2Gymnasium-v0")`.
"""

from __future__ import annotations

from gymnasium import make as gymnasium_make
from gymnasium import register as gymnasium_register

from circle2d_mj.safety_gymnasium import vector, wrappers
from circle2d_mj.safety_gymnasium.making import make, make_ma, register, registry
from circle2d_mj.safety_gymnasium.naming import install

__all__ = [
    "gymnasium_make",
    "gymnasium_register",
    "install",
    "make",
    "make_ma",
    "register",
    "registry",
    "vector",
    "wrappers",
]
__version__ = "1.0.0"
"""The version of safety-gymnasium that this module stands for."""
