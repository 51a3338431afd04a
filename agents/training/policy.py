"""Trained policies for use outside training, and their evaluation."""

from __future__ import annotations

import contextlib
import copy
import functools
import os
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn
from torch import from_numpy as to_tensor

from agents.algorithms import Learner
from agents.algorithms import learner as make_learner
from agents.checks import In, as_integer, check
from agents.errors import (
    OWN_ERRORS,
    OwnCodeError,
    TaskFailure,
    UserError,
    described,
    nearest,
    no_exit,
)
from agents.lockstep import tree
from agents.lockstep.rollout import ENDS
from agents.lockstep.rollout import Policy as RunsPolicy
from agents.training.config import (
    CHECKPOINTS,
    COUNTERS,
    POLICIES,
    RunId,
    TrainConfig,
    is_of_policy,
    policy_path,
    read_spaces,
)
from agents.training.environments import (
    Spaces,
    checked_spaces,
    most_steps,
    registered,
    task_id,
)
from agents.training.files import Arrays, numbered
from agents.training.wrappers import Bounds, CheckedEnv
from emcc import cvar, longest_streak

FOLDER = Path(__file__).parent.parent / "policies"
"""Folder with a folder `ALGORITHM/TASK` for each policy of the package."""


def pretrained(algorithm: str, task: str) -> Path:
    """Return the folder of a trained policy that comes with the package.

    `load_policy` and `circle2d render` also take its name, "pretrained:ALGORITHM/TASK". Its
    `config.json` tells how the policy was trained. Raises UserError, naming what there is, for an
    algorithm or task without a policy.
    """
    there = sorted(path.parent for path in FOLDER.glob("*/*/config.json"))
    algorithms = sorted({path.parent.name for path in there})
    if algorithm not in algorithms:
        hint = nearest(algorithm, algorithms)
        raise UserError(f"no policy of {algorithm!r} comes with the package: {hint}")
    tasks = [path.name for path in there if path.parent.name == algorithm]
    name = task.rpartition(":")[2].rpartition("/")[2]
    if name not in tasks:
        hint = nearest(name, tasks)
        raise UserError(f"no policy of {algorithm} for {task!r} comes with the package: {hint}")
    return FOLDER / algorithm / name


def folder_of(given: str | os.PathLike[str]) -> Path:
    """Return the folder given, or for `pretrained:ALGORITHM/TASK` that of the package's policy."""
    kind, colon, name = Path(given).as_posix().partition(":")
    algorithm, _, task = name.partition("/")
    return pretrained(algorithm, task) if kind == "pretrained" and colon else Path(given)


OBSERVATIONS, SIZES = 256, (0.01, 10.0)
"""Number, and smallest and largest standard deviation, of the observations on which the actions of
a module must be those of its policy."""
SAME = 1e-3
"""Largest difference by rounding between such actions, as a share of the range of actions."""


