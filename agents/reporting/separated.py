"""The table of pairs that EMCC tells apart and the cost rate does not."""

from __future__ import annotations

from collections.abc import Sequence

from agents.paper.settings import by_task, name_of
from agents.reporting.table import Number, Row, Table, number_of, p_number
from agents.results.reading import Group
from agents.results.separation import MARGIN, Comparison, comparisons
from agents.results.statistics import LEVEL, mean_of
from emcc.parts import ALPHA, PARTS
from emcc.statistics import FEWEST_RUNS

RULE = (
    "Compared are all pairs of algorithms on a task in each third of training, of "
    f"{FEWEST_RUNS} seeds or more each; cost rate and EMCC (α = {ALPHA:g}) are those of the "
    "third's rollouts. Cost rates count as equal where a permutation test does not tell them apart "
    f"(p > {LEVEL:g}) and an equivalence test, two one-sided permutation tests, shows that their "
    f"means differ by less than {MARGIN:g} (p ≤ {LEVEL:g}); neither is corrected, and not to be "
    "told apart alone would not make them equal. EMCC differs where the permutation test's p is at "
    f"most {LEVEL:g} after correction for all comparisons (Holm), whatever their cost rates"
)
HEAD = ("cost rate A", "cost rate B", "B - A", "p equal", "EMCC A", "EMCC B", "B - A", "p")


def separated_table(groups: Sequence[Group]) -> Table | None:
    """The separated pairs, with the counts in a sentence; None where there is nothing to compare.

    Columns "p equal" and "p": of the equivalence test of cost rates, and of the test of EMCC.
    """
    found = comparisons([group for of_task in by_task(groups).values() for group in of_task])
    if not found:
        return None
    not_told = [of for of in found if of.rate_p > LEVEL]
    equal = [of for of in not_told if of.equal_rates]
    shown = [of for of in equal if of.separated]
    differ = sum(of.emcc_p <= LEVEL for of in not_told)
    caption = (
        f"{RULE}. Of {len(found)} comparisons the cost rate does not tell {len(not_told)} apart, "
        f"of which EMCC tells {differ} apart; {len(equal)} have equal cost rates, of which EMCC "
        f"tells {len(shown)} apart: these are listed. Differences with Welch's 95 % t interval, "
        "where all runs of either end in one place; p equal: of the equivalence test; p: of EMCC, "
        f"corrected for {len(found)} tests"
    )
    return Table(caption, ["A and B", *HEAD], [_row(of) for of in shown])


def _row(of: Comparison) -> Row:
    names = " and ".join(name_of(group) for group in (of.a, of.b))
    cells = [
        *_means(of.rates),
        number_of(of.rate_difference, 3, signed=True),
        p_number(of.equivalence_p),
        *_means(of.emccs),
        number_of(of.emcc_difference, 3, signed=True),
        p_number(of.emcc_p),
    ]
    return Row(f"{of.a.config.task}, {PARTS[of.part]}: {names}", cells, kind="difference")


def _means(sides: tuple[list[float], list[float]]) -> list[Number]:
    means = (mean_of(side) for side in sides)
    return [Number(of and of.value, 3) for of in means]
