"""The figures of a report, against positions, costs and records worked out here."""

import io
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image
from small_runs import write_runs

from agents.paper import introduction as example
from agents.reporting import figures
from agents.results.reading import Group, Run
from agents.results.source import FolderSource
from agents.results.steps import Episode
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.envs import Circle2DEnv
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas
from circle2d_mj.render.figure import figure
from emcc import EpisodeRecords, mcc

MEASURES = {"J_R": -5.25, "J_C": 3.0}


def image_of(figure):
    return np.asarray(Image.open(io.BytesIO(figure.content)).convert("RGB")).astype(int)


@pytest.mark.parametrize("name", example.ROUTES)
def test_scripted_episodes_are_those_of_the_environment(name):
    """The same actions, through the environment: the same positions and costs."""
    config = Circle2DConfig(level=1)
    path, costs = example.walk(config, example.ROUTES[name])
    env = Circle2DEnv(config=config)
    env.reset(seed=0)
    env.load_state_dict({**env.state_dict(), "position": path[:1].copy()})
    for k, action in enumerate(np.diff(path, axis=0) / 1.1):
        assert np.hypot(*action) <= 1 + 1e-9
        observation, _, _, _, info = env.step(action)
        np.testing.assert_allclose(observation * config.arena, path[k + 1], atol=1e-5)
        assert info["cost"] == costs[k]
    assert (len(costs), len(path)) == (50, 51)
    assert config.region.places(path[-1:]) == ["corridor"]
    (low, high) = config.start_rectangle
    assert (path[0] >= low).all()
    assert (path[0] <= high).all()


def test_equal_costs_and_different_chains():
    """As the paper's first figure: 10 cost steps each, in chains counted by hand."""
    costs = [example.walk(Circle2DConfig(), route).costs for route in example.ROUTES.values()]
    chains = [
        [len(part) for part in "".join(str(int(c)) for c in of).split("0") if part] for of in costs
    ]
    assert chains == [[10], [2, 3, 3, 2]]
    assert [mcc([of]) for of in costs] == [10 / 50, 3 / 50]
    _, words = example.two_trajectories(128)
    for part in ("chain 10, EMCC 0.20", "chain 3, EMCC 0.06", "cost rate (0.20) does"):
        assert part in words


def test_the_levels_show_the_tasks(monkeypatch):
    """Without the words, each picture is there once, from left to right."""
    size = 200
    monkeypatch.setattr(example, "LABELS", {})
    shown, left = example.levels(size), 0
    for level in range(4):
        view = Circle2DView(Circle2DConfig(level=level))
        task = view.overlay(view.background(size))[1:-1, 1:-1]  # less the frame
        windows = np.lib.stride_tricks.sliding_window_view(shown, (1, *task.shape[1:]))[
            ..., 0, :, :
        ]
        first_rows = np.argwhere((windows[:, :, 0] == task[0]).all(axis=(2, 3)))
        places = [(y, x) for y, x in first_rows if np.array_equal(shown[y:, x:][:198, :198], task)]
        assert len(places) == 1
        assert places[0][1] > left
        left = places[0][1] + size


def test_labels_stand_where_what_they_name_is():
    for words, (first, places) in example.LABELS.items():
        config = Circle2DConfig(level=max(first, 1))
        at = np.array(places) * config.constraint_radius
        if words == "start":
            assert ((at >= config.start_rectangle[0]) & (at <= config.start_rectangle[1])).all()
        elif words in ("corridor", "cost region"):
            assert config.region.places(at) == [words]
        elif words == "goal":
            assert np.hypot(*at[0]) < 4
        else:  # just outside the rim, beside the cut-out of the level
            inwards = at / np.hypot(*at.T)[:, None] * 0.9 * config.constraint_radius
            assert {place.split(" ", 1)[1] for place in config.region.places(inwards)} == {
                "cut-out" if first == 2 else "diagonal cut-out"
            }


def group(folder, config, seeds=(0, 1)):
    records = [EpisodeRecords.load(folder / f"seed-{k}" / "episodes.csv") for k in seeds]
    runs = [Run(k, MEASURES, 100, {}, of) for k, of in zip(seeds, records, strict=True)]
    return Group(folder.name, config, runs)


@pytest.fixture
def groups(tmp_path):
    """Three folders, the second without a record of positions and the third with one run less."""
    found = []
    for name in ("a", "b", "c"):
        config = write_runs(tmp_path / name)
        seeds = (0, 1) if name != "c" else (1,)
        found.append(group(tmp_path / name, config, seeds))
    (tmp_path / "b" / "seed-1" / "visited.npy").unlink()
    return found


def named(drawn, start):
    """The figure of that kind; None where there is none."""
    return next((figure for figure in drawn if figure.name.startswith(start)), None)


TITLE = "SAC-Lag\n(120 steps)"


