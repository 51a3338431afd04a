"""Settings of a training's process, and conversions between arrays and tensors."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.errors import UserError
from agents.lockstep import kernel
from agents.lockstep.kernel import Backend


def configure(backend: Backend) -> None:
    """Prepare this process for training: use that kernel, and one thread, since lockstep runs fill
    a core and other processes the other cores. Raises UserError if the kernel is not available."""
    torch.set_num_threads(1)
    try:
        kernel.use(backend)
    except kernel.NoCpp as error:
        raise UserError(f"backend 'c++' does not work here ({error}); 'numpy' does") from error


def choose(choice: Backend) -> tuple[Backend, str]:
    """Return the backend to train with, and why it is not the chosen one; "" if it is."""
    if choice == "c++":
        try:
            kernel.in_cpp()
        except kernel.NoCpp as error:
            return "numpy", f"networks are computed in NumPy, half as fast: {error}"
    return choice, ""


@contextlib.contextmanager
def restored() -> Iterator[None]:
    """Restore on exit what `configure` changes."""
    threads, used = torch.get_num_threads(), kernel.used()
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        kernel.use(used)


def tensor(array: NDArray) -> Tensor:
    """Return the array as a tensor that shares its memory."""
    return torch.from_numpy(array)


def array(numbers: Tensor | NDArray) -> NDArray:
    """Return a tensor or array as an array that shares its memory."""
    return numbers if isinstance(numbers, np.ndarray) else numbers.numpy()
