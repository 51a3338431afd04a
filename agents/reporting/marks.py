"""The best values of a table, as the paper's tables highlight them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import TypeVar

from agents.results.measures import Measure, measure, measures

Key = TypeVar("Key", bound=Hashable)


def best(
    candidates: Mapping[Key, tuple[Mapping[str, float | None], bool | None]],
) -> set[tuple[Key, str]]:
    """The best measures of some candidates.

    candidates: measures, and whether the candidate is within its cost limit (None: without one or
    not known). Of each measure of training the lowest, or the highest where that is better; of
    those of the trained policy all that belong to the candidates of the highest J_R among those
    within their limit. All to the digits that are printed, so that equal ones are marked together;
    nothing where there is nothing to compare with. Source: caption of table Circle2DResults.
    """
    marked: set[tuple[Key, str]] = set()
    safest = _best_policies(candidates)
    for column in measures():
        values = _printed(candidates, column)
        if len(values) < 2 or column.better == "neither":
            continue
        if column.of == "policy":
            chosen = safest & values.keys()
        else:
            wanted = (min if column.better == "lower" else max)(values.values())
            chosen = {key for key, value in values.items() if value == wanted}
        marked |= {(key, column.name) for key in chosen}
    return marked


def _best_policies(
    candidates: Mapping[Key, tuple[Mapping[str, float | None], bool | None]],
) -> set[Key]:
    """The candidates of the highest J_R among those within their cost limits."""
    within = {key: candidate for key, candidate in candidates.items() if candidate[1]}
    known = _printed(within, measure("J_R"))
    return {key for key, value in known.items() if value == max(known.values())}


def _printed(
    candidates: Mapping[Key, tuple[Mapping[str, float | None], bool | None]], measure: Measure
) -> dict[Key, float]:
    """The measure of each candidate that has it, as it is printed."""
    values = {key: of.get(measure.name) for key, (of, _) in candidates.items()}
    return {key: round(v, measure.digits) for key, v in values.items() if v is not None}


def marking() -> str:
    """The rule of `best` in words."""
    of_training = [measure for measure in measures() if measure.of == "training"]
    rules = [
        f"the {rule} {_list(chosen)}"
        for rule, better in (("lowest", "lower"), ("highest", "higher"))
        if (chosen := [measure for measure in of_training if measure.better == better])
    ]
    of_policy = [m for m in measures() if m.of == "policy" and m.better != "neither"]
    if of_policy:
        rules.append(f"{_list(of_policy)} of the highest return with every seed within the limit")
    return "; ".join(rules)


def _list(chosen: Iterable[Measure]) -> str:
    """Their words: A, B and C."""
    *first, last = dict.fromkeys(measure.word or measure.title for measure in chosen)
    return f"{', '.join(first)} and {last}" if first else last
