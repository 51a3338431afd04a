"""MuJoCo's dynamics: a ball with inertia, and a cost region made of contact geometry."""

# mujoco has no stubs for its enums.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.pieces import OVERHANG
from circle2d_mj.circle2d.scene import SUBSTEPS, Actuation, scene
from circle2d_mj.circle2d.simulation import Move
from circle2d_mj.circle2d.start import StartArea
from circle2d_mj.core.engine import Batch, mujoco
from circle2d_mj.core.simulation import State, positive_integer


class Physics:
    """`num_envs` balls, each in a world of its own, on one model that is compiled once.

    num_threads: of MuJoCo; the states do not depend on it. actuation: see `scene`.
    """

    # A ball pressed against the arena's edge or an oblique wall exceeds 1 by a little.
    observation_bounds = (1.1, 1.1, 2.0, 2.0)

    def __init__(
        self,
        config: Circle2DConfig,
        num_envs: int,
        actuation: Actuation = "velocity",
        num_threads: int = 1,
    ) -> None:
        self.config, self.num_envs, self.actuation = config, num_envs, actuation
        self.num_threads = positive_integer("num_threads", num_threads)
        self._rigid = not config.infeasible_region_penetratable
        self.info_units = {"contact_force": "N", "penetration": "m"}
        self.start_area = config.start_area
        self.model = scene(config, actuation).compile()
        # Outside of this region the ball touches nothing.
        clearance = self.model.geom("agent").size[0] + OVERHANG * config.constraint_radius
        self._reach = config.region.grown(clearance)
        if self._rigid and not config.allow_infeasible_init:
            self.start_area = StartArea(config.start_rectangle, self._reach)
        # Contacts with a region that never pushes matter only at the step's end.
        self._without_contacts = copy.copy(self.model)
        self._without_contacts.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._batch = Batch(self.model, num_envs, self.num_threads)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._sensors = self._batch.bind("sensordata")
        self._full_action = self.model.actuator_ctrlrange[:, 1]

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions of the agents: [num_envs, 2], world units."""
        return self._qpos

    def place(self, index: NDArray[np.intp], position: NDArray[np.float64]) -> None:
        """Put the agents `index` at rest at `position`, [len(index), 2]."""
        self._batch.state[index] = 0.0
        self._qpos[index] = position

    def step(self, action: NDArray[np.float64]) -> Move:
        """Take ten physics steps. action: [num_envs, 2], clipped to [-1, 1].

        MuJoCo's contacts decide. A rigid region is in contact if the ball touched it after any of
        the ten; a region that can be entered, if the ball's centre is inside it after the last.
        "contact_force": the region's greatest force on the ball during the step, kg·units/s²; 0
        where it can be entered. "penetration": world units; how far the rigid region and the ball
        overlapped at most, elsewhere how far the centre is from free space at the end.
        """
        self._ctrl[:] = np.clip(action, -1.0, 1.0) * self._full_action
        return self._push() if self._rigid else self._pass_through()

    def _pass_through(self) -> Move:
        self._batch.set_models(self._without_contacts)
        self._batch.step(nstep=SUBSTEPS)
        self._batch.set_models(self.model)
        inside = self._distance() < 0
        depth = np.zeros(self.num_envs)
        if inside.any():
            depth[inside] = self.config.region.depth(self._qpos[inside])
        return Move(inside, {"contact_force": np.zeros(self.num_envs), "penetration": depth})

    def _push(self) -> Move:
        # Each row holds the state before a physics step and the forces during it.
        rows = self._batch.rollout(SUBSTEPS, record=("sensordata",))["sensordata"]
        force, distance = rows[..., :3], rows[:, 1:, 3]
        overlap = 0.0 - np.minimum(distance.min(axis=1), self._distance())
        strongest = np.sqrt(np.square(force).sum(axis=-1).max(axis=1))
        return Move(overlap > 0, {"contact_force": strongest, "penetration": overlap})

    def _distance(self) -> NDArray[np.float64]:
        """Return the distance of ball and region now, negative in contact, else 0: [num_envs].

        mj_step leaves the contacts of the state before its last physics step. To detect them anew
        takes a tenth of a step's time, so that is done only for balls near the region.
        """
        near = self._reach.contains(self._qpos)
        self._batch.forward(near, mujoco.mjtStage.mjSTAGE_POS)
        return np.where(near, self._sensors[:, 3], 0.0)

    def observe(self) -> NDArray[np.float32]:
        """Return scaled positions and velocities: [num_envs, 4] float32."""
        a_step = SUBSTEPS * self.model.opt.timestep
        return task.observe(self.config, self._qpos, self._qvel * a_step)

    def state_dict(self) -> State:
        """Return MuJoCo's whole state, `mjSTATE_INTEGRATION`: [num_envs, mj_stateSize]."""
        return {"mujoco": self._batch.state.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state."""
        self._batch.state[:] = state["mujoco"]

    def __getstate__(self) -> dict[str, Any]:
        arguments = (self.config, self.num_envs, self.actuation, self.num_threads)
        return {"arguments": arguments, "state": self.state_dict()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(*state["arguments"])
        self.load_state_dict(state["state"])
