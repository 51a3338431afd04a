"""Folders that differ in their seeds alone as one group: seeds that were trained later."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from agents.results.reading import Group, read_groups
from agents.results.source import Source
from agents.results.steps import Episode, Replay, Visits
from agents.training.config import TrainConfig
from emcc import EpisodeRecords


def pool(groups: Sequence[Group]) -> list[list[Group]]:
    """The groups that are one together: those of equal algorithm, task, steps and settings.

    A group stays alone where one of these has a seed that another has too: one of the two is a
    second training of the same runs, which must not count twice.
    """
    alike: list[list[Group]] = []
    for group in groups:
        for of in alike:
            if _equal(of[0].config, group.config):
                of.append(group)
                break
        else:
            alike.append([group])
    return [part for of in alike for part in ([of] if _share_no_seed(of) else [[g] for g in of])]


def _equal(a: TrainConfig, b: TrainConfig) -> bool:
    names = ("algorithm", "task", "task_parameters", "steps", "hyperparameters")
    return all(getattr(a, name) == getattr(b, name) for name in names)


def _share_no_seed(groups: Sequence[Group]) -> bool:
    seeds = [seed for group in groups for seed in group.config.seeds]
    return len(set(seeds)) == len(seeds)


class PooledSource:
    """Groups and steps of a source in which folders that differ in their seeds alone are one, named
    after all of them.

    groups: its groups; by_folder: those of the folders one by one.
    """

    def __init__(self, source: Source, notes: list[str]) -> None:
        """Read all groups. The notes get those of `read_groups`, and which folders are one. Raises
        UserError where no run is left."""
        self.source = source
        self.by_folder = read_groups(source, notes)
        self.parts = {" + ".join(g.folder for g in of): of for of in pool(self.by_folder)}
        self.groups = [_as_one(folder, of) for folder, of in self.parts.items()]
        notes += [self._note(of) for of in self.parts.values() if len(of) > 1]

    def _note(self, groups: Sequence[Group]) -> str:
        parts = [
            f"{self.source.title(group.folder)} (seeds {', '.join(map(str, group.config.seeds))})"
            for group in groups
        ]
        return f"of equal settings, with other seeds, so counted as one: {'; '.join(parts)}"

    def title(self, folder: str) -> str:
        """All folders, as seen from beside the source's."""
        return " + ".join(self.source.title(of.folder) for of in self.parts[folder])

    def visits(
        self, folder: str, config: TrainConfig, records: Mapping[int, EpisodeRecords]
    ) -> list[Visits]:
        """States visited in each third of training, of runs by seed. Raises UserError."""
        found = []
        for of in self.parts[folder]:
            own = {seed: records[seed] for seed in of.seeds if seed in records}
            if own:
                found.append((len(own), self.source.visits(of.folder, of.config, own)))
        runs = [n for n, _ in found]
        return [_together(runs, part) for part in zip(*(of for _, of in found), strict=True)]

    def trained(
        self, folder: str, config: TrainConfig, seeds: Sequence[int]
    ) -> dict[int, list[Episode] | None]:
        """Episodes of the trained policies, by seed; None of one that diverged. UserError."""
        played: dict[int, list[Episode] | None] = {}
        for of in self.parts[folder]:
            own = [seed for seed in of.config.seeds if seed in seeds]
            if own:
                played |= self.source.trained(of.folder, of.config, own)
        return played

    def replay(
        self, folder: str, config: TrainConfig, seed: int, records: EpisodeRecords
    ) -> Replay:
        """The episode of highest MCC in each window of training. Raises UserError."""
        of = next(of for of in self.parts[folder] if seed in of.config.seeds)
        return self.source.replay(of.folder, of.config, seed, records)


def _as_one(folder: str, groups: Sequence[Group]) -> Group:
    config = replace(groups[0].config, seeds=tuple(k for g in groups for k in g.config.seeds))
    runs = [run for group in groups for run in group.runs]
    missing = {seed: why for group in groups for seed, why in group.missing.items()}
    return Group(folder, config, runs, missing)


def _together(runs: Sequence[int], visits: Sequence[Visits]) -> Visits:
    """Visits of one part of training by several folders, of so many runs each."""
    return Visits(
        np.sum([of.counts for of in visits], axis=0),
        float(np.average([of.emcc for of in visits], weights=runs)),
        sum(of.rollouts for of in visits),
        sum(of.of for of in visits),
    )
