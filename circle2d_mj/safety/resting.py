"""Objects whose next state is known while nothing touches them, so that steps skip them."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch, mujoco
from circle2d_mj.safety import rules, worlds
from circle2d_mj.safety.substeps import SUBSTEPS, Substeps
from circle2d_mj.safety.worlds import World

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
AT_REST = 1e-8
"""Speed in m/s and rad/s below which an object rests. A speed of exactly 0 does not count: that is
the start, when objects have yet to settle by micrometres."""
ON_PATH = 1e-13
"""Deviation from its path, by rounding, that a gremlin may have, m, m/s and rad/s."""
SETTLED = 0.5
"""Time after which a gremlin may be on its path, s; until then it catches up with its target."""


class Resting:
    """Free objects; a step leaves those that rest out of reach as they are.

    Contacts of objects with the floor take most of a step's time. A step therefore leaves out the
    contacts of every object that rests and that neither the agent nor a moving object can touch
    within the step, and restores the object's state afterwards. Which objects are left out is a
    function of the state.
    """

    way = 0.0
    """Distance that an object moves by itself within a step, m."""

    def __init__(
        self, batch: Batch, world: World, substeps: Substeps, qpos: Floats, qvel: Floats
    ) -> None:
        """qpos, qvel: of the free objects, [num_envs, k, 7] and [num_envs, k, 6], live."""
        (kind,) = (k for k in world.kinds.values() if k.physics in ("free", "driven"))
        self._substeps, self._free = substeps, world.free
        self._qpos, self._qvel = qpos, qvel
        stride = world.agent.stride + self.way
        self._of_agent = world.agent.radius + kind.radius + stride
        self._of_object = 2 * kind.radius + stride
        self._seconds = SUBSTEPS * world.model.opt.timestep
        first = world.model.body(worlds.names(kind, 1)[0]).geomadr[0]
        shape = (*qpos.shape[:2], -1)  # [num_envs, k, geoms per object]
        self._collides = [
            batch.expand(f"geom_{name}")[:, first:].reshape(shape)
            for name in ("contype", "conaffinity")
        ]

    def wake(self, index: NDArray[np.intp]) -> None:
        """Let all objects of the environments `index` collide."""
        for collides in self._collides:
            collides[index] = 1

    def step(self, distance: Floats, places: Floats) -> None:
        """Take the substeps. distance: [num_envs, objects], from the agent; places: [.., 2]."""
        speed = np.add.reduce(np.abs(self._qvel), axis=2)  # bounds linear and angular speed
        awake = (speed == 0.0) | (speed >= AT_REST)
        awake = self._awake(awake, speed, distance[:, self._free], places[:, self._free])
        for collides in self._collides:
            collides[:] = awake[..., None]
        if awake.all():
            self._substeps.take()
            return
        qpos, qvel, asleep = self._qpos.copy(), self._qvel.copy(), ~awake[..., None]
        self._substeps.take()
        np.copyto(self._qpos, qpos, where=asleep)
        np.copyto(self._qvel, qvel, where=asleep)

    def _awake(self, awake: Flags, speed: Floats, distance: Floats, places: Floats) -> Flags:
        """Return which objects may leave their known states: the `awake` ones and all in reach.

        awake, speed, distance (from the agent): [num_envs, k]; places: [num_envs, k, 2].
        """
        awake = awake | (distance < self._of_agent)
        if awake.shape[1] == 1 or not awake.any():
            return awake
        # An awake object may push objects within its reach, and these may push others.
        reach = self._of_object + self._seconds * speed
        dx = places[:, :, None, 0] - places[:, None, :, 0]
        dy = places[:, :, None, 1] - places[:, None, :, 1]
        near = dx * dx + dy * dy < (reach * reach)[:, None, :]
        while True:
            reached = (near & awake[:, None, :]).any(axis=2)
            if (reached <= awake).all():
                return awake
            awake |= reached


class Circling(Resting):
    """The gremlins; a step moves those that nothing touches along their paths.

    A gremlin is welded to a target on a circle, which moves before each substep. Its position after
    a number of steps, relative to its place, is the same for all gremlins and rotations: `Path`.
    """

    way = 0.02

    def __init__(
        self, batch: Batch, world: World, substeps: Substeps, qpos: Floats, qvel: Floats
    ) -> None:
        super().__init__(batch, world, substeps, qpos, qvel)
        self.at_rest = qpos[:, :, :3].copy()
        """Where gremlins were placed, m: [num_envs, k, 3]."""
        self._time = batch.bind("time").reshape(-1)
        self._welded = batch.bind("eq_active")[:, -qpos.shape[1] :]  # after the agent's equalities
        self._mocap_pos = batch.bind("mocap_pos").reshape(len(qpos), -1, 3)
        self._targets = self._mocap_pos[:, -qpos.shape[1] :]
        self._timestep = world.model.opt.timestep
        self._path = path(self._timestep, world.model.opt.integrator)

    def put(self, index: NDArray[np.intp], places: Floats) -> None:
        """Set the places of the gremlins of the environments `index`, [len(index), k, 2] m."""
        self.at_rest[index, :, :2] = places

    def wake(self, index: NDArray[np.intp]) -> None:
        """Let all gremlins of the environments `index` collide and follow their targets."""
        super().wake(index)
        self._welded[index] = 1

    def step(self, distance: Floats, places: Floats) -> None:
        """Take the substeps: see `Resting.step`."""
        steps = np.rint(self._time / self._seconds).astype(np.intp)
        here, after = self._path.around(steps)
        speed = np.add.reduce(np.abs(self._qvel), axis=2)
        off_path = ~self._on_path(steps, here)
        awake = self._awake(off_path, speed, distance[:, self._free], places[:, self._free])
        for switched in (*self._collides, self._welded[..., None]):
            switched[:] = awake[..., None]
        qpos = self._qpos.copy()
        np.add(self.at_rest, after[:, None, :3], out=qpos[:, :, :3])
        busy = np.logical_or.reduce(awake, axis=1)
        if not busy.any():
            self._substeps.take()
        else:
            self._follow_targets(np.flatnonzero(busy))
            if not busy.all():
                self._substeps.take(np.flatnonzero(~busy))
        idle = ~busy[:, None, None]
        np.copyto(self._targets, self.at_rest + after[:, None, 9:], where=idle)
        asleep = ~awake[..., None]
        np.copyto(self._qpos, qpos, where=asleep)
        np.copyto(self._qvel, after[:, None, 3:9], where=asleep)

    def _on_path(self, steps: NDArray[np.intp], here: Floats) -> Flags:
        """Return which gremlins are on the path: [num_envs, k]."""
        off = np.abs(self._qpos[:, :, :3] - (self.at_rest + here[:, None, :3]))
        # A gremlin that does not rotate has its target's orientation, or the weld would rotate it.
        moves = np.abs(self._qvel - here[:, None, 3:9])
        farthest = np.maximum(np.maximum.reduce(off, axis=2), np.maximum.reduce(moves, axis=2))
        whole = np.abs(self._time - steps * self._seconds) < 1e-9  # time is a multiple of a step
        return (farthest < ON_PATH) & (whole & (self._time > SETTLED))[:, None]

    def _follow_targets(self, index: NDArray[np.intp]) -> None:
        """Take the substeps of the environments `index`; targets move before each substep."""
        clock = np.full((len(index), SUBSTEPS), self._timestep)
        clock[:, 0] = self._time[index]
        offset = rules.gremlin_offset(np.add.accumulate(clock, axis=1))
        aims = np.repeat(self._mocap_pos[index, None], SUBSTEPS, axis=1)
        aims[:, :, -self.at_rest.shape[1] :] = self.at_rest[index, None] + offset[:, :, None]
        self._substeps.follow(index, aims)


class Path:
    """Positions of a gremlin after each step, relative to its place at the start.

    MuJoCo computes them once per process, as far as they are needed. Nothing rotates, so that all
    versions of MuJoCo's Runge-Kutta scheme agree.
    """

    def __init__(self, timestep: float, integrator: int) -> None:
        self._model = worlds.gremlin_alone(timestep, integrator)
        self._data = mujoco.MjData(self._model)
        self._rest = self._data.qpos[:3].copy()
        self._states = np.zeros((1, 12))

    def around(self, steps: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return the states [n, 12] after numbers of steps [n], and after one step more: position,
        m, and qvel of the gremlin, and position of its last target."""
        if (last := int(np.maximum.reduce(steps)) + 1) >= len(self._states):
            self._extend(last + 100)
        return self._states[steps], self._states[steps + 1]

    def _extend(self, steps: int) -> None:
        data, found = self._data, []
        for _ in range(len(self._states), steps + 1):
            for _ in range(SUBSTEPS):
                data.mocap_pos[0] = self._rest + rules.gremlin_offset(np.array(data.time))
                mujoco.mj_step(self._model, data)
            places = np.array((data.qpos[:3], data.mocap_pos[0])) - self._rest
            found.append(np.concatenate((places[0], data.qvel, places[1])))
        self._states = np.concatenate((self._states, found))


path = functools.cache(Path)
