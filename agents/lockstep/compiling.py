"""Functions of tensors as compiled code: each as a whole, for any number of runs."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

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


def is_compiling() -> bool:
    """Whether what is marked `compiled` runs as compiled code."""
    return _compiles


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Mark a pure function of tensors to run as one piece of compiled code where `configure` says.

    Elsewhere the function stays as it is. The source is ordinary PyTorch, gradients by `torch.func`
    included; it may not branch on a tensor's value. The first axis of every argument and result is
    the run axis, of any length in the compiled code: so the function is compiled once, and a run's
    results do not depend, bit for bit, on the number of runs. One run is computed beside a copy of
    itself, since axes of length 1 lead to other code.
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


class CompileClock:
    """Seconds that this process has spent compiling, for the display of progress."""

    def __init__(self) -> None:
        self.began: float | None = None
        """Start of the present compilation, `time.monotonic`; None where there is none."""
        self.seconds = 0.0
        """Seconds of the compilations that are over."""

    def start(self, *_: object) -> None:
        self.began = time.monotonic()

    def stop(self, *_: object) -> None:
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
