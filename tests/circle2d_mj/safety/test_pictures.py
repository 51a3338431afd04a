"""Pictures of the suite's tasks: depths against rays cast with mj_ray, colours against MuJoCo's
renderer and the original; sizes, modes, errors."""

import pickle

import gymnasium as gym
import mujoco
import numpy as np
import pytest
import safety_pictures

import circle2d_mj.safety_gymnasium as safety_gymnasium
from circle2d_mj.render import gl

pytestmark = pytest.mark.usefixtures("opengl")
equal = np.testing.assert_array_equal
WIDTH, HEIGHT = 48, 32
DOWN = ((1, 0, 0), (0, 1, 1))
"""The x and y axes of a camera that looks north and 45 degrees down."""
EYES = {
    "Point": ((0, 0, 0.15), (0, -1, 0), (0.4, 0, 1), 90),
    "Car": ((0, 0.1, 0.2), (-1, 0, 0), (0, -0.4, 1), 45),
    "Doggo": ((0.0625, 0, 0.1), (0, -0.5, 0), (0.2, 0, 0.5), 100),
    "Racecar": (
        (0.2, 0, 0.05),
        (0, -1, 0),
        (0, 0, 1),
        45,
    ),  # the original turns it by 1.57, not π / 2
    "Ant": ((0, 0.05, 0.05), (1, 0, 0), (0, 0, 1), 45),
}
"""The original's camera on each agent's body: place, x and y axes, vertical angle in degrees."""


def made(name, **options):
    env = safety_gymnasium.make(name, width=WIDTH, height=HEIGHT, **options)
    env.reset(seed=2)
    for _ in range(3):
        env.step(env.action_space.low)
    return env


def pose(env, camera):
    """Return a camera's place, axes [3, 3] (columns x, y and backwards) and vertical angle."""
    task = env.unwrapped.task
    place, x, y, degrees = {
        "fixednear": ((0, -2, 2), *DOWN, 45),
        "fixedfar": ((0, -5, 5), *DOWN, 45),
        "track": (np.add(task.agent.pos, (0, 2, 2)), (-1, 0, 0), (0, -1, 1), 45),
        "vision": EYES[task.agent_name],
    }[camera]
    x, y = np.array(x) / np.linalg.norm(x), np.array(y) / np.linalg.norm(y)
    axes = np.column_stack((x, y, np.cross(x, y)))
    if camera == "vision":
        return task.agent.pos + task.agent.mat @ place, task.agent.mat @ axes, degrees
    return np.array(place, float), axes, degrees


def cast(env, camera):
    """Return the depth, along the axis, of the first hit of the ray through each pixel's middle."""
    place, axes, degrees = pose(env, camera)
    half = np.tan(np.radians(degrees) / 2)
    up = half * (1 - (2 * np.arange(HEIGHT) + 1) / HEIGHT)
    right = half * WIDTH / HEIGHT * ((2 * np.arange(WIDTH) + 1) / WIDTH - 1)
    simulation = env.unwrapped._envs.simulation
    data, hit = simulation.data(0), np.zeros(1, np.int32)
    model = simulation.picture_model
    # The Racecar's bumper is nearer than the near plane of pictures.
    near = 0.05 if (env.unwrapped.task.agent_name, camera) == ("Racecar", "vision") else 0.0
    distance = np.full((HEIGHT, WIDTH), np.inf)
    for i in range(HEIGHT):
        for j in range(WIDTH):
            ray = axes @ (right[j], up[i], -1.0)
            far = mujoco.mj_ray(model, data, place + near * ray, ray, None, 1, -1, hit)
            distance[i, j] = near + far if far >= 0 else np.inf  # in rays, 1 along the axis
    return distance


@pytest.mark.parametrize("camera", ["fixednear", "fixedfar", "track", "vision"])
@pytest.mark.parametrize("agent", EYES)
def test_depths_are_those_of_rays(agent, camera):
    """Except at edges; round shapes are drawn as polyhedra, a ball's 2 mm within its surface."""
    env = made(f"Safety{agent}Push2-v0", render_mode="depth_array", camera_name=camera)
    depth, expected = env.render(), cast(env, camera)
    env.close()
    assert depth.dtype == np.float32 and depth.shape == (HEIGHT, WIDTH)
    seen = expected < 20
    assert seen.mean() > 0.25
    close = np.abs(depth[seen] - expected[seen]) < 0.01 * expected[seen] + 0.003
    assert close.mean() > 0.9


