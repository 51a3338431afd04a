"""Adam against PyTorch's, run by run."""

import torch

from agents.lockstep.nets import adam, no_moments


def test_against_torch():
    generator = torch.Generator().manual_seed(0)
    params = torch.randn(3, 2, 32, generator=generator)
    theirs = [params[run].clone().requires_grad_() for run in range(3)]
    optimizers = [torch.optim.Adam([p], lr=1e-2) for p in theirs]
    moments = no_moments(params)
    for _ in range(30):
        gradient = torch.randn(3, 2, 32, generator=generator) * 10 ** torch.arange(-3.0, 0).view(
            3, 1, 1
        )
        params, moments = adam(params, gradient, moments, 1e-2)
        for run, optimizer in enumerate(optimizers):
            theirs[run].grad = gradient[run].clone()
            optimizer.step()
    torch.testing.assert_close(params, torch.stack(theirs).detach(), rtol=1e-5, atol=1e-6)


def test_first_step_by_hand():
    """m̂ = g and v̂ = g², so the first step is the learning rate against the gradient's sign."""
    params = torch.zeros(1, 32)
    gradient = torch.full((1, 32), -4.0)
    params, _ = adam(params, gradient, no_moments(params), 0.5)
    torch.testing.assert_close(params, torch.full((1, 32), 0.5))
