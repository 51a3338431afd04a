"""The page's maps and replay, against positions, costs and records computed here."""

import base64
import io
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image
from small_runs import STREAKS, chain, edit_results, evaluate, groups_of, write_runs
from toys import registered

from agents.reporting.figures import task_figures
from agents.reporting.maps import (
    SCENE_SIZE,
    Map,
    Scenes,
    heat_png,
    maps,
    paths,
    replay_data,
)
from agents.reporting.page import script_json
from agents.results.groups import RunResult
from agents.training import derive
from agents.training.derive import STATES, drawn, shown_states
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas

TITLE = "SAC-Lag (120 steps)"


def image_of(content):
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGBA")).astype(int)


@pytest.fixture
def groups(tmp_path):
    """Groups of three folders: the second without visits, the third with its second run alone."""
    for name in ("a", "b", "c"):
        write_runs(tmp_path / name)
        evaluate(tmp_path / name)
    edit_results(tmp_path / "b", **{"Circle2D-3-v0__visits": None})
    a, b, c = groups_of(*(tmp_path / name for name in ("a", "b", "c")))
    alone = derive.derived(tmp_path / "c", replace(c.config, seeds=(1,)))
    part = replace(c.trainings[0], arrays=alone, config=replace(c.config, seeds=(1,)))
    return [a, b, replace(c, runs=c.runs[1:], trainings=[part])]


def test_the_layers_of_a_scene_give_the_views_picture():
    """Composed here as a browser does, against the view's own composition."""
    scenes = Scenes()
    task = of_task("Circle2D-3-v0")
    scene = scenes.get(task, [])
    assert scenes.get(task, []) is scene
    assert scenes.all == [scene]
    view = Circle2DView(Circle2DConfig(level=3))
    below, above = image_of(scene.below)[..., :3], image_of(scene.above)
    np.testing.assert_array_equal(below, view.background(SCENE_SIZE))
    rng = np.random.default_rng(0)
    heat = rng.integers(0, 256, (SCENE_SIZE, SCENE_SIZE, 3)).astype(np.uint8)
    share = above[..., 3:] / 255
    mixed = heat * (1 - share) + above[..., :3] * share
    assert np.abs(mixed - view.overlay(heat)).max() <= 3


def of_task(task):
    return SimpleNamespace(task=task, config=SimpleNamespace(task_parameters={}))


def test_heat_by_hand():
    """The colours of 0, 1, 3 and 9 visits where the most is 9, and of more visits than that."""
    counts = np.array([[0, 1], [3, 9], [81, 0]])
    image = image_of(heat_png(counts, 9))
    assert image[..., 3].tolist() == [[0, 255], [255, 255], [255, 0]]
    for (row, column), stop in {(0, 1): 0, (1, 0): 8, (1, 1): 16, (2, 0): 16}.items():
        assert np.abs(image[row, column, :3] - canvas.HEAT[stop]).max() <= 1


def test_heat_maps_by_algorithm_and_third(groups, tmp_path):
    notes = []
    shown, *_ = maps(groups, Scenes(), notes)
    assert notes[0].startswith("no heat map of b: it has no positions, or a third")
    assert not any(str(tmp_path) in note for note in notes)
    assert shown.columns == [TITLE] * 2
    assert shown.rows[0] == "0 to 33 % of training"
    # By small_runs' table of streaks, the 4 rollouts of a run have the MCC .8 1 .4 .6, then
    # 1 .2 .8 0, then .2 .6 .4 .2 in the thirds of training; α is .1.
    rows = np.arange(240, dtype=np.float32).reshape(12, 10, 2) / 100
    expected = []
    for worst in (1, 4, 9):
        for seeds in ((0, 1), (1,)):
            at = np.concatenate([rows[worst] + k for k in seeds])
            cells = np.zeros((80, 80), np.int64)  # the arena reaches from -15 to 15
            for x, y in at:
                cells[int((15 - y) / 30 * 80), int((x + 15) / 30 * 80)] += 1
            expected.append(cells)
    most = canvas.most_visits(expected)
    assert shown.most_visits == most
    cells = [cell for row in shown.cells for cell in row]
    for cell, counts in zip(cells, expected, strict=True):
        np.testing.assert_array_equal(image_of(cell.heat), image_of(heat_png(counts, most)))
    words = [cell.words for cell in cells]
    assert words[:2] == ["EMCC 1.00 (2 of 8 rollouts)", "EMCC 1.00 (1 of 4 rollouts)"]
    assert words[4:] == ["EMCC 0.60 (2 of 8 rollouts)", "EMCC 0.60 (1 of 4 rollouts)"]


