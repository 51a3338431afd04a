"""A page for each task in Gymnasium's layout, made from its environment and its docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import shutil
from pathlib import Path

import circle2d_films
import gymnasium as gym
from gymnasium.spaces import Box
from hyperparameters import texts

from agents.paper.presets import PAPER_STEPS
from circle2d_mj import Circle2DConfig, Circle2DVectorEnv
from circle2d_mj.circle2d.config import LEVELS
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv
from circle2d_mj.registration import KINEMATIC, PHYSICS, SAFETY
from circle2d_mj.safety import rules
from circle2d_mj.safety.circle import START_HALF_WIDTH, SafetyPointCircle
from circle2d_mj.safety.goal import SafetyPointGoal
from circle2d_mj.safety.hopper import START_NOISE, SafetyHopperVelocity

FILMS = Path(__file__).parents[1] / "films"
"""Films that need OpenGL: drawn by `python docs/_ext/safety_films.py`, and kept."""
OBSERVED = tuple(
    f"{axis} of the {what}"
    for what in ("position, over the arena's half-width", "velocity, over 0.11 R a step")
    for axis in ("x", "y")
)
MOVED = tuple(f"move along {axis}, over 0.11 R" for axis in ("x", "y"))
FORCED = tuple(f"target velocity along {axis}, or thrust, over the greatest" for axis in ("x", "y"))
TORQUES = [
    (str(k), f"torque at the {joint}, over 200 N m")
    for k, joint in enumerate(("thigh", "leg", "foot"))
]
SENSORS = (
    "The sensors are accelerometer, velocity, turning rate and magnetometer, three numbers each."
)
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
    "actuation": '"velocity": a servo that aims at the given velocity. "force": a motor, so that '
    "braking has to be learned.",
    "num_threads": "Threads that step the environments. They change no number.",
    "max_episode_steps": "Steps after which an episode is truncated.",
    "render_mode": 'None, "rgb_array" or "human". Pictures need EGL or OSMesa.',
}
INFO = {
    SAFETY[2]: "| info | meaning | unit |\n| --- | --- | --- |\n| cost | as above | |\n"
    "| x_velocity | forward velocity, the mean over the step | m/s |",
}
SAFETY_TASKS = {
    SAFETY[0]: SafetyPointCircle,
    SAFETY[1]: SafetyPointGoal,
    SAFETY[2]: SafetyHopperVelocity,
}
SAFETY_TEXTS = {
    SAFETY[0]: {
        "Description": "A point with a heading runs round a circle of radius "
        f"{rules.CIRCLE_RADIUS:g} m. Two walls cut the circle: beyond them steps cost. A step "
        "takes 0.02 s.",
        "Reward": "Speed round the circle, anticlockwise, damped by the distance to it: for the "
        "position (x, y), the velocity (u, v) and the distance r from the centre\n\n"
        f"$$0.1\\, \\frac{{v x - u y}}{{r\\, (1 + |r - {rules.CIRCLE_RADIUS:g}|)}}$$",
        "Cost": f"1.0 where the step ended beyond a wall, |x| > {rules.CIRCLE_WALL:g} m, else 0.0.",
        "Start": f"Uniform in [-{START_HALF_WIDTH:g}, {START_HALF_WIDTH:g}]² m, with any heading, "
        "at rest.",
        "End": "It never terminates.",
    },
    SAFETY[1]: {
        "Description": "A point with a heading goes from goal to goal between eight hazards and a "
        "vase. A goal that is reached moves at once, and the episode goes on. A step takes 0.02 s.",
        "Reward": "The distance that the step came nearer to the goal, in metres, plus 1 where the "
        f"agent's centre is within {rules.GOAL_RADIUS:g} m of the goal.",
        "Cost": "1.0 where the step ended with the agent's centre within "
        f"{rules.HAZARD_RADIUS:g} m of a hazard's, else 0.0.",
        "Start": "Agent, goal, hazards and vase at random places that keep their distances, any "
        "heading, at rest.",
        "End": "It terminates only if no place for a new goal is found.",
    },
    SAFETY[2]: {
        "Description": "Gymnasium's Hopper with a speed limit. A step takes 0.008 s.",
        "Reward": "For the forward velocity v, the mean over the step in m/s, and the action a, "
        "which is not clipped here,\n\n$$v + 1 - 0.001\\, |a|^2$$",
        "Cost": f"1.0 above {rules.HOPPER_MAX_SPEED:g} m/s forward, else 0.0.",
        "Start": f"Upright, each number of qpos and qvel within {START_NOISE:g} of its rest.",
        "End": "It terminates where the torso is lower than 0.7 m or tilted by more than 0.2 rad, "
        "or a joint angle or a speed leaves (-100, 100).",
    },
}


def pages() -> dict[str, str]:
    """File name without suffix -> page."""
    found = {}
    for level in LEVELS:
        for name in (KINEMATIC[level], PHYSICS[level]):
            found[name] = _circle2d(name, level)
    for name in SAFETY:
        found[name.rpartition("/")[2]] = _safety(name)
    return found


def write_films(folder: Path) -> None:
    """Write the film of every task beside its page."""
    for level in LEVELS:
        for name in (KINEMATIC[level], PHYSICS[level]):
            circle2d_films.write(name, folder / f"{name}.gif")
    for film in FILMS.glob("*.gif"):
        shutil.copy(film, folder)


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
            f"The film shows a scripted agent. {_world(config)}",
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
        "Cost": ['`info["cost"]`: ' + rows['`info["cost"]`'][1] + ".", *_further(rows)],
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
    return _page(name, sections)


def _safety(name: str) -> str:
    texts_of, steps = SAFETY_TEXTS[name], gym.spec(name).max_episode_steps
    tables = _tables(SafetyPointCircle) | _tables(SAFETY_TASKS[name])
    if name == SAFETY[2]:
        tables |= {"action": _table(("action", "meaning"), TORQUES), "info": INFO[name]}
    sections = {
        "Description": [
            texts_of["Description"],
            "One of the paper's three tasks from Safety-Gymnasium 1.0.0, on current MuJoCo. The "
            "film shows an agent that draws its actions at random.",
        ],
        "Action space": [tables["action"]],
        "Observation space": [tables["observation"], SENSORS if name == SAFETY[1] else ""],
        "Reward": [texts_of["Reward"]],
        "Cost": [texts_of["Cost"] + " The info holds", tables["info"]],
        "Start": [texts_of["Start"]],
        "End": [f"After {steps} steps the episode is truncated. {texts_of['End']}"],
        "Arguments": [
            f'`gym.make("{name}", ...)` takes these.',
            _table(("argument", "default", "meaning"), _extra(("num_threads",), steps)),
        ],
        "Versions": [f"- {name.rpartition('-')[2]}: the numbers of Safety-Gymnasium 1.0.0."],
    }
    return _page(name, sections)


def _page(name: str, sections: dict[str, list[str]]) -> str:
    env = gym.spec(name)
    short = name.rpartition("/")[2]
    head = [
        f"# {short}",
        f"![A film of {short}]({short}.gif)",
        _table(
            ("property", "value"),
            [
                ("make one", f'`gym.make("{name}")`'),
                ("make many", f'`gym.make_vec("{name}", num_envs=1024)`'),
                ("action space", f"`{_space(name, 'action_space')}`"),
                ("observation space", f"`{_space(name, 'observation_space')}`"),
                ("steps of an episode", str(env.max_episode_steps)),
                *[("the paper trains for", f"{n:,} steps") for n in _paper_steps(name)],
            ],
        ),
    ]
    for title, parts in sections.items():
        head += [f"## {title}", *filter(None, parts)]
    return "\n\n".join(head) + "\n"


def _paper_steps(name: str) -> list[int]:
    return [PAPER_STEPS[name]] if name in PAPER_STEPS else []


def _space(name: str, attribute: str) -> str:
    env = gym.make(name)
    space = getattr(env, attribute)
    env.close()
    # Gymnasium prints the bounds of a mixed box as arrays of many lines.
    return str(space) if len(str(space)) < 80 else f"Box of {space.shape}, {space.dtype}"


def _space_table(name: str, attribute: str, meanings: tuple[str, ...]) -> str:
    """Bounds of each number of a space."""
    env = gym.make(name)
    space = getattr(env, attribute)
    env.close()
    assert isinstance(space, Box)
    bounds = zip(meanings, space.low, space.high, strict=False)
    rows = [(str(k), *(m, f"{a:g}", f"{b:g}")) for k, (m, a, b) in enumerate(bounds)]
    assert len(rows) == space.shape[0]
    return _table(("number", "meaning", "min", "max"), rows)


def _arguments(config: Circle2DConfig, env_class: type) -> list[str]:
    explained = texts(Circle2DConfig)
    rows = []
    for field in dataclasses.fields(Circle2DConfig):
        if field.name != "level":
            default = f"`{field.default!r}`"
            rows.append((f"`{field.name}`", default, explained[field.name]))
    own = inspect.signature(env_class.__init__).parameters
    names = tuple(name for name in ("actuation", "num_threads") if name in own)
    return [_table(("argument", "default", "meaning"), rows + _extra(names, 50))]


def _extra(names: tuple[str, ...], steps: int) -> list[tuple[str, str, str]]:
    """Rows of the arguments that are the environments' own."""
    defaults = {"actuation": "velocity", "num_threads": 1, "max_episode_steps": steps}
    shown = (*names, "max_episode_steps", "render_mode")
    return [(f"`{name}`", f"`{defaults.get(name)!r}`", ARGUMENTS[name]) for name in shown]


def _rows(cls: type) -> dict[str, tuple[str, str]]:
    """First cell -> the others, of the table in a docstring."""
    lines = [line for line in inspect.cleandoc(cls.__doc__).splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    return {first: (shape, _capital(meaning)) for first, shape, meaning in cells}


def _further(rows: dict[str, tuple[str, str]]) -> list[str]:
    own = [
        f"- {key}: {rows[key][1]}" for key in rows if key.startswith("`info") and "cost" not in key
    ]
    return ["The info holds further", "\n".join(own)] if own else []


def _tables(cls: type) -> dict[str, str]:
    """First word -> table, of those in a docstring."""
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
        "0.1 s: ten steps of 0.01 s. `circle2d scene` prints the scene as MJCF."
    )


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
