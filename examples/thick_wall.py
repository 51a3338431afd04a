"""Circle2D-3 with cut-outs a step less deep, so that the wall to the corridor is a step thicker.

The sizes of cut-outs are not specified in the paper. Whether results depend on ours:
results/README.md.

Run here:

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
    """Level 3 with the corridor as it is, and all other cut-outs less deep by a full step."""

    @cached_property
    def region(self) -> CostRegion:
        """Cost region of this task."""
        region = CostRegion(self)
        corridor, *others = region.cutouts
        shallower = [cut._replace(inner=cut.inner + self.full_step) for cut in others]
        region._shape(region.radius, (corridor, *shallower))
        return region


def env(**how: Any) -> gym.Env:
    """One environment, as `gymnasium.make` asks for it."""
    return for_gym_make(config=ThickWall(level=3), **how)


def vector_env(num_envs: int, **how: Any) -> Circle2DVectorEnv:
    """Many, as `gymnasium.make_vec` asks for them."""
    return Circle2DVectorEnv(num_envs, config=ThickWall(level=3), **how)


gym.register(
    "Circle2DThickWall-3-v0",
    entry_point=env,
    vector_entry_point=vector_env,
    max_episode_steps=MAX_EPISODE_STEPS,
)