def test_heat_maps_by_algorithm_and_third(groups, tmp_path):
    """The whole picture, from counts and captions worked out here."""
    notes = []
    drawn = figures.figures(FolderSource(tmp_path), groups, notes)
    assert len([note for note in notes if note.startswith("no heat map")]) == 1
    assert f"{tmp_path.name}/b/seed-1/visited.npy is missing" in notes[0]
    assert not any(str(tmp_path) in note for note in notes)
    view = Circle2DView(Circle2DConfig(level=3))
    rows = np.arange(240, dtype=np.float32).reshape(12, 10, 2) / 100
    # By small_runs' table of streaks, of 4 rollouts a run in each part, with α = .1: MCC .8 1 .4
    # .6, then 1 .2 .8 0, then .2 .6 .4 .2.
    worst = [rows[1], rows[4], rows[9]]
    counts = [
        [canvas.count_visits(view.extent, np.concatenate([one + k for k in seeds]), 160)]
        for seeds in ((0, 1), (1,))
        for one in worst
    ]
    counts = [of for (of,) in counts]
    most = canvas.most_visits(counts)
    ground = view.background(figures.SIZE)
    maps = [view.overlay(canvas.with_counts(ground, of, most)) for of in counts]
    words = ["EMCC 1.00 ({} of {} rollouts)"] * 2 + ["EMCC 0.60 ({} of {} rollouts)"]
    expected = figure(
        [maps[:3], maps[3:]],
        ["0 to 33 % of training", "33 to 66 % of training", "66 to 99 % of training"],
        row_titles=[TITLE] * 2,
        captions=[[w.format(2, 8) for w in words], [w.format(1, 4) for w in words]],
        most_visits=most,
    )
    np.testing.assert_array_equal(image_of(named(drawn, "visited")), expected)


def test_no_figure_of_no_positions(groups, tmp_path):
    notes = []
    (curves,) = figures.figures(FolderSource(tmp_path), [groups[1]], notes)
    assert curves.file == "curves-Circle2D-3-v0.svg"
    # There is no checkpoint either.
    assert [note.partition(" of ")[0] for note in notes] == ["no heat map", "no trajectories"]


class Played(FolderSource):
    """A source whose policies' episodes are given."""

    def trained(self, folder, config, seeds):
        return {seed: EPISODES[seed] for seed in seeds}


PATH = np.linspace((12.0, 1.0), (2.0, 1.0), 11).astype(np.float32)
EPISODES = {0: None, 1: [Episode(PATH, np.ones(10))]}


def test_episodes_of_trained_policies_by_algorithm_and_run(groups, tmp_path):
    drawn = figures.figures(Played(tmp_path), groups[::2], [])
    view = Circle2DView(Circle2DConfig(level=3))
    ground = view.background(figures.SIZE)
    one = canvas.with_trajectories(ground, view.extent, [PATH], [np.ones(10)], boxed=False)
    painted, words = one, "seed {}: J_R -5.2, J_C 3.0"
    one = view.overlay(painted)
    expected = figure(
        [[None, one], [one, None]],
        ["", ""],
        row_titles=[TITLE] * 2,
        captions=[[words.format(0), words.format(1)], [words.format(1), ""]],
    )
    np.testing.assert_array_equal(image_of(named(drawn, "trained")), expected)
    at = canvas.pixels(view.extent, PATH, figures.SIZE).astype(int)
    for k, (column, row) in enumerate(at):
        wanted = canvas.BOX if k else canvas.DOT
        assert np.abs(painted[row, column].astype(int) - wanted).max() <= 60


def test_tasks_without_a_view_have_curves_alone(groups, tmp_path):
    gym.register("NoView-v0", lambda: NoView())
    try:
        other = [replace(g, config=replace(g.config, task="NoView-v0")) for g in groups]
        notes = []
        (curves,) = figures.figures(FolderSource(tmp_path), other, notes)
    finally:
        del gym.registry["NoView-v0"]
    assert curves.file == "curves-NoView-v0.svg"
    assert "Thin line: the cost limit, 5." in curves.caption
    assert notes == []
    nobody = [replace(g, runs=[]) for g in other]
    assert figures.figures(FolderSource(tmp_path), nobody, notes) == []


class NoView(gym.Env):
    observation_space = action_space = gym.spaces.Box(-1, 1, (1,))


def test_the_safety_tasks_have_heat_maps(tmp_path):
    task, rng = "circle2d_mj/SafetyPointCircle1-v0", np.random.default_rng(0)
    config = write_runs(tmp_path / "a", task)
    for seed in (0, 1):
        positions = rng.uniform(-1, 1, (120, 2)).astype(np.float32)
        np.save(tmp_path / "a" / f"seed-{seed}" / "visited.npy", positions)
    notes = []
    drawn = figures.figures(FolderSource(tmp_path), [group(tmp_path / "a", config)], notes)
    shown = named(drawn, "visited")
    assert shown.file == "visited-circle2d_mj-SafetyPointCircle1-v0.png"
    assert image_of(shown).std() > 10


def test_files_hold_the_pictures_without_loss():
    levels, trajectories = figures.introduction()
    np.testing.assert_array_equal(image_of(levels), example.levels(figures.SIZE))
    assert trajectories == figures.introduction()[1]  # byte for byte
