"""`env.unwrapped.task`: a read-only view of a navigation task with safety-gymnasium's names."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from circle2d_mj.core.engine import mujoco
from circle2d_mj.core.simulation import of_one
from circle2d_mj.safety import parts, rules, worlds
from circle2d_mj.safety.scenes import WALL_COLOUR

HOW = (
    "the task is compiled once, from its parameters: numbers of objects, half_width, layout_seed "
    "and places, as in make(id, hazards=3, layout_seed=7); for another scene, register a task of "
    "your own with circle2d_mj.safety.own"
)
"""Advice in errors about values that cannot be written."""


class Part:
    """Named read-only values; writing one raises AttributeError, which says what to do."""

    def __init__(self, what: str, **values: Any) -> None:
        self.__dict__.update(_what=what, **values)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{self._what}.{name} cannot be written: {HOW}")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        known = ", ".join(known for known in dir(self) if not known.startswith("_"))
        raise AttributeError(f"{self._what} has no {name!r}; it has {known}")

    def __repr__(self) -> str:
        shown = (f"{k}={v!r}" for k, v in self.__dict__.items() if not k.startswith("_"))
        return f"{self._what}({', '.join(shown)})"


class Objects(Part):
    """Objects of one kind."""

    @property
    def pos(self) -> Any:
        """Current position, [3] m, or a list of positions for kinds of several objects."""
        places = self._simulation.positions(self.name)[self._index]
        return list(places) if "num" in vars(self) else places[0]


class Buttons(Objects):
    """The buttons."""

    @property
    def goal_button(self) -> int:
        """Index of the button to press."""
        return int(self._simulation.goal_button[self._index])

    @property
    def timer(self) -> int:
        """Remaining steps in which buttons are off."""
        return int(self._simulation.timer[self._index])


class Agent(Part):
    """The agent; all quantities are in the world's frame, except the sensors'."""

    @property
    def pos(self) -> NDArray[np.float64]:
        """Position of the agent's origin, [3] m."""
        return self._simulation.positions("agent")[self._index, 0]

    @property
    def mat(self) -> NDArray[np.float64]:
        """Rotation matrix of the agent, [3, 3]; its columns are the agent's axes."""
        return self._simulation.rotations[self._index, 0].copy()

    @property
    def vel(self) -> NDArray[np.float64]:
        """Velocity of the agent's origin, [3] m/s."""
        return self.engine.body_vel("agent")

    @property
    def com(self) -> NDArray[np.float64]:
        """Centre of mass of the agent, [3] m."""
        return self.engine.data.body("agent").subtree_com.copy()

    def get_sensor(self, name: str) -> NDArray[np.float64]:
        """Return the reading of a sensor of the agent's model, such as "velocimeter": [3]."""
        sensor = self._simulation.model.sensor(name)
        first = sensor.adr[0]
        return self._simulation.sensors[self._index, first : first + sensor.dim[0]].copy()

    def obs_sensor(self) -> dict[str, NDArray[np.float64]]:
        """Return the agent's part of the observation by name: see `TaskView.obs_info`."""
        return {name: v for name, v in self._by_name().items() if not name.endswith("_lidar")}

    def dist_xy(self, pos: Any) -> float:
        """Return the horizontal distance to a place, [2 or 3], m."""
        return float(np.hypot(*(np.asarray(pos)[:2] - self.pos[:2])))

    def is_alive(self) -> bool:
        """Return whether the agent is above its lowest allowed height, which only the Ant has."""
        return bool(self._simulation.alive[self._index])


class Engine(Part):
    """Copies of MuJoCo's model and data that follow the task; if they are written to, the next step
    raises RuntimeError. The joints of the Point act along the world's axes."""

    @property
    def model(self) -> mujoco.MjModel:
        """The model with everything that is drawn."""
        return self._envs.live_model

    @property
    def data(self) -> mujoco.MjData:
        """The state and the quantities derived from it."""
        return self._envs.live_data(self._index)

    def body_pos(self, name: str) -> NDArray[np.float64]:
        """Return the position of a body's origin, [3] m."""
        return self.data.body(name).xpos.copy()

    def body_mat(self, name: str) -> NDArray[np.float64]:
        """Return a body's rotation matrix, [3, 3]."""
        return self.data.body(name).xmat.reshape(3, 3).copy()

    def body_com(self, name: str) -> NDArray[np.float64]:
        """Return the centre of mass of a body and its descendants, [3] m."""
        return self.data.body(name).subtree_com.copy()

    def body_vel(self, name: str) -> NDArray[np.float64]:
        """Return the velocity of a body's origin, [3] m/s."""
        velocity, of = np.zeros(6), self.model.body(name).id
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(self.model, self.data, kind, of, velocity, 0)
        return velocity[3:]


