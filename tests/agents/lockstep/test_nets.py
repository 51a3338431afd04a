"""Networks with a run axis against PyTorch's modules, one run at a time."""

import numpy as np
import pytest
import torch
from modules import ACTIVATIONS, flat, module, plain
from small_trainings import trained
from torch import nn
from toys import register

from agents.lockstep.nets import LANES, MLP, forward_numpy, mlp

register()
SIZES = [(2, 64, 64, 4), (3, 17, 40, 2), (3, 5, 1), (7, 1)]
EVERY = [(activation, sizes) for activation in ACTIVATIONS for sizes in SIZES]


def parameters(net, n):
    return torch.from_numpy(np.stack([net.initial(np.random.default_rng(i)) for i in range(n)]))


@pytest.mark.parametrize(("activation", "sizes"), EVERY)
def test_update_acting_and_export_are_one_network(activation, sizes):
    """All three against PyTorch's own modules, with weights that PyTorch drew."""
    net = MLP(sizes, activation)
    theirs = [plain(net) for _ in range(5)]
    params = torch.stack([flat(net, one, lambda p: p) for one in theirs])
    x = 3 * torch.randn(5, 9, sizes[0], generator=torch.Generator().manual_seed(0)).double()
    expected = torch.stack([one(xi) for one, xi in zip(theirs, x, strict=True)]).detach()
    torch.testing.assert_close(net.forward(params, x), expected)
    layers = net.layers(params.numpy())
    in_numpy = forward_numpy(layers, x.numpy(), activation)
    torch.testing.assert_close(torch.from_numpy(in_numpy), expected)
    for run in range(5):
        exported = mlp([layer[run] for layer in layers], activation)
        shapes = [layer.weight.shape for layer in exported if isinstance(layer, nn.Linear)]
        assert shapes == [layer.weight.shape for layer in theirs[run][::2]]
        torch.testing.assert_close(exported(x[run].float()).double(), expected[run], rtol=1e-5,
                                   atol=1e-5)  # fmt: skip


@pytest.mark.parametrize(("activation", "sizes"), EVERY)
def test_the_gradient_is_that_of_each_network_alone(activation, sizes):
    """The gradient of a sum over networks against a backward pass of each PyTorch module, in
    float64. In the padding it is exactly 0."""
    net = MLP(sizes, activation)
    params = parameters(net, 3).double()
    x = torch.randn(3, 9, sizes[0], generator=torch.Generator().manual_seed(1)).double()
    params.requires_grad_()
    (net.forward(params, x) ** 2).mean(dim=(1, 2)).sum().backward()
    gradient, params = params.grad, params.detach()
    for vector, xi, row in zip(params, x, gradient, strict=True):
        theirs = module(net, vector)
        (theirs(xi) ** 2).mean().backward()
        torch.testing.assert_close(row, flat(net, theirs), rtol=1e-9, atol=1e-12)
        padding = flat(net, theirs, torch.ones_like) == 0
        assert (vector[padding] == 0).all()
        assert (row[padding] == 0).all()


def test_the_flat_vector_is_padded_to_a_multiple_of_32():
    assert MLP((2, 64, 64, 4)).size == 4640  # 2·64 + 64 + 64·64 + 64 + 64·4 + 4 = 4612
    assert MLP((2, 33, 4)).size == 256  # 2·33 + 33 + 33·4 + 4 = 235
    assert all(MLP(sizes).size % LANES == 0 for sizes in SIZES)


def test_initial_parameters_are_distributed_as_pytorchs():
    """Uniform in ±1/√(inputs), weights and biases alike."""
    net = MLP((16, 401, 9))
    weight1, bias1, weight2, bias2 = net.layers(net.initial(np.random.default_rng(0))[None])
    for array, n in ((weight1, 16), (bias1, 16), (weight2, 401), (bias2, 401)):
        assert np.abs(array).max() <= 1 / np.sqrt(n)
        assert array.std() == pytest.approx(1 / np.sqrt(3 * n), rel=0.25)


@pytest.mark.parametrize(
    ("name", "activation"), [("sac-lag", "silu"), ("trpo-lag", "tanh"), ("ppo-lag", "relu")]
)
def test_trained_networks(name, activation):
    """After a training with odd layer sizes a run is, bit for bit, what it is alone, the padding is
    still exactly 0, and acting, update and export compute the same policy."""
    sizes = {"hidden": (17, 40), "activation": activation, "input_scale": (7.0, 0.3), "steps": 200}
    it, alone = (trained(name, seeds=seeds, **sizes).learner for seeds in ((0, 1), (1,)))
    whole, own = it.state_dict(), alone.state_dict()
    for key, value in own.items():
        if not key.startswith("replay"):
            np.testing.assert_array_equal(value[0], whole[key][1], err_msg=key)
    actor_net = getattr(it.nets.actor, "net", it.nets.actor)
    for net, key in ((actor_net, "actor"), (it.nets.critic, "critics")):
        padding = (flat(net, plain(net), torch.ones_like) == 0).numpy()
        assert padding.any()
        assert (whole[key][..., : net.size][..., padding] == 0).all()
        assert (whole[key][..., : net.size][..., ~padding] != 0).all()
    x = np.random.default_rng(0).normal(size=(2, 20, 2)).astype(np.float32)
    acted, scaled = it.policy()(x, None), torch.from_numpy(x) * torch.tensor([7.0, 0.3])
    for run in (0, 1):
        vector = torch.from_numpy(whole["actor"][run, : actor_net.size])
        updated = actor_net.forward(vector[None], scaled[run : run + 1])[0, :, :1]
        theirs = module(actor_net, vector)(scaled[run].double())[:, :1].detach()
        if name == "sac-lag":
            updated, theirs = updated.tanh(), theirs.tanh()
        for found in (updated, it.module(run)(torch.from_numpy(x[run])).detach()):
            np.testing.assert_allclose(found, acted[run], atol=2e-6)
        np.testing.assert_allclose(theirs, acted[run], atol=2e-6)
