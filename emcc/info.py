"""The cost in the info of a step: its only checks, for single and for vector environments.

Where `StreakCost` has weighted info["cost"], it is info["plain_cost"].
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emcc.arrays import as_array


def cost_of(info: Mapping[str, Any]) -> float:
    """info["cost"] of one environment's step.

    Its value is checked by `CostRecorder`. KeyError: no cost. TypeError: not one number.
    """
    name = _name_in(info)
    cost = as_array(info[name], f"info['{name}']")
    if cost.size != 1:
        raise TypeError(f"info['{name}'] must be one number, got shape {cost.shape}")
    return float(cost.reshape(()))


def costs_of(
    infos: Mapping[str, Any], active: NDArray[np.bool_], done: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The costs of a vector environment's step, [num_envs]; 0 where `active` is False.

    active: [num_envs] environments that took a step; done: [num_envs] episodes that ended with it.
    Where environments reset in the step that ends an episode, infos["cost"] may belong to the next
    episode's reset; the cost of the last step is then in infos["final_info"].
    KeyError, ValueError: no cost at all, or of one environment. TypeError: an array of whole
    numbers or bools that gymnasium has made of all costs.
    """
    final = infos.get("final_info", {})
    if isinstance(final, np.ndarray):  # gymnasium before 1.0: an array of dicts
        return _with_final_dicts(infos, final, active, done)
    finals = active & done & ("cost" in final)
    others = active & ~finals
    costs = np.zeros(len(active))
    if finals.any():
        costs[finals] = _given_costs(final, finals)[finals]
    if others.any():
        costs[others] = _given_costs(infos, others)[others]
    return costs


def _with_final_dicts(
    infos: Mapping[str, Any],
    final: NDArray[Any],
    active: NDArray[np.bool_],
    done: NDArray[np.bool_],
) -> NDArray[np.float64]:
    finals = active & done & np.array([info is not None for info in final])
    others = active & ~finals
    costs = np.zeros(len(active))
    costs[finals] = [cost_of(final[index]) for index in np.flatnonzero(finals)]
    if others.any():
        costs[others] = _given_costs(infos, others)[others]
    return costs


def _given_costs(infos: Mapping[str, Any], needed: NDArray[np.bool_]) -> NDArray[Any]:
    """infos["cost"], whose mask infos["_cost"], where there is one, must cover those needed; with a
    mask, which is gymnasium's own, no array of whole numbers or bools."""
    name = _name_in(infos)
    missing = needed & ~np.asarray(infos.get(f"_{name}", needed), dtype=bool)
    if missing.any():
        raise ValueError(f"sub-environment {int(np.argmax(missing))} gave no {name!r} in its info")
    costs = as_array(infos[name], f"info['{name}']")
    if f"_{name}" in infos and costs.dtype.kind in "biu":
        raise TypeError(
            f"info['{name}'] came as {costs.dtype}: gymnasium's vector environments give all costs "
            "the type of the first, which may have rounded others; let every one give a float"
        )
    return costs


def _name_in(info: Mapping[str, Any]) -> str:
    """The name of the plain cost. KeyError: no cost."""
    if "cost" not in info:
        raise KeyError(f"the environment's info has no 'cost'; it has {sorted(info)}")
    return "plain_cost" if "plain_cost" in info else "cost"
