"""Pages on tasks in Gymnasium's layout, generated from environments and their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
from collections.abc import Iterable
from pathlib import Path

import gymnasium as gym
from gymnasium.spaces import Box
from hyperparameters import texts

from agents.presets import PAPER_STEPS
from agents.reporting import pictures
from agents.training.config import TrainConfig
from agents.training.policy import FOLDER, pretrained
from circle2d_mj import Circle2DConfig, Circle2DVectorEnv
from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.physics_config import PhysicsConfig
from circle2d_mj.registration import KINEMATIC, PHYSICS
from circle2d_mj.safety import families
from circle2d_mj.safety.navigation import NavigationTask
from circle2d_mj.safety.robots import AGENTS
from circle2d_mj.safety.scenes import COUNTED, parameters, scene
from circle2d_mj.safety.tasks import IDS, VELOCITY
from circle2d_mj.safety.velocity import BODIES, VelocityTask

SIZE = 300
"""Pixels along the side of a film of Circle2D."""
OBSERVED = tuple(
    f"{axis} of the {what}"
    for what in ("position, over the arena's half-width", "velocity, over 0.11 R a step")
    for axis in ("x", "y")
)
MOVED = tuple(f"move along {axis}, over 0.11 R" for axis in ("x", "y"))
FORCED = tuple(f"target velocity along {axis}, or thrust, over the greatest" for axis in ("x", "y"))
LEVEL = {
    0: "The cost region of level 0 is solid: a move that would end inside it does not happen, and "
    "costs.",
    1: "The cost region of level 1 can be entered, at a cost of 1 a step. The corridor on the left "
    "leads to the nearest place without cost.",
    2: "As level 1, with two more cut-outs in the cost region: they hold local optima, nearer to "
    "the start than the corridor.",
    3: "As level 1, with four more cut-outs in the cost region: they hold local optima, nearer to "
    "the start than the corridor.",
}
ARGUMENTS = {
    "camera": '"top", "side" or "follow": frames that MuJoCo draws, with shadows and forces.',
    "num_threads": "Number of threads that step the environments; it changes no result.",
    "max_episode_steps": "Steps after which an episode is truncated.",
    "render_mode": 'None, "rgb_array" or "human". Pictures need EGL or OSMesa.',
}
FAMILIES = ("Goal", "Button", "Push", "Circle", "Run")
SAFETY_PAGES = (*(f"Safety{family}" for family in FAMILIES), "SafetyVelocity")
"""Pages on the Safety tasks, one for each family."""
FILMED = {family: f"SafetyPoint{family}1-v0" for family in FAMILIES[:4]}
FILMED |= {"Run": "SafetyCarRun0-v0", "Velocity": "SafetyHalfCheetahVelocity-v1"}
COSTS = {
    "hazards": "the agent's origin is in a hazard",
    "vases_contact": "the agent touches a vase",
    "vases_velocity": "a vase moves at 0.0001 m/s or more",
    "buttons": "the agent touches a wrong button, and no button was pressed within ten steps",
    "gremlins": "the agent touches a gremlin; these circle at 0.35 m",
    "pillars": "the agent touches a pillar",
    "out_of_boundary": "the agent is beyond a wall",
}
CHANGED = {kind: f"Number of {kind}, on levels that have some; 0 for none." for kind in COUNTED}
CHANGED["half_width"] = "Half-width of the square in which everything is placed, m."
ORIGINAL = "The tasks are Safety-Gymnasium's, on current MuJoCo: see [parity](../../parity.md)."


def shown_policy(task: str) -> str:
    """Return the name of the policy in a task's film: the zoo's or else CPO's, if the package has
    one, else ""."""
    found = (name for name in ("zoo", "cpo") if (FOLDER / name / task).is_dir())
    return "".join(f"pretrained:{name}/{task}" for name in itertools.islice(found, 1))


def pages() -> dict[str, str]:
    """Return the pages by file name without suffix."""
    found = {}
    for level in LEVELS:
        for name in (KINEMATIC[level], PHYSICS[level]):
            found[name] = _circle2d(name, level)
    for family in FAMILIES:
        found[f"Safety{family}"] = _family(family)
    found["SafetyVelocity"] = _velocity()
    return found


def write_films(folder: Path) -> None:
    """Write a film of the zoo's policy on every Circle2D task next to the task's page."""
    for name in (*KINEMATIC.values(), *PHYSICS.values()):
        policies = pretrained("zoo", name)
        [run] = TrainConfig.read(policies).runs
        episodes, view = pictures.evaluation_episodes(policies, run, 1, noisy=False)
        panels = [pictures.Panel(name, view, episodes)]
        frames = pictures.film(panels, SIZE)
        pictures.write_film(folder / f"{name}.gif", frames, pictures.pictures_of(panels))


def _circle2d(name: str, level: int) -> str:
    physics = name in PHYSICS.values()
    env_class = Circle2DMuJoCoVectorEnv if physics else Circle2DVectorEnv
    rows = _rows(Circle2DVectorEnv) | (_rows(Circle2DMuJoCoVectorEnv) if physics else {})
    config = Circle2DConfig(level=level)
    (left, low), (right, high) = config.start_rectangle
    sections = {
        "Description": [
            "A point starts on the right of a disc in which steps cost, and is rewarded for being "
            "near its middle. The direct way leads through the cost region; the way without cost "
            "leads round it, into the corridor on the far side.",
            LEVEL[level],
            f"The film shows the policy `{shown_policy(name)}`. {_world(config)}",
            _physics() if physics else "",
        ],
        "Action space": [_space_table(name, "action_space", FORCED if physics else MOVED)],
        "Observation space": [_space_table(name, "observation_space", OBSERVED)],
        "Reward": [
            "Minus the distance of the position p to the optimum o, over the arena's half-diagonal "
            "(m is `init_radius_multiplier`):",
            r"$$-\frac{\lVert p - o \rVert}{\sqrt{2}\, m R}$$",
            "With `sparse_reward=True` it is 1 more inside the corridor and the cut-outs, and 0 "
            "elsewhere.",
        ],
        "Cost": ['`info["cost"]`: ' + rows['`info["cost"]`'] + ".", *_further(rows)],
        "Start": [
            f"Uniform over the rectangle x in [{left:g}, {right:g}], y in [{low:g}, {high:g}] "
            "(world units), outside the cost region, at rest."
        ],
        "End": [
            f"After {gym.spec(name).max_episode_steps} steps the episode is truncated. It "
            "terminates only with `reset_on_cost=True`, at a step with cost."
        ],
        "Arguments": [
            f'`gym.make("{name}", ...)` takes these; the level is part of the id. Lengths are in '
            "world units, R stands for `constraint_radius`.",
            *_arguments(config, env_class),
        ],
        "Versions": ["- v0: the paper's task. The first version of this package has it too."],
    }
    return _page(name, f"{name}.gif", _properties(name), sections)


def _family(family: str) -> str:
    task = getattr(families, f"{family}Task")
    levels = [0] if family == "Run" else [0, 1, 2]
    rows, kinds = [], []
    for agent in AGENTS:
        for level in levels:
            name, laid = IDS[f"Safety{agent}{family}{level}"], scene(f"{family}{level}", agent)
            env = gym.spec(name).make()
            # A kind that a level may have several of is named in the plural.
            objects = [f"{p.number} {p.kind.rstrip('s' * (p.number == 1))}" for p in laid.placed]
            shown = ", ".join(objects) or "none"
            bounds = [f"{axis} = ±{at:g} m" for axis, at in zip("xy", laid.walls, strict=False)]
            walls = ", ".join(bounds)
            costs = ", ".join(laid.costs) or "none"
            shape = str(env.observation_space.shape[0])
            cells = (f"`{name.rpartition('/')[2]}`", shown, walls, costs, shape)
            rows.append(cells)
            kinds += [kind for kind in laid.costs if kind not in kinds]
            env.close()
    first = scene(f"{family}{levels[-1]}", "Point")
    lidars = (
        f"After the sensors come 16 numbers for each lidar: {', '.join(first.lidars)}. Each tells "
        "how near the nearest object of its kind is in 16 directions, 1 at no distance and 0 at "
        f"{first.reach:g} m."
    )
    sections = {
        "Description": [_prose(task), ORIGINAL],
        "Variants": [_table(("id", "objects", "walls", "kinds of cost", "observation"), rows)],
        "Action space": [f"{name}:\n\n{_tables(type(c))['action']}" for name, c in AGENTS.items()],
        "Observation space": [
            *(f"{name}:\n\n{_tables(type(c))['observation']}" for name, c in AGENTS.items()),
            lidars if first.lidars else "",
        ],
        "Reward": [_prose(task)],
        "Cost": [
            "1.0 if any kind of cost occurs, else 0.0; level 0 has none.",
            _table(("kind", "costs where"), [(f"`cost_{kind}`", COSTS[kind]) for kind in kinds]),
            _tables(NavigationTask)["info"],
        ],
        "Start": ["At random places with minimum distances, with a random heading, at rest."],
        "End": [_end(IDS[f"SafetyPoint{family}0"]), _terminates(family)],
        "Arguments": [_safety_arguments(IDS[f"SafetyPoint{family}0"], parameters(first))],
        "Versions": ["- v0: the numbers of Safety-Gymnasium 1.0.0."],
    }
    return _safety_page(f"Safety{family}", FILMED[family], sections)


def _velocity() -> str:
    rows = []
    for body in VELOCITY:
        task = BODIES[body]
        env = gym.make(IDS[f"Safety{body}Velocity"])
        seconds = env.unwrapped._envs.simulation.step_seconds
        cells = (f"`Safety{body}Velocity-v1`", f"{task.max_speed:g}", f"{seconds:g}")
        rows.append((*cells, *(str(s.shape[0]) for s in (env.observation_space, env.action_space))))
        env.close()
    head = ("id", "speed limit, m/s", "step, s", "observation", "action")
    reward = [
        (body, f"{b.forward:g} v + {b.alive:g} - {b.control_cost:g} ‖a‖²")
        for body, b in BODIES.items()
    ]
    sections = {
        "Description": ["Gymnasium's bodies, v4, with a speed limit.", ORIGINAL],
        "Variants": [_table(head, rows)],
        "Action space": ["Torques over the actuators' gear. MuJoCo clips them to the bounds."],
        "Observation space": [_prose(VelocityTask)],
        "Reward": [
            "For the forward velocity v, the mean over the step in m/s, and the action a, which is "
            "not clipped here:",
            _table(("body", "reward"), reward),
        ],
        "Cost": [
            "1.0 above the speed limit, else 0.0. The speed is v; for Ant and Humanoid it is the "
            "speed in the plane.",
        ],
        "Start": ["Near rest, by the noise of gymnasium's v4."],
        "End": [
            _end(IDS["SafetyHopperVelocity"]),
            "Hopper, Walker2d, Ant and Humanoid terminate when the torso's height, or for the "
            "first two the torso's tilt, leaves the allowed range.",
        ],
        "Arguments": [_safety_arguments(IDS["SafetyHopperVelocity"])],
        "Versions": [
            "- v1: the numbers of Safety-Gymnasium 1.0.0. Before 0.2.0, Hopper had twice the "
            "original's contact margins.",
        ],
    }
    return _safety_page("SafetyVelocity", FILMED["Velocity"], sections)


def _end(name: str) -> str:
    return f"After {gym.spec(name).max_episode_steps} steps the episode is truncated."


def _terminates(family: str) -> str:
    draws = family in ("Goal", "Push")
    return (
        f"It terminates where {'no place for a new goal is found, and where ' * draws}the Ant is "
        "too low."
    )


def _prose(cls: type) -> str:
    """Return the first paragraph of a docstring that is not a table, as one line."""
    paragraphs = inspect.cleandoc(cls.__doc__).split("\n\n")
    at = 1 if cls is VelocityTask else 0
    return " ".join(paragraphs[at].split())


def _safety_arguments(name: str, changed: Iterable[str] = ()) -> str:
    rows = [(f"`{key}`", "the level's own", CHANGED[key]) for key in changed]
    steps = gym.spec(name).max_episode_steps
    return _table(("argument", "default", "meaning"), rows + _extra(("num_threads",), steps))


def _safety_page(name: str, film: str, sections: dict[str, list[str]]) -> str:
    policy = shown_policy(film)
    shown = f"The policy `{policy}`" if policy else "An agent that draws its actions at random"
    return _page(name, f"../../films/{film}.gif", f"{shown}, on `{film}`.", sections)


def _page(name: str, film: str, about: str, sections: dict[str, list[str]]) -> str:
    """Return a page. film: path of the film of a task; about: what follows below it."""
    parts = [f"# {name}", f"![A film of {Path(film).stem}]({film})", about]
    for title, own in sections.items():
        parts += [f"## {title}", *filter(None, own)]
    return "\n\n".join(parts) + "\n"


def _properties(name: str) -> str:
    rows = [
        ("make one", f'`gym.make("{name}")`'),
        ("make many", f'`gym.make_vec("{name}", num_envs=1024)`'),
    ]
    for kind in ("action", "observation"):
        space = _space(name, f"{kind}_space")
        # Gymnasium prints the bounds of a mixed box as arrays of many lines.
        short = str(space) if len(str(space)) < 80 else f"Box of {space.shape}, {space.dtype}"
        rows.append((f"{kind} space", f"`{short}`"))
    rows.append(("steps of an episode", str(gym.spec(name).max_episode_steps)))
    if name in PAPER_STEPS:
        rows.append(("the paper trains for", f"{PAPER_STEPS[name]:,} steps"))
    return _table(("property", "value"), rows)


def _space(name: str, attribute: str) -> Box:
    env = gym.make(name)
    space = getattr(env, attribute)
    env.close()
    assert isinstance(space, Box)
    return space


def _space_table(name: str, attribute: str, meanings: tuple[str, ...]) -> str:
    """Return the table of bounds of each number of a space."""
    space = _space(name, attribute)
    bounds = zip(meanings, space.low, space.high, strict=False)
    rows = [(str(k), *(m, f"{a:g}", f"{b:g}")) for k, (m, a, b) in enumerate(bounds)]
    assert len(rows) == space.shape[0]
    return _table(("number", "meaning", "min", "max"), rows)


def _arguments(config: Circle2DConfig, env_class: type) -> list[str]:
    own = inspect.signature(env_class.__init__).parameters
    rows = []
    for kind in (Circle2DConfig, *([PhysicsConfig] if "camera" in own else [])):
        explained = texts(kind)
        for field in dataclasses.fields(kind):
            if field.name != "level":
                default = "`{}`" if field.name == "randomize" else f"`{field.default!r}`"
                rows.append((f"`{field.name}`", default, explained[field.name]))
    names = tuple(name for name in ("num_threads", "camera") if name in own)
    return [_table(("argument", "default", "meaning"), rows + _extra(names, 50))]


def _extra(names: tuple[str, ...], steps: int) -> list[tuple[str, str, str]]:
    """Return rows for arguments that environments add to the config's."""
    defaults = {"num_threads": 1, "max_episode_steps": steps}
    shown = (*names, "max_episode_steps", "render_mode")
    return [(f"`{name}`", f"`{defaults.get(name)!r}`", ARGUMENTS[name]) for name in shown]


