"""Films: what each picture shows, panels side by side, and frames that tasks render themselves."""

import re

import imageio.v3 as imageio
import numpy as np
import pytest
from toys import Walk, registered

import agents
from agents.cli.main import main
from agents.reporting import pictures
from agents.reporting.pictures import HELD, Panel
from agents.results.groups import Episode
from agents.training.config import RunId
from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.render import canvas


class Drawn(Walk):
    """A walk that renders frames whose pixels are six times the number of steps so far."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode

    def render(self):
        return np.full((6, 12, 3), 6 * self.t, np.uint8)


class Undrawn(Drawn):
    """A walk that declares frames and renders None."""

    def render(self):
        return None


@pytest.fixture(scope="module")
def walks(tmp_path_factory):
    """Folders of runs on tasks without a view."""
    folder = tmp_path_factory.mktemp("walks")
    more = {"seeds": 4, "steps": 100, "episodes": 2}
    with registered(WalkFilm=Walk, DrawnFilm=Drawn, UndrawnFilm=Undrawn):
        for name in ("Walk", "Drawn", "Undrawn"):
            agents.train("trpo-lag", f"{name}Film-v0", out=folder / name, **more)
        yield folder


def test_a_task_without_a_view_is_filmed_by_its_frames(walks, tmp_path):
    """The film shows each state of the evaluated episodes once; lengths and costs are recorded."""
    folder, out = walks / "Drawn", tmp_path / "film.gif"
    with np.load(folder / "results.npz") as file:
        prefix = "DrawnFilm-v0/4/evaluation/deterministic/"
        measured = {name: file[prefix + name] for name in ("costs", "lengths")}
    run = RunId("DrawnFilm-v0", 4)
    episodes, view = pictures.evaluation_episodes(folder, run, 3, noisy=False)
    assert view is None
    assert [episode.costs.sum() for episode in episodes] == measured["costs"][:3, 0].tolist()
    thinned, _ = pictures.evaluation_episodes(folder, run, 3, noisy=False, every=4)
    for episode, few, n in zip(episodes, thinned, measured["lengths"], strict=False):
        assert [*episode.frames] == [*range(n + 1)] and len(episode.costs) == n
        assert {*range(0, n, 4), n} <= {*few.frames} < {*range(n + 1)}
    command = ["render", str(folder), "--out", str(out), "--size", "64"]
    assert main([*command, "--frames", "mujoco", "--every", "3"]) == main(command) == 0
    frames = imageio.imread(out)  # a picture that is held is a single frame
    # The task's frame, twice as wide as it is high, is in the middle of the panel.
    levels = [frame[frame.shape[0] // 2, frame.shape[1] // 2].astype(int) for frame in frames]
    times = [k for episode in episodes for k in range(len(episode.costs) + 1)]
    assert len(frames) == len(times)
    np.testing.assert_allclose(levels, 6 * np.array(times)[:, None].repeat(3, 1), atol=8)


def test_a_long_episode_is_shown_in_two_hundred_pictures(tmp_path):
    """It shows every third state of 500 steps, and the last."""
    command = "render pretrained:trpo-lag/SafetyPointCircle1-v0 --episodes 1 --size 64 --out"
    assert main([*command.split(), str(tmp_path / "film.gif")]) == 0
    assert len(imageio.imread(tmp_path / "film.gif")) == len({*range(0, 500, 3), 500})


@pytest.mark.filterwarnings("ignore")  # gymnasium warns about the same mistakes
@pytest.mark.parametrize(
    ("folder", "out", "message"),
    [
        ("Drawn --camera side --frames mujoco", "x.gif", "camera is for Circle2DMuJoCo-0-v0, "),
        ("Drawn", "x.png", "offers no view to draw whole episodes on: give --out a film"),
        ("Undrawn", "x.gif", "'UndrawnFilm-v0' gives no frames with .*'NoneType'"),
        ("Walk", "x.gif", "'WalkFilm-v0' gives no frames with .*'render_mode'"),
    ],
)
def test_a_task_that_cannot_be_filmed(walks, tmp_path, capsys, folder, out, message):
    command = f"render {walks}/{folder} --out {tmp_path}/{out}".split()
    assert main(command) == 2
    assert re.search(message, capsys.readouterr().err.replace("\n", " "))
    assert not (tmp_path / out).exists()


VIEW = Circle2DView(Circle2DConfig(level=1))
COSTS = [0, 1, 1, 0, 1]


def episode(steps, costs=COSTS):
    """Return an episode along the x axis, by one unit of the arena per step."""
    path = np.stack((12.0 - np.arange(steps + 1), np.zeros(steps + 1)), axis=1)
    return Episode(path, np.array(costs[:steps], float))


def agent(picture):
    """Return the mean column of the pixels in the agent's colour."""
    return np.nonzero((picture == np.array(canvas.AGENT)).all(axis=-1))[1].mean()


def test_a_film_shows_every_state_and_waits_for_the_longer_episode():
    panels = [Panel("a", VIEW, [episode(5), episode(2)]), Panel("b", VIEW, [episode(3)] * 2)]
    shown = list(pictures.film(panels, 96))
    assert len(shown) == pictures.pictures_of(panels) == (5 + 1 + HELD) + (3 + 1 + HELD)
    height, width, _ = shown[0].shape
    assert height % 2 == width % 2 == 0
    assert {picture.shape for picture in shown} == {shown[0].shape}
    left = [agent(picture[:, : width // 2]) for picture in shown[: 5 + 1]]
    right = [agent(picture[:, width // 2 :]) for picture in shown[: 5 + 1]]
    step = 96 / 30  # pixels per unit: the arena is 30 units wide
    np.testing.assert_allclose(np.diff(left), -step, atol=0.8)
    np.testing.assert_allclose(np.diff(right), [*[-step] * 3, 0, 0], atol=0.8)


def test_the_words_on_a_picture_have_the_cost_and_streak_so_far():
    for steps, cost, streak in ((0, 0, 0), (3, 2, 2), (5, 3, 2)):
        words = f"episode 2, step {steps}: cost {cost}, longest streak {streak}"
        assert pictures._words(2, episode(5), steps) == words
