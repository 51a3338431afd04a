"""The kernels in C++ and NumPy against each other and PyTorch; a run alone and among others."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from small_trainings import assert_same, finished, of_run, small, trainer
from toys import register

from agents import first_order
from agents.lockstep import kernel
from agents.lockstep.descent import Clipped, Descent, Moments, Squared, orders
from agents.lockstep.nets import MLP
from agents.training.config import TrainConfig

register()


def kernels():
    try:
        return [kernel.in_cpp(), kernel.IN_NUMPY]
    except kernel.NoCpp as error:
        pytest.skip(str(error))


shapes = st.tuples(
    st.integers(1, 40),
    st.lists(st.integers(1, 70), max_size=3),
    st.integers(1, 20),
    st.sampled_from(["tanh", "relu", "silu"]),
    st.integers(1, 3),  # inputs
    st.integers(1, 3),  # networks that share one
    st.integers(1, 150),  # rows
)


@settings(max_examples=60, deadline=None)
@given(shapes)
def test_both_kernels_agree_with_autograd_in_float64(shape):
    """Values, both gradients and the product with a policy's curvature, for any depth and width.

    A network's numbers are, bit for bit, those of the network alone.
    """
    n_in, hidden, n_out, activation, inputs, share, rows = shape
    net, nets = MLP((n_in, *hidden, n_out), activation), inputs * share
    rng = np.random.default_rng(0)
    params = np.stack([net.initial(rng) for _ in range(nets)])
    x, dy = rng.normal(size=(inputs, rows, n_in)), rng.normal(size=(nets, rows, n_out))
    v = np.where(params == 0, 0, rng.normal(size=params.shape))
    x, dy, v = (a.astype(np.float32) for a in (x, dy, v))

    def values(p, x):
        at = 0
        x = x.repeat_interleave(share, dim=0)
        for k, (a, b) in enumerate(pairwise(net.sizes)):
            w, bias = p[:, at : at + a * b].view(-1, a, b), p[:, None, at + a * b : at + a * b + b]
            x, at = x @ w + bias, at + a * b + b
            if k < len(net.sizes) - 2:
                x = getattr(torch.nn.functional, activation)(x)
        return x

    given_ = [torch.from_numpy(a).double().requires_grad_() for a in (params, x)]
    y = values(*given_)
    expected = [y.detach(), *torch.autograd.grad(y, given_, torch.from_numpy(dy).double())]
    _, jy = torch.autograd.functional.jvp(
        lambda p: values(p, given_[1]), given_[0], torch.from_numpy(v).double()
    )
    weight = rng.random((nets, rows))
    log_std, of_log_std = rng.normal(0, 0.3, (2, nets, n_out))
    u = torch.from_numpy(weight[..., None] * np.exp(-2 * log_std)[:, None]) * jy
    (of_params,) = torch.autograd.grad(values(*given_), given_[:1], u)
    of_spread = 2 * weight.sum(axis=1, keepdims=True) * of_log_std
    direction = np.concatenate([v, of_log_std], axis=1)
    curved = np.concatenate([of_params.numpy(), of_spread], axis=1) + 0.1 * direction
    expected.append(torch.from_numpy(curved))
    for own in kernels():
        found, tape = own.forward(net, params, x, share)
        gp, gx = own.backward(net, params, x, tape, dy, "px", share)
        gx = gx.reshape(inputs, share, rows, n_in).sum(axis=1)
        policies = np.concatenate([params, log_std], axis=1, dtype=np.float32)
        seen, at = np.repeat(x, share, axis=0), slice(net.size, net.size + n_out)
        it = kernel.Curvature(net, policies, at, seen, weight.astype(np.float32), 0.1)
        curved = own.curvature(it, direction.astype(np.float32))
        for ours, theirs in zip((found, gp, gx, curved), expected, strict=True):
            scale = max(1.0, theirs.abs().max().item())
            np.testing.assert_allclose(ours / scale, theirs.detach().numpy() / scale, atol=3e-5)
        k = nets - 1
        alone, tape = own.forward(net, params[k:], x[k // share :][:1])
        np.testing.assert_array_equal(alone[0], found[k])
        of_p, _ = own.backward(net, params[k:], x[k // share :][:1], tape, dy[k:], "p")
        np.testing.assert_array_equal(of_p[0], gp[k])


def passed(own, dtype, net, loss, log_std, start, *pass_):
    """Return the parameters [R, K, P] after a pass from `start`, and the records [R, K]."""
    x, order, steps, batch_size = pass_
    runs, k, size = start.shape
    params = start.astype(dtype).reshape(runs * k, size)
    size = k * size
    mean, square = np.zeros((runs, size), dtype), np.full((runs, size), 0.01, dtype)
    moments = Moments(mean, square, *np.full((2, runs), 0.5, dtype))
    kind, *columns = [a.astype(dtype) if isinstance(a, np.ndarray) else a for a in loss]
    what = (net, params, moments, x.astype(dtype), batch_size, 0.1, log_std, 1.0)
    record = own.descend(Descent(*what), kind(*columns), order, steps)
    return params.reshape(start.shape), record.reshape(runs, k)


@settings(max_examples=20, deadline=None)
@given(shapes, st.integers(1, 100), st.booleans())
def test_a_pass_over_minibatches_agrees_with_one_in_float64(shape, batch_size, policy):
    """For policies and critics, any number of rows and any batch size.

    A run's numbers are, bit for bit, those of the run alone.
    """
    n_in, hidden, n_out, activation, runs, share, rows = shape
    rng = np.random.default_rng(0)
    steps = rng.integers(rows, size=runs) + 1
    order, x = orders(steps, [rng] * runs), rng.normal(size=(runs, rows, n_in + 1))
    columns = rng.normal(size=(runs, share + 1, rows))
    if policy:
        action, share = rng.normal(size=(runs, rows, n_out)), 1
        loss = (Clipped, action, columns[:, 1], columns[:, 0] - 1.5 * n_out, 0.3)
    else:
        loss = (Squared, columns[:, 1:])
    net = MLP((n_in, *hidden, n_out if policy else 1), activation)
    log_std = slice(net.size, net.size + n_out * policy)
    start = np.stack([[net.initial(rng) for _ in range(share)] for _ in range(runs)])
    start = np.pad(start, ((0, 0), (0, 0), (0, n_out * policy)))

    def found(own, dtype, run=slice(None)):
        part = [a[run] if isinstance(a, np.ndarray) else a for a in loss]
        return passed(own, dtype, net, part, log_std, start[run], x[run], order[run], steps[run],
                      batch_size)  # fmt: skip

    expected = found(kernel.IN_NUMPY, np.float64)
    for own in kernels():
        ours, alone = found(own, np.float32), found(own, np.float32, slice(runs - 1, runs))
        for values, theirs, its in zip(ours, expected, alone, strict=True):
            np.testing.assert_allclose(values, theirs, atol=1e-4, rtol=1e-4)
            np.testing.assert_array_equal(values[-1:], its)


def test_nan_stays_in_its_own_run():
    net = MLP((2, 32, 1))
    params = np.stack([net.initial(np.random.default_rng(0)) for _ in range(2)])
    params[1, 0] = np.nan
    x = np.ones((2, 5, 2), np.float32)
    for own in kernels():
        y, tape = own.forward(net, params, x)
        gp, _ = own.backward(net, params, x, tape, np.ones_like(y), "p")
        assert np.isfinite(y[0]).all() and np.isnan(y[1]).all()
        assert np.isfinite(gp[0]).all() and np.isnan(gp[1]).any()


def test_a_kernel_that_computes_wrongly_is_not_taken():
    class Wrong(kernel.InNumpy):
        def values(self, *given):
            return 1.001 * super().values(*given)

    assert kernel.error_of(kernel.IN_NUMPY) < 1e-5
    assert kernel.error_of(Wrong()) > kernel.TOLERANCE


def trained_in(backend, name, seeds, **changes):
    """Return the finished trainer of some runs, trained with a kernel."""
    kernel.use(backend)
    try:
        config = TrainConfig(name, ("Walk-v0",), seeds, 150, small(name, **changes))
        return finished(trainer(config))
    finally:
        kernel.use("c++")


def assert_one_but_for_rounding(found, expected, near):
    for key, value in found.items():
        if value.dtype.kind == "f" and key.startswith(("actor", "critics")):
            np.testing.assert_allclose(value, expected[key], atol=near, err_msg=key)


@pytest.mark.parametrize("name", ["ppo-lag", "cpo", "sac-lag", "cup", "wcsac"])
def test_trainings_in_cpp_and_numpy_agree_up_to_rounding(name):
    """After the first epochs; with either kernel a run is, bit for bit, what it is alone.

    The tolerance is sharp: conjugate gradients in single precision differ by 8e-5 for CPO.
    """
    kernels()
    found, odd = {}, {} if "sac" in name else {"batch_size": 20, "hidden": (17, 40)}
    for backend in ("c++", "numpy"):
        runs = [trained_in(backend, name, seeds, **odd) for seeds in ((0, 1, 2), (1,))]
        found[backend] = of_run(runs[0], 1)
        assert_same(found[backend], of_run(runs[1], 0))
    assert_one_but_for_rounding(found["c++"], found["numpy"], 1e-5)


@pytest.mark.parametrize("batch_size", [20, 32])
def test_a_rule_trains_alike_by_autograd_and_in_closed_form(batch_size, monkeypatch):
    """By autograd, too, a run is, bit for bit, what it is alone."""
    kernels()
    how = {"batch_size": batch_size}
    closed = of_run(trained_in("c++", "ppo-lag", (0, 1), **how), 1)
    monkeypatch.setattr(first_order, "loss_of", first_order.Raised)
    by_autograd = of_run(trained_in("c++", "ppo-lag", (0, 1), **how), 1)
    assert_same(by_autograd, of_run(trained_in("c++", "ppo-lag", (1,), **how), 0))
    assert_one_but_for_rounding(by_autograd, closed, 1e-5)
    assert any((by_autograd[key] != closed[key]).any() for key in closed)
