"""Functions of an algorithm's rule with their gradients: by PyTorch, or in the closed form that a
built-in function has beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import torch

from agents.lockstep import tree
from agents.lockstep.backend import array, tensor
from agents.lockstep.kernel import Float

Pull = Callable[[Float], Float]
"""A gradient in a function's values -> that in the numbers that the values are of."""
Closed = TypeVar("Closed", bound=Callable[..., tuple[Float, Pull]])
_CLOSED: dict[int, tuple[Callable, Callable[..., tuple[Float, Pull]]]] = {}
"""By the identity of a function, which the entry keeps alive; another, even one that wraps it, has
no closed form."""


def closed_form(function: Callable) -> Callable[[Closed], Closed]:
    """Decorate the closed form of a function of a rule: (config, numbers, ...) as arrays -> values
    and `Pull`."""

    def closed(form: Closed) -> Closed:
        _CLOSED[id(function)] = function, form
        return form

    return closed


def has_closed_form(function: Callable) -> bool:
    """Whether `pulled` needs no PyTorch."""
    return id(function) in _CLOSED


def pulled(function: Callable, config: Any, at: Float, *others: Any) -> tuple[Float, Pull]:
    """The values of a rule's function, and how gradients in them go to the numbers `at`."""
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
