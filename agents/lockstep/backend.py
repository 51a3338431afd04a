"""Settings of the machine that training runs under, and functions as compiled code.

Both change results in their last bits."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import torch
from numpy.typing import NDArray
from torch import Tensor

from agents.errors import UserError

P = ParamSpec("P")
T = TypeVar("T")

_compiles = False
"""Whether functions marked `compiled` run as compiled code in this process."""
_other_limit = 1024
"""Sets of shapes that a function is compiled for at most; the caller's limit while ours is set."""


def set_compiling(compiles: bool) -> None:
    """Run functions marked `compiled` as compiled code from now on, or operation by operation."""
    global _compiles, _other_limit
    if compiles != _compiles:
        from torch._dynamo import config  # here, since it takes a second

        config.recompile_limit, _other_limit = _other_limit, config.recompile_limit
    _compiles = compiles


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Mark a pure function of tensors to run as one piece of compiled code where `configure` says.

    Elsewhere the function stays as it is. The source is ordinary PyTorch, gradients by
    `differentiate`; it may not branch on a tensor's value. The first axis of every argument and
    result is the run axis, of any length in the compiled code: so the function is compiled once,
    and a run's results do not depend, bit for bit, on the number of runs. One run is computed
    beside a copy of itself, since axes of length 1 lead to other code.
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
    """Apply `of` to every tensor in nested tuples, lists and dicts; other parts stay."""
    if isinstance(tree, Tensor):
        return of(tree)
    if isinstance(tree, dict):
        return {name: _map(of, part) for name, part in tree.items()}
    if isinstance(tree, (tuple, list)):
        parts = [_map(of, part) for part in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)
    return tree


def _runs(tree: Any) -> int:
    """Length of the first axis of the tensors in a tree."""
    lengths: set[int] = set()
    _map(lambda x: lengths.add(len(x)), tree)
    assert len(lengths) == 1, f"tensors of different numbers of runs: {lengths}"
    return lengths.pop()


def differentiate(loss: Callable[[Tensor], tuple[Tensor, T]], at: Tensor) -> tuple[Tensor, T]:
    """The gradient of a loss at some parameters, and what the loss returns beside its value.

    The same bits either way: `torch.func` can be compiled, but where it is not it is slower, and
    imports the compiler.
    """
    if torch.compiler.is_compiling():
        return torch.func.grad(loss, has_aux=True)(at)
    with torch.enable_grad():
        at = at.detach().requires_grad_()
        value, others = loss(at)
    return torch.autograd.grad(value, at)[0], others


def jacobian_products(
    function: Callable[[Tensor], Tensor], at: Tensor
) -> tuple[Callable[[Tensor], Tensor], Callable[[Tensor], Tensor]]:
    """v -> J v and u -> Jᵀ u, J the Jacobian of a function there. As `differentiate`."""
    # J v is the gradient in u of `Jᵀ u · v`; forward mode gives the same, slower.
    if torch.compiler.is_compiling():
        outputs, pull, *_ = torch.func.vjp(function, at)
        _, push, *_ = torch.func.vjp(lambda u: pull(u)[0], torch.zeros_like(outputs))
        return lambda v: push(v)[0], lambda u: pull(u)[0]
    with torch.enable_grad():
        at = at.detach().requires_grad_()
        outputs = function(at)
        u = torch.zeros_like(outputs, requires_grad=True)
        [pulled] = torch.autograd.grad(outputs, at, u, create_graph=True)
    return (
        lambda v: torch.autograd.grad(pulled, u, v, retain_graph=True)[0],
        lambda u: torch.autograd.grad(outputs, at, u, retain_graph=True)[0],
    )


class CompileClock:
    """Seconds that this process has spent compiling, for the display of progress."""

    def __init__(self) -> None:
        self.began: float | None = None
        """Start of the present compilation, `time.monotonic`; None where there is none."""
        self.seconds = 0.0
        """Seconds of the compilations that are over."""

    def start(self, *_: object) -> None:
        """A compilation begins."""
        self.began = time.monotonic()

    def stop(self, *_: object) -> None:
        """It ends."""
        if self.began is not None:
            self.seconds += time.monotonic() - self.began
        self.began = None


CLOCK = CompileClock()


def compiling_is_off() -> bool:
    """Whether PyTorch was told not to compile, by its own environment variable."""
    return os.environ.get("TORCH_COMPILE_DISABLE", "0") != "0"


@functools.cache
def cannot_compile() -> str:
    """Why this machine cannot compile, in a line; empty where it can. Found by trying."""
    if compiling_is_off():
        return "TORCH_COMPILE_DISABLE is set"
    try:
        _keep_compiled_code()
        torch.compile(lambda x: 2.0 * x, fullgraph=True)(torch.ones(32))
    except Exception as error:  # whatever the compiler, its headers or the cache lack
        return (str(error).strip() or type(error).__name__).splitlines()[0]
    return ""


@functools.cache
def _keep_compiled_code() -> None:
    """Keep compiled code between processes, where it outlasts a restart of the machine."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache / "circle2d-mj"))
    from torch._dynamo.callback import callback_handler  # here, since it takes a second

    callback_handler.register_start_callback(CLOCK.start)
    callback_handler.register_end_callback(CLOCK.stop)


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


WORTH_COMPILING = 300_000
"""Steps of all runs together from which on compiling pays (docs/speed.md)."""


def choose(
    choice: Literal["auto", "compiled", "eager"], steps: int, device: str
) -> Literal["compiled", "eager"]:
    """The backend of a training of so many steps of all runs together. Raises as `require` does.

    Warns where "auto" cannot compile a long training, unless TORCH_COMPILE_DISABLE asks for that.
    """
    require(choice == "compiled", device)
    if choice != "auto":
        return choice
    if steps < WORTH_COMPILING:
        return "eager"
    why = cannot_compile()
    if why and not compiling_is_off():
        warnings.warn(f"updates run in eager PyTorch, a third slower: {why}", stacklevel=5)
    return "eager" if why else "compiled"


@contextlib.contextmanager
def restored() -> Iterator[None]:
    """Restore at the end what `configure` changes: threads, default device, products, compilation.

    Three things stay: freed memory is kept, PyTorch keeps compiled code in a folder of ours unless
    TORCHINDUCTOR_CACHE_DIR names another, and two callbacks measure its compiler's time.
    """
    threads, device, compiles = torch.get_num_threads(), torch.get_default_device(), _compiles
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