def _rows(cls: type) -> dict[str, str]:
    """Return the last cell of each row of the table in a docstring, by the first cell."""
    lines = [line for line in inspect.cleandoc(cls.__doc__).splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    return {first: meaning[:1].upper() + meaning[1:] for first, _, meaning in cells}


def _further(rows: dict[str, str]) -> list[str]:
    own = [
        f"- {key}: {text}"
        for key, text in rows.items()
        if key.startswith("`info") and "cost" not in key
    ]
    return ["The info also holds", "\n".join(own)] if own else []


def _tables(cls: type) -> dict[str, str]:
    """Return the tables in a docstring by their first heading."""
    paragraphs = inspect.cleandoc(cls.__doc__).split("\n\n")
    found = [paragraph for paragraph in paragraphs if paragraph.startswith("|")]
    plain = [
        text.replace(": see `rules.lidar`", "").replace(", as in `SafetyPointCircle`", "")
        for text in found
    ]
    return {text.split("|")[1].strip(): text for text in plain}


def _world(config: Circle2DConfig) -> str:
    return (
        f"The disc has radius R = {config.constraint_radius:g} world units, the arena a half-width "
        f"of {config.arena:g}; a full action moves the point by {config.full_step:g} along an axis."
    )


def _physics() -> str:
    return (
        "MuJoCo moves a ball with inertia, without friction. On level 0 the region is rigid, "
        "made of contact geometry; on levels 1 to 3 it is detected without force. A step takes "
        "0.1 s: ten steps of 0.01 s. `circle2d scene` prints the scene as MJCF. Mass, friction, "
        "actuators and a region that pushes back are parameters: see "
        "[environments](../../environments.md)."
    )


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
