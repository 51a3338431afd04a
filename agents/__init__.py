"""Safe reinforcement learning: train, evaluate and report runs of several algorithms in lockstep.

The complete Python interface:

| name | |
| --- | --- |
| `train(algorithm, task, seeds=..., steps=..., out=...)` | train runs and evaluate them -> `Runs` |
| `resume(*folders)` | continue interrupted runs -> `Runs` |
| `load_runs(*folders)` | open the runs at or below folders -> `Runs` |
| `load_policy(folder, seed, step=None)` | a trained policy -> `Policy` |
| `pretrained(algorithm, task)` | the folder of a policy that comes with the package |
| `zoo()` | results of the trained agents that come with the package -> a pandas frame |
| `evaluate(policy_or_folder, task)` | play episodes -> `Evaluation` |
| `sweep(algorithm, task, grid={...}, out=...)` | every combination of hyper-parameters -> `Runs` |
| `grid(algorithms, tasks, out=...)` | train algorithms on tasks, on all cores -> `Runs` |
| `report(*folders)` | write tables, figures and a page of all runs below the folders |
| `plot(*folders, out=...)` | draw learning curves for a paper: PDF, SVG, PNG, PGF |
| `compare(a, b)` | compare two sets of runs, with their differences |
| `register(name, Algorithm(...))` | register your own algorithm |
| `use_study(study)` | show your own study in place of the paper's |

`on_epoch` of `train` receives an `Epoch`; a mistake of the caller raises `UserError`. `import
agents` imports none of this: each name is imported, and torch with it, on first use.

The subpackages and modules, lowest layer first; each imports only those before it:

- `errors`, `checks`: mistakes of the user, errors in their code, values that settings allow
- `lockstep`: many runs of one algorithm as one batch: networks, Adam, noise, rollouts
- `on_policy`, `trust_region`, `first_order`, `sac`: the families of algorithms
- `algorithms`: the part that each algorithm's paper adds, one file each, and the registry
- `presets`: the initial hyper-parameters of an algorithm on a task
- `training`: configuration, the trainer and its files, what is derived from them, policies
- `results`: reading trained runs, their measures, and one tidy frame of them
- `reporting`: tables, figures, page
- `paper`: the study of the paper: grid, printed numbers and claims
- `studies`: the study that reports show, by default the paper's
- `export`: policies as files for other programs
- `runs`: runs on disk as Python objects
- `zoo`: results of the package's trained agents
- `api`: the functions that train and report
- `cli`: the command `circle2d`
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.algorithms import Algorithm, register
    from agents.api import compare, grid, plot, report, resume, sweep, train
    from agents.errors import UserError
    from agents.runs import Runs, load_runs
    from agents.studies import use_study
    from agents.training.callbacks import Epoch
    from agents.training.policy import Evaluation, Policy, evaluate, load_policy, pretrained
    from agents.zoo import zoo

__all__ = (
    "Algorithm",
    "Epoch",
    "Evaluation",
    "Policy",
    "Runs",
    "UserError",
    "compare",
    "evaluate",
    "grid",
    "load_policy",
    "load_runs",
    "plot",
    "pretrained",
    "register",
    "report",
    "resume",
    "sweep",
    "train",
    "use_study",
    "zoo",
)
_HOMES = {
    "agents.algorithms": ("Algorithm", "register"),
    "agents.api": ("compare", "grid", "plot", "report", "resume", "sweep", "train"),
    "agents.errors": ("UserError",),
    "agents.zoo": ("zoo",),
    "agents.runs": ("Runs", "load_runs"),
    "agents.studies": ("use_study",),
    "agents.training.callbacks": ("Epoch",),
    "agents.training.policy": ("Evaluation", "Policy", "evaluate", "load_policy", "pretrained"),
}
"""Exported names by the module that defines them, which is imported on first use of a name."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    from agents.errors import extra_hint

    home = next(module for module, names in _HOMES.items() if name in names)
    try:
        value = getattr(importlib.import_module(home), name)
    except ModuleNotFoundError as error:
        if not (hint := extra_hint(error, f"agents.{name}")):
            raise
        raise ImportError(hint) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