class Played(RunResult):
    """A run whose evaluated episodes are EPISODES."""

    def trained(self):
        return EPISODES


def played(groups):
    own = RunResult.__dataclass_fields__
    return [
        replace(g, runs=[Played(**{k: getattr(run, k) for k in own}) for run in g.runs])
        for g in groups
    ]


PATH = np.linspace((12.0, 1.5), (2.0, 1.5), 11).astype(np.float32)
EPISODES = [drawn(PATH, np.array([0.0, 1, 1, 0, 0, 0, 0, 0, 0, 1]))]


def test_paths_of_trained_policies(groups):
    _, shown = maps(played(groups[::2]), Scenes(), [])
    (other, two), (one, gap) = shown.cells
    assert gap == ""
    assert isinstance(one, Map)
    assert other.words == "seed 0: J_R -5.2, J_C 3.0"
    assert one.words == two.words == "seed 1: J_R -5.2, J_C 3.0"
    # A unit is 1000 / 30 thousandths of the width, and y points down from 15. A cost is drawn where
    # its step ended.
    assert one.way == "M900 450l" + " ".join(["-33 0", "-34 0", "-33 0"] * 3 + ["-33 0"])
    assert one.costs == "M833 450h0M800 450h0M567 450h0"


@pytest.mark.parametrize("steps", [1, 2, 127, 128, 129, 500, 1001])
def test_long_episodes_are_drawn_by_some_of_their_states(steps):
    shown = shown_states(steps)
    assert len(shown) <= STATES + 1
    assert shown[0] == 0
    assert shown[-1] == steps - 1
    assert (np.diff(shown) >= 1).all()
    assert steps > STATES or len(shown) == steps


def test_a_cost_between_two_drawn_states_is_shown():
    """Every eighth state of 1000 steps is drawn; the 500th step costs."""
    scene = Scenes().get(of_task("Circle2D-1-v0"), [])
    costs = np.zeros(1000)
    costs[499] = 1.0
    positions = np.linspace((0, 0), (10, 0), 1001)
    way, costly = paths(scene.extent, [drawn(positions, costs)])
    assert costly.count("M") == 1
    # State 500 lies between the drawn states 496 and 504, at x = 5.04.
    assert re.fullmatch(r"M668 500h0", costly)
    assert way.count(" 0") >= 120


def test_tasks_without_a_view_have_curves_but_no_maps(groups):
    other, notes = [replace(g, task="NoView-v0") for g in groups], []
    with registered(NoView=NoView):
        assert maps(other, Scenes(), notes) == []
    (curves,) = task_figures(other)
    assert "the cost limit, 5." in curves.caption
    assert notes == []
    nobody = [replace(g, runs=[]) for g in other]
    assert task_figures(nobody) == maps(nobody, Scenes(), notes) == []


class NoView(gym.Env):
    observation_space = action_space = gym.spaces.Box(-1, 1, (1,))


def test_the_safety_tasks_have_heat_maps(tmp_path):
    task, rng = "circle2d_mj/SafetyPointCircle1-v0", np.random.default_rng(0)
    write_runs(tmp_path / "a", task)
    counts = rng.integers(0, 2, (3, 160, 160)).astype(np.uint32)
    name = "circle2d_mj-SafetyPointCircle1-v0"
    visits = {f"{name}/visits": counts, f"{name}/visited": np.full((3, 3), 0.5)}
    evaluate(tmp_path / "a", **visits)
    notes = []
    (shown,) = maps(groups_of(tmp_path / "a"), Scenes(), notes)
    assert [note.partition(" of ")[0] for note in notes] == ["no trajectories"]
    assert all((image_of(cell.heat)[..., 3] > 0).sum() > 15 for cell in shown.cells[0])


