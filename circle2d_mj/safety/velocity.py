"""The velocity tasks: bodies of Gymnasium's v4 environments with a speed limit."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import functools
import importlib.resources
import re
from typing import NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from circle2d_mj.core.engine import mujoco
from circle2d_mj.core.simulation import Outcome, State
from circle2d_mj.core.streams import Streams
from circle2d_mj.safety import rules, views
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.worlds import as_the_original

Floats = NDArray[np.float64]


class Body(NamedTuple):
    """A body and its task."""

    xml: str
    """Name of the model file in the installed gymnasium."""
    substeps: int
    max_speed: float
    """Speed limit, m/s, above which a step costs."""
    noise: float
    """Bound of the uniform noise on each number of qpos and qvel at the start."""
    control_cost: float
    alive: float = 0.0
    forward: float = 1.0
    """The reward is forward * speed + alive - control_cost * |action|²."""
    hidden: int = 1
    """How many leading numbers of qpos are not observed: x, or x and y."""
    normal: bool = False
    """Whether the noise of qvel is normal, with `noise` as standard deviation."""
    clipped: float = np.inf
    """Bound on observed velocities."""
    planar: bool = True
    """Whether the body moves in a vertical plane; otherwise its speed is that in x and y."""
    height: tuple[float, float] | None = None
    """Range of the torso's height, m, outside which the episode ends; None: it never ends."""
    tilt: tuple[float, float] | None = None
    """Range of the torso's tilt, rad, outside which the episode ends; None: no limit."""
    rest: float | None = None
    """Absolute value of any other number of the state at which the episode ends; None: no limit."""
    rim: bool = False
    """Whether the ends of `height` belong to the allowed range."""
    measured: str = "qpos"
    """Source of the speed: "qpos", "torso" or "centre of mass"."""
    terms: tuple[str, ...] = ()
    """Names in the info of the reward's terms: progress, minus control cost, being alive."""


BODIES = {
    "HalfCheetah": Body(
        *("half_cheetah", 5, 3.2096, 0.1, 0.1), normal=True, terms=("reward_run", "reward_ctrl")
    ),
    "Hopper": Body(
        *("hopper", 4, 0.7402, 0.005, 1e-3, 1.0),
        clipped=10.0,
        height=(0.7, np.inf),
        tilt=(-0.2, 0.2),
        rest=100.0,
    ),
    "Swimmer": Body(
        *("swimmer", 4, 0.2282, 0.1, 1e-4), hidden=2, terms=("reward_fwd", "reward_ctrl")
    ),
    "Walker2d": Body(
        *("walker2d", 4, 2.3415, 0.005, 1e-3, 1.0),
        clipped=10.0,
        height=(0.8, 2.0),
        tilt=(-1.0, 1.0),
    ),
    "Ant": Body(
        *("ant", 5, 2.6222, 0.1, 0.5, 1.0),
        hidden=2,
        normal=True,
        planar=False,
        height=(0.2, 1.0),
        rest=np.inf,
        rim=True,
        measured="torso",
        terms=("reward_forward", "reward_ctrl", "reward_survive"),
    ),
    "Humanoid": Body(
        *("humanoid", 5, 1.4149, 0.01, 0.1, 5.0, 1.25),
        hidden=2,
        planar=False,
        height=(1.0, 2.0),
        measured="centre of mass",
        terms=("reward_linvel", "reward_quadctrl", "reward_alive"),
    ),
}
OLD_SPEEDS = {
    "HalfCheetah": 2.8795,
    "Hopper": 0.37315,
    "Swimmer": 0.04845,
    "Walker2d": 1.7075,
    "Ant": 2.5745,
    "Humanoid": 2.3475,
}
"""Speed limits of version 0, m/s; in that version the Swimmer's speed is the one in x and y."""
HUMANOID_EXTRA = ("cinert", "cvel", "qfrc_actuator")
"""Fields of MuJoCo's data that the Humanoid observes, besides cfrc_ext, the contact forces."""


