"""Several sources as one: one's own runs in a report with published ones, or a grid in parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.errors import UserError
from agents.results.archive import open_source
from agents.results.source import RunFiles, Source, title
from agents.results.steps import Episode, Replay, Visits
from agents.training.config import TrainConfig
from emcc import EpisodeRecords


class JoinedSource:
    """The runs in some folders and archives, under a name of their own.

    A folder keeps its name where no other source has one of that name; otherwise, and where it is
    all of its source (`.`), the name of the path that was given stands before it. Raises UserError
    where that leaves two folders of one name, and as `open_source` does.
    """

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        self.name = name
        sources = {path: open_source(path) for path in paths}
        self.problems: Sequence[str] = [p for source in sources.values() for p in source.problems]
        self._of: dict[str, tuple[Source, str]] = {}
        count = Counter(folder for source in sources.values() for folder in source.configs)
        for path, source in sources.items():
            before = path.stem if path.is_file() else path.resolve().name
            for folder in source.configs:
                alone = count[folder] == 1 and folder != "."
                joined = folder if alone else title(before, folder)
                if joined in self._of:
                    raise UserError(f"two of the sources hold runs named {joined}: rename one")
                self._of[joined] = source, folder
        self.configs: Mapping[str, dict[str, Any]] = {
            joined: source.configs[folder] for joined, (source, folder) in self._of.items()
        }

    def title(self, folder: str) -> str:
        """A folder as seen from beside one that would hold all."""
        return title(self.name, folder)

    def sessions(self, folder: str) -> Mapping[str, float]:
        """Seconds that each process trained a folder; empty where nothing says."""
        source, own = self._of[folder]
        return source.sessions(own)

    def run(self, folder: str, config: TrainConfig, seed: int) -> RunFiles:
        """Read a run. Raises UserError where it failed, is unfinished, missing or damaged."""
        source, own = self._of[folder]
        return source.run(own, config, seed)

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of runs by seed. Raises UserError."""
        source, own = self._of[folder]
        return source.visits(own, config, records)

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        source, own = self._of[folder]
        return source.trained(own, config, seeds)

    def costs(self, folder: str, seed: int, records: EpisodeRecords) -> NDArray[np.float64]:
        """Costs of all steps of a run, [steps]. Raises UserError."""
        source, own = self._of[folder]
        return source.costs(own, seed, records)

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        source, own = self._of[folder]
        return source.replay(own, config, seed, records)
