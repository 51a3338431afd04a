"""The arithmetic of networks: outputs, products with their Jacobian, passes of Adam.

It is in C++ (`kernel.cpp`), which is compiled once, if there is a compiler and the results are
right; else the same functions run in NumPy, several times slower. In both, the numbers of a network
depend on that network alone, bit for bit, whatever others are computed beside it.
"""

from __future__ import annotations

import contextlib
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

from agents.lockstep.descent import MAY_DIVERGE, Clipped, Descent, Loss, Moments, Squared, descend

Activation = Literal["tanh", "relu", "silu"]
Backend = Literal["c++", "numpy"]
Float = NDArray[np.floating]
SOURCE = Path(__file__).with_name("kernel.cpp")
FLAGS = ("-std=c++17", "-O2", "-ftree-vectorize", "-march=native", "-fno-math-errno")
FLAGS += ("-shared", "-fPIC")
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8


class Shape(Protocol):
    """Shape of a network, as far as the functions here need it."""

    @property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of inputs, hidden layers and outputs."""
        ...

    @property
    def activation(self) -> Activation:
        """Activation function of the hidden layers."""
        ...


class Curvature(NamedTuple):
    """The damped Hessian H of the mean KL divergence of R policies from themselves:
    `damping + Jᵀ M J`, where J is the Jacobian of means and log-stds, and M, `1/σ²` and 2, the
    Fisher information of a Gaussian in them."""

    net: Shape
    params: Float
    """[R, P]"""
    log_std: slice
    """Slice of the parameters that holds the log-std."""
    inputs: Float
    """[R, B, at least in]: networks see the first `in` numbers"""
    weight: Float
    """[R, B]: weights of the rows in the mean"""
    damping: float


class InNumpy:
    """The kernel in NumPy, for numbers of any precision.

    The functions take N networks of one shape, params [N, at least size], and inputs
    [N / share, B, in], each shared by `share` consecutive networks.
    """

    def values(self, net: Shape, params: Float, x: Float, share: int = 1) -> Float:
        """Return the outputs [N, B, out]."""
        return self.forward(net, params, x, share)[0]

    def forward(self, net: Shape, params: Float, x: Float, share: int = 1) -> tuple[Float, Any]:
        """Return the outputs [N, B, out], and what `backward` needs of the hidden layers."""
        x, tape = np.repeat(x, share, axis=0), []
        *hidden, (weight, bias) = layers(net.sizes, params)
        for w, b in hidden:
            z = np.matmul(x, w) + b
            x = ACTIVATIONS[net.activation](z)
            tape.append((x, _SLOPES[net.activation](z, x)))
        return np.matmul(x, weight) + bias, tape

    def backward(
        self, net: Shape, params: Float, x: Float, tape: Any, dy: Float, of: str, share: int = 1
    ) -> tuple[Float | None, Float | None]:
        """Return the products of dy [N, B, out] with the Jacobian; of: "p" in the parameters,
        [N, width of params], 0 behind the network's own; "x" in the inputs, [N, B, in]; "px"
        both."""
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

    def adam(self, params: Float, gradient: Float, moments: Moments, rate: float) -> None:
        """Step down the gradient, in place; all [R, ...]. Source: Kingma & Ba 2015, algorithm 1."""
        mean, square, *decays = moments
        for decay, beta in zip(decays, (BETA1, BETA2), strict=True):
            decay *= beta
        rest1, rest2 = (1 - decay.reshape(-1, *[1] * (params.ndim - 1)) for decay in decays)
        mean += (1 - BETA1) * (gradient - mean)
        square *= BETA2
        square += (1 - BETA2) * gradient * gradient
        params -= rate * (mean / rest1) / (np.sqrt(square / rest2) + EPSILON)

    def descend(
        self, it: Descent, loss: Loss, order: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> Float:
        """Make a pass of Adam; return the sums over minibatches of what the loss records, [N].

        order: from `orders`; steps: [R], rows of each run in it, 0 for an inactive run. A run
        without rows in a minibatch waits."""
        return descend(self, it, loss, order, steps)

    @MAY_DIVERGE
    def curvature(self, it: Curvature, v: Float, iterations: int = 0) -> Float:
        """Return H v for v [R, P], or with iterations the x of H x = v by `conjugate_gradient`."""
        if iterations:
            return conjugate_gradient(functools.partial(self.curvature, it), v, iterations)
        params, x, log_std = it.params, it.inputs[..., : it.net.sizes[0]], it.params[:, it.log_std]
        _, tape = self.forward(it.net, params, x)
        by_variance = np.exp(-2.0 * log_std)[:, None] * it.weight[..., None]
        pushed = by_variance * _tangent(it.net, params, x, tape, v)
        image, _ = self.backward(it.net, params, x, tape, pushed, "p")
        assert image is not None
        image[:, it.log_std] = 2.0 * it.weight.sum(axis=-1, keepdims=True) * v[:, it.log_std]
        return image + it.damping * v


def _tangent(net: Shape, params: Float, x: Float, tape: Any, v: Float) -> Float:
    """Multiply the Jacobian in the parameters with v, [N, at least size] -> [N, B, out]."""
    dot, steps = np.zeros_like(x), [*tape, (None, 1)]
    for (w, _), (vw, vb), (values, slope) in zip(
        layers(net.sizes, params), layers(net.sizes, v), steps, strict=True
    ):
        dot = (np.matmul(x, vw) + vb + np.matmul(dot, w)) * slope
        x = values
    return dot


@MAY_DIVERGE
def conjugate_gradient(product: Callable[[Float], Float], b: Float, iterations: int) -> Float:
    """Solve `H x = b` approximately for x; product: v -> H v, symmetric positive definite.

    b: [R, P] -> [R, P]. A run whose residual has vanished stays where it is. The vectors have
    double precision, the products that of b: rounding errors of the vectors are magnified up to a
    hundred times as much as those of the products.
    """

    def dot(a: Float, b: Float) -> Float:
        return (a * b).sum(axis=-1, keepdims=True)

    def over(a: Float, b: Float) -> Float:
        return np.where(going, a / np.where(going, b, 1.0), 0.0)

    residual = b.astype(np.float64)
    x, direction, square = np.zeros_like(residual), residual, dot(residual, residual)
    least = 1e-10 * square
    for _ in range(iterations):
        image, going = product(direction.astype(b.dtype)).astype(np.float64), square > least
        step = over(square, dot(direction, image))
        x, residual = x + step * direction, residual - step * image
        before, square = square, dot(residual, residual)
        direction = residual + over(square, before) * direction
    return x.astype(b.dtype)


def layers(sizes: Sequence[int], params: Float) -> Iterator[tuple[Float, Float]]:
    """Yield views in params of the weights [N, in, out] and biases [N, 1, out] of each layer."""
    at = 0
    for rows, columns in pairwise(sizes):
        weight, bias = at, at + rows * columns
        at = bias + columns
        yield params[:, weight:bias].reshape(-1, rows, columns), params[:, None, bias:at]


def _sigmoid(z: Float) -> Float:
    return 0.5 + 0.5 * np.tanh(0.5 * z)  # as tanh, it cannot overflow


def _silu_slope(z: Float, _: Float) -> Float:
    s = _sigmoid(z)
    return s * (1 + z * (1 - s))


ACTIVATIONS: dict[Activation, Callable[[Float], Float]] = {
    "tanh": np.tanh,
    "relu": lambda z: np.maximum(z, 0),
    "silu": lambda z: z * _sigmoid(z),
}
_SLOPES: dict[Activation, Callable[[Float, Float], Float]] = {
    "tanh": lambda _, y: 1 - y * y,
    "relu": lambda z, _: (z > 0).astype(z.dtype),
    "silu": _silu_slope,
}
"""Slopes of the activation functions, from pre-activations and activations."""
IN_NUMPY = InNumpy()


class InCpp(InNumpy):
    """The kernel in C++, for float32."""

    def __init__(self, library: Path) -> None:
        self.functions = ctypes.CDLL(str(library))
        pointer, long, float_ = ctypes.c_void_p, ctypes.c_int64, ctypes.c_float
        shape = [ctypes.c_int, pointer, ctypes.c_int]
        nets = [*shape, long, pointer, long, long, pointer]
        self.functions.tape_size.argtypes, self.functions.tape_size.restype = [*shape, long], long
        self.functions.forward.argtypes = [*nets, pointer, long, pointer]
        self.functions.backward.argtypes = [*nets, pointer, pointer, long, pointer]
        self.functions.adam.argtypes = [long, long, *[pointer] * 6, float_]
        runs = [*shape, long, long, pointer, long, long, *[pointer] * 4, pointer, long, long]
        passed = [pointer, long, pointer, long, *[pointer] * 3, float_, pointer, float_, float_]
        self.functions.descend.argtypes = [*runs, *passed, pointer]
        policies = [*shape, long, pointer, long, long, pointer, long, long, pointer, float_]
        self.functions.curvature.argtypes = [*policies, pointer, long, pointer]
        for name in ("forward", "backward", "adam", "descend", "curvature"):
            getattr(self.functions, name).restype = None

    @functools.cache  # noqa: B019  (there is one kernel)
    def _tape_size(self, sizes: tuple[int, ...], activation: Activation, rows: int) -> int:
        return self.functions.tape_size(*_shape(sizes, activation), rows)

    def values(self, net: Shape, params: Float, x: Float, share: int = 1) -> Float:
        """See `InNumpy`."""
        y = np.empty((len(params), x.shape[1], net.sizes[-1]), np.float32)
        self.functions.forward(*_of(net, params, x, None), _data(x), share, _data(y))
        return y

    def forward(self, net: Shape, params: Float, x: Float, share: int = 1) -> tuple[Float, Any]:
        """See `InNumpy`."""
        y = np.empty((len(params), x.shape[1], net.sizes[-1]), np.float32)
        size = self._tape_size(net.sizes, net.activation, x.shape[1])
        tape = np.empty(len(params) * size + LINE, np.float32)
        self.functions.forward(*_of(net, params, x, tape), _data(x), share, _data(y))
        return y, tape

    def backward(
        self, net: Shape, params: Float, x: Float, tape: Any, dy: Float, of: str, share: int = 1
    ) -> tuple[Float | None, Float | None]:
        """See `InNumpy`."""
        dy = np.ascontiguousarray(dy)  # kept alive while its address is in use
        gp = np.empty(params.shape, np.float32) if "p" in of else None
        gx = np.empty((*dy.shape[:2], net.sizes[0]), np.float32) if "x" in of else None
        to = (_data(gp), params.shape[1], _data(gx))
        self.functions.backward(*_of(net, params, x, tape), _data(dy), *to)
        return gp, gx

    def adam(self, params: Float, gradient: Float, moments: Moments, rate: float) -> None:
        """See `InNumpy`."""
        size = (len(params), params.size // len(params))
        self.functions.adam(*size, *map(_data, (params, gradient, *moments)), rate)

    def descend(
        self, it: Descent, loss: Loss, order: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> Float:
        """See `InNumpy`."""
        if not isinstance(loss, Clipped | Squared):
            return super().descend(it, loss, order, steps)
        params, x = it.params, np.ascontiguousarray(it.inputs)
        assert params.flags.c_contiguous and all(m.flags.c_contiguous for m in it.moments)
        # Contiguous, and kept alive while their addresses are in use.
        rows, takes = (np.ascontiguousarray(a) for a in (order, steps))
        records, nothing = np.zeros(len(params), np.float32), (None, None, None, 0.0)
        columns = [np.ascontiguousarray(a) for a in loss if isinstance(a, np.ndarray)]
        data = [_data(column) for column in columns]
        losses = (*data, loss.clip_range, None) if isinstance(loss, Clipped) else (*nothing, *data)
        self.functions.descend(
            *_shape(it.net.sizes, it.net.activation),
            *(len(takes), len(params) // len(takes), _data(params), params.shape[1]),
            it.log_std.start,
            *(_data(m) for m in it.moments),
            *(_data(x), *x.shape[1:]),
            *(_data(rows), rows.shape[1], _data(takes), it.batch_size),
            *losses,
            *(it.longest, it.rate, _data(records)),
        )
        return records

    def curvature(self, it: Curvature, v: Float, iterations: int = 0) -> Float:
        """See `InNumpy`."""
        params, x, weight, v = (
            np.ascontiguousarray(a) for a in (it.params, it.inputs, it.weight, v)
        )
        found = np.empty_like(v)
        self.functions.curvature(
            *_shape(it.net.sizes, it.net.activation),
            *(len(params), _data(params), params.shape[1], it.log_std.start),
            *(_data(x), *x.shape[1:], _data(weight), it.damping),
            *(_data(v), iterations, _data(found)),
        )
        return found


LINE = 16
"""Numbers in a cache line, the alignment of tapes in C++."""


def _of(net: Shape, params: Float, x: Float, tape: Float | None) -> tuple[Any, ...]:
    """Return the first arguments of the C++ functions `forward` and `backward`."""
    given = (len(params), _data(params), params.strides[0] // 4, x.shape[1])
    return *_shape(net.sizes, net.activation), *given, _data(tape)


@functools.cache
def _shape(sizes: tuple[int, ...], activation: Activation) -> tuple[int, Any, int]:
    array = (ctypes.c_int64 * len(sizes))(*sizes)
    return len(sizes) - 1, array, list(ACTIVATIONS).index(activation)


def _data(array: Any) -> int | None:
    """Return the address of an array's numbers, None for None."""
    if array is None:
        return None
    try:  # a quarter of the time of `ctypes.data`
        return ctypes.addressof(ctypes.c_char.from_buffer(array))
    except (BufferError, TypeError, ValueError):  # strided, read-only or empty
        return array.ctypes.data


