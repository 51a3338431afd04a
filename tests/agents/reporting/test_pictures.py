"""Heat maps and films of runs: which steps and episodes they show, and the files of commands."""

import shutil

import imageio.v3 as imageio
import numpy as np
import pytest
from small_runs import TASK, edit_results, evaluate, write_runs

from agents.cli.main import main
from agents.presets import preset
from agents.reporting import pictures
from agents.reporting.maps import png
from agents.reporting.pictures import HELD
from agents.results.reading import read_folder
from agents.training.config import RunId, TrainConfig
from agents.training.derive import Steps, count_visits
from agents.training.trainer import train
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas, gl
from circle2d_mj.render.gl import NoOpenGL


@pytest.mark.parametrize(
    ("part", "alpha", "rollouts", "mcc"),
    [
        # Rollouts 0 to 3 start below step 39.6, with the MCC .8, 1, .4, .6; 4 to 7 start below
        # 79.2, with 1, .2, .8, 0; and 8 to 11 below 118.8, with .2, .6, .4, .2.
        (0.33, 0.1, [1], 1.0),
        (0.33, 0.5, [0, 1], 0.9),
        (0.66, 0.5, [4, 6], 0.9),
        (0.66, 1.0, [4, 5, 6, 7], 0.5),
        (0.99, 0.75, [8, 9, 10, 11], 0.4),  # the two with .2 count half each
    ],
)
def test_the_dominating_rollouts_by_hand(tmp_path, part, alpha, rollouts, mcc):
    write_runs(tmp_path)
    evaluate(tmp_path)
    (group,), steps = read_folder(tmp_path, "a"), Steps(tmp_path)
    runs = [(r.records, steps.get(RunId(TASK, r.seed), "positions")) for r in group.runs]
    (found,) = count_visits(Circle2DView(Circle2DConfig(level=3)), runs, 120, [part], alpha, 160)
    one = np.arange(240).reshape(12, 10, 2)[rollouts].reshape(-1, 2) / 100
    expected = np.zeros((160, 160), int)
    for x, y in np.concatenate((one, one + 1)):  # the arena reaches from -15 to 15
        expected[int((15 - y) / 30 * 160), int((x + 15) / 30 * 160)] += 1
    assert found.counts.sum() == expected.sum()
    # A position on the border of two cells may count for either.
    assert np.abs(found.counts - expected).sum() <= 0.02 * expected.sum()
    assert found.emcc == pytest.approx(mcc)
    assert (found.rollouts, found.of) == (2 * len(rollouts), 8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "first"
    config = TrainConfig("trpo-lag", (TASK,), (5, 6), 1100, preset("trpo-lag", TASK))
    config.write(path)
    train(path)
    return path


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # imageio's reader
def test_commands_write_pictures_and_films(folder, tmp_path, capsys, monkeypatch):
    """They need no OpenGL; test_reproduce.py shows the same of reports."""

    def nothing(*_):
        raise NoOpenGL("install one")

    monkeypatch.setattr(gl, "check_backend", nothing)
    for command, name, shape in (
        ("heatmap", "h.png", None),
        ("render", "t.png", None),
        # Two episodes of 50 steps with their starts; their last pictures are held.
        ("render", "f.mp4", 2 * (51 + HELD)),
        ("render", "f.gif", None),
    ):
        out = tmp_path / "new" / name
        options = ["--size", "128"] + (["--episodes", "2"] if command == "render" else [])
        assert main([command, str(folder), "--out", str(out), *options]) == 0
        assert capsys.readouterr().out == f"{out}\n"
        image = imageio.imread(out)
        assert shape is None or len(image) == shape
        assert image.std() > 10
        assert [p.name for p in out.parent.iterdir() if "unfinished" in p.name] == []


def test_the_episodes_drawn_are_those_of_the_evaluation(folder):
    episodes, view = pictures.evaluation_episodes(folder, RunId(TASK, 6), 3, noisy=False)
    task = Circle2DConfig(level=3)
    assert view.extent == (-task.arena, task.arena, -task.arena, task.arena)
    (group,) = read_folder(folder, "a")
    run = group.runs[1]
    kept = run.trained()
    for k, (path, costs) in enumerate(episodes):
        assert path.shape == (51, 2)
        np.testing.assert_allclose(path, kept[k].positions, rtol=1e-5, atol=1e-6)
        assert costs.sum() == run.evaluation["deterministic"]["cost_returns"][k]
        np.testing.assert_array_equal(task.region.contains(path[1:]), costs > 0)
    noisy, _ = pictures.evaluation_episodes(folder, RunId(TASK, 6), 3, noisy=True)
    assert np.array_equal(noisy[0].positions[0], episodes[0].positions[0])
    assert not np.array_equal(noisy[0].positions, episodes[0].positions)


def test_a_frame_of_steps_that_cost_has_an_orange_edge():
    """The third of five steps costs, and every second state is filmed."""
    grey = png(np.full((64, 64, 3), 128, np.uint8))
    frames = dict.fromkeys((0, 2, 4, 5), grey)
    episode = pictures.Filmed(frames, np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
    shown = [*pictures.film([pictures.Panel("", None, [episode])], 64, 2)]
    assert len(shown) == 4 + HELD
    edged = [(picture == canvas.BOX).all(-1).any() for picture in shown]
    assert edged == [False, False, True, *[False] * (1 + HELD)]


def test_a_heat_map_of_the_runs_that_did_not_fail(folder, tmp_path, capsys):
    copy, out = tmp_path / "x", tmp_path / "x" / "heatmap.png"
    shutil.copytree(folder, copy)

    def drawn(*options):
        assert main(["heatmap", str(copy), "--size", "96", *options]) == 0
        return out.read_bytes()

    everyone, five, six = drawn(), drawn("--seeds", "5"), drawn("--seeds", "6")
    assert len({everyone, five, six}) == 3
    assert drawn("--seeds", "5", "6") == everyone
    edit_results(copy, **{f"{TASK}__5__failure": np.array("x")})
    assert drawn() == six
    assert drawn("--seeds", "5") == five
    edit_results(copy, **{f"{TASK}__6__failure": np.array("x")})
    capsys.readouterr()
    assert main(["heatmap", str(copy)]) == 2
    assert "seeds must be among [5, 6], not failed" in capsys.readouterr().err


def test_heat_maps_of_several_folders_side_by_side(folder, tmp_path):
    """A folder and its copy have equal columns, each with the thirds of training."""
    copy, out = tmp_path / "x", tmp_path / "both.png"
    shutil.copytree(folder, copy)
    size, gap = 96, 96 // 24

    def columns():
        options = ["--out", str(out), "--size", str(size)]
        assert main(["heatmap", str(folder), str(copy), *options]) == 0
        both = imageio.imread(out)
        assert len(both) > 3 * size
        end = both.shape[1] - gap
        scale = slice(0, -5 * gap // 2)  # without the colour scale below the maps
        return (both[scale, end - size : end], both[scale, end - 2 * size - gap : end - size - gap])

    np.testing.assert_array_equal(*columns())
    edit_results(copy, **{f"{TASK}__5__failure": np.array("x")})
    left, right = columns()
    assert (left != right).any()
