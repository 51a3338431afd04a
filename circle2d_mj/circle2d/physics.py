"""MuJoCo's dynamics: a ball with inertia, and a cost region made of contact geometry."""

# mujoco has no stubs for its enums.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.circle2d import task
from circle2d_mj.circle2d.config import Camera, Circle2DConfig
from circle2d_mj.circle2d.physics_config import (
    PhysicsConfig,
    completed,
    full_action,
    softness,
    top_speed,
)
from circle2d_mj.circle2d.region import StartArea
from circle2d_mj.circle2d.scene import OVERHANG, scene
from circle2d_mj.circle2d.task import Move
from circle2d_mj.core.engine import Batch, mujoco
from circle2d_mj.core.simulation import State, positive_integer
from circle2d_mj.core.streams import Streams


class Physics:
    """`num_envs` balls, each in its own world, with one model that is compiled once.

    num_threads: MuJoCo's threads; the states do not depend on their number. Each ball has its own
    values of the parameters in `PhysicsConfig.randomize`. camera: see `Circle2DMuJoCoVectorEnv`.
    """

    def __init__(
        self,
        config: Circle2DConfig,
        num_envs: int,
        physics: PhysicsConfig | None = None,
        num_threads: int = 1,
        camera: Camera | None = None,
    ) -> None:
        if camera is not None and camera not in get_args(Camera):
            raise ValueError(f"camera must be None or one of {get_args(Camera)}, got {camera!r}")
        self.camera = camera
        self.config, self.num_envs = config, num_envs
        self.physics = completed(config, physics or PhysicsConfig())
        self.num_threads = positive_integer("num_threads", num_threads)
        self.info_units = {"contact_force": "N", "penetration": "m"}
        self.model = scene(config, self.physics).compile()
        self._pushes = self.physics.contact != "none"
        self._substeps = self.physics.substeps
        self.step_seconds = self._substeps * self.model.opt.timestep
        self._ball = self.model.geom("agent").id
        # A ball whose centre is outside of this grown region touches nothing.
        clearance = self.model.geom_size[self._ball, 0] + OVERHANG * config.constraint_radius
        self._reach = config.region.grown(clearance)
        self.start_area = config.start_area
        if self._pushes and not config.allow_infeasible_init:
            self.start_area = StartArea(config.start_rectangle, self._reach)
        self._batch = Batch(self.model, num_envs, self.num_threads)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._sensors = self._batch.bind("sensordata")
        self._full_action = np.tile(self.model.actuator_ctrlrange[:, 1], (num_envs, 1))
        # With a region that does not push, contacts are needed only at the end of a step.
        self._flags = None if self._pushes else self._batch.expand("opt.disableflags")
        ranges = self.physics.randomize
        self.drawn = np.tile([low for low, _ in ranges.values()], (num_envs, 1))
        """Each ball's drawn parameters, [num_envs, parameters], in the order of `randomize`."""
        self._apply(np.arange(num_envs))

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        """Upper bounds. They exceed 1, since a ball pressed against the arena's edge or an oblique
        wall does so slightly."""
        speed, config = top_speed(self.config, self.physics), self.config
        beyond = 1.0 + 2.0 * speed * self.model.opt.timestep / config.arena
        of_full_step = max(1.0, speed * self.step_seconds / config.full_step)
        return (max(1.1, beyond),) * 2 + (2.0 * of_full_step,) * 2

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions of the agents: [num_envs, 2], world units."""
        return self._qpos

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Place the agents `index` at random in the start area and draw their parameters."""
        self.place(index, self.start_area.sample(streams, index))
        if ranges := self.physics.randomize:
            low, high = np.array([*ranges.values()]).T
            draws = streams.uniform(index, draws=-(-len(ranges) // 4))[:, : len(ranges)]
            self.drawn[index] = low + draws * (high - low)
            self._apply(index)

    def state_info(self) -> dict[str, NDArray[np.float64]]:
        """Return the parameters that were drawn for each agent, [num_envs] by name."""
        return {name: self.drawn[:, k].copy() for k, name in enumerate(self.physics.randomize)}

    def place(self, index: NDArray[np.intp], position: NDArray[np.float64]) -> None:
        """Put the agents `index` at rest at `position`, [len(index), 2]."""
        self._batch.state[index] = 0.0
        self._qpos[index] = position

    def _apply(self, index: NDArray[np.intp]) -> None:
        """Write the drawn parameters of the agents `index` into their models."""
        physics, ball, field = self.physics, self._ball, self._batch.expand
        drawn = dict(zip(physics.randomize, self.drawn[index].T, strict=True))
        if "mass" in drawn:
            field("body_mass")[index, self.model.geom_bodyid[ball]] = drawn["mass"]
        if "friction" in drawn:
            field("geom_friction")[index, ball, 0] = drawn["friction"]
        if "damping" in drawn:
            field("dof_damping")[index] = drawn["damping"][:, None]
        if "gain" in drawn:
            field("actuator_gainprm")[index, :, 0] = drawn["gain"][:, None]
            field("actuator_biasprm")[index, :, 2] = -drawn["gain"][:, None]
        for name, limits in (
            (full_action(physics), "actuator_ctrlrange"),
            ("max_force", "actuator_forcerange"),
        ):
            if name in drawn and (limits, physics.actuation) != ("actuator_forcerange", "force"):
                field(limits)[index] = drawn[name][:, None, None] * [-1.0, 1.0]
        if full_action(physics) in drawn:
            self._full_action[index] = drawn[full_action(physics)][:, None]
        names = ("stiffness", "damping_ratio", "mass")
        if physics.contact == "soft" and drawn.keys() & set(names):
            numbers = [drawn.get(name, getattr(physics, name)) for name in names]
            reference, impedance = softness(physics, *numbers)
            field("geom_solref")[index, ball] = reference
            field("geom_solimp")[index, ball, :2] = impedance[:, None]
        if "mass" in drawn:
            self._batch.set_const(index)

    def step(self, action: NDArray[np.float64]) -> Move:
        """Take the physics steps of an environment step. action: [num_envs, 2], clipped to [-1, 1].

        Contact is what MuJoCo detects: with a region that pushes, the ball touches it after any of
        the physics steps; with a region that does not push, the ball's centre is inside it after
        the last. With cost "force", contact means that the force exceeds the limit.
        "contact_force": greatest force of the region on the ball during the step, N. "penetration":
        greatest overlap of the ball and a region that pushes, m; for a region that does not push,
        distance from the ball's centre to free space at the end of the step.
        """
        self._ctrl[:] = np.clip(action, -1.0, 1.0) * self._full_action
        contact, force, depth = self._push() if self._pushes else self._pass_through()
        if (limit := self.physics.force_limit) is not None:
            contact = force > limit
        return Move(contact, {"contact_force": force, "penetration": depth})

    def _pass_through(self) -> tuple[NDArray, NDArray, NDArray]:
        assert self._flags is not None
        self._flags |= mujoco.mjtDisableBit.mjDSBL_CONTACT.value
        self._batch.step(nstep=self._substeps)
        self._flags &= ~mujoco.mjtDisableBit.mjDSBL_CONTACT.value
        inside = self._distance() < 0
        depth = np.zeros(self.num_envs)
        if inside.any():
            depth[inside] = self.config.region.depth(self._qpos[inside])
        return inside, np.zeros(self.num_envs), depth

    def _push(self) -> tuple[NDArray, NDArray, NDArray]:
        # Each row has the state before a physics step and the forces during that step.
        rows = self._batch.rollout(self._substeps, record=("sensordata",))["sensordata"]
        force, distance = rows[..., :3], rows[:, 1:, 3]
        overlap = 0.0 - np.minimum(distance.min(axis=1, initial=0.0), self._distance())
        return overlap > 0, np.sqrt(np.square(force).sum(axis=-1).max(axis=1)), overlap

    def _distance(self) -> NDArray[np.float64]:
        """Return the current distance of ball and region, negative in contact, else 0: [num_envs].

        After mj_step, contacts belong to the state before the last physics step. Detecting them
        again takes a tenth of a step's time, so this is done only for balls near the region.
        """
        near = self._reach.contains(self._qpos)
        if self.physics.xml is not None:  # the user's scene may have contacts anywhere
            near = np.ones_like(near)
        self._batch.forward(near, mujoco.mjtStage.mjSTAGE_POS)
        return np.where(near, self._sensors[:, 3], 0.0)

    def observe(self) -> NDArray[np.float32]:
        """Return scaled positions and velocities: [num_envs, 4] float32."""
        return task.observe(self.config, self._qpos, self._qvel * self.step_seconds)

    def data(self, index: int) -> mujoco.MjData:
        """Return agent `index` as an MjData with derived quantities and forces, for drawing."""
        data = self._batch.get_data(index)
        mujoco.mj_forward(self._batch.get_model(index), data)
        return data

    def state_dict(self) -> State:
        """Return MuJoCo's whole state, `mjSTATE_INTEGRATION`, [num_envs, mj_stateSize], and with
        `randomize` the parameters that were drawn for each agent."""
        state = {"mujoco": self._batch.state.copy()}
        return state | ({"physics": self.drawn.copy()} if self.physics.randomize else {})

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        self._batch.state[:] = state["mujoco"]
        if self.physics.randomize:
            self.drawn[:] = state["physics"]
            self._apply(np.arange(self.num_envs))

    def __getstate__(self) -> dict[str, Any]:
        arguments = (self.config, self.num_envs, self.physics, self.num_threads, self.camera)
        return {"arguments": arguments, "state": self.state_dict()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(*state["arguments"])
        self.load_state_dict(state["state"])
