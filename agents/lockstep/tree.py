"""Nested named tuples of tensors with a run axis: choosing by run, saving, loading.

None stands for a part that an algorithm does not have.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray
from torch import Tensor

from agents.lockstep.backend import array, tensor
from agents.lockstep.compiling import compiled

Tree = TypeVar("Tree")
ALL = slice(None)
"""All runs, where some can be chosen."""


def where(mask: NDArray[np.bool_], new: Tree, old: Tree) -> Tree:
    """The new state of the runs in mask [R], the old state of the others."""
    return new if mask.all() else select(tensor(mask), new, old)


def select(mask: Tensor, new: Any, old: Any) -> Any:
    """`where` for a mask that is a tensor; does not branch on its values."""
    if new is None:
        return new
    if isinstance(new, Tensor):
        return torch.where(mask.view(-1, *[1] * (new.dim() - 1)), new, old)
    return type(new)(*(select(mask, a, b) for a, b in zip(new, old, strict=True)))


def finite(tree: Any) -> NDArray[np.bool_]:
    """Mask of the runs that hold only finite numbers, [R]."""
    return array(_finite(list(_leaves(tree))))


@compiled
def _finite(leaves: list[Tensor]) -> Tensor:
    return torch.stack([leaf.flatten(1).isfinite().all(dim=1) for leaf in leaves]).all(dim=0)


def _leaves(tree: Any) -> Iterator[Tensor]:
    if isinstance(tree, Tensor):
        yield tree
    elif tree is not None:
        for part in tree:
            yield from _leaves(part)


def expect(
    name: str, arrays: dict[str, NDArray], shape: tuple[int, ...], dtype: DTypeLike
) -> NDArray:
    """The array of that name. KeyError where it is missing, ValueError where it is another kind."""
    found = arrays[name]
    if found.shape != shape or found.dtype != dtype:
        given = f"{list(found.shape)} {found.dtype}"
        raise ValueError(f"{name} is {given}, expected {list(shape)} {np.dtype(dtype)}")
    return found


def flatten(tree: Any, runs: slice = ALL, prefix: str = "") -> dict[str, NDArray]:
    """Every tensor of some runs under its dotted name."""
    if tree is None:
        return {}
    if isinstance(tree, Tensor):
        return {prefix: array(tree[runs])}
    named = zip(tree._fields, tree, strict=True)
    dot = f"{prefix}." if prefix else ""
    return {k: v for name, part in named for k, v in flatten(part, runs, f"{dot}{name}").items()}


def unflatten(like: Any, arrays: dict[str, NDArray], runs: slice = ALL, prefix: str = "") -> Any:
    """The tree `like`, but for some runs with the arrays that `flatten` named. KeyError for a
    missing one, ValueError for one of another shape or type."""
    if like is None:
        return None
    if isinstance(like, Tensor):
        whole = array(like).copy()
        whole[runs] = expect(prefix, arrays, whole[runs].shape, whole.dtype)
        return tensor(whole)
    dot = f"{prefix}." if prefix else ""
    return type(like)(
        *(
            unflatten(part, arrays, runs, f"{dot}{name}")
            for name, part in zip(like._fields, like, strict=True)
        )
    )