@pytest.fixture
def runs(tmp_path):
    """Two runs of 24 episodes of 5 steps, each of which begins with a chain of cost steps."""
    write_runs(tmp_path / "a")
    evaluate(tmp_path / "a")
    streaks = [streak for pair in STREAKS for streak in pair]
    costs = np.concatenate([chain(k, 5) for k in streaks])
    return SimpleNamespace(folder=tmp_path, streaks=streaks, costs=costs)


def bits(text):
    return np.unpackbits(np.frombuffer(base64.b64decode(text), np.uint8))


def test_every_number_of_the_replay(runs):
    notes = []
    data = replay_data(groups_of(runs.folder / "a"), Scenes(), notes)
    assert notes == []
    assert (data["windows"], data["extents"]) == (60, [[-15.0, 15.0, -15.0, 15.0]])
    assert [run["seed"] for run in data["runs"]] == [0, 1]
    for seed, run in enumerate(data["runs"]):
        assert (run["task"], run["algorithm"]) == ("Circle2D-3-v0", "SAC-Lag (120 steps)")
        # Windows have two steps; the episode that starts in a window is shown.
        assert run["start"] == [5 * k for k in range(24)]
        assert run["window"] == [5 * k // 2 for k in range(24)]
        assert (run["length"], run["cost"]) == (5, None)
        np.testing.assert_array_equal(bits(run["unsafe"])[:120], runs.costs)
        visited = np.arange(240).reshape(120, 2) / 100 + seed
        weights = 2 ** np.arange(9, -1, -1)
        points = bits(run["points"])[: 120 * 20].reshape(120, 2, 10) @ weights
        low, high = np.reshape(run["box"], (2, 2))
        off = np.abs(low + points * (high - low) / 1023 - visited)
        assert (off <= 0.51 * (high - low) / 1023).all()
    # Point 25 of 50 lies at step 61.2 of 120; its EMCC is of rollouts that start in [55.2, 67.2].
    assert data["runs"][0]["emcc"][25] == round(1000 * max(runs.streaks[12:14]) / 5)


def test_a_replay_of_other_costs_and_different_lengths(runs):
    """Costs other than 0 and 1 are given as sums, and lengths that differ one by one."""
    folder, lengths = runs.folder / "b", [5] * 22 + [10]
    write_runs(folder, weight=2.5, lengths=lengths, each=1)
    evaluate(folder)
    _, run = replay_data(groups_of(folder), Scenes(), [])["runs"]
    assert run["length"] == lengths
    assert run["cost"] == [2.5 * k for k in runs.streaks[:22]] + [2.5 * sum(runs.streaks[22:])]


def test_runs_that_cannot_be_replayed(runs):
    edit_results(runs.folder / "a", **{"Circle2D-3-v0__1__replay__drawn": None})
    notes = []
    data = replay_data(groups_of(runs.folder / "a"), Scenes(), notes)
    assert [run["seed"] for run in data["runs"]] == [0]
    assert notes == ["no replay of a: it has no positions"]


def test_a_replay_of_many_runs_has_the_first_seeds(runs, monkeypatch):
    monkeypatch.setattr("agents.reporting.maps.REPLAYED", 1)
    notes = []
    data = replay_data(groups_of(runs.folder / "a") * 2, Scenes(), notes)
    assert [run["seed"] for run in data["runs"]] == [0, 0]
    assert notes == ["seeds of each algorithm in the replay: 1"]


def test_names_cannot_end_the_pages_script():
    assert json.loads(script_json({"a": "</script><b>"})) == {"a": "</script><b>"}
    assert "<" not in script_json({"a": "</script><b>"})