class TaskView(Part):
    """A navigation task: objects as in `task.hazards.pos[0]`, `task.agent`, and its settings."""

    def __init__(self, envs: Any, index: int) -> None:
        task, engine = envs.simulation, Engine("task.world", _envs=envs, _index=index)
        super().__init__("task", _envs=envs, _simulation=task, _index=index, world=engine)
        world, name = task.world, task.agent.name
        model = task.model
        bodies = range(1, 1 + _bodies(model))
        geoms = [model.geom(i).name for b in bodies for i in _geoms(model, b)]
        size = {"nq": task.agent.nq, "nv": task.agent.nv, "nu": task.agent.nu}
        agent = Agent(
            "task.agent",
            _simulation=task,
            _index=index,
            _by_name=self._by_name,
            name=name,
            engine=engine,
            keepout=float(world.areas.keepout[0]),
            z_height=task.agent.height,
            rot=None,
            placements=[world.scene.start] if world.scene.start else None,
            locations=task.given.get("agent", []),
            action_space=task.action_space,
            body_info=Part("body_info", **size, nbody=1 + len(bodies), geom_names=geoms),
            sensor_conf=Part("sensor_conf", sensors=_SENSORS),
            sensor_info=Part(
                "sensor_info",
                sensor_dim={
                    model.sensor(i).name: int(model.sensor(i).dim[0])
                    for i in range(model.nsensor)
                    if model.sensor(i).adr[0] < task.agent.sensed
                },
            ),
        )
        half, floor = world.scene.half_width, model.geom("floor").size.tolist()
        clip = None if task.family == "Run" else rules.REWARD_CLIP
        self.__dict__.update(
            agent_name=name,
            agent=agent,
            task_name=f"{task.family}Level{task.level}",
            num_steps=envs.registered_steps,
            action_space=task.action_space,
            observation_space=task.observation_space,
            observation_flatten=task.vision_size is None,
            observe_vision=task.vision_size is not None,
            vision_env_conf=Part("task.vision_env_conf", vision_size=task.vision_size),
            debug=False,
            action_noise=0.0,
            lidar_conf=Part(
                "task.lidar_conf",
                num_bins=rules.LIDAR_BINS,
                max_dist=world.scene.reach,
                exp_gain=1.0,
                type="pseudo",
                alias=True,
            ),
            compass_conf=Part("task.compass_conf", shape=2),
            reward_conf=Part("task.reward_conf", reward_clip=clip),
            cost_conf=Part("task.cost_conf", constrain_indicator=True),
            mechanism_conf=Part(
                "task.mechanism_conf",
                randomize_layout=envs.layout_seed is None,
                continue_goal=True,
                terminate_resample_failure=True,
            ),
            sim_conf=Part("task.sim_conf", frameskip_binom_n=10, frameskip_binom_p=1.0),
            floor_conf=Part("task.floor_conf", type="mat", size=tuple(floor)),
            obs_info=Part("task.obs_info", obs_space_dict=task.parts),
            placements_conf=Part(
                "task.placements_conf",
                extents=(-half, -half, half, half),
                margin=0.0,
                placements=self._placements(agent.placements),
            ),
            **{kind: self._objects(kind) for kind in world.kinds},
        )
        if world.scene.walls:
            bound = world.scene.walls[0]
            walls = {
                "num": 2 * len(world.scene.walls),
                "locate_factor": bound,
                "size": floor[0],
                "keepout": 0.0,
                "locations": [(bound, 0), (-bound, 0), (0, bound), (0, -bound)],
                "color": np.array(WALL_COLOUR),
                "is_lidar_observed": False,
                "is_constrained": True,
            }
            self.__dict__["sigwalls"] = Part("task.sigwalls", name="sigwalls", **walls)

    @property
    def goal_achieved(self) -> bool:
        """Whether the current state meets the current goal."""
        return bool(self._simulation.met[self._index])

    @property
    def world_info(self) -> Part:
        """The layout by name: places of agent and objects at the start, m; goals' current place."""
        layout = self._simulation.layout[self._index]
        return Part("task.world_info", layout=dict(zip(self._names(), layout, strict=True)))

    @property
    def model(self) -> mujoco.MjModel:
        """See `Engine.model`."""
        return self.world.model

    @property
    def data(self) -> mujoco.MjData:
        """See `Engine.data`."""
        return self.world.data

    @property
    def last_dist_goal(self) -> float:
        """See `dist_goal`."""
        return self.dist_goal()

    @property
    def _obstacles(self) -> list[Objects]:
        return [getattr(self, kind) for kind in self._simulation.world.kinds]

    def dist_goal(self) -> float:
        """Return the horizontal distance from the agent to the goal, m."""
        return self.agent.dist_xy(self.goal.pos)

    def dist_box_goal(self) -> float:
        """Return the distance from the box to the goal, m."""
        return float(np.linalg.norm(self.push_box.pos - self.goal.pos))

    def obs(self) -> Any:
        """Return the observation."""
        return of_one(self._simulation.observe(), self._index)

    def calculate_cost(self) -> dict[str, float]:
        """Return the costs of the current state by kind, 1.0 or 0.0, and cost_sum, the maximum."""
        kinds = {f"cost_{k}": float(v[self._index]) for k, v in self._simulation._costs().items()}
        return {**kinds, "cost_sum": max([0.0, *kinds.values()])}

    def _objects(self, kind: str) -> Objects:
        world = self._simulation.world
        rows, of = world.rows[kind], world.kinds[kind]
        several = {"num": rows.stop - rows.start} if kind.endswith("s") else {}
        values = {
            "name": kind,
            "size": of.size[0],
            "keepout": float(world.areas.keepout[rows.start]) if rows.stop > rows.start else 0.0,
            "locations": self._simulation.given.get(kind, []),
            "placements": None,
            "is_lidar_observed": kind in world.scene.lidars,
            "is_constrained": any(cost.startswith(kind) for cost in world.scene.costs),
            "color": np.array(of.colour),
            **({"density": of.density} if of.physics in ("free", "driven") else {}),
            **({"radius": of.size[0]} if kind == "circle" else {}),
            **dict.fromkeys(_WEIGHTS.get(kind, ()), 1.0),
        }
        made = Buttons if kind == "buttons" else Objects
        where = {"_simulation": self._simulation, "_index": self._index}
        return made(f"task.{kind}", **where, **several, **values)

    def _names(self) -> list[str]:
        world = self._simulation.world
        each = (
            worlds.names(kind, world.rows[name].stop - world.rows[name].start)
            for name, kind in world.kinds.items()
        )
        return ["agent", *(name for of_kind in each for name in of_kind)]

    def _placements(self, agent: Any) -> dict[str, tuple[Any, float]]:
        """Return the rectangles in which each may be placed (None: the square), with keepout."""
        areas = self._simulation.world.areas
        pairs = zip(self._names(), areas.keepout.tolist(), strict=True)
        return {name: (agent if name == "agent" else None, keepout) for name, keepout in pairs}

    def _by_name(self) -> dict[str, NDArray[np.float64]]:
        """Return the observation's numbers by name."""
        task = self._simulation
        return of_one(parts.by_name(task.parts, task.numbers()), self._index)


_WEIGHTS = {
    "goal": ("reward_goal", "reward_distance"),
    "buttons": ("reward_goal", "reward_distance", "cost"),
    "push_box": ("reward_box_dist", "reward_box_goal"),
    "hazards": ("cost",),
    "pillars": ("cost",),
    "vases": ("contact_cost", "velocity_cost"),
    "gremlins": ("contact_cost", "dist_cost"),
}
"""Names of the weights of rewards and costs by kind of object; all weights are 1."""
_SENSORS = ("accelerometer", "velocimeter", "gyro", "magnetometer")


def _bodies(model: mujoco.MjModel) -> int:
    """Return the number of the agent's bodies; they come first, all below body 1."""
    return int((model.body_rootid == model.body("agent").id).sum())


def _geoms(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_geomadr[body])
    return range(first, first + int(model.body_geomnum[body]))
