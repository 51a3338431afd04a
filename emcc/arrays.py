"""Checks of arguments: convert array-like input to NumPy arrays, or raise an error naming it.

Each function raises TypeError for input that is not numeric, and ValueError for numbers that are
not allowed.
"""

import math
import operator
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emcc.npz import UNREADABLE, is_damage, words_of


@contextmanager
def named(source: Any) -> Iterator[None]:
    """Prefix errors about the content of a file or run with its name, as ValueError."""
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
    """Convert lists, numpy, pandas, or torch tensors to a bool, integer or float array."""
    detach = getattr(values, "detach", None)
    if callable(detach):  # a torch tensor on any device; torch is not imported
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
    """Convert to a non-empty 1-D array whose values are finite and in [low, high]."""
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
    """Return the values of all steps, one trajectory after another, and the lengths [E].

    values: such an array of all steps, or an array [T] for each trajectory; with the latter,
    lengths may be None.
    """
    if isinstance(values, (list, tuple)):  # may be ragged, on which np.ndim fails
        joined = not values or np.ndim(values[0]) == 0
    else:
        values = as_array(values, name)
        joined = values.ndim < 2 or not len(values)
    if joined:
        if lengths is None:
            rule = "must hold one array for each trajectory, or come with lengths"
            raise ValueError(f"{name} {rule}, got {reprlib.repr(values)}")
        return as_array(values, name), lengths
    pieces = [as_vector(row, f"{name} of trajectory {k}", low) for k, row in enumerate(values)]
    sizes = np.array([piece.size for piece in pieces])
    if lengths is not None and not np.array_equal(as_array(lengths, "lengths"), sizes):
        raise ValueError(f"lengths must equal the lengths of the arrays in {name}, or be left out")
    return np.concatenate(pieces), sizes


def as_runs(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Convert to a float64 array [runs, tasks]; the values of one task, [runs], become a column."""
    array = as_array(values, name)
    if array.ndim not in (1, 2) or not array.size:
        needed = "[runs] or [runs, tasks] and not empty"
        raise ValueError(f"{name} must be {needed}, got shape {array.shape}")
    check_range(array, name)
    return array.reshape(len(array), -1).astype(np.float64)


def as_two_sets(first: ArrayLike, second: ArrayLike, fewest: int = 1) -> tuple[NDArray, NDArray]:
    """Convert two sets of at least `fewest` runs to [runs, tasks] each, with the same tasks."""
    a, b = as_runs(first, "first"), as_runs(second, "second")
    if min(len(a), len(b)) < fewest:
        raise ValueError(f"first and second need {fewest} runs each, got {len(a)} and {len(b)}")
    if a.shape[1] != b.shape[1]:
        tasks = f"{a.shape[1]} and {b.shape[1]}"
        raise ValueError(f"first and second must have the same tasks, got {tasks} tasks")
    return a, b


def as_integers(values: ArrayLike, name: str, low: float = 0) -> NDArray[np.int64]:
    """Convert to int64, in any shape, no value below `low`; floats must be whole numbers."""
    array = as_array(values, name)
    check_range(array, name, low)
    with np.errstate(invalid="ignore"):  # values that do not fit change; the next line finds them
        whole = array.astype(np.int64)
    if (array != whole).any():
        index = int(np.argmax(array != whole))
        raise ValueError(f"{name} must be whole numbers (int64), got {array.flat[index]}")
    return whole


def check_range(
    array: NDArray[Any], name: str, low: float = -math.inf, high: float = math.inf
) -> None:
    """Raise ValueError naming the first value that is NaN, infinite or outside [low, high]."""
    if array.size == 0 or array.dtype == bool:
        return
    smallest, largest = float(array.min()), float(array.max())  # both are NaN if any value is
    if low <= smallest and largest <= high and np.isfinite((smallest, largest)).all():
        return
    bad = ~(np.isfinite(array) & (array >= low) & (array <= high))
    index = int(np.argmax(bad))
    limits = f" and >= {low}" if low > -math.inf else ""
    if high < math.inf:
        limits = f" and in [{low}, {high}]"
    raise ValueError(f"{name} must be finite{limits}, got {array.flat[index]} at index {index}")


def as_number(value: float, name: str, low: float = -math.inf) -> float:
    """Convert to a finite float that is at least `low`."""
    try:
        number = float(operator.pos(value))  # pos: float() alone would accept the text "0.5"
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} must be a number, got {value!r}") from error
    except OverflowError as error:
        raise ValueError(f"{name} must be finite, got an integer too large for a float") from error
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}")
    if number < low:
        raise ValueError(f"{name} must be >= {low:g}, got {number}")
    return number


def as_one(value: Any, name: str) -> float:
    """Convert a real number, or an array of any shape with one element, to float.

    NaN and infinity are accepted. TypeError: not a number, or several numbers.
    """
    if isinstance(value, Real):
        try:
            return float(value)
        except OverflowError as error:
            raise ValueError(f"{name} must be finite, got one too large for a float") from error
    array = as_array(value, name)
    if array.size != 1:
        raise TypeError(f"{name} must be one number, got shape {array.shape}")
    return float(array.reshape(()))


def as_flag(value: Any, name: str) -> bool:
    """Convert a bool, 0, 1 or a one-element array to bool; TypeError or ValueError otherwise."""
    number = as_one(value, name)
    if number not in (0.0, 1.0):
        raise ValueError(f"{name} must be True or False, got {value!r}")
    return number == 1.0


def as_count(value: int, name: str) -> int:
    """Convert to an int that is at least 1."""
    try:
        count = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name} must be an integer, got {value!r}") from error
    if count < 1:
        raise ValueError(f"{name} must be >= 1, got {count}")
    return count


def exceed(costs: NDArray[Any], threshold: float) -> NDArray[np.bool_]:
    """Return the mask of the costs that exceed the threshold, compared as float64.

    By default NumPy would round the threshold to the dtype of costs of lower precision.
    """
    return np.greater(costs, threshold, signature="dd->?")


def as_names(value: Any, name: str) -> tuple[str, ...]:
    """Convert to a tuple of different names, at least one. ValueError: anything else."""
    names = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else ()
    if not names or not all(isinstance(n, str) for n in names) or len({*names}) < len(names):
        raise ValueError(f'{name} must be different names, as in ("cost",), got {value!r}')
    return names
