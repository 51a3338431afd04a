"""Size of a run folder in an archive, by its parts: of one that was trained, or made up.

    python benchmarks/archive_size.py [FOLDER]

Made up are 10 runs of 1 000 000 steps in episodes of 50: costs come and go in streaks of five steps
on average, in 15 % of all steps, at random, which no compression foresees; positions are random
walks, returns noise of eight bytes. Trained agents repeat themselves more.
"""

import io
import sys
import time
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from agents.training.derive import GRID_MAX, WINDOWS, pack_costs, packed_results, smallest

SEEDS, STEPS, LENGTH, EPISODES = 10, 1_000_000, 50, 100
TASK = "Circle2D-1-v0"


def made_up(seed):
    """The arrays of a run that no one trained."""
    rng, count = np.random.default_rng(seed), STEPS // LENGTH
    pairs = STEPS // 20  # alternating gaps and streaks of geometric lengths
    lengths = np.column_stack((rng.geometric(3 / 85, pairs), rng.geometric(1 / 5, pairs)))
    costs = np.repeat(np.tile([0.0, 1.0], pairs), lengths.ravel())[:STEPS]
    costs = np.pad(costs, (0, STEPS - len(costs)))
    walks = np.cumsum(rng.normal(0, 0.02, (WINDOWS, LENGTH, 2)), axis=1) + 0.5
    points = (np.clip(walks, 0, 1) * GRID_MAX).astype(np.uint16)
    arrays = {"rollouts": np.full(count // 10, 10, np.uint16)}
    arrays |= {"length": smallest(np.full(count, LENGTH)), "return": rng.normal(-20, 5, count)}
    arrays |= {f"costs/cost/{name}": array for name, array in pack_costs(costs).items()}
    arrays |= {"replay/points": points.reshape(-1, 2), "replay/box": np.eye(2)}
    for policy in ("deterministic", "stochastic"):
        returns, steps = rng.normal(-20, 5, EPISODES), np.full(EPISODES, LENGTH)
        own = {"returns": returns, "costs": rng.integers(0, 9, (EPISODES, 1)) * 1.0}
        arrays |= {f"evaluation/{policy}/{k}": v for k, v in (own | {"lengths": steps}).items()}
    return arrays


def all_made_up():
    """The arrays of a training."""
    arrays = {f"{TASK}/{k}/{name}": v for k in range(SEEDS) for name, v in made_up(k).items()}
    rng = np.random.default_rng(99)
    at = np.clip(rng.normal(80, 30, (3, 100_000 * SEEDS // 3, 2)), 0, 159.9).astype(int)
    counts = [np.bincount(part[:, 0] * 160 + part[:, 1], minlength=160 * 160) for part in at]
    arrays[f"{TASK}/visits"] = np.array(counts, np.uint32).reshape(3, 160, 160)
    return arrays


def main() -> None:
    """Pack the results and print the compressed size of their parts."""
    if len(sys.argv) > 1:
        with np.load(Path(sys.argv[1]) / "results.npz") as results:
            arrays = dict(results)
    else:
        arrays = all_made_up()
    started = time.perf_counter()
    content = packed_results(arrays)
    took, parts = time.perf_counter() - started, Counter()
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        for info in file.infolist():
            names = info.filename.removesuffix(".npy").split("/")
            own = names[2 if len(names) > 1 and names[1].isdigit() else 1 :]
            parts["/".join(own or names)] += info.compress_size
    runs = sum(name.endswith("/rollouts") for name in arrays)
    print(f"{runs} runs: {len(content) / 1e6:.2f} MB, written in {took:.0f} s")
    for name, size in parts.most_common():
        print(f"{name:>34}: {size / 1e6:8.3f} MB, {size / runs:10.0f} bytes a run")


if __name__ == "__main__":
    main()