class Policy:
    """A trained policy, which acts in its task's own action space.

    Call it with one observation [observation size] or a batch [N, observation size]; the action is
    [action size] or [N, action size], of the task's type and within its bounds. Policies can be
    pickled, for other processes.
    """

    task: str
    """Id of the task that the policy was trained on."""
    task_parameters: dict[str, Any]
    seed: int
    """Seed of its run."""
    step: int | None
    """Environment steps that its run had taken; for a policy kept by `evaluate_every` the `step`
    given to `load_policy`. None if not recorded, as in policies of the package."""
    failure: str
    """Why its run failed; "" if it did not."""
    spaces: Spaces
    """Size of observations, and bounds of actions."""
    in_lockstep: RunsPolicy
    """The policy as training calls it, with actions in [-1, 1]."""

    def __init__(
        self,
        config: TrainConfig,
        run: RunId,
        step: int | None,
        failure: str,
        spaces: Spaces,
        learner: Learner,
    ) -> None:
        """learner: holds only this run."""
        self.task, self.task_parameters = run.task, config.task_parameters
        self.seed, self.step, self.failure = run.seed, step, failure
        self.spaces, self.in_lockstep = spaces, learner.policy()
        self._config = config
        module = getattr(learner, "module", None)
        self._module = module(0) if module else None
        self._rng = np.random.default_rng()
        low, high = (np.array(bound, dtype=spaces.dtype) for bound in (spaces.low, spaces.high))
        self._bounds = Bounds(low, high)

    def __repr__(self) -> str:
        return f"Policy(task={self.task!r}, seed={self.seed})"

    def __call__(
        self,
        observation: ArrayLike,
        deterministic: bool = True,
        rng: np.random.Generator | None = None,
    ) -> NDArray:
        """Act on one observation or a batch.

        deterministic: take the centre of the distribution of actions instead of drawing from it.
        rng: generator of the draws, by default one of the policy, which is not seeded.
        Raises TypeError unless observations are real numbers, ValueError for a wrong shape.
        """
        observations, alone = self._batch(observation)
        noise = None
        if not deterministic:
            shape = (1, len(observations), len(self._bounds.low))
            noise = (rng or self._rng).standard_normal(shape, dtype=np.float32)
        action = self._bounds(np.clip(self.in_lockstep(observations[None], noise)[0], -1.0, 1.0))
        return action[0] if alone else action

    def wrap(self, env: gym.Env | VectorEnv) -> Any:
        """Return an Env or a VectorEnv of the task as the policy sees it: observations end with
        what its algorithm adds, such as the remaining budget of Sauté. Most algorithms add nothing,
        and the environment is returned as it is."""
        return self._config.wrap(env, self.task)

    def predict(
        self,
        observation: ArrayLike,
        deterministic: bool = True,
        *,
        state: None = None,
        episode_start: Any = None,
    ) -> tuple[NDArray, None]:
        """Return `(action, None)`, as `evaluate_policy` of Stable-Baselines3 expects; deterministic
        by default. A policy has no memory: `state` must be None, and `episode_start` is ignored."""
        if state is not None:
            raise TypeError(f"state must be None: a policy has no memory, got {state!r}")
        return self(observation, deterministic), None

    def to_torch(self) -> nn.Module:
        """Return the deterministic policy as a module from observations to actions, [..., size].

        It equals the policy itself, rescaling and bounds included, up to rounding in float32.
        Raises UserError for a family of algorithms without such a module, and if the module's
        actions differ from the policy's on some test observations.
        """
        if self._module is None:
            raise UserError(f"{self!r} has no module: its Learner has no method `module`")
        module = self.bounded(copy.deepcopy(self._module))
        self.check_same(module, "the module that its Learner's method `module` returns")
        return module

    def bounded(self, net: nn.Module) -> nn.Module:
        """Turn a network of actions in [-1, 1] into a module of actions in the task's bounds."""
        return _Bounded(net, self._bounds.low, self._bounds.high)

    def check_same(self, module: nn.Module, words: str) -> None:
        """Raise UserError if the actions of a module on some observations are not the policy's.

        That happens if a Learner's `policy` does more than its network, such as projecting actions.
        words: what the module is.
        """
        shape = (OBSERVATIONS, self.spaces.observation_size)
        sizes = np.geomspace(*SIZES, OBSERVATIONS)[:, None]
        observations = (sizes * np.random.default_rng(0).standard_normal(shape)).astype(np.float32)
        ours = self(observations)
        with torch.no_grad():
            found = module(to_tensor(observations)).numpy()
        if found.shape != ours.shape:
            raise UserError(f"{words} gives actions {list(found.shape)}, not {list(ours.shape)}")
        far = np.abs(found - ours) > SAME * (self._bounds.high - self._bounds.low)
        unlike = far | (np.isnan(found) != np.isnan(ours))  # NaN equals NaN here
        if unlike.any():
            k = int(unlike.any(axis=-1).argmax())
            raise UserError(
                f"{self!r} acts differently from {words}: on {observations[k].tolist()} it gives "
                f"{ours[k].tolist()}, not {found[k].tolist()}. A module must do all that the "
                "Learner's `policy` does; use `load_policy`, which does it in any case"
            )

    def _batch(self, observation: ArrayLike) -> tuple[NDArray[np.float32], bool]:
        """Return observations as [N, size], and whether a single one was given."""
        size = self.spaces.observation_size
        given = np.asarray(observation)
        if given.dtype.kind not in "biuf":
            raise TypeError(f"observation must hold real numbers, got an array of {given.dtype}")
        if given.ndim not in (1, 2) or given.shape[-1] != size:
            raise ValueError(
                f"observation must be [{size}], or [N, {size}] for a batch, "
                f"got shape {list(given.shape)}"
            )
        return given.astype(np.float32).reshape(-1, size), given.ndim == 1


