"""Circle2D: a benchmark task for safe exploration.

`gymnasium.make("Circle2D-1-v0")` works without importing this package, once it is installed.
"""

from circle2d_mj.config import Circle2DConfig
from circle2d_mj.envs import Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.region import CostRegion
from circle2d_mj.registration import register
from circle2d_mj.wrappers import FromSafetyGymnasium, SafetyGymnasiumAPI

__all__ = [
    "Circle2DConfig",
    "Circle2DEnv",
    "Circle2DVectorEnv",
    "CostRegion",
    "FromSafetyGymnasium",
    "SafetyGymnasiumAPI",
]

register()
