"""The substeps of a step: MuJoCo's own, or Runge-Kutta as MuJoCo was when the suite was made."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are compiled in, where pyright does not see them.

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch, mujoco

Floats = NDArray[np.float64]
SUBSTEPS = 10


class Substeps:
    """Takes the substeps of a batch, with its controls held."""

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._control = batch.bind("ctrl")

    def take(self, index: NDArray[np.intp] | None = None) -> None:
        """Take those of the environments `index`; None: of all."""
        self._batch.step(index, nstep=SUBSTEPS)

    def follow(self, index: NDArray[np.intp], targets: Floats) -> None:
        """Take those of the environments `index`, each with the mocap bodies somewhere else:
        targets [len(index), SUBSTEPS, bodies, 3] m."""
        control = np.repeat(self._control[index, None], SUBSTEPS, axis=1)
        inputs = (control, targets.reshape(len(index), SUBSTEPS, -1))
        what = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS
        inputs = np.concatenate(inputs, axis=2)
        self._batch.rollout(SUBSTEPS, inputs, int(what), record=(), ids=index)


class RungeKutta(Substeps):
    """The same by the Runge-Kutta scheme of MuJoCo before 4.0.

    It averages the turning rates of the four stages as they are, each in the frame of its own
    stage, so that orientations converge at second order; 4.0 has a correction. Stages: mj_forward.
    """

    _STAGES = ((0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6))
    """Share of the substep at whose end each of the second to fourth stages is, and its weight"""

    def __init__(self, batch: Batch, model: mujoco.MjModel) -> None:
        super().__init__(batch)
        self._model, self._h = model, model.opt.timestep
        self._qpos, self._qvel = batch.bind("qpos"), batch.bind("qvel")
        self._qacc, self._time = batch.bind("qacc"), batch.bind("time")
        self._mocap_pos = batch.bind("mocap_pos")

    def take(self, index: NDArray[np.intp] | None = None) -> None:
        """Take the substeps, as `Substeps.take`."""
        for _ in range(SUBSTEPS):
            self._substep(index)

    def follow(self, index: NDArray[np.intp], targets: Floats) -> None:
        """Take them with moving targets, as `Substeps.follow`."""
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
        """Return positions a substep later."""
        moved = qpos.copy()
        for row, rates in zip(moved, speed, strict=True):
            mujoco.mj_integratePos(self._model, row, rates, self._h)
        return moved


def substeps(batch: Batch, model: mujoco.MjModel) -> Substeps:
    """Return what takes the substeps of a batch, by the model's integrator."""
    rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    return RungeKutta(batch, model) if rk4 else Substeps(batch)
