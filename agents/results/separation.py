"""Pairs of algorithms that EMCC tells apart and the cost rate does not, by a rule."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

from agents.results import thirds
from agents.results.reading import Group
from agents.results.statistics import LEVEL, corrected, difference_of, equivalence_of, p_of
from emcc import Interval
from emcc.parts import PARTS
from emcc.statistics import FEWEST_RUNS

MARGIN = 0.02
"""Cost per step. Cost rates are printed to two digits; two of the last ones are taken as equal."""


class Comparison(NamedTuple):
    """Two algorithms on a task in a third of training."""

    a: Group
    b: Group
    part: float
    """The third, as in `emcc.parts.PARTS`."""
    rates: tuple[list[float], list[float]]
    """Cost rates of the runs of A and of B."""
    emccs: tuple[list[float], list[float]]
    rate_p: float
    """Permutation test of the cost rates."""
    equivalence_p: float
    """Equivalence test of the cost rates with `MARGIN`."""
    emcc_p: float
    """Permutation test of EMCC, corrected for all comparisons (Holm)."""

    @property
    def equal_rates(self) -> bool:
        """Whether the cost rates are not told apart and equivalent."""
        return self.rate_p > LEVEL >= self.equivalence_p

    @property
    def separated(self) -> bool:
        """Whether EMCC tells them apart and the cost rate does not."""
        return self.equal_rates and self.emcc_p <= LEVEL

    @property
    def rate_difference(self) -> Interval | None:
        """B - A."""
        return difference_of(*self.rates, self._one_place)

    @property
    def emcc_difference(self) -> Interval | None:
        """B - A."""
        return difference_of(*self.emccs, self._one_place)

    @property
    def _one_place(self) -> bool:
        return self.a.one_place and self.b.one_place


def comparisons(groups: Sequence[Group]) -> list[Comparison]:
    """All pairs of groups on a task, in each third. Groups of fewer than five runs are in none."""
    found = list(_compared(groups))
    p_values = corrected({k: p_of(*of.emccs) for k, of in enumerate(found)})
    return [of._replace(emcc_p=p_values[k]) for k, of in enumerate(found)]


def _compared(groups: Sequence[Group]) -> Iterator[Comparison]:
    enough = [group for group in groups if len(group.runs) >= FEWEST_RUNS]
    by_third = {id(group): thirds.of_group(group) for group in enough}
    for a, b in combinations(enough, 2):
        for part in PARTS if a.config.task == b.config.task else ():
            sides = by_third[id(a)][part], by_third[id(b)][part]
            rates, emccs = (
                ([getattr(k, name) for k in sides[0]], [getattr(k, name) for k in sides[1]])
                for name in ("cost_rate", "emcc")
            )
            rate_p, equivalence_p = p_of(*rates), equivalence_of(*rates, MARGIN)
            assert rate_p is not None
            assert equivalence_p is not None
            yield Comparison(a, b, part, rates, emccs, rate_p, equivalence_p, 1.0)
