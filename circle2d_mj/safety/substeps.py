"""The substeps of a step: by MuJoCo, or by the Runge-Kutta scheme of MuJoCo before 4.0."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch, mujoco

Floats = NDArray[np.float64]
SUBSTEPS = 10


class Substeps:
    """Takes the substeps of a batch, holding the controls."""

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._control = batch.bind("ctrl")

    def take(self, index: NDArray[np.intp] | None = None) -> None:
        """Take the substeps of the environments `index`; None: of all environments."""
        self._batch.step(index, nstep=SUBSTEPS)

    def follow(self, index: NDArray[np.intp], targets: Floats) -> None:
        """Take the substeps of the environments `index`, and place the mocap bodies before each
        substep: targets [len(index), SUBSTEPS, bodies, 3] m."""
        control = np.repeat(self._control[index, None], SUBSTEPS, axis=1)
        inputs = (control, targets.reshape(len(index), SUBSTEPS, -1))
        what = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS
        inputs = np.concatenate(inputs, axis=2)
        self._batch.rollout(SUBSTEPS, inputs, int(what), record=(), ids=index)


class RungeKutta(Substeps):
    """Takes the substeps with the Runge-Kutta scheme of MuJoCo before 4.0.

    It averages the angular velocities of the four stages without a change of frame, although each
    is in its own stage's frame, so that orientations converge at second order; MuJoCo 4.0 corrects
    this. Each stage is an mj_forward.
    """

    _STAGES = ((0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6))
    """Time of the second to fourth stage, as a share of the substep, and the stage's weight."""

    def __init__(self, batch: Batch, model: mujoco.MjModel) -> None:
        super().__init__(batch)
        self._model, self._h = model, model.opt.timestep
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        self._qacc, self._time = batch.bind("qacc"), batch.bind("time")
        self._mocap_pos = batch.bind("mocap_pos")

    def take(self, index: NDArray[np.intp] | None = None) -> None:
        """Take the substeps: see `Substeps.take`."""
        for _ in range(SUBSTEPS):
            self._substep(index)

    def follow(self, index: NDArray[np.intp], targets: Floats) -> None:
        """Take the substeps with moving targets: see `Substeps.follow`."""
        shape = self._mocap_pos[index].shape
        for k in range(SUBSTEPS):
            self._mocap_pos[index] = targets[:, k].reshape(shape)
            self._substep(index)

    def _substep(self, index: NDArray[np.intp] | None) -> None:
        at = slice(None) if index is None else index
        self._batch.forward(index)
        qpos, qvel, qacc = self._qpos[at].copy(), self._qvel[at].copy(), self._qacc[at]
        speed, way, gain = qvel, qvel / 6, qacc / 6
        for share, weight in self._STAGES:
            self._qpos[at] = self._moved(qpos, share * speed)
            speed = qvel + self._h * (share * qacc)
            self._qvel[at] = speed
            self._batch.forward(index)
            qacc = self._qacc[at]
            way += weight * speed
            gain += weight * qacc
        self._qpos[at], self._qvel[at] = self._moved(qpos, way), qvel + self._h * gain
        self._time[at] += self._h

    def _moved(self, qpos: Floats, speed: Floats) -> Floats:
        """Return the positions after a substep at constant speed."""
        moved = qpos.copy()
        for row, rates in zip(moved, speed, strict=True):
            mujoco.mj_integratePos(self._model, row, rates, self._h)
        return moved


def substeps(batch: Batch, model: mujoco.MjModel) -> Substeps:
    """Return the `Substeps` of a batch for the model's integrator."""
    rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    return RungeKutta(batch, model) if rk4 else Substeps(batch)
