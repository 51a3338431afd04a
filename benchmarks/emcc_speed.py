"""Time to compute EMCC of 1e8 steps, compared with a plain itertools.groupby loop.

    python benchmarks/emcc_speed.py

Target: streaks, MCC and EMCC by part in less than 2 s and 2 GB, on one thread.
"""

import itertools
import resource
import time
from collections.abc import Iterator

import numpy as np

from emcc import EpisodeRecords, emcc_by_part, longest_streaks

EPISODES, LENGTH, PER_ROLLOUT = 2_000_000, 50, 10
SLICE = 20_000  # episodes for the plain loop


def random_costs(rng: np.random.Generator) -> np.ndarray:
    """Draw cost steps, a quarter of all steps, in streaks of 5 on average; in blocks for memory."""
    costs = np.empty(EPISODES * LENGTH, dtype=bool)
    for block in np.array_split(costs, 100):
        ends = np.flatnonzero(rng.random(block.size) < 0.1)  # a streak or a gap ends
        block[:] = np.searchsorted(ends, np.arange(block.size)) % 2
        block &= np.repeat(rng.random(-(-block.size // LENGTH)) < 0.5, LENGTH)[: block.size]
    return costs


def by_part(costs: np.ndarray, lengths: np.ndarray) -> dict[float, float]:
    streaks = longest_streaks(costs, lengths)
    rows = np.arange(EPISODES)
    zero = np.zeros(EPISODES)
    records = EpisodeRecords(rows // PER_ROLLOUT, rows * LENGTH, lengths, zero, zero, streaks)
    return emcc_by_part(*records.mcc_per_rollout(), records.total_steps)


def plain_streaks(costs: list[float]) -> Iterator[int]:
    for start in range(0, len(costs), LENGTH):
        groups = itertools.groupby(costs[start : start + LENGTH], key=lambda cost: cost > 0)
        yield max((len(list(group)) for unsafe, group in groups if unsafe), default=0)


def main() -> None:
    lengths = np.full(EPISODES, LENGTH)
    flags = random_costs(np.random.default_rng(0))
    alternating = np.arange(flags.size, dtype=np.uint8) % 2 == 1
    print(f"{'costs':24} {'all':>7} {'streaks':>8} {'groupby loop':>13} {'ratio':>6}")
    for name, costs in [("random", flags), ("alternating", alternating)]:
        for dtype in (bool, np.float32):
            typed = costs.astype(dtype, copy=False)
            times = [time.perf_counter()]
            by_part(typed, lengths)
            times.append(time.perf_counter())
            streaks = longest_streaks(typed, lengths)
            times.append(time.perf_counter())
            plain = list(plain_streaks(typed[: SLICE * LENGTH].tolist()))
            times.append(time.perf_counter())
            assert plain == streaks[:SLICE].tolist()
            total, fast, slow = np.diff(times)
            slow *= EPISODES / SLICE
            label = f"{name} {np.dtype(dtype).name}"
            print(f"{label:24} {total:6.2f}s {fast:7.2f}s {slow:12.1f}s {slow / fast:5.0f}x")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory, data included: {peak:.2f} GB")


if __name__ == "__main__":
    main()
