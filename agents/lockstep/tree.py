"""Nested tuples of arrays and tensors with a run axis: selection by run, saving, loading.

None stands for a part that an algorithm does not have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray
from torch import Tensor

from agents.lockstep.backend import array, tensor

Tree = TypeVar("Tree")
LEAF = (np.ndarray, Tensor)


def where(mask: NDArray[np.bool_], new: Tree, old: Tree) -> Tree:
    """Return the new state for the runs in mask [R], the old state for the others."""
    return new if mask.all() else _select(mask, new, old)


def _select(mask: NDArray[np.bool_], new: Any, old: Any) -> Any:
    if new is None:
        return new
    if isinstance(new, LEAF):
        chosen = np.where(mask.reshape(-1, *[1] * (new.ndim - 1)), array(new), array(old))
        return tensor(chosen) if isinstance(new, Tensor) else chosen
    return _like(new, (_select(mask, a, b) for a, b in zip(new, old, strict=True)))


def copy(tree: Any) -> Any:
    """Return a deep copy of the tree."""
    if tree is None:
        return tree
    if isinstance(tree, LEAF):
        copied = array(tree).copy()
        return tensor(copied) if isinstance(tree, Tensor) else copied
    return _like(tree, map(copy, tree))


def tensors(tree: Any) -> Any:
    """Return the tree with contiguous tensors instead of arrays."""
    if isinstance(tree, np.ndarray):
        return tensor(np.ascontiguousarray(tree))
    return tree if isinstance(tree, Tensor) else _like(tree, map(tensors, tree))


def finite(tree: Any) -> NDArray[np.bool_]:
    """Return a mask [R] of the runs whose numbers are all finite."""
    return np.all([np.isfinite(leaf).reshape(len(leaf), -1).all(1) for leaf in _leaves(tree)], 0)


def _leaves(tree: Any) -> Iterator[NDArray]:
    if isinstance(tree, LEAF):
        yield array(tree)
    elif tree is not None:
        for part in tree:
            yield from _leaves(part)


def expect(
    name: str, arrays: dict[str, NDArray], shape: tuple[int, ...], dtype: DTypeLike
) -> NDArray:
    """Return the array of that name. Raises KeyError if missing, ValueError if it does not fit."""
    found = arrays[name]
    if found.shape != shape or found.dtype != dtype:
        given = f"{list(found.shape)} {found.dtype}"
        raise ValueError(f"{name} is {given}, expected {list(shape)} {np.dtype(dtype)}")
    return found


def flatten(tree: Any, prefix: str = "") -> dict[str, NDArray]:
    """Return every array by its dotted name."""
    if tree is None:
        return {}
    if isinstance(tree, LEAF):
        return {prefix: array(tree)}
    return {k: v for name, part in _named(tree, prefix) for k, v in flatten(part, name).items()}


def unflatten(like: Any, arrays: dict[str, NDArray], prefix: str = "") -> Any:
    """Return the tree `like` with the arrays that `flatten` named. Raises KeyError for a missing
    array, ValueError for one of another shape or type."""
    if like is None:
        return None
    if isinstance(like, LEAF):
        whole = array(like)
        found = expect(prefix, arrays, whole.shape, whole.dtype).copy()
        return tensor(found) if isinstance(like, Tensor) else found
    return _like(like, (unflatten(part, arrays, name) for name, part in _named(like, prefix)))


def _named(tree: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """Return the parts of a tuple by dotted names: of their fields, or else their indices."""
    names = getattr(tree, "_fields", map(str, range(len(tree))))
    dot = f"{prefix}." if prefix else ""
    return ((f"{dot}{name}", part) for name, part in zip(names, tree, strict=True))


def _like(tree: Any, parts: Iterable[Any]) -> Any:
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
