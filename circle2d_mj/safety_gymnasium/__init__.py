"""The face of safety-gymnasium 1.0.0, for code that was written for it.

    import circle2d_mj.safety_gymnasium as safety_gymnasium

    env = safety_gymnasium.make("SafetyPointGoal2-v0")
    observation, reward, cost, terminated, truncated, info = env.step(action)

`install()` does the same for code that cannot be changed: `import safety_gymnasium` finds this
module then. Importing it registers the suite's ids with suffix Gymnasium, too, as in
`gymnasium.make("SafetyPointGoal2Gymnasium-v0")`: five values.
"""

from __future__ import annotations

import sys
from typing import Any

import gymnasium as gym

from circle2d_mj import registration
from circle2d_mj.safety.tasks import NAMES, TASKS
from circle2d_mj.safety_gymnasium import vector, wrappers
from circle2d_mj.safety_gymnasium.making import make

__all__ = ["install", "make", "registry", "vector", "wrappers"]
__version__ = "1.0.0"
"""The version of safety-gymnasium whose tasks these are."""

registry = {NAMES[name]: gym.spec(f"circle2d_mj/{NAMES[name]}") for name in TASKS}
"""The ids that `make` takes, with gymnasium's specifications of them."""


def install() -> None:
    """Let `import safety_gymnasium`, in this process, find this module.

    Raises RuntimeError where another safety_gymnasium has been imported.
    """
    name, here = "safety_gymnasium", sys.modules[__name__]
    found = sys.modules.get(name, here)
    if found is not here:
        raise RuntimeError(f"{name} has been imported already, from {found.__file__}")
    sys.modules[name] = here
    sys.modules[f"{name}.wrappers"] = wrappers
    parts = ("async_vector_env", "sync_vector_env", "utils", "utils.tile_images")
    for part in ("vector", *(f"vector.{module}" for module in parts)):
        sys.modules[f"{name}.{part}"] = vector


def _register_five_values() -> None:
    for name, task in TASKS.items():
        plain, version = NAMES[name].rsplit("-", 1)
        arguments: dict[str, Any] = {"task": name}
        registration.add(
            f"{plain}Gymnasium-{version}", "safety.envs:Safety", task.max_episode_steps, **arguments
        )


_register_five_values()
