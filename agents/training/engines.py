"""Engines that train groups of folders: processes of this machine, or tasks of a Ray cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.errors import UserError
from agents.training.workers import Group, Workers, cores

EngineName = Literal["local", "ray"]


@dataclass(frozen=True)
class Engine:
    """An engine that is ready to train."""

    count: int
    """Groups that train at a time."""
    workers: Callable[[Sequence[Group], Callable[[Path], bool], Sequence[str]], Workers]
    """Workers for groups; which folders are finished; modules to import first."""


@contextlib.contextmanager
def engine(
    name: EngineName, count: int | None = None, address: str | None = None, device: str = "cpu"
) -> Iterator[Engine]:
    """Make an engine ready; it is put away at the end of the `with` block.

    count: groups at a time, by default as many as there are cores. address: of the Ray cluster's
    head, such as 10.0.0.1:6379, or auto for one of this machine; None starts one here, unless
    RAY_ADDRESS names one. device: cuda, where each group needs a GPU. Raises UserError for an
    unknown engine, a missing library, and a cluster that does not answer.
    """
    if name == "ray":
        from agents.training.ray_engine import RayWorkers, connected

        with connected(address) as found:
            most = found if count is None else count
            gpus = int(device == "cuda")
            yield Engine(most, lambda groups, *more: RayWorkers(groups, most, *more, gpus=gpus))
        return
    if name != "local":
        raise UserError(f"engine must be local or ray, got {name!r}")
    if address is not None:
        raise UserError("address is of a Ray cluster: it needs the engine ray")
    at_once = cores() if count is None else count
    yield Engine(at_once, lambda groups, *more: Workers(groups, at_once, *more))
