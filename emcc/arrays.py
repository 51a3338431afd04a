"""Anything array-like in, a checked numpy array out; the complaints about bad input live here.

Each raises TypeError for something that is no number or no numbers, ValueError for other numbers
than are allowed.
"""

import math
import operator
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.npz import UNREADABLE, is_damage, words_of


@contextmanager
def named(source: Any) -> Iterator[None]:
    """Puts the file, or the run, in front of what is wrong with its content."""
    try:
        yield
    except KeyError as error:
        raise ValueError(f"{source}: missing: {error.args[0]}") from error
    except UNREADABLE as error:
        raise ValueError(f"{source}: {words_of(error)}") from error
    except OSError as error:
        if not is_damage(error):
            raise
        raise ValueError(f"{source}: {error}") from error


def as_array(values: ArrayLike, name: str) -> NDArray[Any]:
    """A bool, integer or float array from lists, numpy, pandas, or torch tensors on any device."""
    detach = getattr(values, "detach", None)
    if callable(detach):  # a torch tensor, met without importing torch
        values = detach().cpu()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(values, np.ma.MaskedArray):
        raise TypeError(f"{name} must not be a masked array: its mask would be lost")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # a ragged list, say
        raise TypeError(f"{name} must be an array of numbers: {error}") from error
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be bool, integer or float numbers, got {array.dtype}")
    return array


def as_vector(
    values: ArrayLike, name: str, low: float = -math.inf, high: float = math.inf
) -> NDArray[Any]:
    """A 1-D array with at least one value, all of them finite and in [low, high]."""
    array = as_array(values, name)
    if array.ndim != 1:
        raise ValueError(f"{name} must be 1-D, got shape {array.shape}")
    if array.size == 0:
        raise ValueError(f"{name} must have at least one value, got none")
    check_range(array, name, low, high)
    return array


def as_steps(
    values: Any, lengths: ArrayLike | None, name: str, low: float = -math.inf
) -> tuple[NDArray[Any], ArrayLike]:
    """Numbers of all steps, one trajectory after another, and the trajectories' lengths [E].

    values: just these; or an array [T] of each trajectory, where lengths may be None.
    """
    listed = isinstance(values, (list, tuple)) and len(values)  # numpy has no ndim of ragged lists
    if (1 + np.ndim(values[0]) if listed else np.ndim(values)) < 2 or not len(values):
        if lengths is None:
            rule = "must hold an array of each trajectory, or come with lengths"
            raise ValueError(f"{name} {rule}, got {reprlib.repr(values)}")
        return as_array(values, name), lengths
    pieces = [as_vector(row, f"{name} of trajectory {k}", low) for k, row in enumerate(values)]
    sizes = np.array([piece.size for piece in pieces])
    if lengths is not None and not np.array_equal(as_array(lengths, "lengths"), sizes):
        raise ValueError(f"lengths must be those of the trajectories of {name}, or left out")
    return np.concatenate(pieces), sizes


def as_runs(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """[runs, tasks]; values of one task, [runs], are a column."""
    array = as_array(values, name)
    if array.ndim not in (1, 2) or not array.size:
        needed = "[runs] or [runs, tasks] and not empty"
        raise ValueError(f"{name} must be {needed}, got shape {array.shape}")
    check_range(array, name)
    return array.reshape(len(array), -1).astype(np.float64)


def as_two_sets(first: ArrayLike, second: ArrayLike, fewest: int = 1) -> tuple[NDArray, NDArray]:
    """Two sets of at least `fewest` runs, [runs, tasks] each, with the same tasks."""
    a, b = as_runs(first, "first"), as_runs(second, "second")
    if min(len(a), len(b)) < fewest:
        raise ValueError(f"first and second need {fewest} runs each, got {len(a)} and {len(b)}")
    if a.shape[1] != b.shape[1]:
        tasks = f"{a.shape[1]} and {b.shape[1]}"
        raise ValueError(f"first and second must have the same tasks, got {tasks} of them")
    return a, b


def as_integers(values: ArrayLike, name: str, low: float = 0) -> NDArray[np.int64]:
    """An int64 array of any shape, none below `low`; floats where they are whole numbers."""
    array = as_array(values, name)
    check_range(array, name, low)
    with np.errstate(invalid="ignore"):  # what does not fit changes, which is looked for below
        whole = array.astype(np.int64)
    if (array != whole).any():
        index = int(np.argmax(array != whole))
        raise ValueError(f"{name} must be whole numbers (int64), got {array.flat[index]}")
    return whole


def check_range(
    array: NDArray[Any], name: str, low: float = -math.inf, high: float = math.inf
) -> None:
    """ValueError naming the first value that is NaN, infinite or outside [low, high]."""
    if array.size == 0 or array.dtype == bool:
        return
    smallest, largest = float(array.min()), float(array.max())  # NaN, if there is one, is both
    if low <= smallest and largest <= high and np.isfinite((smallest, largest)).all():
        return
    bad = ~(np.isfinite(array) & (array >= low) & (array <= high))
    index = int(np.argmax(bad))
    limits = f" and >= {low}" if low > -math.inf else ""
    if high < math.inf:
        limits = f" and in [{low}, {high}]"
    raise ValueError(f"{name} must be finite{limits}, got {array.flat[index]} at index {index}")


def as_number(value: float, name: str, low: float = -math.inf) -> float:
    """A finite real number, at least `low`."""
    try:
        number = float(operator.pos(value))  # pos: float() alone would take the text "0.5"
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must be a number, got {value!r}") from error
    except OverflowError as error:
        raise ValueError(f"{name} must be finite, got an integer beyond all floats") from error
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}")
    if number < low:
        raise ValueError(f"{name} must be >= {low:g}, got {number}")
    return number


def as_one(value: Any, name: str) -> float:
    """The number that a value holds: a real number, or an array of one element of any shape.

    NaN and infinite ones too. TypeError: no number, or several.
    """
    if isinstance(value, Real):
        try:
            return float(value)
        except OverflowError as error:
            raise ValueError(f"{name} must be finite, got a number beyond all floats") from error
    array = as_array(value, name)
    if array.size != 1:
        raise TypeError(f"{name} must be one number, got shape {array.shape}")
    return float(array.reshape(()))


def as_flag(value: Any, name: str) -> bool:
    """True or False, from a bool, 0 or 1, or an array of one. TypeError, ValueError: another."""
    number = as_one(value, name)
    if number not in (0.0, 1.0):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return number == 1.0


def as_count(value: int, name: str) -> int:
    """A whole number >= 1."""
    try:
        count = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name} must be an integer, got {value!r}") from error
    if count < 1:
        raise ValueError(f"{name} must be >= 1, got {count}")
    return count


def exceed(costs: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    """Mask of the costs that exceed the threshold, compared as float64.

    numpy alone would round the threshold to the type of costs of lower precision.
    """
    return np.greater(costs, threshold, signature="dd->?")


def as_names(value: Any, name: str) -> tuple[str, ...]:
    """Different names, one at least. ValueError: anything else."""
    if isinstance(value, str) or not value or len(set(value)) < len(value):
        raise ValueError(f'{name} must be different names, as in ("cost",), got {value!r}')
    return tuple(value)
