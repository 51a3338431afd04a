"""The arithmetic of networks: values, products with their Jacobian, Adam.

In C++ (`kernel.cpp`), which is compiled once where there is a compiler and its results are right;
else the same functions in NumPy, several times slower. In both a network's numbers depend on itself
alone, bit for bit, whatever others are computed beside it.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Activation = Literal["tanh", "relu", "silu"]
Backend = Literal["c++", "numpy"]
Float = NDArray[np.floating]
SOURCE = Path(__file__).with_name("kernel.cpp")
FLAGS = ("-std=c++17", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC")
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8


class Shape(Protocol):
    """What the functions here need to know of a network."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Of inputs, hidden layers and outputs."""
        ...

    @property
    def activation(self) -> Activation:
        """Behind the hidden layers."""
        ...


class Kernel(Protocol):
    """Functions of N networks of one shape, params [N, at least size], and inputs
    [N / share, B, in]: each is that of `share` networks, one behind the other."""

    def forward(self, net: Shape, params: Float, x: Float, share: int = 1) -> tuple[Float, Any]:
        """Outputs [N, B, out], and what the others need of the hidden layers."""
        ...

    def backward(
        self, net: Shape, params: Float, x: Float, tape: Any, dy: Float, of: str, share: int = 1
    ) -> tuple[Float | None, Float | None]:
        """Products of dy [N, B, out] with the Jacobian; of: "p" in the parameters, [N, width of
        params], 0 behind the network's own; "x" in the inputs, [N, B, in]; "px" both."""
        ...

    def tangent(self, net: Shape, params: Float, x: Float, tape: Any, v: Float) -> Float:
        """Products of the Jacobian in the parameters with v [N, at least size]: [N, B, out]."""
        ...

    def adam(
        self,
        params: Float,
        gradient: Float,
        mean: Float,
        square: Float,
        rest: tuple[Float, Float],
        rate: float,
    ) -> None:
        """One step down the gradient, all [R, P], in place; rest: 1 - β₁ᵗ and 1 - β₂ᵗ, [R] each.
        Source: Kingma & Ba 2015, algorithm 1."""
        ...


class InNumpy:
    """The kernel in NumPy, for numbers of any precision."""

    def forward(self, net: Shape, params: Float, x: Float, share: int = 1) -> tuple[Float, Any]:
        """See `Kernel`."""
        x, tape = np.repeat(x, share, axis=0), []
        *hidden, (weight, bias) = layers(net.sizes, params)
        for w, b in hidden:
            x, slope = _ACTIVATIONS[net.activation](np.matmul(x, w) + b)
            tape.append((x, slope))
        return np.matmul(x, weight) + bias, tape

    def backward(
        self, net: Shape, params: Float, x: Float, tape: Any, dy: Float, of: str, share: int = 1
    ) -> tuple[Float | None, Float | None]:
        """See `Kernel`."""
        gradient = np.zeros_like(params)
        inputs = [np.repeat(x, share, axis=0), *(values for values, _ in tape)]
        pairs = zip(layers(net.sizes, params), layers(net.sizes, gradient), strict=True)
        for k, ((w, _), (gw, gb)) in reversed(list(enumerate(pairs))):
            if "p" in of:
                gw[...] = np.matmul(inputs[k].swapaxes(1, 2), dy)
                gb[...] = dy.sum(axis=1, keepdims=True)
            if k or "x" in of:
                dy = np.matmul(dy, w.swapaxes(1, 2)) * (tape[k - 1][1] if k else 1)
        return gradient if "p" in of else None, dy if "x" in of else None

    def tangent(self, net: Shape, params: Float, x: Float, tape: Any, v: Float) -> Float:
        """See `Kernel`."""
        dot, steps = np.zeros_like(x), [*tape, (None, 1)]
        for (w, _), (vw, vb), (values, slope) in zip(
            layers(net.sizes, params), layers(net.sizes, v), steps, strict=True
        ):
            dot = (np.matmul(x, vw) + vb + np.matmul(dot, w)) * slope
            x = values
        return dot

    def adam(
        self,
        params: Float,
        gradient: Float,
        mean: Float,
        square: Float,
        rest: tuple[Float, Float],
        rate: float,
    ) -> None:
        """See `Kernel`."""
        rest1, rest2 = (part[:, None] for part in rest)
        mean += (1 - BETA1) * (gradient - mean)
        square *= BETA2
        square += (1 - BETA2) * gradient * gradient
        params -= rate * (mean / rest1) / (np.sqrt(square / rest2) + EPSILON)


