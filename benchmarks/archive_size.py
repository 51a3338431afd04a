"""Size of an archive, by its parts: of a folder of runs, or of made-up runs of the paper's length.

    python benchmarks/archive_size.py [FOLDER]

Made up are 200 runs of 1 000 000 steps in episodes of 50, in 20 folders: costs come and go in
streaks of five steps on average, in 15 % of all steps, at random, which no compression foresees;
positions are random walks, returns noise of eight bytes. Trained agents repeat themselves more.
"""

from __future__ import annotations

import sys
import tempfile
import time
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from agents.paper.presets import preset
from agents.results.archive import open_source, write_archive
from agents.results.reading import Group, Run, read_groups
from agents.results.steps import LAST, Episode, Replay, ReplayEpisode, Visits, replay_rows
from agents.training.config import TrainConfig
from emcc import EpisodeRecords, count_streaks, longest_streaks

FOLDERS, SEEDS, STEPS, LENGTH = 20, 10, 1_000_000, 50
TASK = "Circle2D-1-v0"
CONFIG = TrainConfig("trpo-lag", TASK, tuple(range(SEEDS)), STEPS, preset("trpo-lag", TASK))


class MadeUp:
    """A source of runs that no one trained."""

    name = "made-up"
    configs = {f"folder-{k}": CONFIG.settings for k in range(FOLDERS)}  # noqa: RUF012
    problems = ()

    def rng(self, folder, seed):
        return np.random.default_rng([int(folder.rpartition("-")[2]), seed])

    def sessions(self, folder):
        return {"0" * 16: 12_345.678}

    def costs(self, folder, seed, records):
        """Alternating gaps and streaks of geometric lengths."""
        rng = self.rng(folder, seed)
        pairs = STEPS // 20
        lengths = np.column_stack((rng.geometric(3 / 85, pairs), rng.geometric(1 / 5, pairs)))
        costs = np.repeat(np.tile([0.0, 1.0], pairs), lengths.ravel())[:STEPS]
        return np.pad(costs, (0, STEPS - len(costs)))

    def visits(self, folder, config, records):
        rng = self.rng(folder, 99)
        at = np.clip(rng.normal(80, 30, (3, 100_000 * SEEDS // 3, 2)), 0, 159.9).astype(int)
        flat = [np.bincount(of[:, 0] * 160 + of[:, 1], minlength=160 * 160) for of in at]
        return [Visits(of.reshape(160, 160), 0.5, 660 * SEEDS, 6600 * SEEDS) for of in flat]

    def walk(self, rng, steps):
        return np.cumsum(rng.normal(0, 0.6, (steps, 2)), axis=0)

    def trained(self, folder, config, seeds):
        rng = self.rng(folder, 98)
        one = [Episode(self.walk(rng, LENGTH + 1).astype("f4"), np.zeros(LENGTH)) for _ in range(5)]
        return dict.fromkeys(seeds, one)

    def replay(self, folder, config, seed, records):
        rng, rows = self.rng(folder, seed), replay_rows(records, STEPS)
        paths = [np.clip(self.walk(rng, LENGTH) / 30 + 0.5, 0, 1) * LAST for _ in rows]
        episodes = [
            ReplayEpisode(w, int(records.start_step[k]), path.astype(np.uint16), np.zeros(LENGTH))
            for (w, k), path in zip(rows, paths, strict=True)
        ]
        return Replay(episodes, np.array([[-15.0, -15.0], [15.0, 15.0]]))

    def run(self, folder, config, seed):
        raise NotImplementedError

    def title(self, folder):
        return folder

    def groups(self):
        return [
            Group(folder, CONFIG, [self.made_run(folder, seed) for seed in CONFIG.seeds])
            for folder in self.configs
        ]

    def made_run(self, folder, seed):
        count, rng = STEPS // LENGTH, self.rng(folder, seed + 1000)
        costs, length = self.costs(folder, seed, None), np.full(count, LENGTH)
        cost_steps, streaks = count_streaks(costs, length)
        episodes = np.arange(count)
        columns = episodes // 10, episodes * LENGTH, length, rng.normal(-20, 5, count), cost_steps
        records = EpisodeRecords(*columns, longest_streaks(costs, length), cost_steps, streaks)
        of = {"J_R": -9.0, "J_C": 4.0, "CVaR_0.5": 6.0, "lengths": [LENGTH] * 100}
        of |= {"returns": rng.normal(-20, 5, 100).tolist(), "cost_returns": [4.0] * 100}
        last = rng.normal(size=(100, 2)).astype(np.float32)
        of["final_observations"] = last.astype(float).tolist()
        evaluation = {"seed": seed, "episodes": 100, "deterministic": of, "stochastic": of}
        return Run(seed, {}, 100, {"corridor": 90, "right rim": 10}, records, evaluation)


def main() -> None:
    """Write an archive and print the compressed size of its parts."""
    if len(sys.argv) > 1:
        source = open_source(Path(sys.argv[1]))
        groups = read_groups(source, [])
    else:
        source = MadeUp()
        groups = source.groups()
    with tempfile.TemporaryDirectory() as folder:
        path, started = Path(folder) / "x.zip", time.perf_counter()
        write_archive(path, source, groups)
        took = time.perf_counter() - started
        parts = Counter()
        with zipfile.ZipFile(path) as file:
            for info in file.infolist():
                parts[Path(info.filename).stem] += info.compress_size
        runs = sum(len(group.runs) for group in groups)
        size = path.stat().st_size
    print(f"{runs} runs: {size / 1e6:.2f} MB, written in {took:.0f} s")
    for name, of_part in parts.most_common():
        print(f"{name:>20}: {of_part / 1e6:8.3f} MB, {of_part / runs:10.0f} bytes a run")


if __name__ == "__main__":
    main()
