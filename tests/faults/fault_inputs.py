"""Malformed options of commands, and malformed arrays for functions and environments."""

import contextlib
import dataclasses
import datetime
import math
import shutil
import warnings

import gymnasium as gym
import numpy as np
from fault_common import Tally, here
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

import circle2d_mj  # noqa: F401  # registers the tasks
import emcc
from agents import api
from agents.algorithms import ALGORITHMS
from agents.cli import training as train_command
from agents.training.config import TrainConfig

NUMBERS = ["0", "-1", "1", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "1_0", "٣",
           "9223372036854775807", "9223372036854775808", "-9223372036854775809", "4294967296",
           "1" + "0" * 5000, "0x10", "1j", "1,5", "1e6", "2**70", "True", "None", "", " ", "--",
           "-", "\x1b[31m", "\n", "a\nb", "..", "/", "<b>", "'", "\\", "🙂", "\ud800"]  # fmt: skip


def many(count, number=0):
    """Return a decorator: hypothesis with so many examples, at least one, the same each time."""
    how = {"deadline": None, "database": None, "suppress_health_check": [*HealthCheck]}
    checks = settings(max_examples=max(1, count), phases=[Phase.generate], **how)
    return lambda function: seed(number)(checks(function))


def options_of(algorithm):
    """Return the names of all options of a training."""
    own = [field.name for field in dataclasses.fields(ALGORITHMS[algorithm].config)]
    general = [field.name for field in dataclasses.fields(train_command.TrainOptions)]
    return [name for name in own + general if name not in ("algorithm", "out", "imports")]


@contextlib.contextmanager
def without_training():
    """Have the command `train` do everything except the training."""
    train, finish = api._train, train_command._finish
    api._train, train_command._finish = (lambda *_: None), (lambda *_: 0)
    try:
        yield
    finally:
        api._train, train_command._finish = train, finish


def try_options(tally: Tally, count, rng, root):
    """Give options of `train` and of other commands values of all kinds.

    `train` must either write settings that can be read again, or say in one line what is wrong and
    leave no folder.
    """
    values = st.sampled_from(NUMBERS) | st.text(max_size=20) | st.integers().map(str)
    values |= st.floats().map(str)
    out = root / "options"
    others = [["evaluate"], ["resume"], ["report"], ["compare"], ["heatmap"], ["render"], ["scene"]]

    @many(count, rng.randrange(2**30))
    @given(st.data())
    def one(data):
        if data.draw(st.integers(0, 4)) == 0:
            command = data.draw(st.sampled_from(others)) + data.draw(st.lists(values, max_size=3))
            command = [word for word in command if word not in ("/", "..")]  # takes long
            tally.note("options of other commands", here(command).problem((0, 1, 2)))
            return
        algorithm = data.draw(st.sampled_from(sorted(ALGORITHMS)))
        command = ["train", algorithm, "--out", str(out), "--backend", "numpy"]
        names = st.lists(st.sampled_from(options_of(algorithm)), min_size=1, max_size=2)
        for name in data.draw(names):
            command += [f"--{name.replace('_', '-')}", data.draw(values)]
        done = here(command)
        tally.note("options of train", _problem(done, out, command))

    with without_training(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one()


def _problem(done, out, command):
    problem = done.problem((0, 2))
    if not problem and done.status == 0 and out.exists():
        try:
            TrainConfig.read(out)
        except ValueError as error:
            problem = f"accepted, and refused when it is read: {error}"
    if not problem and done.status == 2 and out.exists():
        problem = "a folder was left"
    if out.exists():
        shutil.rmtree(out)
    return f"{command}: {problem}" if problem else ""


ODD = st.sampled_from([
    None, "", "1", b"1", [], [[]], [[1], [1, 2]], {}, {"a": 1}, [None], ["1"], [b"1"], 1j, [1j],
    10**400, [10**400], -(10**400), math.nan, math.inf, [math.nan], [1e308, 1e308],
    [-1e308, 1e308],
    np.ma.masked_array([1.0, 2.0], [True, False]), np.array([None]), np.array(["1"]), object(),
    np.array(["2020-01-01"], dtype="M8[D]"), np.array([1], dtype="m8[s]"),
    datetime.date(2020, 1, 1), np.array([(1, 2)], dtype=[("a", int), ("b", float)]), True,
    [True, False], np.float16(65504),
    np.array([2**64 - 1], dtype=np.uint64), np.longdouble("1e4000"), [np.longdouble("1e4000")],
    range(3), iter([1]), lambda: 1, np.zeros((0, 3)), np.zeros((2, 0)), np.array(5), [5, "a"],
])  # fmt: skip
ARRAYS = arrays_of.arrays(
    st.sampled_from(["f8", "f4", "f2", "i8", "u8", "i1", "?", "c16", "O", "U3", "S3", "M8[s]"]),
    arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    fill=st.nothing(),
)
VALUES = (
    ODD | ARRAYS | st.lists(st.floats() | st.integers(), max_size=6) | st.floats() | st.integers()
)
FUNCTIONS = [
    (emcc.longest_streak, 2), (emcc.longest_streaks, 3), (emcc.count_streaks, 3), (emcc.emcc, 3),
    (emcc.cvar, 2), (emcc.emcc_by_part, 4), (emcc.EpisodeRecords.from_costs, 5),
    (emcc.EpisodeRecords, 8), (emcc.mean_interval, 2), (emcc.iqm, 1), (emcc.cost_rate, 2),
]  # fmt: skip
TASKS = ("Circle2D-1-v0", "Circle2DMuJoCo-1-v0", "circle2d_mj/SafetyHopperVelocity-v1",
         "circle2d_mj/SafetyPointGoal1-v0")  # fmt: skip


def try_arrays(tally: Tally, count, rng):
    """Give the metric's functions arguments, and environments actions, of all kinds.

    Each call must raise TypeError or ValueError, or succeed; what environments return must be
    finite.
    """
    envs = {task: gym.make(task, disable_env_checker=True) for task in TASKS}
    for env in envs.values():
        env.reset(seed=0)

    @many(count, rng.randrange(2**30))
    @given(st.data())
    def one(data):
        if data.draw(st.integers(0, 2)) == 0:
            task = data.draw(st.sampled_from(TASKS))
            action = data.draw(VALUES)
            tally.note("actions", _of_action(envs[task].unwrapped, action))
        else:
            function, most = data.draw(st.sampled_from(FUNCTIONS))
            arguments = [data.draw(VALUES) for _ in range(data.draw(st.integers(1, most)))]
            tally.note("arguments of the metric", _of_function(function, arguments))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one()
    for env in envs.values():
        env.close()


def _of_action(env, action):
    try:
        observation, reward, terminated, truncated, info = env.step(action)
    except (TypeError, ValueError):
        return ""
    except Exception as error:
        return f"{env}: {action!r}: {type(error).__name__}: {error}"
    if terminated or truncated:
        env.reset(seed=0)
    finite = np.isfinite(observation).all() and np.isfinite([reward, *info.values()]).all()
    return "" if finite else f"{env}: {action!r}: not finite"


def _of_function(function, arguments):
    try:
        function(*arguments)
    except (TypeError, ValueError):
        return ""
    except Exception as error:
        return f"{function.__qualname__}{tuple(arguments)!r}: {type(error).__name__}: {error}"
    return ""
