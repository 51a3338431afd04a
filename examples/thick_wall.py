"""Circle2D-3 with cut-outs one step less deep, so that the wall to the corridor is a step thicker.

The paper does not specify the sizes of cut-outs. results/README.md tells whether results depend on
ours.

Run in this folder:

circle2d train sac-lb --import thick_wall --task Circle2DThickWall-3-v0 --cost-limit 5 \
    --time-limit terminal --steps 500000 --seeds 0 1 2 3 4 --out runs/thick-wall
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import gymnasium as gym

from circle2d_mj import Circle2DConfig, Circle2DVectorEnv, CostRegion
from circle2d_mj.circle2d.envs import MAX_EPISODE_STEPS, for_gym_make


class ThickWall(Circle2DConfig):
    """Level 3 with all cut-outs but the corridor less deep by a full step."""

    @cached_property
    def region(self) -> CostRegion:
        """Cost region of this task."""
        region = CostRegion(self)
        corridor, *others = region.cutouts
        shallower = [cut._replace(inner=cut.inner + self.full_step) for cut in others]
        region._shape(region.radius, (corridor, *shallower))
        return region


def env(**how: Any) -> gym.Env:
    """Return one environment, for `gymnasium.make`."""
    return for_gym_make(config=ThickWall(level=3), **how)


def vector_env(num_envs: int, **how: Any) -> Circle2DVectorEnv:
    """Return a vector environment, for `gymnasium.make_vec`."""
    return Circle2DVectorEnv(num_envs, config=ThickWall(level=3), **how)


gym.register(
    "Circle2DThickWall-3-v0",
    entry_point=env,
    vector_entry_point=vector_env,
    max_episode_steps=MAX_EPISODE_STEPS,
)
