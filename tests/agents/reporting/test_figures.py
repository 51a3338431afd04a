"""The figures of a report, against positions, costs and records worked out here."""

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from small_runs import write_runs

from agents.paper import introduction as example
from agents.reporting import figures
from agents.results.reading import Group, Run
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.envs import Circle2DEnv
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas
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
    runs = [
        Run(seed, MEASURES, 100, "", EpisodeRecords.load(folder / f"seed-{seed}" / "episodes.csv"))
        for seed in seeds
    ]
    return Group(folder, config, runs)


@pytest.fixture
def groups(tmp_path):
    """Three folders, the second without a record of positions and the third with one run less."""
    found = []
    for name in ("a", "b", "c"):
        config = write_runs(tmp_path / name)
        found.append(group(tmp_path / name, replace(config, algorithm="sac-lag")))
    (tmp_path / "b" / "seed-1" / "visited.npy").unlink()
    return [found[0], found[1], found[2]._replace(runs=found[2].runs[1:])]


def test_heat_maps_by_algorithm_and_third(groups, monkeypatch):
    asked = {}
    figure = figures.figure
    monkeypatch.setattr(figures, "figure", lambda *a, **k: asked.update(k, a=a) or figure(*a, **k))
    notes = []
    shown = figures._heatmaps(groups, notes)
    assert len(notes) == 1
    assert "b/seed-1/visited.npy is missing" in notes[0]
    rows, columns = asked["a"]
    assert len(rows) == len(asked["row_titles"]) == 2
    assert [len(row) for row in rows] == [3, 3]
    assert columns == ["0 to 33 % of training", "33 to 66 % of training", "66 to 99 % of training"]
    # By small_runs' table of streaks, of 4 rollouts a run in each part, with α = .1.
    assert asked["captions"] == [
        [
            "EMCC 1.00 (2 of 8 rollouts)",
            "EMCC 1.00 (2 of 8 rollouts)",
            "EMCC 0.60 (2 of 8 rollouts)",
        ],
        [
            "EMCC 1.00 (1 of 4 rollouts)",
            "EMCC 1.00 (1 of 4 rollouts)",
            "EMCC 0.60 (1 of 4 rollouts)",
        ],
    ]
    view = Circle2DView(Circle2DConfig(level=3))
    one = np.arange(240).reshape(12, 10, 2)[1] / 100  # the rollout of MCC 1 in the first part
    counts = canvas.count_visits(view.extent, np.concatenate((one, one + 1)), 160)
    ground = view.background(figures.SIZE)
    changed = (canvas.with_counts(ground, counts, asked["most_visits"]) != ground).any(axis=-1)
    crossed = (view.overlay(ground) != ground).any(axis=-1)
    np.testing.assert_array_equal((rows[0][0] != ground).any(axis=-1) | crossed, changed | crossed)
    assert image_of(shown).shape[1] > 3 * figures.SIZE


def test_no_figure_of_no_positions(groups):
    notes = []
    assert figures._heatmaps([groups[1]], notes) is None
    assert figures._trained([groups[1]], notes) is None  # there is no checkpoint either
    assert [note.partition(" of ")[0] for note in notes] == ["no heat map", "no trajectories"]


def test_episodes_of_trained_policies_by_algorithm_and_run(groups, monkeypatch):
    path = np.linspace((12.0, 1.0), (2.0, 1.0), 11)
    played = figures.Episodes([path], [np.ones(10)])
    monkeypatch.setattr(figures, "episodes_by_seed", lambda *a, **k: {0: None, 1: played})
    asked = {}
    figure = figures.figure
    monkeypatch.setattr(figures, "figure", lambda *a, **k: asked.update(k, a=a) or figure(*a, **k))
    figures._trained(groups[::2], [])
    (first, third), _ = asked["a"]
    assert [picture is None for picture in (*first, *third)] == [True, False, False, True]
    words = "seed {}: J_R -5.2, J_C 3.0"
    assert asked["captions"] == [[words.format(0), words.format(1)], [words.format(1), ""]]
    extent = Circle2DView(Circle2DConfig(level=3)).extent
    at = canvas.pixels(extent, path, figures.SIZE).astype(int)
    on_the_rim = np.abs(np.hypot(*path.T) - 10) < 0.2  # below the outline
    assert on_the_rim.sum() == 1
    for k, (column, row) in enumerate(at):
        if on_the_rim[k]:
            continue
        wanted = canvas.BOX if k else canvas.DOT
        assert np.abs(first[1][row, column].astype(int) - wanted).max() <= 60


def test_other_tasks_have_curves_alone(groups):
    other = [
        g._replace(config=replace(g.config, task="circle2d_mj/SafetyPointGoal1-v0")) for g in groups
    ]
    notes = []
    (curves,) = figures.figures(other, notes)
    assert curves.name == "curves-circle2d_mj-SafetyPointGoal1-v0.svg"
    assert "Dashed: the cost limit, 5." in curves.caption
    assert notes == []
    assert figures.figures([g._replace(runs=[]) for g in other], notes) == []


def test_files_hold_the_pictures_without_loss():
    levels, trajectories = figures.introduction()
    np.testing.assert_array_equal(image_of(levels), example.levels(figures.SIZE))
    assert trajectories == figures.introduction()[1]  # byte for byte