class _Bounded(nn.Module):
    """A network of actions in [-1, 1], clipped to this range and rescaled to a task's bounds."""

    low: Tensor
    high: Tensor

    def __init__(self, net: nn.Module, low: NDArray, high: NDArray) -> None:
        super().__init__()
        self.net = net
        self.register_buffer("low", to_tensor(low.astype(np.float32)))
        self.register_buffer("high", to_tensor(high.astype(np.float32)))

    def forward(self, observation: Tensor) -> Tensor:
        share = (self.net(observation).clamp(-1.0, 1.0) + 1.0) / 2.0
        action = self.low + (self.high - self.low) * share
        return action.clamp(self.low, self.high)  # rounding may lead beyond


@no_exit()
def load_policy(
    folder: str | os.PathLike[str],
    seed: int | None = None,
    step: int | None = None,
    task: str | None = None,
) -> Policy:
    """Load a trained policy from a folder of runs, or one that comes with the package.

    folder: that of the runs, or "pretrained:ALGORITHM/TASK", such as
        "pretrained:sac-lb-streak/Circle2D-2-v0".
    seed, task: those of the run; each may be left out if there is only one.
    step: a multiple of the training's `evaluate_every`, for the policy kept then; by default the
        policy of the newest checkpoint.

    Needs neither the task's environment nor the replay buffer. Raises UserError if the folder, the
    run or the policy does not exist.
    """
    folder, step = folder_of(folder), as_integer(step)
    check("step", step, int | None)
    config = TrainConfig.read(folder)
    run = chosen_run(folder, config, seed, task)
    spaces = read_spaces(folder)
    arrays, step, failure = read_policy_arrays(folder, config, run, step)
    stream_seed = config.stream_seeds[config.runs.index(run)]
    learner = make_learner(config.algorithm, config.hyperparameters, [stream_seed], *spaces.sizes)
    try:
        fresh = learner.state_dict()
        for name, array in arrays.items():
            like = fresh[name]
            if not name.startswith("replay."):  # their length depends on the training
                tree.expect(name, arrays, like.shape, like.dtype)
            fresh[name] = array
        learner.load_state_dict(fresh)
    except (KeyError, ValueError) as error:
        damaged = f"{folder}: the policy is damaged or of another version: {error}"
        raise UserError(damaged) from error
    return Policy(config, run, step, failure, spaces, learner)


def bare(task: str) -> str:
    """Return the id of a task without the module or the package's name before it."""
    return re.split("[:/]", task)[-1]


def chosen_run(
    folder: object, config: TrainConfig, seed: int | None = None, task: str | None = None
) -> RunId:
    """Return the run of a seed and a task, or the only run. Raises UserError if there is none.

    task: also without module, package name or version.
    """
    known = {task: bare(task) for task in config.tasks}
    meant = task and bare(task)
    tasks = [k for k, name in known.items() if meant in (None, name, name.rpartition("-v")[0])]
    tasks = [task] if task in config.tasks else tasks
    if not tasks:
        raise UserError(f"{folder} has no run on task {task!r}: its tasks are {config.tasks}")
    if len(tasks) > 1:
        raise UserError(f"{folder} has several tasks: give the task, one of {config.tasks}")
    if seed is None and len(config.seeds) > 1:
        raise UserError(f"{folder} has several runs: give the seed, one of {config.seeds}")
    seeds = list(config.seeds)
    seed = seeds[0] if seed is None else seed
    if seed not in seeds:
        raise UserError(f"{folder} has no run of seed {seed!r}: there are {config.seeds}")
    return RunId(tasks[0], seed)