@functools.cache
def model(body: str) -> mujoco.MjModel:
    """Return a body's model, from the installed gymnasium. It is shared: do not write to it."""
    folder = importlib.resources.files("gymnasium").joinpath("envs/mujoco/assets")
    xml = folder.joinpath(f"{BODIES[body].xml}.xml").read_text()
    total = re.search(r'\s*settotalmass="([\d.]+)"', xml)
    # HalfCheetah has settotalmass, which makes MuJoCo 4.0 warn; it is applied below instead.
    spec = mujoco.MjSpec.from_string(xml.replace(total[0], "") if total else xml)
    as_the_original(spec.option)
    # One tree of bodies is one island; searching for islands takes a tenth of a step's time.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    for geom in spec.geoms:
        # Since MuJoCo 3.5 the margins of two geoms are added; before, the greater margin counted.
        geom.margin *= 0.5
    compiled = spec.compile()
    if total:
        mujoco.mj_setTotalmass(compiled, float(total[1]))
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
    return compiled


class VelocityTask(MuJoCoTask):
    """`num_envs` copies of a body of `BODIES` with a speed limit; 1000 steps per episode.

    The observation is qpos without x (and y), then qvel, clipped to `Body.clipped`; for the
    Humanoid also MuJoCo's cinert, cvel, qfrc_actuator and cfrc_ext. Actions are torques over the
    actuator's gear; MuJoCo clips them, but the reward's control cost is that of unclipped actions.
    `info["x_velocity"]`, and for Swimmer, Ant and Humanoid `info["y_velocity"]`, is the mean over
    the step, m/s; `info["x_position"]` is the position at its end, m; the reward's terms have the
    original's names: `Body.terms`. version: 0 has other speed limits, `OLD_SPEEDS`. For Ant and
    Humanoid, positions are those of the last stage of MuJoCo's integrator, as in the original.
    Source: safety-gymnasium 1.0.0 on Gymnasium's v4.
    """

    def __init__(
        self, body: str, num_envs: int = 1, num_threads: int = 1, version: int = 1
    ) -> None:
        self.body = BODIES[body]
        if version not in (0, 1):
            raise ValueError(f"version must be 0 or 1, got {version!r}")
        if version == 0:
            self.body = self.body._replace(max_speed=OLD_SPEEDS[body])
        self._sideways = self.body.hidden == 2  # the info has y
        # Whether the speed that costs is that in x and y.
        self._both = not self.body.planar or (body == "Swimmer" and version == 0)
        observes_forces = body == "Humanoid"
        super().__init__(
            *(model(body), num_envs, num_threads, self.body.substeps, observes_forces),
            body=body,
            version=version,
        )
        lead = self.model.nq - self.body.hidden + self.model.nv
        self._extra = [self.batch.bind(name) for name in HUMANOID_EXTRA] * observes_forces
        size = lead + sum(array[0].size for array in self._extra)
        size += 6 * self.model.nbody if observes_forces else 0
        self.view = views.of_body(body, self.body.max_speed, not self._both)
        self.observation_space = Box(-np.inf, np.inf, (size,), np.float64)
        low, high = self.model.actuator_ctrlrange.T.astype(np.float32)
        self.action_space = Box(low, high, dtype=np.float32)
        of_step = ("cost", "x_velocity", *self.body.terms)
        of_state = ("x_position",)
        if self._sideways:
            of_step += ("y_velocity", "forward_reward")
            of_state += ("y_position", "distance_from_origin")
        self.info_keys = of_step + of_state
        measured = {"torso": "xpos", "centre of mass": "xipos"}.get(self.body.measured)
        self._bodies = None if measured is None else self.batch.bind(measured)
        self._all = np.arange(self.num_envs)
        self._scratch = mujoco.MjData(self.model)
        self._seen = np.zeros((self.num_envs, size - lead))  # observed besides qpos and qvel
        self._place = np.zeros((self.num_envs, 2))  # x and y by which the speed is measured

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Put the bodies `index` near their rest positions."""
        nq, nv, noise = self.model.nq, self.model.nv, self.body.noise
        draw = streams.uniform(index, draws=(nq + (2 if self.body.normal else 1) * nv + 3) // 4)
        qpos = self.model.qpos0 + noise * (2.0 * draw[:, :nq] - 1.0)
        if self.body.normal:
            radius = np.sqrt(-2.0 * np.log(draw[:, nq : nq + nv].copy()))
            qvel = noise * radius * np.cos(2.0 * np.pi * draw[:, nq + nv : nq + 2 * nv])
        else:
            qvel = noise * (2.0 * draw[:, nq : nq + nv] - 1.0)
        if not self.body.planar:
            # Normalise quaternions, as MuJoCo 2.3.3 did itself.
            qpos[:, 3:7] /= np.sqrt((qpos[:, 3:7] ** 2).sum(axis=1, keepdims=True))
        self.place(index, qpos, qvel)

    def place(self, index: NDArray[np.intp], qpos: Floats, qvel: Floats) -> None:
        """Put the bodies `index` into states: qpos [len(index), nq], qvel [len(index), nv]."""
        self.begin(index, qpos, qvel)
        if self._bodies is not None:
            self.batch.forward(index)
        self._place[index] = self._where()[index]
        self._see(index, forces=False)

    def put_measured(self, index: int, place: Floats) -> None:
        """Set the place from which the body's next speed is measured: [2] m."""
        self._place[index] = place

    def step(self, action: Floats) -> Outcome:
        """Move all bodies with their actions, [num_envs, nu]."""
        before = self._place
        self.advance(action)
        self._place = self._where()
        velocity = (self._place - before) / self.step_seconds
        self._see(self._all)
        of = self.body
        x_velocity = velocity[:, 0].copy()
        forward, control = of.forward * x_velocity, rules.control_cost(action, of.control_cost)
        reward = forward + of.alive - control
        speed = np.hypot(x_velocity, velocity[:, 1]) if self._both else x_velocity
        info = {"cost": rules.velocity_cost(speed, of.max_speed), "x_velocity": x_velocity}
        if of.terms:
            terms = (forward, -control, np.full(self.num_envs, of.alive))
            info.update(zip(of.terms, terms, strict=False))
        if self._sideways:
            info["y_velocity"], info["forward_reward"] = velocity[:, 1].copy(), forward.copy()
        return Outcome(reward, self._fell(), info)

    def state_info(self) -> dict[str, Floats]:
        """Return the bodies' places; velocities are in the step's info."""
        place = {"x_position": self._place[:, 0].copy()}
        if self._sideways:
            place["y_position"] = self._place[:, 1].copy()
            place["distance_from_origin"] = np.hypot(*self._place.T)
        return place

    def observe(self) -> Floats:
        """Return the observations: [num_envs, observation size]."""
        qvel, bound = self.qvel, self.body.clipped
        if bound < np.inf:
            qvel = np.minimum(np.maximum(qvel, -bound), bound)
        seen = (self._seen,) * bool(self._extra)
        return np.concatenate((self.qpos[:, self.body.hidden :], qvel, *seen), axis=1)

    def state_dict(self) -> State:
        """Return everything that steps and observations depend on."""
        return {**super().state_dict(), "place": self._place.copy(), "seen": self._seen.copy()}

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        super().load_state_dict(state)
        self._place, self._seen = state["place"].copy(), state["seen"].copy()

    def _where(self) -> Floats:
        """Return the places by which the bodies' speeds are measured: [num_envs, 2] m."""
        if self._bodies is None:
            return self.qpos[:, :2].copy()
        if self.body.measured == "torso":
            return self._bodies[:, 1, :2].copy()
        mass = self.model.body_mass
        return (mass[:, None] * self._bodies[:, :, :2]).sum(axis=1) / mass.sum()

    def _fell(self) -> NDArray[np.bool_]:
        of = self.body
        if of.height is None:
            return np.zeros(self.num_envs, dtype=bool)
        fell = rules.outside(self.qpos[:, 1 if of.planar else 2], of.height, of.rim)
        if of.tilt is not None:
            fell |= rules.outside(self.qpos[:, 2], of.tilt)
        if of.rest is not None:
            fell |= rules.diverged(self.qpos[:, 2:], of.rest)
            fell |= rules.diverged(self.qvel, of.rest)
        return fell

    def _see(self, index: NDArray[np.intp], forces: bool = True) -> None:
        """Update what the Humanoid observes besides qpos and qvel; forces are 0 at the start."""
        if not self._extra:
            return
        n = len(index)
        parts = [array[index].reshape(n, -1) for array in self._extra]
        self._seen[index] = 0.0
        self._seen[index, : self._seen.shape[1] - 6 * self.model.nbody] = np.hstack(parts)
        if not forces:
            return
        for i in index:
            # The batch does not compute these forces; a sensor would show those of another stage.
            self.batch.get_data(i, self._scratch)
            mujoco.mj_rnePostConstraint(self.model, self._scratch)
            self._seen[i, -6 * self.model.nbody :] = self._scratch.cfrc_ext.ravel()