def layers(sizes: Sequence[int], params: Float) -> Iterator[tuple[Float, Float]]:
    """Views of the weights [N, in, out] and biases [N, 1, out] of each layer in params."""
    at = 0
    for rows, columns in pairwise(sizes):
        weight, bias = at, at + rows * columns
        at = bias + columns
        yield params[:, weight:bias].reshape(-1, rows, columns), params[:, None, bias:at]


def _tanh(z: Float) -> tuple[Float, Float]:
    y = np.tanh(z)
    return y, 1 - y * y


def _relu(z: Float) -> tuple[Float, Float]:
    return np.maximum(z, 0), (z > 0).astype(z.dtype)


def _silu(z: Float) -> tuple[Float, Float]:
    s = 0.5 + 0.5 * np.tanh(0.5 * z)  # the sigmoid by tanh cannot overflow
    return z * s, s * (1 + z * (1 - s))


_ACTIVATIONS: dict[Activation, Callable[[Float], tuple[Float, Float]]] = {
    "tanh": _tanh,
    "relu": _relu,
    "silu": _silu,
}
"""Pre-activations -> activations and their slopes."""
IN_NUMPY = InNumpy()


class InCpp:
    """The kernel in C++, for float32."""

    def __init__(self, library: Path) -> None:
        self.functions = ctypes.CDLL(str(library))
        pointer, long, float_ = ctypes.c_void_p, ctypes.c_int64, ctypes.c_float
        shape = [ctypes.c_int, pointer, ctypes.c_int]
        nets = [*shape, long, pointer, long, long, pointer]
        self.functions.tape_size.argtypes, self.functions.tape_size.restype = [*shape, long], long
        self.functions.forward.argtypes = [*nets, pointer, long, pointer]
        self.functions.backward.argtypes = [*nets, pointer, pointer, long, pointer]
        self.functions.tangent.argtypes = [*nets, pointer, long, pointer]
        self.functions.adam.argtypes = [long, long, *[pointer] * 6, float_]
        for name in ("forward", "backward", "tangent", "adam"):
            getattr(self.functions, name).restype = None

    def forward(self, net: Shape, params: Float, x: Float, share: int = 1) -> tuple[Float, Any]:
        """See `Kernel`."""
        y = np.empty((len(params), x.shape[1], net.sizes[-1]), np.float32)
        size = self.functions.tape_size(*_shape(net.sizes, net.activation), x.shape[1])
        tape = np.empty(len(params) * size + LINE, np.float32)
        self.functions.forward(*_of(net, params, x, tape), x.ctypes.data, share, y.ctypes.data)
        return y, tape

    def backward(
        self, net: Shape, params: Float, x: Float, tape: Any, dy: Float, of: str, share: int = 1
    ) -> tuple[Float | None, Float | None]:
        """See `Kernel`."""
        dy = np.ascontiguousarray(dy)  # kept here, while its address is in use
        gp = np.zeros(params.shape, np.float32) if "p" in of else None
        gx = np.empty((*dy.shape[:2], net.sizes[0]), np.float32) if "x" in of else None
        to = (_data(gp), params.shape[1], _data(gx))
        self.functions.backward(*_of(net, params, x, tape), dy.ctypes.data, *to)
        return gp, gx

    def tangent(self, net: Shape, params: Float, x: Float, tape: Any, v: Float) -> Float:
        """See `Kernel`."""
        jy = np.empty((len(params), x.shape[1], net.sizes[-1]), np.float32)
        direction = (v.ctypes.data, v.strides[0] // 4)
        self.functions.tangent(*_of(net, params, x, tape), *direction, jy.ctypes.data)
        return jy

    def adam(
        self,
        params: Float,
        gradient: Float,
        mean: Float,
        square: Float,
        rest: tuple[Float, Float],
        rate: float,
    ) -> None:
        """See `Kernel`."""
        arrays = [a.ctypes.data for a in (params, gradient, mean, square, *rest)]
        self.functions.adam(*params.shape, *arrays, rate)


LINE = 16
"""Numbers in a line of the cache, at whose beginning C++ has a tape begin."""


def _of(net: Shape, params: Float, x: Float, tape: Float) -> tuple[Any, ...]:
    """The arguments that the functions of networks begin with."""
    given = (len(params), params.ctypes.data, params.strides[0] // 4, x.shape[1])
    return *_shape(net.sizes, net.activation), *given, tape.ctypes.data


@functools.cache
def _shape(sizes: tuple[int, ...], activation: Activation) -> tuple[int, Any, int]:
    array = (ctypes.c_int64 * len(sizes))(*sizes)
    return len(sizes) - 1, array, list(_ACTIVATIONS).index(activation)


def _data(array: Float | None) -> int | None:
    return None if array is None else array.ctypes.data


class NoCpp(Exception):
    """Why networks cannot be computed in C++ here, in a line."""


@functools.cache
def in_cpp() -> InCpp:
    """The kernel in C++, compiled where it has not been. Raises NoCpp."""
    compiler = os.environ.get("CXX") or next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise NoCpp(f"there is no C++ compiler: {', '.join(COMPILERS)}, or CXX names one")
    try:
        version = subprocess.run([compiler, "--version"], capture_output=True, check=True).stdout
        made_of = (SOURCE.read_bytes(), " ".join(FLAGS).encode(), version, _processor())
        name = hashlib.blake2b(b"\0".join(made_of), digest_size=16).hexdigest()
        library = _cache() / f"kernel-{name}.so"
        if not library.exists():
            with tempfile.TemporaryDirectory(dir=library.parent) as folder:
                made = Path(folder) / library.name  # moved whole: others may do so at the same time
                command = [compiler, *FLAGS, str(SOURCE), "-o", str(made)]
                subprocess.run(command, capture_output=True, check=True)
                made.replace(library)
        kernel = InCpp(library)
    except subprocess.CalledProcessError as error:
        lines = error.stderr.decode(errors="replace").strip().splitlines() or [str(error)]
        raise NoCpp(f"{compiler} fails: {lines[0]}") from error
    except OSError as error:
        raise NoCpp(str(error)) from error
    if (off := error_of(kernel)) > TOLERANCE:
        raise NoCpp(f"what {compiler} makes of {SOURCE.name} is wrong by {off:.1g}")
    return kernel


COMPILERS = ("c++", "g++", "clang++")
TOLERANCE = 1e-4
"""Largest error of the kernel in C++, of numbers about 1."""


def _processor() -> bytes:
    """What the processor can do, as far as Linux tells: code is for this one alone."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
    except OSError:
        lines = []
    flags = [line for line in lines if line.startswith((b"flags", b"Features"))]
    return flags[0] if flags else f"{platform.machine()} {platform.processor()}".encode()


def _cache() -> Path:
    """The folder of compiled code, which is there."""
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "circle2d-mj"
    kept.mkdir(parents=True, exist_ok=True)
    return kept


class _Probe(NamedTuple):
    sizes: tuple[int, ...]
    activation: Activation


def error_of(kernel: Kernel) -> float:
    """The largest difference of a kernel's float32 from the NumPy kernel in float64."""
    rng, worst = np.random.default_rng(0), 0.0
    for activation in _ACTIVATIONS:
        net = _Probe((5, 30, 64, 3), activation)
        size = sum((a + 1) * b for a, b in pairwise(net.sizes))
        shapes = ((4, size), (2, 70, 5), (4, 70, 3), (4, size))
        given = [rng.normal(0, 0.3, shape) for shape in shapes]
        found = [_results(kernel, net, [a.astype(np.float32) for a in given])]
        found.append(_results(IN_NUMPY, net, given))
        differences = [np.abs(a - b).max() for a, b in zip(*found, strict=True)]
        worst = max(worst, *differences) if np.isfinite(differences).all() else np.inf
    return worst


def _results(kernel: Kernel, net: Shape, given: Sequence[Float]) -> list[Float]:
    """What all functions of a kernel return."""
    params, x, dy, v = given
    y, tape = kernel.forward(net, params, x, 2)
    gp, gx = kernel.backward(net, params, x, tape, dy, "px", 2)
    assert gp is not None and gx is not None
    alone = kernel.forward(net, params[:2], x)[1]
    jy = kernel.tangent(net, params[:2], x, alone, v[:2])
    moved, mean, square = params.copy(), 0.1 * v, v * v
    rest = (np.full(4, 0.2, params.dtype), np.full(4, 0.1, params.dtype))
    kernel.adam(moved, gp, mean, square, rest, 1e-2)
    return [y, gp / 10, gx, jy, moved, mean, square]


_kernel: Kernel = IN_NUMPY


def use(backend: Backend) -> None:
    """Compute float32 by that kernel from now on. Raises NoCpp."""
    global _kernel
    _kernel = in_cpp() if backend == "c++" else IN_NUMPY
    if isinstance(_kernel, InCpp):
        _kernel.functions.keep_freed_memory()


def used() -> Backend:
    """The kernel of float32."""
    return "numpy" if _kernel is IN_NUMPY else "c++"


def of(array: Float) -> Kernel:
    """The kernel for numbers like those of an array."""
    return _kernel if array.dtype == np.float32 else IN_NUMPY