@pytest.mark.parametrize("name", ["SafetyCarButton1-v0", "SafetyHopperVelocity-v1"])
def test_pictures_are_mujocos_own(name, monkeypatch):
    """Equal to mujoco.Renderer's, for every camera of the model and the free one; all differ."""
    monkeypatch.setattr("mujoco.rendering.classic.gl_context.GLContext", gl._gl_context)
    cameras = ["fixednear", "fixedfar", "track", "vision", "free"]
    seen = []
    for camera in cameras if "Car" in name else ["track", "human"]:
        for mode in ("rgb_array", "depth_array"):
            env = made(name, render_mode=mode, camera_name=camera)
            simulation = env.unwrapped._envs.simulation
            with mujoco.Renderer(simulation.picture_model, HEIGHT, WIDTH) as renderer:
                if mode == "depth_array":
                    renderer.enable_depth_rendering()
                theirs = -1 if camera in ("free", "human") else camera
                renderer.update_scene(simulation.data(0), theirs)
                expected = renderer.render().astype(float)
            difference = np.abs(env.render() - expected) / np.maximum(expected, 1.0)
            # Our small pictures draw round shapes with fewer corners.
            assert np.median(difference) < 1e-3 and np.quantile(difference, 0.9) < 0.1
            env.close()
        seen.append(expected)
    assert all((a != b).mean() > 0.2 for i, a in enumerate(seen) for b in seen[:i])


def test_the_view_from_above_has_depths():
    """The default of gymnasium.make: without perspective, 5 m above the floor."""
    env = gym.make("circle2d_mj/SafetyPointGoal0-v0", render_mode="depth_array")
    env.reset(seed=0)
    depth = env.render()
    assert depth.shape == (640, 640)
    assert np.median(depth) == pytest.approx(5.0, abs=1e-3)
    x, y, _ = env.unwrapped.task.agent.pos
    row, column = round(320 - 160 * y), round(320 + 160 * x)
    assert depth[row, column] == pytest.approx(4.8, abs=1e-2)  # the top of the ball
    env.close()


@pytest.mark.parametrize("vector", [False, True])
def test_sizes_modes_and_lists(vector):
    options = {"camera_name": "track", "width": 128, "height": 72}
    if vector:
        envs = safety_gymnasium.vector.make(
            "SafetyPointGoal1-v0", 2, render_mode="rgb_array", **options
        )
        envs.reset(seed=0)
        pictures = pickle.loads(pickle.dumps(envs)).render()
        assert [picture.shape for picture in pictures] == [(72, 128, 3)] * 2
        equal(envs.call("render"), pictures)
        single = safety_gymnasium.make("SafetyPointGoal1-v0", render_mode="rgb_array", **options)
        single.reset(seed=1)
        equal(single.render(), pictures[1])
        envs.close(), single.close()
        return
    for mode, shape in (("rgb_array_list", (72, 128, 3)), ("depth_array_list", (72, 128))):
        env = safety_gymnasium.make("SafetyPointGoal1-v0", render_mode=mode, **options)
        env.reset(seed=0)
        for _ in range(3):
            env.step(np.ones(2))
        assert [picture.shape for picture in env.render()] == [shape] * 4
        env.close()


def test_the_originals_sizes_and_cameras_are_the_default():
    for name, size, camera in (
        ("SafetyCarGoal1-v0", 256, "vision"),
        ("SafetyAntVelocity-v1", 480, "track"),
    ):
        env = safety_gymnasium.make(name, render_mode="rgb_array")
        named = safety_gymnasium.make(
            name, render_mode="rgb_array", camera_name=camera, width=size, height=size
        )
        env.reset(seed=0), named.reset(seed=0)
        equal(env.render(), named.render())
        assert env.render().shape == (size, size, 3)
        env.close(), named.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera_name": "nonsense"}, "one of top, .*fixednear, fixedfar.*free.*, got 'nonsense'"),
        ({"camera_id": 17}, "camera_id must be from -1 .*vision.*, got 17"),
        ({"camera_name": "track", "camera_id": 0}, "give one of the two"),
        ({"width": 0}, "width must be at least 1, got 0"),
    ],
)
def test_bad_options_are_named(options, message):
    for make in (safety_gymnasium.make, safety_gymnasium.vector.make):
        with pytest.raises(ValueError, match=message):
            make("SafetyPointGoal1-v0", render_mode="rgb_array", **options)


def test_pictures_are_like_the_originals():
    """Recorded at equal states: three cameras, five tasks. The original's sky has faint stars."""
    similar = {}
    for case, theirs, ours in safety_pictures.pairs():
        assert ours.shape == theirs.shape == (64, 64, 3)
        similar.setdefault(case, []).append(safety_pictures.similarity(theirs, ours))
        mirrored = ours[:, ::-1]
        assert safety_pictures.similarity(theirs, mirrored) < 0.9
    assert len(similar) == 15
    assert min(min(values) for values in similar.values()) > 0.95, similar
    others = [values for case, values in similar.items() if "vision" not in case]
    assert min(min(values) for values in others) > 0.98, similar
