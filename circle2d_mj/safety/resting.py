"""Objects that rest out of reach, which a step leaves as they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch
from circle2d_mj.safety import worlds
from circle2d_mj.safety.worlds import World

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
SUBSTEPS = 10
AT_REST = 1e-8
"""Speed in m/s and rad/s below which an object stands. At the start it is 0 exactly, and objects
have yet to settle by micrometres."""
STRIDE = 0.1
"""How far an agent, or what stood and is pushed, may move within a step, m: see the tests"""


class Resting:
    """The free objects that rest out of reach: a step leaves them as they are.

    Most of a step's time goes into contacts of objects with the floor. Those of objects that stand,
    and that neither the agent nor an object that could move can touch within the step, are left
    out, and the objects' states are put back after it. Which objects do is a function of the
    state.
    """

    def __init__(self, batch: Batch, world: World, qpos: Floats, qvel: Floats) -> None:
        """qpos, qvel: of the free objects, [num_envs, k, 7] and [num_envs, k, 6], live."""
        (kind,) = (kind for kind in world.kinds.values() if kind.physics == "free")
        self._batch, self._free = batch, world.free
        self._qpos, self._qvel = qpos, qvel
        self._of_agent = world.agent.radius + kind.radius + STRIDE
        self._of_object = 2 * kind.radius + STRIDE
        self._seconds = SUBSTEPS * world.model.opt.timestep
        first = world.model.body(worlds.names(kind, 1)[0]).geomadr[0]
        self._geoms = (world.model.ngeom - first) // self._qpos.shape[1]
        self._collides = [
            batch.expand(f"geom_{name}")[:, first:] for name in ("contype", "conaffinity")
        ]

    def wake(self, index: NDArray[np.intp]) -> None:
        """Let all objects of the environments `index` collide."""
        for collides in self._collides:
            collides[index] = 1

    def step(self, distance: Floats, places: Floats) -> None:
        """Take the substeps. distance: [num_envs, objects], from the agent; places: [.., 2]."""
        awake = self._awake(distance[:, self._free], places[:, self._free])
        for collides in self._collides:
            collides[:] = np.repeat(awake, self._geoms, axis=1)
        if awake.all():
            self._batch.step(nstep=SUBSTEPS)
            return
        qpos, qvel, asleep = self._qpos.copy(), self._qvel.copy(), ~awake[..., None]
        self._batch.step(nstep=SUBSTEPS)
        np.copyto(self._qpos, qpos, where=asleep)
        np.copyto(self._qvel, qvel, where=asleep)

    def _awake(self, distance: Floats, places: Floats) -> Flags:
        """Which objects may move in this step: [num_envs, k]."""
        speed = np.add.reduce(np.abs(self._qvel), axis=2)  # of both kinds: no less than of each
        awake = (speed == 0.0) | (speed >= AT_REST) | (distance < self._of_agent)
        if awake.shape[1] == 1 or not awake.any():
            return awake
        # What is awake may push what it reaches, and that may push others.
        reach = self._of_object + self._seconds * speed
        dx = places[:, :, None, 0] - places[:, None, :, 0]
        dy = places[:, :, None, 1] - places[:, None, :, 1]
        near = dx * dx + dy * dy < (reach * reach)[:, None, :]
        while True:
            reached = (near & awake[:, None, :]).any(axis=2)
            if (reached <= awake).all():
                return awake
            awake |= reached
