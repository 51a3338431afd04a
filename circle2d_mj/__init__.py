"""Tasks for safe reinforcement learning: Safety-Gymnasium's on current MuJoCo, and Circle2D. The
packages `agents` (algorithms and trained agents) and `emcc` (the metric) belong to the same suite.

    import circle2d_mj
    import gymnasium as gym

    env = gym.make("Circle2D-1-v0")

Importing the package registers its tasks with Gymnasium. If a program takes only an id, a prefix
imports the package: `gym.make("circle2d_mj:Circle2D-1-v0")`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.envs import Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.region import CostRegion
from circle2d_mj.registration import register

if TYPE_CHECKING:
    from circle2d_mj.safety.six_values import FromSafetyGymnasium, SafetyGymnasiumAPI

    __version__: str

__all__ = [
    "Circle2DConfig",
    "Circle2DEnv",
    "Circle2DVectorEnv",
    "CostRegion",
    "FromSafetyGymnasium",
    "SafetyGymnasiumAPI",
    "__version__",
]


def __getattr__(name: str) -> Any:
    if name in ("FromSafetyGymnasium", "SafetyGymnasiumAPI"):
        return getattr(import_module("circle2d_mj.safety.six_values"), name)
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("circle2d-mj")
        except PackageNotFoundError as error:
            raise AttributeError("circle2d_mj.__version__: circle2d-mj is not installed") from error
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


register()
