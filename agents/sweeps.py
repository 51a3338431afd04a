"""Combinations of hyper-parameters, and the training of several folders by an engine."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from agents.algorithms import BUILT_IN, module_of
from agents.errors import UserError
from agents.paper import grid
from agents.training.config import TrainConfig
from agents.training.engines import EngineName, engine
from agents.training.environments import module_of_task

Values = Collection[Any]
"""Values of a hyper-parameter."""


def sweep_configs(values: Mapping[str, Values]) -> dict[str, dict[str, Any]]:
    """Every combination, by a name for its folder, such as "cost_limit=5.0,hidden=64x64".

    Raises UserError for an empty grid, values that are none, and equal names.
    """
    if not isinstance(values, Mapping):
        raise UserError(f"grid must be values by the names of hyper-parameters, got {values!r}")
    for name, of_name in values.items():
        if isinstance(of_name, str) or not isinstance(of_name, Collection) or not of_name:
            raise UserError(f"grid needs several values of {name}, got {of_name!r}")
    if not values:
        raise UserError("grid is empty: it needs values of a hyper-parameter at least")
    found: dict[str, dict[str, Any]] = {}
    for chosen in itertools.product(*values.values()):
        combination = dict(zip(values, chosen, strict=True))
        name = ",".join(f"{key}={_word(value)}" for key, value in combination.items())
        if name in found:
            raise UserError(f"grid has {name} twice")
        found[name] = combination
    return found


def _word(value: Any) -> str:
    parts = value if isinstance(value, (tuple, list)) else [value]
    return re.sub(r"[^\w.+-]+", "_", "x".join(map(str, parts)))


def train_groups(
    configs: Mapping[Path, TrainConfig],
    name: EngineName,
    count: int | None = None,
    address: str | None = None,
) -> None:
    """Train folders to their end, those of equal settings together; what is done stays.

    count, address: see `engine`. Raises UserError where one holds other runs, and where the
    training of a folder fails; the others are done by then.
    """
    configs = dict(configs)
    first = next(iter(configs.values()))
    imports = modules_of(configs.values())
    with engine(name, count, address, first.device) as ready:
        grid.prepare(configs)
        left = {f: c for f, c in configs.items() if not grid.finished(f, c)}
        groups = grid.groups(left, ready.count)

        def finished(folder: Path) -> bool:
            return grid.finished(folder, configs[folder])

        with ready.workers(groups, finished, imports) as workers:
            workers.run(lambda: None, 0.5)
        failed = {f: why for f, why in workers.failed.items() if not finished(f)}
    if failed:
        raise UserError("; ".join(f"{folder} failed: {why}" for folder, why in failed.items()))


def modules_of(configs: Collection[TrainConfig]) -> list[str]:
    """Modules that other processes import in order to know algorithms and tasks. Raises UserError
    for one that the running script registers, which they cannot import."""
    found = {}
    for config in configs:
        if config.algorithm not in BUILT_IN:
            found[module_of(config.algorithm)] = config.algorithm, "agents.register"
        if module := module_of_task(config.task):
            found[module] = config.task, "gymnasium.register"
    if "__main__" in found:
        name, register = found["__main__"]
        raise UserError(
            f"{name} is registered in the running script, which the processes that train cannot "
            f"import: call {register} in a module of its own and import that"
        )
    return sorted(found)
