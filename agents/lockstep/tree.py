"""Nested tuples of tensors with a run axis: choosing by run, saving, loading.

None stands for a part that an algorithm does not have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray
from torch import Tensor

from agents.lockstep.backend import array, tensor

Tree = TypeVar("Tree")


def where(mask: NDArray[np.bool_], new: Tree, old: Tree) -> Tree:
    """The new state of the runs in mask [R], the old state of the others."""
    return new if mask.all() else select(tensor(mask), new, old)


def select(mask: Tensor, new: Any, old: Any) -> Any:
    """`where` for a mask that is a tensor; does not branch on its values."""
    if new is None:
        return new
    if isinstance(new, Tensor):
        return torch.where(mask.view(-1, *[1] * (new.dim() - 1)), new, old)
    return _like(new, (select(mask, a, b) for a, b in zip(new, old, strict=True)))


def copy(tree: Any) -> Any:
    """The tree with tensors of its own."""
    if tree is None:
        return tree
    if isinstance(tree, Tensor):
        return tree.clone(memory_format=torch.contiguous_format)
    return _like(tree, map(copy, tree))


def finite(tree: Any) -> NDArray[np.bool_]:
    """Mask of the runs that hold only finite numbers, [R]."""
    return array(_finite(list(_leaves(tree))))


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


def flatten(tree: Any, prefix: str = "") -> dict[str, NDArray]:
    """Every tensor under its dotted name."""
    if tree is None:
        return {}
    if isinstance(tree, Tensor):
        return {prefix: array(tree)}
    return {k: v for name, part in _named(tree, prefix) for k, v in flatten(part, name).items()}


def unflatten(like: Any, arrays: dict[str, NDArray], prefix: str = "") -> Any:
    """The tree `like` with the arrays that `flatten` named. KeyError for a missing one, ValueError
    for one of another shape or type."""
    if like is None:
        return None
    if isinstance(like, Tensor):
        whole = array(like)
        return tensor(expect(prefix, arrays, whole.shape, whole.dtype).copy())
    return _like(like, (unflatten(part, arrays, name) for name, part in _named(like, prefix)))


def _named(tree: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """Parts of a tuple by their dotted names: those of its fields, or their places."""
    names = getattr(tree, "_fields", map(str, range(len(tree))))
    dot = f"{prefix}." if prefix else ""
    return ((f"{dot}{name}", part) for name, part in zip(names, tree, strict=True))


def _like(tree: Any, parts: Iterable[Any]) -> Any:
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
