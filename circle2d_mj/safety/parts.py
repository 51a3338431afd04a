"""The parts of a navigation task's observation, with safety-gymnasium's names."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray

from circle2d_mj.core.engine import mujoco
from circle2d_mj.safety import rules
from circle2d_mj.safety.worlds import World

PICTURE = "vision"
"""Name of the agent's camera, and of its picture in the observation."""


def of_world(world: World, picture: tuple[int, int] | None) -> Dict:
    """Return the parts in the observation's order: the agent's sensors, the lidars and, if
    `picture` is (width, height), the picture, uint8 [height, width, 3]."""
    model, agent = world.model, world.agent
    shapes: dict[str, tuple[int, ...]] = {}
    later: dict[str, tuple[int, ...]] = {}
    for i in range(model.nsensor):
        sensor = model.sensor(i)
        if sensor.adr[0] >= agent.sensed:
            break
        angle = sensor.type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS
        place = sensor.type[0] == mujoco.mjtSensor.mjSENS_FRAMEPOS  # only the height is observed
        size = 2 if angle else 1 if place else int(sensor.dim[0])
        (later if angle else shapes)[sensor.name] = (size,)
    if agent.name == "Car":
        later["ballquat_rear"] = (3, 3)
    spaces: Any = OrderedDict()  # Gymnasium's Dict would sort the names of a dict
    for name, shape in (shapes | later).items():
        spaces[name] = Box(-np.inf, np.inf, shape, np.float64)
    for kind in world.scene.lidars:
        spaces[f"{kind}_lidar"] = Box(0.0, 1.0, (rules.LIDAR_BINS,), np.float64)
    if picture:
        spaces[PICTURE] = Box(0, 255, (picture[1], picture[0], 3), np.uint8)
    return Dict(spaces)


def by_name(parts: Dict, numbers: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Split the numbers of observations, [n, size], into parts: [n, *shape of the part]."""
    found, first = {}, 0
    for name, space in parts.items():
        if name != PICTURE:
            stop = first + int(np.prod(space.shape or ()))
            found[name] = numbers[:, first:stop].reshape(len(numbers), *(space.shape or ()))
            first = stop
    return found
