"""Agents among objects: the base class of the navigation tasks. `families` adds the goals."""

# pyright: reportAttributeAccessIssue=false
# mujoco's names are defined in compiled modules, which pyright cannot read.

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import flatten_space
from numpy.typing import NDArray

from circle2d_mj.core.engine import mujoco
from circle2d_mj.core.simulation import Outcome, State, positive_integer
from circle2d_mj.core.streams import Streams
from circle2d_mj.render.gl import Offscreen
from circle2d_mj.safety import layout, parts, rules, scenes, views, worlds
from circle2d_mj.safety.layout import Areas
from circle2d_mj.safety.mujoco_task import MuJoCoTask
from circle2d_mj.safety.parts import PICTURE
from circle2d_mj.safety.resting import Circling, Resting
from circle2d_mj.safety.robots import action_space
from circle2d_mj.safety.scenes import Scene
from circle2d_mj.safety.substeps import SUBSTEPS, substeps
from circle2d_mj.safety.worlds import World

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
_QUIET = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


class NavigationTask(MuJoCoTask):
    """`num_envs` copies of a task: an agent (one of `AGENTS`) in a scene of the family.

    | info | meaning | unit |
    | --- | --- | --- |
    | cost | 1.0 if there is any kind of cost, else 0.0 | |
    | cost_... | 1.0 if there is this kind of cost, else 0.0: see `scenes` | |
    | goal_met | 1.0 if the step reached the goal, else 0.0; in families with goals | |
    | x_position, y_position | position of the agent in the world | m |

    The observation is the agent's sensors, then 16 numbers for each lidar. An episode starts with a
    random layout, uniform headings and rotations of objects, and everything at rest. Source:
    safety-gymnasium 1.0.0.

    Parameters that replace those of the level: the numbers of `hazards`, `vases`, `pillars` and
    `gremlins`, for the kinds that the level has, from 0 to 100 (the observation keeps its size),
    and `half_width`, m, of the square in which everything is placed. `places` sets the starting
    places of the first objects of a kind, or of the "agent", as in
    `places={"hazards": [(0, 0), (1, 0)]}`, m; for a goal, that of the episode's first goal. With
    `vision_size`, (width, height) in pixels, observations are dicts of parts with
    safety-gymnasium's names, float64, and "vision", the picture of the agent's camera, uint8
    [height, width, 3]; ids with `Vision` have (256, 256). Raises TypeError for a parameter that the
    task does not have, ValueError for a value that is not allowed.

    level: of the task, or a `Scene` of your own.
    """

    family: ClassVar[str]
    has_goals: ClassVar[bool] = False
    camera: ClassVar[str] = "top"

    def __init__(
        self,
        agent: str,
        level: int | Scene,
        num_envs: int = 1,
        num_threads: int = 1,
        *,
        places: Mapping[str, Any] | None = None,
        vision_size: tuple[int, int] | None = None,
        **changes: float,
    ) -> None:
        self.level = level if isinstance(level, int) else "Own"
        name = level if isinstance(level, Scene) else f"{self.family}{level}"
        scene = scenes.scene(name, agent, tuple(changes.items()))
        self._of_world = agent, self.family, scene
        self.world = worlds.world(*self._of_world)
        self.given = checked_places(self.world, {} if places is None else places)
        self._areas = starting_areas(self.world, self.given)
        arguments = {"agent": agent, "level": level, "places": self.given, **changes}
        arguments["vision_size"] = self.vision_size = checked_size(vision_size)
        super().__init__(self.world.model, num_envs, num_threads, SUBSTEPS, **arguments)
        self.agent = self.world.agent
        self.action_space = action_space(self.agent)
        self.parts = parts.of_world(self.world, self.vision_size)
        self.observation_space = self.parts if self.vision_size else flatten_space(self.parts)
        self._eye: Offscreen | None = None
        hazard = self.world.kinds.get("hazards")
        radius = hazard.size[0] if hazard else 0.0
        self.view = views.of_scene(self.family, scene, radius, self.agent.sensors)
        self.info_keys = (
            "cost",
            *(f"cost_{kind}" for kind in scene.costs),
            *(["goal_met"] if self.has_goals else []),
            "x_position",
            "y_position",
        )
        n, free = self.num_envs, self.world.free.stop - self.world.free.start
        self._free_qpos = self.qpos[:, self.agent.nq :].reshape(n, free, 7)
        self._free_qvel = self.qvel[:, self.agent.nv :].reshape(n, free, 6)
        self._mocap_pos = self.batch.bind("mocap_pos").reshape(n, -1, 3)
        self._mocap_quat = self.batch.bind("mocap_quat").reshape(n, -1, 4)
        rotations = self.batch.bind("xmat").reshape(n, -1, 3, 3)
        self.rotations = rotations[:, 1 : 1 + self.agent.bodies]
        """Rotation matrices of the agent's bodies, its root first: [num_envs, bodies, 3, 3]."""
        rows = self.world.rows
        counts = [rows[kind].stop - rows[kind].start for kind in scene.lidars]
        groups = np.repeat(np.arange(len(counts)), counts)
        shown = [i for kind in scene.lidars for i in range(rows[kind].start, rows[kind].stop)]
        # Mostly the lidars show all objects, in the order of placement: then a slice is faster.
        every = shown == list(range(1, len(self.world.areas.keepout)))
        self._shown = slice(1, None) if every else np.array(shown, dtype=np.intp)
        self._lidars = rules.Lidars(n, groups, len(counts), scene.reach) if counts else None
        self._driven = "gremlins" in rows
        self._first_gremlin = len(self.world.mocap) - free  # of the mocap bodies
        self._flags = self.batch.expand("opt.disableflags")
        self._all_on = self.model.opt.disableflags
        self._taken = substeps(self.batch, self.model)
        kind_of_rest = Circling if self._driven else Resting
        of_free = self.world, self._taken, self._free_qpos, self._free_qvel
        self._rests = kind_of_rest(self.batch, *of_free) if free else None
        # Where everything was placed, m: [num_envs, objects, 2]; for goals the current place.
        self._layout = np.zeros((n, len(self.world.areas.keepout), 2))
        self._places = self._layout.copy()  # where everything is now
        self._look()
        # New goals within an episode are drawn from these streams, which `start` seeds.
        self._goals = Streams(np.zeros(n, dtype=np.uint64))

    @property
    def met(self) -> Flags:
        """Whether the current state meets the current goal: [num_envs]."""
        return self._met(self._lengths())

    @property
    def alive(self) -> Flags:
        """Whether the agents are above their lowest allowed height: [num_envs]."""
        lowest = self.agent.lowest
        return self._position[:, 2] > (-np.inf if lowest is None else lowest)

    @property
    def layout(self) -> Floats:
        """Where everything was placed, m: [num_envs, objects, 2]; for goals the current place."""
        return self._layout.copy()

    @property
    def places(self) -> Floats:
        """Current places of everything, m: [num_envs, objects, 2]; rows: `world.rows`."""
        return self._places.copy()

    def positions(self, kind: str) -> Floats:
        """Return the current positions of a kind of objects or the agent, m: [num_envs, k, 3]."""
        if kind == "agent":
            return self._position[:, None].copy()
        if self.world.kinds[kind].physics in ("free", "driven"):
            return self._free_qpos[:, :, :3].copy()
        places = self._places[:, self.world.rows[kind]]
        height = np.full((*places.shape[:-1], 1), self.world.kinds[kind].height)
        return np.concatenate((places, height), axis=-1)

    def start(self, streams: Streams, index: NDArray[np.intp]) -> None:
        """Draw new layouts for the environments `index`, everything at rest."""
        free = self._free_qpos.shape[1]
        self._goals.reseed(index, layout.stream_keys(streams, index, 1)[:, 0])
        draw = streams.uniform(index, draws=1 + (free + self.agent.noise) // 4)
        places = layout.sample_layout(streams, index, self._areas)
        heading, turns, noise = np.split(draw, (1, 1 + free), axis=1)
        turns, noise = np.pi * turns[:, :free], noise[:, : self.agent.noise]  # half of each turn
        self.place(index, places, 2.0 * np.pi * heading[:, 0], turns, noise)
        self._begin_goals(index)

    def place(
        self,
        index: NDArray[np.intp],
        places: Floats,
        heading: Floats,
        half_turns: Floats,
        noise: Floats | None = None,
    ) -> None:
        """Place agents and objects of the environments `index`, at rest.

        places: [len(index), objects, 2]; heading: [len(index)]; half_turns: [len(index), free
        objects], half of each object's rotation about the vertical; noise: of the agent's joints.
        """
        world, n = self.world, len(index)
        self._layout[index] = places
        if isinstance(self._rests, Circling):
            self._rests.put(index, places[:, world.free])
        qpos = np.empty((n, self.model.nq))
        qpos[:, : self.agent.nq] = self.agent.qpos(places[:, 0], heading, noise)
        objects = qpos[:, self.agent.nq :].reshape(n, -1, 7)
        objects[:, :, :2] = places[:, world.free]
        for kind in world.kinds.values():
            if kind.physics in ("free", "driven"):
                objects[:, :, 2] = kind.height
        objects[:, :, 3:] = 0.0
        objects[:, :, 3], objects[:, :, 6] = np.cos(half_turns), np.sin(half_turns)
        self.batch.state[index] = self._initial
        self._mocap_pos[index, :, :2] = places[:, world.mocap]
        if self._driven:
            self._mocap_quat[index, self._first_gremlin :] = objects[:, :, 3:]
        self.qpos[index], self.qvel[index] = qpos, 0.0
        self.settle(index)

    def settle(self, index: NDArray[np.intp]) -> None:
        """Update sensors and places after states were written."""
        if self._rests:
            self._rests.wake(index)
        self.batch.forward(index)
        self._sense(index)
        self._look()

    def put_clock(self, index: int, time: float) -> None:
        """Set the time since the reset, s."""
        self._time[index] = time

    def put_gremlins(self, index: int, offset: Floats) -> None:
        """Set the gremlins' targets, relative to their places: [gremlins, 3] m."""
        assert isinstance(self._rests, Circling)
        self._mocap_pos[index, self._first_gremlin :] = self._rests.at_rest[index] + offset

    def step(self, action: Floats) -> Outcome:
        """Move all agents with their actions, [num_envs, nu], and renew the goals they reach."""
        before = self._lengths()
        self.advance(action)
        self._look()
        after = self._lengths()
        met = self._met(after)
        reward = self._reward(before, after, met)
        of_kind = self._costs()
        cost = np.zeros(self.num_envs)
        for value in of_kind.values():
            np.maximum(cost, value, out=cost)
        info = {"cost": cost, **{f"cost_{kind}": value for kind, value in of_kind.items()}}
        if self.has_goals:
            info["goal_met"] = met.astype(np.float64)
        terminated = self._renew_goals(met)
        if self.agent.lowest is not None:
            terminated |= ~self.alive
        return Outcome(reward, terminated, info)

    def state_info(self) -> dict[str, Floats]:
        """Return the agents' positions."""
        return {
            "x_position": self._position[:, 0].copy(),
            "y_position": self._position[:, 1].copy(),
        }

    def observe(self) -> Any:
        """Return the observations: `numbers`, or with `vision_size` a dict of arrays."""
        numbers = self.numbers()
        if self.vision_size is None:
            return numbers
        return {**parts.by_name(self.parts, numbers), PICTURE: self._see()}

    def numbers(self) -> Floats:
        """Return the numbers of the observations: [num_envs, observation size]."""
        read = self.agent.observe(self.sensors, self.rotations)
        if self._lidars is not None:
            axes, height = self.rotations[:, 0, :, :2], self._position[:, 2]
            read += (self._lidars(self._offset[:, self._shown], height, axes),)
        return np.concatenate(read, axis=1)

    def _see(self) -> NDArray[np.uint8]:
        """Return the pictures of the agents' cameras: [num_envs, height, width, 3]."""
        assert self.vision_size is not None
        if self._eye is None:
            self._eye = Offscreen(self.picture_model, *self.vision_size)
        camera = self.picture_model.camera(PICTURE).id
        return np.stack([self._eye.draw(self._drawn(i), camera) for i in range(self.num_envs)])

    def close(self) -> None:
        """Close all renderers and windows."""
        super().close()
        if self._eye is not None:
            self._eye.close()
        self._eye = None

    def state_dict(self) -> State:
        """Return everything that steps depend on."""
        goals = {"goal_keys": self._goals.keys.copy(), "goal_counters": self._goals.counters.copy()}
        return {**super().state_dict(), "layout": self._layout.copy(), **goals}

    def load_state_dict(self, state: State) -> None:
        """Load a state from `state_dict`."""
        super().load_state_dict(state)
        self._layout[:] = state["layout"]
        if isinstance(self._rests, Circling):
            self._rests.put(np.arange(self.num_envs), self._layout[:, self.world.free])
        self._goals.keys[:] = state["goal_keys"]
        self._goals.counters[:] = state["goal_counters"]
        self.batch.forward()  # rotations
        self._look()

    @property
    def picture_model(self) -> mujoco.MjModel:
        """The model with everything that is drawn."""
        return worlds.picture_model(*self._of_world)

    def _fill(self, data: Any, index: int) -> None:
        super()._fill(data, index)
        count = len(self.world.mocap)
        data.mocap_pos[:count] = self._mocap_pos[index]
        data.mocap_quat[:count] = self._mocap_quat[index]
        for kind, rows in self.world.rows.items():
            if kind != "agent" and self.world.kinds[kind].physics == "none":
                after = count + rows.stop - rows.start
                data.mocap_pos[count:after, :2] = self._places[index, rows]
                count = after

    # Methods that a family may override.

    def _lengths(self) -> Floats:
        """Return the lengths whose decrease is the reward: [num_envs, any]."""
        return np.zeros((self.num_envs, 0))

    def _met(self, lengths: Floats) -> Flags:
        """Return whether the goal is reached in states with these lengths: [num_envs]."""
        return np.zeros(self.num_envs, dtype=bool)

    def _reward(self, before: Floats, after: Floats, met: Flags) -> Floats:
        """Return the reward of steps from lengths `before` to lengths `after`: [num_envs]."""
        return rules.way_made(before, after, met)

    def _begin_goals(self, index: NDArray[np.intp]) -> None:
        """Choose the goals of the environments `index`, whose episodes have just started."""

    def _renew_goals(self, met: Flags) -> Flags:
        """Choose new goals where `met`; return the mask of episodes that end without one."""
        return np.zeros(self.num_envs, dtype=bool)

    def _costs(self) -> dict[str, Floats]:
        """Return the costs in the current state by kind, [num_envs] each."""
        return {kind: self._cost(kind) for kind in self.world.scene.costs}

    def _cost(self, kind: str) -> Floats:
        world = self.world
        if kind == "hazards":
            radius = world.kinds[kind].size[0]
            return rules.hazard_cost(self._distance[:, world.rows[kind]], radius)
        if kind == "out_of_boundary":
            return rules.boundary_cost(self._position, world.scene.walls)
        if kind == "vases_velocity":
            return rules.speed_cost(self._free_qvel[:, :, :3])
        return rules.touch_cost(self.sensors[:, world.touch[kind.removesuffix("_contact")]])

    def _look(self) -> None:
        """Update positions, places, offsets and distances from the current state."""
        self._position = self.agent.position(self.qpos)
        self._places[:] = self._layout
        self._places[:, 0] = self._position[:, :2]
        if self._free_qpos.size:
            self._places[:, self.world.free] = self._free_qpos[:, :, :2]
        self._offset = self._places - self._places[:, :1]  # from the agent
        self._distance = rules.length(self._offset)

    def _take_substeps(self) -> None:
        # Sensors are off in the substeps, where they would take a tenth of the time.
        self._flags.fill(self._all_on | _QUIET)
        if self._rests:
            self._rests.step(self._distance, self._places)
        else:
            self._taken.take()
        self._flags.fill(self._all_on)
        self.batch.forward()


def checked_size(size: Any) -> tuple[int, int] | None:
    """Return a width and height, or None. Raises TypeError or ValueError for anything else."""
    if size is None:
        return None
    if not isinstance(size, Sequence) or len(size) != 2:
        raise TypeError(f"vision_size must be (width, height), got {size!r}")
    return positive_integer("vision_size[0]", size[0]), positive_integer("vision_size[1]", size[1])


def checked_places(world: World, places: Mapping[str, Any]) -> dict[str, list[tuple[float, float]]]:
    """Return the given places of the agent and of kinds of objects, k pairs (x, y) each, m.

    Raises ValueError for unknown kinds, for more places than objects, for anything but pairs of
    finite numbers, and for two places that are closer than their objects may be.
    """
    if not isinstance(places, Mapping):
        raise TypeError(f"places must be pairs (x, y) by kind, got {places!r}")
    fixed = {"circle", "goal"} if "buttons" in world.kinds else {"circle"}
    placed = [kind for kind in world.rows if kind not in fixed]
    found: dict[str, list[tuple[float, float]]] = {}
    each: list[tuple[str, NDArray[np.float64], float]] = []
    for kind, given in places.items():
        if kind not in placed:
            raise ValueError(f"places may hold {', '.join(placed)}, got {kind!r}")
        rows = world.rows[kind]
        try:
            at = np.atleast_2d(np.asarray(given, dtype=np.float64))
        except (TypeError, ValueError):  # ragged, or no numbers
            at = np.empty((0, 0))
        if at.ndim != 2 or at.shape[1] != 2 or not np.isfinite(at).all():
            raise ValueError(f"places[{kind!r}] must be pairs (x, y), m, got {given!r}")
        if len(at) > rows.stop - rows.start:
            count = rows.stop - rows.start
            raise ValueError(f"places[{kind!r}] may hold at most {count}, got {len(at)}")
        found[kind] = [(float(x), float(y)) for x, y in at]
        keepouts = world.areas.keepout[rows]
        each += [(f"{kind}[{i}]", at[i], float(keepouts[i])) for i in range(len(at))]
    for (name, one, own), (other, place, keepout) in itertools.combinations(each, 2):
        apart, needed = float(np.hypot(*(one - place))), own + keepout
        if apart < needed:
            raise ValueError(
                f"places: {name}, {other} are {apart:.3g} m apart; the minimum is {needed:.3g}"
            )
    return found


def starting_areas(world: World, given: Mapping[str, list[tuple[float, float]]]) -> Areas:
    """Return where everything may start: the world's areas, reduced to points at given places."""
    if not given:
        return world.areas
    centre, half = world.areas.centre.copy(), world.areas.half.copy()
    for kind, places in given.items():
        first = world.rows[kind].start
        centre[first : first + len(places)] = places
        half[first : first + len(places)] = 0.0
    return Areas(centre, half, world.areas.keepout)
