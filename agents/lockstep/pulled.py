"""Gradients of the functions of an algorithm's rule: by PyTorch, or in closed form where a built-in
function has one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import torch

from agents.lockstep import tree
from agents.lockstep.backend import array, tensor
from agents.lockstep.kernel import Float

Pull = Callable[[Float], Float]
"""Map from the gradient in a function's values to the gradient in its argument."""
Closed = TypeVar("Closed", bound=Callable[..., tuple[Float, Pull]])
_CLOSED: dict[int, tuple[Callable, Callable[..., tuple[Float, Pull]]]] = {}
"""Closed forms by the identity of their function, which the entry keeps alive; any other function,
even a wrapper, has none."""


def closed_form(function: Callable) -> Callable[[Closed], Closed]:
    """Decorate the closed form of a rule's function: (config, argument, ...) as arrays -> values
    and `Pull`."""

    def closed(form: Closed) -> Closed:
        _CLOSED[id(function)] = function, form
        return form

    return closed


def has_closed_form(function: Callable) -> bool:
    """Whether `pulled` needs no PyTorch for a function."""
    return id(function) in _CLOSED


def pulled(function: Callable, config: Any, at: Float, *others: Any) -> tuple[Float, Pull]:
    """Return the values of a rule's function at `at`, and the `Pull` of gradients to `at`."""
    if id(function) in _CLOSED:
        return _CLOSED[id(function)][1](config, at, *others)
    leaf = tree.tensors(at).requires_grad_()
    with torch.enable_grad():
        values = function(config, leaf, *tree.tensors(others))

    def pull(slope: Float) -> Float:
        if not values.requires_grad:  # a constant
            return 0.0 * at
        return array(torch.autograd.grad(values, leaf, tensor(slope))[0])

    return array(values.detach()), pull
