"""Settings of the machine that training runs under. They change results in their last bits."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import warnings
from collections.abc import Iterator
from typing import Literal

import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.errors import UserError
from agents.lockstep.compiling import (
    cannot_compile,
    compiling_is_off,
    is_compiling,
    set_compiling,
)

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


def configure(compiles: bool = False, device: str = "cpu") -> None:
    """Prepare this process for training: one thread, kept memory, the faster matrix products.

    compiles: run functions marked `compiled` as compiled code from now on; device: "cpu" or "cuda",
    where new tensors go. One thread a process, since lockstep runs fill a core and processes fill
    the others. Raises UserError where torch sees no such device or cannot compile.
    """
    require(compiles, device)
    torch.set_num_threads(1)
    torch.set_default_device(device if device != "cpu" else None)
    _keep_freed_memory()
    _use_onednn_products()
    set_compiling(compiles)


def require(compiles: bool, device: str) -> None:
    """Raise UserError where torch sees no such device or cannot compile."""
    if device != "cpu" and not torch.cuda.is_available():
        raise UserError(f"device {device!r}: torch {torch.__version__} sees no GPU; 'cpu' is there")
    if compiles and (why := cannot_compile()):
        raise UserError(f"backend 'compiled' does not work here ({why}); 'eager' does")


def choose(choice: Literal["auto", "compiled", "eager"]) -> Literal["compiled", "eager"]:
    """The backend that "auto" stands for on this machine.

    Warns where that is eager PyTorch, half as fast, unless TORCH_COMPILE_DISABLE asks for it.
    """
    if choice != "auto":
        return choice
    why = cannot_compile()
    if why and not compiling_is_off():
        warnings.warn(f"updates run in eager PyTorch, half as fast: {why}", stacklevel=5)
    return "eager" if why else "compiled"


@contextlib.contextmanager
def restored() -> Iterator[None]:
    """Restore at the end what `configure` changes: threads, default device, products, compilation.

    Three things stay: freed memory is kept, PyTorch keeps compiled code in a folder of ours unless
    TORCHINDUCTOR_CACHE_DIR names another, and two callbacks measure its compiler's time.
    """
    threads, device, compiles = torch.get_num_threads(), torch.get_default_device(), is_compiling()
    matmul = getattr(torch.backends.mkldnn, "matmul", None)
    precision = getattr(matmul, "fp32_precision", None)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_default_device(None if device == torch.device("cpu") else device)
        set_compiling(compiles)
        if matmul is not None and precision is not None:
            matmul.fp32_precision = precision


def tensor(array: NDArray) -> Tensor:
    """The array on the device that trains; on a CPU it shares its memory."""
    return torch.from_numpy(array).to(torch.get_default_device())


def array(tensor: Tensor) -> NDArray:
    """The tensor in main memory; a CPU's shares it."""
    return tensor.cpu().numpy()


def _keep_freed_memory() -> None:
    """Have glibc hand freed blocks to the next tensor instead of back to the system.

    The page faults of fresh megabytes cost more than the arithmetic that fills them.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL("libc.so.6").mallopt
    except (OSError, AttributeError):
        return  # another C library: only slower
    mallopt(_M_MMAP_THRESHOLD, 32 * 2**20)
    mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
    mallopt(_M_TOP_PAD, 64 * 2**20)


def _use_onednn_products() -> None:
    """Let oneDNN do batched products where its arithmetic stays float32.

    torch asks it only when told that bfloat16 would do; a CPU without matrix units for bfloat16
    computes in float32 all the same, one with them really rounds. So the setting is tried, and
    taken back where the error says that it rounds.
    """
    matmul = getattr(torch.backends.mkldnn, "matmul", None)
    if matmul is None or not hasattr(matmul, "fp32_precision"):
        return
    before = matmul.fp32_precision
    matmul.fp32_precision = "bf16"
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(8, 64, 64, generator=generator, device="cpu") for _ in range(2))
    error = (torch.bmm(a, b) - torch.bmm(a.double(), b.double())).abs().max().item()
    if not error < 1e-4:
        matmul.fp32_precision = before
