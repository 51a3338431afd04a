"""Circle2D: a benchmark task for safe exploration.

`gymnasium.make("Circle2D-1-v0")` works without importing this package, once it is installed.
"""

from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.envs import Circle2DEnv, Circle2DVectorEnv
from circle2d_mj.circle2d.region import CostRegion
from circle2d_mj.core.wrappers import FromSafetyGymnasium, SafetyGymnasiumAPI
from circle2d_mj.registration import register

__all__ = [
    "Circle2DConfig",
    "Circle2DEnv",
    "Circle2DVectorEnv",
    "CostRegion",
    "FromSafetyGymnasium",
    "SafetyGymnasiumAPI",
]

register()
