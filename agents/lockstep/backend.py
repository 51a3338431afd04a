"""Settings of the machine that training runs under. They change results in their last bits."""

from __future__ import annotations

import ctypes
import functools
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.errors import UserError

P = ParamSpec("P")
T = TypeVar("T")

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3


_compiles = False
"""Whether functions marked `compiled` are; as `configure` was last told."""


class CompileClock:
    """How long this process has been compiling, for those who show progress."""

    def __init__(self) -> None:
        self.began: float | None = None
        """When the compilation that goes on began, `time.monotonic`; None where none does."""
        self.seconds = 0.0
        """Seconds of those that are over."""

    def start(self, _: object) -> None:
        self.began = time.monotonic()

    def stop(self, _: object) -> None:
        if self.began is not None:
            self.seconds += time.monotonic() - self.began
        self.began = None


CLOCK = CompileClock()


def configure(compiles: bool = False, device: str = "cpu") -> None:
    """Prepare this process for training: one thread, kept memory, the faster matrix products.

    compiles: run what is marked `compiled` as compiled code from now on; device: "cpu" or "cuda",
    where new tensors go. One thread a process, since lockstep runs fill a core and processes fill
    the others. Raises UserError where torch sees no such device or cannot compile.
    """
    global _compiles
    if device != "cpu" and not torch.cuda.is_available():
        raise UserError(f"device {device!r}: torch {torch.__version__} sees no GPU; 'cpu' is there")
    torch.set_num_threads(1)
    torch.set_default_device(device if device != "cpu" else None)
    _keep_freed_memory()
    _use_onednn_products()
    if compiles and (why := cannot_compile()):
        raise UserError(f"backend 'compiled' cannot be had here ({why}); 'eager' can")
    _compiles = compiles


def tensor(array: NDArray) -> Tensor:
    """The array on the device that trains; on a CPU it shares its memory."""
    return torch.from_numpy(array).to(torch.get_default_device())


def array(tensor: Tensor) -> NDArray:
    """The tensor in main memory; a CPU's shares it."""
    return tensor.cpu().numpy()


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Mark a pure function of tensors to run as one piece of compiled code where `configure` says.

    Otherwise it is what it was. The source is ordinary PyTorch, gradients by `torch.func` included;
    nothing in it may look at a tensor's value. The first axis of every tensor that comes in or goes
    out is the run axis, of any length in the compiled code: so it is compiled once, and what it
    does to a run does not depend, bit for bit, on how many there are. One run is computed beside a
    copy of itself, since axes of length 1 lead to other code.
    """

    whole: Callable[P, T] | None = None

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        nonlocal whole
        if not _compiles or torch.compiler.is_compiling():  # the latter: as a part of another
            return function(*args, **kwargs)
        if whole is None:  # not sooner, since what it imports takes seconds
            whole = torch.compile(function, fullgraph=True, dynamic=False)
        alone = _runs(args) == 1
        if alone:
            args = _map(lambda x: torch.cat([x, x]), args)
        _map(lambda x: torch._dynamo.mark_dynamic(x, 0), args)
        results = whole(*args, **kwargs)
        return _map(lambda x: x[:1], results) if alone else results

    return call


def _map(of: Callable[[Tensor], Any], tree: Any) -> Any:
    """`of` of every tensor in nested tuples, lists and dicts; whatever else there is stays."""
    if isinstance(tree, Tensor):
        return of(tree)
    if isinstance(tree, dict):
        return {name: _map(of, part) for name, part in tree.items()}
    if isinstance(tree, (tuple, list)):
        parts = [_map(of, part) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)
    return tree


def _runs(tree: Any) -> int:
    """Length of the first axis of the tensors in it."""
    lengths: set[int] = set()
    _map(lambda x: lengths.add(len(x)), tree)
    assert len(lengths) == 1, f"tensors of different numbers of runs: {lengths}"
    return lengths.pop()


def compiling_is_off() -> bool:
    """Whether PyTorch was told not to compile, by its own environment variable."""
    return os.environ.get("TORCH_COMPILE_DISABLE", "0") != "0"


@functools.cache
def cannot_compile() -> str:
    """Why this machine cannot compile, in a line; empty where it can. Found by trying."""
    if compiling_is_off():
        return "TORCH_COMPILE_DISABLE is set"
    _keep_compiled_code()
    try:
        torch.compile(lambda x: 2.0 * x, fullgraph=True)(torch.ones(32))
    except Exception as error:  # whatever the compiler, its headers or the cache lack
        return (str(error).strip() or type(error).__name__).splitlines()[0]
    return ""


@functools.cache
def _keep_compiled_code() -> None:
    """Keep compiled code between processes, where it outlasts a restart of the machine, and for as
    many sets of shapes as a process meets."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache / "circle2d-mj"))
    import torch._dynamo  # here, since it takes a second
    from torch._dynamo.callback import callback_handler

    torch._dynamo.config.recompile_limit = 1024
    callback_handler.register_start_callback(CLOCK.start)
    callback_handler.register_end_callback(CLOCK.stop)


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
