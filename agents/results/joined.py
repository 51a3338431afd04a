"""Several sources as one: one's own runs in a report with published ones, or a grid in parts."""

from __future__ import annotations

import itertools
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
from agents.training.config import NO_RUNS, TrainConfig
from emcc import EpisodeRecords


class JoinedSource:
    """The runs in some folders and archives, under a name of their own.

    A folder keeps its name where no other source has one of that name; otherwise, and where it is
    all of its source (`.`), its source's path stands before it: as many of its last parts as tell
    the sources apart. Raises UserError as `open_source` does, for a source without runs, for one
    that lies in another, and where two folders get one name.
    """

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        self.name = name
        _require_apart(paths)
        sources = [open_source(path) for path in paths]
        self.problems: Sequence[str] = [words for source in sources for words in source.problems]
        self._origins: dict[str, tuple[Source, str]] = {}
        count = Counter(folder for source in sources for folder in source.configs)
        for path, source, prefix in zip(paths, sources, _prefixes(paths), strict=True):
            if not source.configs and not source.problems:
                raise UserError(f"{path} {NO_RUNS}")
            for folder in source.configs:
                is_unique = count[folder] == 1 and folder != "."
                joined = folder if is_unique else title(prefix, folder)
                if joined in self._origins:
                    raise UserError(f"two of the sources hold runs named {joined}: rename one")
                self._origins[joined] = source, folder
        self.configs: Mapping[str, dict[str, Any]] = {
            joined: source.configs[folder] for joined, (source, folder) in self._origins.items()
        }

    def title(self, folder: str) -> str:
        """A folder as seen from beside one that would hold all."""
        return title(self.name, folder)

    def sessions(self, folder: str) -> Mapping[str, float]:
        """Seconds that each process trained a folder; empty where nothing says."""
        source, own = self._origins[folder]
        return source.sessions(own)

    def run(self, folder: str, config: TrainConfig, seed: int) -> RunFiles:
        """Read a run. Raises UserError where it failed, is unfinished, missing or damaged."""
        source, own = self._origins[folder]
        return source.run(own, config, seed)

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of runs by seed. Raises UserError."""
        source, own = self._origins[folder]
        return source.visits(own, config, records)

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        source, own = self._origins[folder]
        return source.trained(own, config, seeds)

    def costs(self, folder: str, seed: int, records: EpisodeRecords) -> NDArray[np.float64]:
        """Costs of all steps of a run, [steps]. Raises UserError."""
        source, own = self._origins[folder]
        return source.costs(own, seed, records)

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        source, own = self._origins[folder]
        return source.replay(own, config, seed, records)


def _require_apart(paths: Sequence[Path]) -> None:
    """Raise UserError where a path is another, or lies below it: its runs would count twice."""
    for one, other in itertools.permutations(paths, 2):
        if one.resolve().is_relative_to(other.resolve()):
            raise UserError(f"{one} is in {other}: its runs would count twice")


def _prefixes(paths: Sequence[Path]) -> list[str]:
    """The last parts of each path, without an archive's suffix: as few as differ, all equally many.

    An archive's suffix stays where nothing else differs.
    """
    resolved = [path.resolve() for path in paths]
    short = [path.with_suffix("") if path.is_file() else path for path in resolved]
    for found in (short, resolved):
        for parts in range(1, max(len(path.parts) for path in found) + 1):
            prefixes = ["/".join(path.parts[-parts:]) for path in found]
            if len(set(prefixes)) == len(paths):
                return prefixes
    raise AssertionError(f"equal paths: {paths}")