def read_policy_arrays(
    folder: Path, config: TrainConfig, run: RunId, step: int | None = None
) -> tuple[dict[str, NDArray], int | None, str]:
    """Read a run's policy: its arrays, each [1, ...]; the environment steps that the run had taken,
    None if not recorded; and why the run failed, "" if it did not.

    step: that of a policy kept during training; None for the newest checkpoint, of which nothing
    else is read. Raises UserError if there is no such policy.
    """
    if step is not None:
        path = policy_path(folder, run, step)
        if not path.exists():
            steps = ", ".join(map(str, numbered(folder / POLICIES, run.prefix))) or "none"
            raise UserError(
                f"{folder} has no policy of {run} at step {step}: there are {steps}; training "
                "keeps one every evaluate_every steps"
            )
        kept = Arrays(path)
        return {name: kept[name] for name in kept if not name.startswith("evaluation/")}, step, ""
    checkpoints = list(numbered(folder, CHECKPOINTS).values())
    if not checkpoints:
        raise UserError(f"{folder} has no checkpoint yet")
    state, k = Arrays(checkpoints[-1]), config.runs.index(run)
    names = [name for name in state if is_of_policy(name)]
    # A family that does not follow the convention of `Learner`: all of its state.
    names = names or [name for name in state if name not in COUNTERS]
    arrays = {name: state[name][k : k + 1] for name in names}
    steps = int(state["steps"][k]) if "steps" in state else None
    return arrays, steps, str(state["failures"][k]) if "failures" in state else ""


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Results of the episodes of an evaluation.

    The arrays are [episodes]; for a folder they are [runs, episodes], with runs in the order of its
    tasks and seeds.
    """

    task: str
    """The task, or several, with spaces between them."""
    seeds: tuple[int, ...]
    """Seed of each run of a folder, or of a policy's run; empty for a function."""
    returns: NDArray[np.float64]
    """Undiscounted sum of the rewards of each episode."""
    costs: NDArray[np.float64]
    """Undiscounted sum of the costs of each episode."""
    lengths: NDArray[np.int64]
    """Environment steps of each episode."""
    longest_streaks: NDArray[np.int64]
    """Longest streak of consecutive steps with a cost in each episode, in steps."""

    def __repr__(self) -> str:
        runs = f"runs={len(self.returns)}, " if self.returns.ndim > 1 else ""
        return (
            f"Evaluation(task={self.task!r}, {runs}episodes={self.returns.shape[-1]}, "
            f"mean_return={self.mean_return:.2f}, mean_cost={self.mean_cost:.2f}, "
            f"mcc={self.mcc:.2f})"
        )

    @property
    def mean_return(self) -> float:
        """Mean of `returns`."""
        return float(self.returns.mean())

    @property
    def mean_cost(self) -> float:
        """Mean of `costs`."""
        return float(self.costs.mean())

    @property
    def mean_length(self) -> float:
        """Mean of `lengths`."""
        return float(self.lengths.mean())

    @property
    def mcc(self) -> float:
        """Maximum consecutive cost steps: the greatest share of an episode in one streak."""
        return float((self.longest_streaks / self.lengths).max())

    def cvar(self, alpha: float = 0.5) -> float:
        """Conditional value at risk of `costs`: see `emcc.cvar`."""
        return cvar(self.costs.ravel(), alpha)


