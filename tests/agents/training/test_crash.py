"""Trainings that are killed at any moment, or whose files are damaged, by enumeration.

The file operations of a small training are recorded. Every prefix of them, without what was not
flushed, makes a folder in which the training is resumed: it must end as if never interrupted. Then
every file of a folder is damaged in several ways.
"""

import os
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from small_runs import SAC, TRPO, checkpoints_often, few_episodes, results
from toy_family import known

import agents
from agents.api import configs_of
from agents.errors import UserError
from agents.results.reading import read_groups
from agents.training.trainer import train

SETTINGS = {"seeds": (0, 1), "steps": 120, "checkpoint_every": 30, "evaluate_every": 60}


@pytest.fixture(autouse=True, scope="module")
def toy():
    with known(), few_episodes(1), checkpoints_often():
        yield


def config(algorithm="toy", **more):
    own = SETTINGS | more
    hyperparameters = {k: own.pop(k) for k in list(own) if k not in SETTINGS and k != "backend"}
    [made] = configs_of(algorithm, "Walk-v0", [hyperparameters], "paper", "numpy", own)
    return made


class Operations:
    """The recorded operations on the files of a folder, in order: (kind, path, content).

    The content of a file is what had been flushed when it got its name.
    """

    def __init__(self, folder, patch):
        self.folder, self.all, self.flushed = folder, [], {}
        fsync, replace = os.fsync, os.replace
        unlink, mkdir = Path.unlink, Path.mkdir

        def recorded_fsync(file):
            fsync(file)
            path = os.readlink(f"/proc/self/fd/{file}")
            self.flushed[path] = Path(path).read_bytes()
            self._note("write", path, self.flushed[path])

        def recorded_replace(source, target):
            replace(source, target)
            content = self.flushed.get(str(source), b"")
            self._note("remove", source)
            self._note("write", target, content)

        def recorded_unlink(path, **kwargs):
            if path.exists():
                self._note("remove", path)
            unlink(path, **kwargs)

        def recorded_mkdir(path, *args, **kwargs):
            self._note("mkdir", path)
            mkdir(path, *args, **kwargs)

        patch.setattr(os, "fsync", recorded_fsync)
        patch.setattr(os, "replace", recorded_replace)
        patch.setattr(Path, "unlink", recorded_unlink)
        patch.setattr(Path, "mkdir", recorded_mkdir)

    def _note(self, kind, path, content=None):
        if Path(path).is_relative_to(self.folder):
            self.all.append((kind, str(Path(path).relative_to(self.folder)), content))

    def states(self, before):
        """Yield the files after every prefix of the operations, each state once; files that are
        being written also cut in half. before: the files at first, by path; a folder's value is
        None."""
        now, seen = dict(before), set()
        for kind, path, content in [("mkdir", ".", None), *self.all]:
            versions = []
            if kind == "remove":
                now.pop(path, None)
            elif path.endswith(".unfinished"):
                versions = [now | {path: content[: len(content) // 2]}]
                now[path] = content
            else:
                now[path] = content
            for state in (*versions, dict(now)):
                key = frozenset(state.items())
                if key not in seen and "config.json" in state:
                    seen.add(key)
                    yield state


def files_of(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def made(folder, state):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in sorted(state.items()):
        path = folder / name
        if content is None:
            path.mkdir(parents=True, exist_ok=True)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return folder


def recorded(folder, go):
    before = files_of(folder) if folder.exists() else {}
    with pytest.MonkeyPatch.context() as patch:
        operations = Operations(folder, patch)
        go(folder)
    return list(operations.states(before))


def assert_goes_on(folder, expected):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*going on from the checkpoint before it.*")
        train(folder)
    assert results(folder) == expected
    assert not list(folder.rglob("*unfinished*"))
    assert len(list((folder / "checkpoints").iterdir())) <= 3  # killed before one was removed


CHOICES = {"toy": {}, "trpo-lag": TRPO, "sac-lag": SAC}
FOLDERS = ("checkpoints", "policies")


@pytest.mark.parametrize(("algorithm", "every"), [("toy", 1), ("trpo-lag", 15), ("sac-lag", 15)])
def test_every_prefix_of_the_operations_goes_on_to_the_same(tmp_path, algorithm, every):
    folder, chosen = tmp_path / "whole", config(algorithm, **CHOICES[algorithm])

    def go(folder):
        chosen.write(folder)
        train(folder)

    states = recorded(folder, go)
    flushed = {name: content for name, content in states[-1].items() if content is not None}
    assert flushed == {n: c for n, c in files_of(folder).items() if c is not None and n != ".lock"}
    expected = results(folder)
    assert {n.split("/")[0] for n in expected} == {"config.json", "results.npz", *FOLDERS}
    assert len(states) > 45
    for state in states[::every]:
        assert_goes_on(made(tmp_path / "cut", state), expected)


@pytest.mark.parametrize("damaged", ["checkpoints", "steps"])
def test_a_training_resumed_from_damaged_files_may_be_killed_at_any_moment_too(tmp_path, damaged):
    """It drops a checkpoint that is damaged, or whose steps are, and everything written after the
    checkpoint before it."""
    folder = tmp_path / "whole"
    config().write(folder)
    train(folder)
    expected = results(folder)
    newest = sorted((folder / damaged).iterdir())[-1]
    newest.write_bytes(newest.read_bytes()[:-30])
    with pytest.warns(UserWarning, match=f"{newest.name} is damaged.* the checkpoint before it"):
        states = recorded(folder, train)
    assert results(folder) == expected
    assert len(states) > 10
    for state in states:
        assert_goes_on(made(tmp_path / "cut", state), expected)


@pytest.fixture(scope="module", params=["finished", "interrupted"])
def left(request, tmp_path_factory):
    """A folder, and the results of its finished training."""
    root = tmp_path_factory.mktemp("left")
    config().write(root / "whole")
    train(root / "whole")
    if request.param == "finished":
        return root / "whole", results(root / "whole")
    config().write(root / "part")
    train(root / "part", lambda trainer: trainer.epochs.max() < 3)
    return root / "part", results(root / "whole")


def flipped(data, at):
    changed = bytearray(data)
    changed[min(at, len(data) - 1)] ^= 16
    return bytes(changed)


DAMAGES = {
    "removed": lambda data: None,
    "empty": lambda data: b"",
    "torn": lambda data: data[: len(data) // 2],
    "JSON": lambda data: b"[" * 50_000,
}
DAMAGES |= {
    f"bit at {share}": lambda data, share=share: flipped(data, int(share * len(data)))
    for share in (0.3, 0.97)
}


def test_every_damaged_file_gives_the_same_or_one_error_that_names_it(left, tmp_path):
    """Nor do readers of the damaged folder see another number."""
    folder, expected = left
    whole = read_groups([folder], []) if (folder / "results.npz").exists() else []
    names = [n for n, c in files_of(folder).items() if c is not None and not n.endswith(".lock")]
    for name in names:
        for kind, damage in DAMAGES.items():
            shutil.rmtree(tmp_path / "x", ignore_errors=True)
            copy = shutil.copytree(folder, tmp_path / "x")
            content = damage((copy / name).read_bytes())
            (copy / name).unlink()
            if content is not None:
                (copy / name).write_bytes(content)
            if whole:
                assert_reads_the_same(copy, *whole)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".*going on from the checkpoint before it.*")
                try:
                    train(copy)
                except UserError as error:
                    assert name.split("/")[0] in str(error) or str(copy) in str(error), (name, kind)
                    continue
            found = results(copy)
            if name.startswith(("policies", "config", "checkpoints")) and name in expected:
                found[name] = expected[name]  # not read here, or read as equal
            assert found == expected, (name, kind)


def assert_reads_the_same(copy, expected):
    """Assert that reading gives the expected groups, an error, or leaves the run out."""
    notes = []
    try:
        groups = read_groups([copy], notes)
    except UserError:
        return
    for run in groups[0].runs:
        other = next(other for other in expected.runs if other.seed == run.seed)
        assert run.measures == other.measures
        for name, column in vars(other.records).items():
            np.testing.assert_array_equal(getattr(run.records, name), column)
    assert set(groups[0].seeds) | set(groups[0].missing) == {0, 1}


def test_a_damaged_policy_from_during_training_is_named(tmp_path):
    config("trpo-lag", **TRPO).write(tmp_path / "x")
    train(tmp_path / "x")
    path = min((tmp_path / "x" / "policies").rglob("*.npz"))
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(UserError, match=f"{path.name} is damaged"):
        agents.load_policy(tmp_path / "x", int(path.parent.name), step=int(path.stem))
