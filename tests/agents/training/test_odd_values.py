"""Settings and evaluations that cannot be: left out and named, whatever their type."""

import json
import shutil

import pytest

import agents
from agents.errors import UserError
from agents.results.archive import open_source
from agents.results.reading import read_groups
from agents.training.config import NOT_SETTINGS, TrainConfig

OPTIONS = {"random_steps": 50, "gradient_steps": 1, "checkpoint_every": 100, "backend": "eager"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("odd") / "whole"
    return agents.train("sac-lag", seeds=[0, 1], steps=300, out=out, **OPTIONS).folder


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "x")


def test_a_deep_or_odd_config_is_damaged(tmp_path):
    for text in ("[" * 100_000, '{"a":' * 100_000, "\x00", "12", '"x"', "true", "NaN", "{"):
        (tmp_path / "config.json").write_text(text)
        with pytest.raises(UserError, match=r"config\.json is damaged"):
            TrainConfig.read(tmp_path, strict=False)


POSSIBLE = (
    ("task_parameters", {"a": 1}),
    ("tensorboard", True),
    ("task", "-x"),
    ("algorithm", "-x"),
)


@pytest.mark.parametrize("strict", [True, False])
def test_settings_of_another_type(folder, strict):
    path = folder / "config.json"
    (folder / "checksums.json").unlink()
    content = json.loads(path.read_text())
    for name in content.keys() - set(NOT_SETTINGS):
        for value in (None, 7.5, [], [[1]], {"a": 1}, "-x", 10**400, -1, True):
            if (name, value) in POSSIBLE:
                continue
            path.write_text(json.dumps(content | {name: value}))
            with pytest.raises(UserError, match=r"config\.json"):
                TrainConfig.read(folder, strict)


@pytest.mark.parametrize(
    "change",
    [
        {"episodes": "x"},
        {"episodes": -1},
        {"episodes": True},
        {"episodes": 99},
        {"deterministic": 3},
        {"deterministic": None},
        {"deterministic": {"J_R": 1.0, "J_C": 1.0, "CVaR_0.5": -2.0}},
        {"deterministic": {"J_R": 1.0, "J_C": "x", "CVaR_0.5": 2.0}},
    ],
)
def test_an_evaluation_that_cannot_be_is_left_out(folder, change):
    (folder / "checksums.json").unlink()
    path = folder / "seed-0" / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    notes = []
    [group] = read_groups(open_source(folder), notes)
    assert group.seeds == [1]
    assert len(notes) == 1


def test_steps_beyond_the_settings_are_left_out(folder):
    (folder / "checksums.json").unlink()
    for path in (folder / "config.json", folder / "seed-0" / "config.json"):
        path.write_text(path.read_text().replace('"steps": 300', '"steps": 200'))
    with pytest.raises(UserError, match="a rollout starts at step 250, the training has 200"):
        read_groups(open_source(folder), [])