class NoCpp(Exception):
    """Networks cannot be computed in C++ here; the message says why, in a line."""


@functools.cache
def in_cpp() -> InCpp:
    """Return the kernel in C++, compiling it if necessary. Raises NoCpp if that fails."""
    compiler = os.environ.get("CXX") or next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise NoCpp(f"there is no C++ compiler: install {' or '.join(COMPILERS)}, or set CXX")
    try:
        version = subprocess.run([compiler, "--version"], capture_output=True, check=True).stdout
        made_of = (SOURCE.read_bytes(), " ".join(FLAGS).encode(), version, _processor())
        name = hashlib.blake2b(b"\0".join(made_of), digest_size=16).hexdigest()
        kernel = _compiled(compiler, f"kernel-{name}.so")
    except subprocess.CalledProcessError as error:
        lines = error.stderr.decode(errors="replace").strip().splitlines() or [str(error)]
        raise NoCpp(f"{compiler} fails: {lines[0]}") from error
    except OSError as error:
        raise NoCpp(str(error)) from error
    if (off := error_of(kernel)) > TOLERANCE:
        raise NoCpp(f"what {compiler} compiles from {SOURCE.name} is wrong by {off:.1g}")
    return kernel


COMPILERS = ("c++", "g++", "clang++")
TOLERANCE = 1e-4
"""Largest error allowed of the kernel in C++, for numbers of about 1."""


