"""Many copies of one MuJoCo model, stepped together: the common part of the tasks."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are compiled in, where pyright does not see them.

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch, mujoco
from circle2d_mj.core.simulation import State, positive_integer
from circle2d_mj.render.gl import Offscreen

if TYPE_CHECKING:
    from circle2d_mj.render.gl import Window

Floats = NDArray[np.float64]
FRAME_SIZE = 640
"""Pixels along each side of a picture"""


class MuJoCoTask:
    """`num_envs` copies of a model: the part of a `Simulation` that all tasks have in common.

    `qpos` and `qvel`, [num_envs, ...], are views of MuJoCo's own states: writing to them changes
    those. `begin` and `advance` update `sensors` [num_envs, ...]. num_threads: of MuJoCo's steps;
    all give bit-identical results. persistent: whether MuJoCo keeps all that it computes, for
    `batch.get_data`. `arguments` are those of the subclass, for copying and pickling.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        num_threads: int,
        substeps: int,
        persistent: bool = False,
        **arguments: Any,
    ) -> None:
        self._arguments = arguments
        self.num_envs = positive_integer("num_envs", num_envs)
        self.num_threads = positive_integer("num_threads", num_threads)
        self.model = model
        self.batch = Batch(model, self.num_envs, self.num_threads, persistent=persistent)
        self.qpos: Floats = self.batch.bind("qpos")
        self.qvel: Floats = self.batch.bind("qvel")
        self.sensors = np.zeros((self.num_envs, model.nsensordata))
        self.recorded_info: dict[str, str] = {}
        self._control = self.batch.bind("ctrl")
        self._sensed = self.batch.bind("sensordata") if model.nsensordata else None
        self._initial = self.batch.state[0].copy()
        self._substeps = substeps
        self._offscreen: Offscreen | None = None
        self._window: Window | None = None
        # Sensors show the state after the last substep only if mj_forward follows it.
        stage = mujoco.mjtStage
        self._stage = int(stage.mjSTAGE_NONE if self._sensed is None else stage.mjSTAGE_ACC)

    @property
    def picture_model(self) -> mujoco.MjModel:
        """Model of `data` and of pictures: the task's own, unless more is drawn than collides."""
        return self.model

    @property
    def step_seconds(self) -> float:
        """Simulated time of a step of the task, s."""
        return self._substeps * self.model.opt.timestep

    def begin(self, index: NDArray[np.intp], qpos: Floats, qvel: Floats | float = 0.0) -> None:
        """Reset the copies `index` to a state: qpos [len(index), nq], qvel [len(index), nv]."""
        self.batch.state[index] = self._initial
        self.qpos[index], self.qvel[index] = qpos, qvel
        if self._sensed is not None:
            self.batch.forward(index)
            self._sense(index)

    def advance(self, control: Floats) -> None:
        """Hold the controls, [num_envs, nu], for one step of the task."""
        self._control[:] = control
        self._take_substeps()
        self._sense(slice(None))

    def _sense(self, index: NDArray[np.intp] | slice) -> None:
        if self._sensed is not None:
            self.sensors[index] = self._sensed[index]

    def _take_substeps(self) -> None:
        self.batch.step(nstep=self._substeps, stage=self._stage)

    def state_dict(self) -> State:
        """Return MuJoCo's states in full, warm starts included, and the sensors' values."""
        return {"mujoco": self.batch.state.copy(), "sensors": self.sensors.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        self.batch.state[:] = state["mujoco"]
        self.sensors[:] = state["sensors"]

    def data(self, index: int) -> mujoco.MjData:
        """Return environment `index` as MuJoCo's own MjData, with derived quantities, to render."""
        data = self.batch.get_data(index)
        mujoco.mj_forward(self.model, data)
        return data

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw environment `index` as a camera of its model sees it: [640, 640, 3]."""
        if self._offscreen is None:
            self._offscreen = Offscreen(self.picture_model, FRAME_SIZE)
        return self._offscreen.draw(self.data(index), camera=0)

    def show(self, index: int) -> None:
        """Show environment `index` in MuJoCo's viewer."""
        if self._window is None:
            from circle2d_mj.render.gl import Window

            self._window = Window(self.picture_model, self.step_seconds)
        self._window.show(self.data(index))

    def close(self) -> None:
        """Close what `frame` and `show` opened."""
        for drawer in (self._offscreen, self._window):
            if drawer is not None:
                drawer.close()
        self._offscreen = self._window = None

    def __getstate__(self) -> dict[str, Any]:
        of_batch = {"num_envs": self.num_envs, "num_threads": self.num_threads}
        return {"arguments": {**self._arguments, **of_batch}, "state": self.state_dict()}

    def __setstate__(self, pickled: dict[str, Any]) -> None:
        type(self).__init__(self, **pickled["arguments"])
        self.load_state_dict(pickled["state"])
