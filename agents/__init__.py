"""Safe reinforcement learning: train, evaluate and report runs of several algorithms in lockstep.

The whole entrance from Python:

| name | |
| --- | --- |
| `train(algorithm, task, seeds=..., steps=..., out=...)` | train runs and evaluate them -> `Runs` |
| `resume(*folders)` | go on with interrupted runs -> `Runs` |
| `load_runs(*folders)` | open the runs at or below folders -> `Runs` |
| `load_policy(folder, seed, step=None)` | a trained policy -> `Policy` |
| `pretrained(algorithm, task)` | the folder of a policy that comes with the package |
| `evaluate(policy_or_folder, task)` | play episodes -> `Evaluation` |
| `sweep(algorithm, task, grid={...}, out=...)` | every combination of hyper-parameters -> `Runs` |
| `report(*folders)` | tables, figures and a page of all runs below some folders |
| `compare(a, b)` | two sets of runs side by side, with their differences |
| `register(name, Algorithm(...))` | make an algorithm of your own known |

`on_epoch` of `train` receives an `Epoch`; a mistake of the caller raises `UserError`. `import
agents` imports none of this: names are looked up when they are first used, and torch with them.

The subpackages and modules, lowest layer first; each imports only those before it:

- `errors`, `checks`: mistakes of a caller; settings that say at the field what is allowed
- `lockstep`: many runs of one algorithm as one batch: networks, Adam, noise, replay, rollouts
- `on_policy`, `trust_region`, `first_order`, `sac`: the families of algorithms
- `algorithms`: the part that each algorithm's paper adds, a file each, and the registry
- `training`: configuration, trainer, its callbacks and files, policies, the launcher
- `results`: measures of the runs on disk, as one tidy frame
- `reporting`: tables, figures, page
- `paper`: a plug-in: presets, grid, claims, and its part of a report
- `export`: policies as files for other programs
- `runs`: runs on disk as Python objects
- `api`: the functions above
- `cli`: the command `circle2d`
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.api import (
        Algorithm,
        Epoch,
        Evaluation,
        Policy,
        Runs,
        UserError,
        compare,
        evaluate,
        load_policy,
        load_runs,
        pretrained,
        register,
        report,
        resume,
        sweep,
        train,
    )

__all__ = (
    "Algorithm",
    "Epoch",
    "Evaluation",
    "Policy",
    "Runs",
    "UserError",
    "compare",
    "evaluate",
    "load_policy",
    "load_runs",
    "pretrained",
    "register",
    "report",
    "resume",
    "sweep",
    "train",
)
_LIGHT = {
    "Algorithm": "agents.algorithms",
    "register": "agents.algorithms",
    "UserError": "agents.errors",
    "pretrained": "agents.training.pretrained",
}
"""Names that need less than all of `agents.api`."""


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    from agents.errors import extra_hint

    try:
        value = getattr(importlib.import_module(_LIGHT.get(name, "agents.api")), name)
    except ModuleNotFoundError as error:
        if not (hint := extra_hint(error, f"agents.{name}")):
            raise
        raise ImportError(hint) from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