def _processor() -> bytes:
    """Return the processor's features, where Linux tells them: code is compiled for them alone."""
    try:
        lines = Path("/proc/cpuinfo").read_bytes().splitlines()
    except OSError:
        lines = []
    flags = [line for line in lines if line.startswith((b"flags", b"Features"))]
    return flags[0] if flags else f"{platform.machine()} {platform.processor()}".encode()


def _compiled(compiler: str, name: str) -> InCpp:
    """Return the kernel of that name from the user's cache, compiling it if it is not there; where
    nothing can be stored, as in a read-only home, it is compiled for this process alone."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "circle2d-mj"
    if (cache / name).exists():
        return InCpp(cache / name)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=cache)
    except OSError:
        folder = tempfile.TemporaryDirectory()
    with folder:
        made = Path(folder.name) / name
        subprocess.run(
            [compiler, *FLAGS, str(SOURCE), "-o", str(made)], capture_output=True, check=True
        )
        kernel = InCpp(made)
        with contextlib.suppress(OSError):
            made.replace(cache / name)  # atomic: other processes may do so too
    return kernel


class _Probe(NamedTuple):
    sizes: tuple[int, ...]
    activation: Activation


def error_of(kernel: InNumpy) -> float:
    """Return the largest difference of a kernel in float32 from the NumPy kernel in float64."""
    rng, worst = np.random.default_rng(0), 0.0
    for activation in ACTIVATIONS:
        net, policy = _Probe((5, 30, 64, 1), activation), _Probe((5, 30, 64, 3), activation)
        shapes = {"params": (4, _size(policy) + 3), "x": (2, 70, 5), "dy": (4, 70, 3)}
        shapes |= {"action": (2, 70, 3), "advantage": (2, 70), "target": (2, 2, 70)}
        given = {name: rng.normal(0, 0.3, shape) for name, shape in shapes.items()}
        given |= {"v": rng.normal(0, 0.3, shapes["params"])}
        single = {name: array.astype(np.float32) for name, array in given.items()}
        found = _results(kernel, net, policy, **single), _results(IN_NUMPY, net, policy, **given)
        differences = [np.abs(a - b).max() for a, b in zip(*found, strict=True)]
        worst = max(worst, *differences) if np.isfinite(differences).all() else np.inf
    return worst


def _size(net: Shape) -> int:
    return sum((a + 1) * b for a, b in pairwise(net.sizes))


def _results(
    kernel: InNumpy, net: Shape, policy: Shape, params: Float, v: Float, x: Float, **given: Float
) -> list[Float]:
    """Return what all functions of a kernel compute."""
    y, tape = kernel.forward(policy, params, x, 2)
    found = [kernel.values(policy, params, x, 2)]
    gp, gx = kernel.backward(policy, params, x, tape, given["dy"], "px", 2)
    assert gp is not None and gx is not None
    found += [y, gp / 10, gx]
    order, steps = np.tile(np.arange(70)[::-1], (2, 1)), np.array([70, 40])
    old, end = np.full_like(given["advantage"], -3.0), _size(policy)
    clipped = Clipped(given["action"], given["advantage"], old, 0.2)
    both = ((policy, params[:2], v[:2], clipped), (net, params, v, Squared(given["target"])))
    for shape, own, direction, loss in both:
        width = end + 3 if shape is policy else _size(net)
        own, direction = own[:, :width].copy(), 0.1 * direction[:, :width].reshape(2, -1)
        moments = Moments(direction, direction**2, *np.full((2, 2), 0.9, own.dtype))
        it = Descent(shape, own, moments, x, 33, 1e-2, slice(end, width), 0.5)
        found += [kernel.descend(it, loss, order, steps), own, *moments]
    moments = Moments(0.1 * v, v * v, *np.full((2, 4), 0.9, v.dtype))
    kernel.adam(moved := params.copy(), gp, moments, 1e-2)
    weight = np.abs(given["advantage"]) / 10
    it = Curvature(policy, params[:2], slice(end, end + 3), x, weight, 0.1)
    curved = [kernel.curvature(it, v[:2] / 10, iterations) for iterations in (0, 5)]
    return [*found, moved, *curved]


_kernel: InNumpy = IN_NUMPY


def use(backend: Backend) -> None:
    """Use that kernel for float32 from now on. Raises NoCpp."""
    global _kernel
    _kernel = in_cpp() if backend == "c++" else IN_NUMPY
    if isinstance(_kernel, InCpp):
        _kernel.functions.keep_freed_memory()


def used() -> Backend:
    """Return the name of the kernel for float32."""
    return "numpy" if _kernel is IN_NUMPY else "c++"


def of(array: Float) -> InNumpy:
    """Return the kernel for numbers of an array's type."""
    return _kernel if array.dtype == np.float32 else IN_NUMPY