@no_exit()
def evaluate(
    policy: Policy | Callable[[NDArray], Any] | str | os.PathLike[str],
    task: str | None = None,
    episodes: int = 100,
    deterministic: bool = True,
    seed: int = 0,
    task_parameters: dict[str, Any] | None = None,
    cost: str | None = None,
) -> Evaluation:
    """Play whole episodes with a policy, or with the policies of a folder of runs. Writes nothing.

    policy: what `load_policy` returned, a folder, runs, or a function from an observation to an
    action of the task.
    task: a gymnasium id with `info["cost"]`, required for a function; by default the policy's own
    task, with its `task_parameters`.
    deterministic: whether policies and folders act without noise; otherwise actions are drawn.
    seed: that of start states and draws, the same for all runs of a folder.
    cost: its name in the infos; by default the first cost of the policy's training, "cost" for a
    function.

    Runs of a folder that failed are left out with a warning. Raises UserError if the task does not
    fit the policy, or every run failed; TaskFailure if rewards or costs are not finite, or costs
    negative.
    """
    episodes = as_integer(episodes)
    check("episodes", episodes, Annotated[int, In(1)])
    check("seed", seed, Annotated[int, In(0)])
    if isinstance(policy, (str, os.PathLike)):
        folder = folder_of(policy)
        config = TrainConfig.read(folder)
        loaded = [load_policy(folder, run.seed, task=run.task) for run in config.runs]
        failed = [f"{p.task}, seed {p.seed} {p.failure}" for p in loaded if p.failure]
        if len(failed) == len(loaded):
            raise UserError(f"every run of {folder} failed: {'; '.join(failed)}")
        if failed:
            warnings.warn(f"left out of {folder}: {'; '.join(failed)}", stacklevel=2)
        policies = [p for p in loaded if not p.failure]
        given = (task, episodes, deterministic, seed, task_parameters, cost)
        results = [evaluate(of_run, *given) for of_run in policies]
        names = ("returns", "costs", "lengths", "longest_streaks")
        columns = [np.array([getattr(result, name) for result in results]) for name in names]
        played = " ".join(dict.fromkeys(result.task for result in results))
        return Evaluation(played, tuple(p.seed for p in policies), *columns)
    if not callable(policy):
        raise TypeError(f"policy must be a policy, a function or a folder, got {policy!r}")
    own = policy if isinstance(policy, Policy) else None
    if task is None and own is None:
        raise UserError("evaluate needs the task if the policy is a function")
    name = task_id(task) if task is not None else own.task if own else ""
    if own and task_parameters is None and bare(name) == bare(own.task):
        task_parameters = own.task_parameters
    try:
        made = gym.make(registered(name), disable_env_checker=True, **(task_parameters or {}))
    except OWN_ERRORS as error:  # of the task's own code
        raise OwnCodeError(f"cannot make task {name!r}: {described(error)}") from error
    trained = own._config if own else None
    cost = (trained.costs[0] if trained else "cost") if cost is None else cost
    added = trained and set(trained.costs) - set(trained.task_costs)  # by `own.wrap`
    needed = () if added and cost in added else (cost,)
    with contextlib.closing(CheckedEnv(made, needed)) as env:
        act: Callable[[NDArray], Any] = policy
        seen: gym.Env = own.wrap(env) if own else env
        if own:
            spaces = checked_spaces(name, seen.observation_space, seen.action_space)
            if spaces != own.spaces:
                raise UserError(
                    f"the policy of {own.task} has {own.spaces}, task {name!r} has {spaces}"
                )
            rng = np.random.default_rng([seed, 1])
            act = functools.partial(own, deterministic=deterministic, rng=rng)
        starts = np.random.default_rng(seed).integers(2**31, size=episodes).tolist()
        try:
            played = [_episode(seen, act, start, cost) for start in starts]
        except TaskFailure as error:
            raise TaskFailure(f"task {name!r} {error}") from error.__cause__
    return Evaluation(name, (own.seed,) if own else (), *map(np.array, zip(*played, strict=True)))


def _episode(
    env: gym.Env, act: Callable[[NDArray], Any], seed: int, cost: str
) -> tuple[float, float, int, int]:
    """Play an episode: its return, cost, length and longest streak."""
    observation, _ = env.reset(seed=seed)
    rewards, costs, over = [], [], False
    most = most_steps(env.spec.max_episode_steps if env.spec else None)
    while not over:
        if len(costs) == most:
            raise TaskFailure(f"has an episode that has not ended after {most} steps: {ENDS}")
        action = act(observation)
        _check_action(action, env.action_space)
        observation, reward, terminated, truncated, info = env.step(action)
        if not np.isfinite([float(reward), info[cost]]).all() or info[cost] < 0:
            given = f"reward {reward:g} and {cost} {info[cost]:g} in step {len(costs) + 1}"
            raise TaskFailure(f"gives {given} of an episode; they must be finite, costs >= 0")
        rewards.append(float(reward))
        costs.append(info[cost])
        over = terminated or truncated
    return sum(rewards), sum(costs), len(costs), longest_streak(np.array(costs))


def _check_action(action: Any, space: gym.Space) -> None:
    """Raise UserError for an action not finite or of a wrong shape; the task checks its bounds."""
    given = np.asarray(action)
    if given.dtype.kind not in "biuf" or not np.isfinite(given).all():
        raise UserError(f"the policy gives an action that is not finite: {action!r}")
    if isinstance(space, Box) and given.shape != space.shape:
        raise UserError(
            f"the policy gives an action of shape {list(given.shape)}, the task takes one of "
            f"{list(space.shape or ())}"
        )
