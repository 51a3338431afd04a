"""The examples library_cpo and library_sac_lag, which follow the paper group's library, compared
with CPO and SAC-Lag."""

import numpy as np
import pytest
import torch

from agents.algorithms import cpo, sac_lag
from agents.lockstep import tree
from agents.sac import update as sac
from agents.sac.replay import Batch
from agents.trust_region import Problem, conjugate_gradient


def problem(gradient, cost_gradient, excess):
    """Return a problem with the identity as Hessian and δ = 0.01."""
    gradient, b = torch.tensor([gradient]), torch.tensor([cost_gradient])
    solve = lambda v: conjugate_gradient(lambda x: x, v, 2)  # noqa: E731
    return Problem(gradient, lambda: b, torch.tensor([excess]), lambda v: v, solve, 0.01)


def test_above_the_limit_the_librarys_cpo_may_increase_the_cost(library):
    """g = (.6, .8), b = (1, 0), c = .05: q = 1, r = .6, s = 1, so that the branches of the dual are
    -.162 (λ = 12) and -.141 (λ = √50). ν = .05 √50 - .6 < 0, so the step is g / √50, and the
    predicted cost grows; CPO's step goes back to the limit."""
    found = problem([0.6, 0.8], [1.0, 0.0], 0.05)
    its = library.cpo.step(library.cpo.LibraryCPOConfig(), found)
    assert its.case.tolist() == [library.cpo.BROKEN]
    expected = [[0.6 / 50**0.5, 0.8 / 50**0.5]]
    torch.testing.assert_close(its.displacement, torch.tensor(expected), rtol=1e-4, atol=1e-4)
    ours = cpo.step(cpo.CPOConfig(), found).displacement
    assert ours[0, 0].item() == pytest.approx(-0.05, abs=1e-5)


def test_the_librarys_cpo_does_not_follow_a_short_gradient(library):
    """The squared norm, .05, is below the residual at which its conjugate gradients stop."""
    config, nothing = library.cpo.LibraryCPOConfig(), problem([0.1, 0.2], [0.0, 0.0], -1.0)
    assert library.cpo.solve(config, nothing, torch.tensor([[0.1, 0.2]])).abs().max() < 2e-4
    longer = torch.tensor([[0.3, 0.2]])
    torch.testing.assert_close(library.cpo.solve(config, nothing, longer), longer)


def test_the_librarys_multiplier_uses_the_actions_of_the_replay(library):
    """The limit lies between the cost critics' values at the replay's action, (1, 1), and at the
    policy's, (0, 0): SAC-Lag's multiplier and the library's move in opposite directions."""
    config = sac_lag.SACLagConfig(learning_rate=1e-9)
    nets = sac.make_nets(config, 2, 2, 1)
    state = sac.initial_state(nets, config, sac_lag.RULE, [0])
    state = state._replace(actor=0 * state.actor)  # with noise 0 its action is 0
    nothing = np.zeros((1, 1, 2), np.float32)
    zero, zeros, replayed = nothing[..., 0], nothing, nothing + 1
    batch = Batch(zeros, replayed, zero, zero[None], zeros, zero, zero)

    def risk(action):
        seen = torch.from_numpy(np.concatenate([zeros, action], axis=-1))
        values = nets.critic.forward_each(torch.from_numpy(state.critics), seen)
        return values[0, 2:].max().item()

    limit = 0.5 * (risk(replayed) + risk(zeros))
    config = sac_lag.SACLagConfig(learning_rate=1e-9, cost_limit=limit)
    noise = sac.UpdateNoise(zeros, zeros)
    moved = []
    for rule in (sac_lag.RULE, library.sac_lag.rule):
        after, _ = sac.update(nets, config, rule, tree.copy(state), batch, noise)
        moved.append(after.multipliers[0].parameter[0, 0].item())
    signs = [risk(action) > limit for action in (zeros, replayed)]
    assert signs[0] != signs[1]
    assert [step > 0 for step in moved] == signs
