"""Updates on another device than the CPU, as far as a machine without a GPU can tell.

The meta device holds shapes without numbers, and refuses to mix with tensors of another device: so
every tensor that an update makes must be made where the others are.
"""

import numpy as np
import pytest
import torch

from agents.algorithms import ALGORITHMS
from agents.errors import UserError
from agents.lockstep import backend
from agents.lockstep.replay import Batch
from agents.on_policy import critics
from agents.sac import update as sac
from agents.trust_region import policy_step as trpo

R, B = 3, 64


@pytest.fixture
def elsewhere():
    torch.set_default_device("meta")
    yield torch.empty
    torch.set_default_device(None)


@pytest.mark.parametrize("name", ["sac-lag", "sac-lb", "wcsac"])
def test_off_policy_updates(name, elsewhere):
    config, rule = ALGORITHMS[name].config(batch_size=B), ALGORITHMS[name].rule
    nets = sac.make_nets(config, 3, 2)
    state = sac.initial_state(nets, config, rule, range(R))
    shapes = (R, B, 3), (R, B, 2), (R, B), (R, B), (R, B, 3), (R, B)
    batch, noise = Batch(*map(elsewhere, shapes)), elsewhere(R, B, 2)
    after, metrics = sac.update(nets, config, rule, state, batch, sac.UpdateNoise(noise, noise))
    assert after.actor.shape == state.actor.shape
    assert after.critics.is_meta
    assert all(value.is_meta and value.shape == (R,) for value in metrics.values())


@pytest.mark.parametrize("name", ["trpo-lag", "cpo"])
def test_on_policy_updates(name, elsewhere):
    """Up to the line search, which looks at numbers."""
    config, rule = ALGORITHMS[name].config(batch_size=B), ALGORITHMS[name].rule
    nets = trpo.make_nets(config, 3, 2)
    state = trpo.initial_state(nets, config, rule, range(R))
    shapes = (R, 512, 3), (R, 512, 2), (R, 512), (R, 512), (R, 512), (R, 2, 512), (R,), (R,)
    epoch = trpo.Epoch(*map(elsewhere, shapes))
    with pytest.raises(RuntimeError, match="cannot be called on meta tensors"):
        trpo.policy_step(nets, config, rule, state, epoch)
    rows, weight = backend.tensor(np.zeros((R, B), dtype=np.int64)), elsewhere(R, B)
    after, losses = critics.critic_step(nets, config, state, epoch, rows, weight)
    assert after.critics.is_meta
    assert losses.is_meta


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_no_gpu_is_a_mistake():
    with pytest.raises(UserError, match=r"device 'cuda': torch .* sees no GPU"):
        backend.configure(device="cuda")
