"""Many copies of one MuJoCo model, stepped together: the base class of the tasks."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import Batch, mujoco
from circle2d_mj.core.simulation import State, positive_integer
from circle2d_mj.render.gl import FREE_CAMERA, Offscreen

if TYPE_CHECKING:
    from circle2d_mj.render.gl import Window

Floats = NDArray[np.float64]
FRAME_SIZE = 640
"""Default number of pixels along each side of a picture."""
FREE_NAMES = ("free", "human")
"""Names of MuJoCo's free camera; the second is safety-gymnasium's."""


class MuJoCoTask:
    """`num_envs` copies of a model: the part of a `Simulation` that all tasks have in common.

    `qpos` and `qvel`, [num_envs, ...], are views of MuJoCo's states: writing to them changes the
    states. `begin` and `advance` update `sensors` [num_envs, ...]. num_threads: threads of MuJoCo's
    steps; results are bit-identical for any number. persistent: whether MuJoCo keeps all computed
    quantities, for `batch.get_data`. arguments: those of the subclass, for copying and pickling.
    """

    camera: ClassVar[str] = "track"
    """Default camera of pictures."""

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
        self.moving: NDArray[np.intp] | None = None
        self._control = self.batch.bind("ctrl")
        self._time = self.batch.bind("time").reshape(self.num_envs)
        self._sensed = self.batch.bind("sensordata") if model.nsensordata else None
        self._initial = self.batch.state[0].copy()
        self._substeps = substeps
        self._offscreen: Offscreen | None = None
        self._camera_id = FREE_CAMERA
        self._to_draw: mujoco.MjData | None = None
        self.choose_picture(None, None, FRAME_SIZE, FRAME_SIZE)
        self._window: Window | None = None
        # Sensors show the state after the last substep only if mj_forward follows it.
        stage = mujoco.mjtStage
        self._stage = int(stage.mjSTAGE_NONE if self._sensed is None else stage.mjSTAGE_ACC)

    @property
    def picture_model(self) -> mujoco.MjModel:
        """Model of `data` and pictures: the task's own, unless some drawn objects are not in it."""
        return self.model

    @property
    def step_seconds(self) -> float:
        """Simulated time of an environment step, s."""
        return self._substeps * self.model.opt.timestep

    def begin(self, index: NDArray[np.intp], qpos: Floats, qvel: Floats | float = 0.0) -> None:
        """Reset the copies `index` to a state: qpos [len(index), nq], qvel [len(index), nv]."""
        self.batch.state[index] = self._initial
        self.qpos[index], self.qvel[index] = qpos, qvel
        if self._sensed is not None:
            self.batch.forward(index)
            self._sense(index)

    def advance(self, control: Floats) -> None:
        """Hold the controls, [num_envs, nu], for one environment step."""
        self._control[:] = control
        self._take_substeps()
        self._sense(slice(None))

    def _sense(self, index: NDArray[np.intp] | slice) -> None:
        if self._sensed is not None:
            self.sensors[index] = self._sensed[index]

    def _take_substeps(self) -> None:
        self.batch.step(self.moving, nstep=self._substeps, stage=self._stage)

    def state_dict(self) -> State:
        """Return MuJoCo's full states, including warm starts, and the sensors' values."""
        return {"mujoco": self.batch.state.copy(), "sensors": self.sensors.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        self.batch.state[:] = state["mujoco"]
        self.sensors[:] = state["sensors"]

    def data(self, index: int) -> mujoco.MjData:
        """Return environment `index` as an MjData of `picture_model`, with derived quantities."""
        data = mujoco.MjData(self.picture_model)
        self.write(data, index)
        return data

    def write(self, data: mujoco.MjData, index: int) -> None:
        """Write environment `index`, with derived quantities, into an MjData of `picture_model`."""
        self._fill(data, index)
        mujoco.mj_forward(self.picture_model, data)

    def choose_picture(
        self, camera_name: str | None, camera_id: int | None, width: int, height: int
    ) -> None:
        """Set what `frame` and `depth` draw: the camera, by name or id, and the size in pixels.

        Names: those of `picture_model`, and "free" or "human" for MuJoCo's free camera, whose id is
        -1. Raises ValueError for an unknown camera, or if both name and id are given; TypeError or
        ValueError for a wrong size.
        """
        self._size = positive_integer("width", width), positive_integer("height", height)
        self._camera = self._camera_of(camera_name, camera_id)
        self._picture = camera_name, camera_id, width, height

    def _camera_of(self, name: str | None, number: int | None) -> int | str:
        if name is not None and number is not None:
            raise ValueError(f"camera_name={name!r} and camera_id={number}: give one of the two")
        if name is None and number is None:
            return self.camera
        if name in FREE_NAMES:
            return FREE_CAMERA
        model = self.picture_model
        names = [model.camera(i).name for i in range(model.ncam)]
        if name is not None:
            if name not in filter(None, names):
                there = ", ".join([*filter(None, names), *FREE_NAMES])
                raise ValueError(f"camera_name must be one of {there}, got {name!r}")
            return name
        if number is None or number not in range(FREE_CAMERA, model.ncam):
            there = f"from {FREE_CAMERA} (free) to {model.ncam - 1}: {', '.join(names)}"
            raise ValueError(f"camera_id must be {there}, got {number!r}")
        return number

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Draw environment `index` with the chosen camera: [height, width, 3]."""
        return self._drawer().draw(self._drawn(index), self._camera_id)

    def depth(self, index: int) -> NDArray[np.float32]:
        """Return the depths along the chosen camera's axis, m: [height, width]."""
        return self._drawer().depth(self._drawn(index), self._camera_id)

    def _drawer(self) -> Offscreen:
        if self._offscreen is None:
            self._offscreen = Offscreen(self.picture_model, *self._size)
            camera, model = self._camera, self.picture_model
            self._camera_id = model.camera(camera).id if isinstance(camera, str) else camera
        return self._offscreen

    def _drawn(self, index: int) -> mujoco.MjData:
        """Return environment `index` with what a picture needs, without contacts and forces."""
        model = self.picture_model
        if self._to_draw is None:
            self._to_draw = mujoco.MjData(model)
        self._fill(self._to_draw, index)
        for derive in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight):
            derive(model, self._to_draw)
        return self._to_draw

    def _fill(self, data: mujoco.MjData, index: int) -> None:
        """Write the state of environment `index` into an MjData of `picture_model`."""
        data.qpos[:], data.qvel[:] = self.qpos[index], self.qvel[index]
        data.ctrl[:], data.time = self._control[index], self._time[index]

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
        arguments, state = {**self._arguments, **of_batch}, self.state_dict()
        return {"arguments": arguments, "state": state, "picture": self._picture}

    def __setstate__(self, pickled: dict[str, Any]) -> None:
        type(self).__init__(self, **pickled["arguments"])
        self.load_state_dict(pickled["state"])
        self.choose_picture(*pickled["picture"])
