"""The rigid region: agents push against it, slide along it, and start beside and inside it."""

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from circle2d_mj import Circle2DConfig
from circle2d_mj.circle2d.mujoco_envs import Circle2DMuJoCoVectorEnv
from circle2d_mj.circle2d.physics import Physics
from circle2d_mj.circle2d.physics_config import PhysicsConfig
from circle2d_mj.circle2d.scene import scene
from circle2d_mj.core.streams import Streams

BODY = 0.25  # at R = 10
actuations = pytest.mark.parametrize("actuation", ["velocity", "force"])


class Worlds:
    """Copies of a rigid scene, with the positions of every physics step."""

    def __init__(self, config, actuation, position):
        model = scene(config, PhysicsConfig(actuation=actuation)).compile()
        self._batch = Batch(model, len(position), 1)
        self.qpos, self.qvel, self._ctrl = (self._batch.bind(n) for n in ("qpos", "qvel", "ctrl"))
        self._most = model.actuator_ctrlrange[:, 1]
        self.qpos[:] = position

    def step(self, action, nstep=10):
        """Return the positions before each physics step and after the last: [nstep + 1, n, 2]."""
        self._ctrl[:] = np.clip(action, -1, 1) * self._most
        seen = self._batch.rollout(nstep, record=("qpos",))["qpos"]
        return np.concatenate((seen, self.qpos[:, None]), axis=1).swapaxes(0, 1)


def free_places(config, number, rng):
    """Draw positions at most 2 away from the region, where the body fits."""
    near, fits = config.region.grown(2.0), config.region.grown(BODY + 0.01)
    points = rng.uniform(-12, 12, (20 * number, 2))
    return points[near.contains(points) & ~fits.contains(points)][:number]


def corners(config):
    """Yield the corners of the cut-outs, at the rim and inside, and the middles of both ends."""
    for cut in config.region.cutouts:
        for sin in {cut.sin, -cut.sin}:
            along, across = np.array([cut.cos, sin]), np.array([-sin, cut.cos])
            for side in (-1, 0, 1):
                yield cut.inner * along + side * cut.half_width * across
                yield np.sqrt(100 - cut.half_width**2) * along + side * cut.half_width * across


@actuations
@pytest.mark.parametrize("level", [0, 2, 3])
def test_no_push_brings_an_agents_centre_into_the_region(level, actuation):
    """500 agents at full thrust: towards corners, towards the centre, and in random directions."""
    config = Circle2DConfig(level=level, infeasible_region_penetratable=False)
    rng = np.random.default_rng(level)
    position = free_places(config, 500, rng)
    assert len(position) == 500
    worlds = Worlds(config, actuation, position)
    goals = np.array([*corners(config), (0.0, 0.0)])
    goal = goals[rng.integers(len(goals), size=500)]
    kind, bang = rng.integers(4, size=500)[:, None], rng.choice([-1, 1], size=(500, 2))
    pressed = 0
    for _ in range(25):
        towards = goal - worlds.qpos
        again = rng.random(500) < 0.2
        bang[again] = rng.choice([-1, 1], size=(again.sum(), 2))
        flips = np.where(rng.random((500, 2)) < 0.2, -1, 1)
        choices = [np.sign(towards), np.clip(towards / 1.1, -1, 1), np.sign(towards) * flips, bang]
        seen = worlds.step(np.choose(kind, choices))
        assert not config.region.contains(seen).any()
        pressed += config.region.grown(BODY - 0.05).contains(seen).sum()
        again = rng.random(500) < 0.05
        goal[again] = goals[rng.integers(len(goals), size=again.sum())]
    assert pressed > 500  # many overlap the region by a fifth of the body's radius


def frame(angle):
    """Return the unit vectors outwards and along the rim."""
    return np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])


def slide(actuation, level, push, start, end, thrust=0.75):
    """Return the speed along the rim, as a share of the commanded one, after each physics step.

    start, end: angles of the path along the rim.
    """
    config = Circle2DConfig(level=level, infeasible_region_penetratable=False)
    radius, speeds = 10 + BODY, []
    worlds = Worlds(config, actuation, radius * frame(start)[0][None])
    while (angle := np.arctan2(*worlds.qpos[0, ::-1])) < end:
        normal, tangent = frame(angle)
        worlds.step(thrust * tangent - push * normal, nstep=1)
        _, tangent = frame(np.arctan2(*worlds.qpos[0, ::-1]))
        speeds.append(worlds.qvel[0] @ tangent / (thrust * 11))
        assert len(speeds) < 1000
        assert abs(np.hypot(*worlds.qpos[0]) - radius) < 0.02
    return np.array(speeds[60:])


@actuations
@pytest.mark.parametrize(("level", "start", "end"), [(0, -1.45, 1.45), (2, -1.2, 1.2)])
def test_sliding_along_the_rim_keeps_its_speed(level, start, end, actuation):
    """Along the right half, across the seams of the prisms at ±0.25 rad."""
    speed = slide(actuation, level, push=0.3, start=start, end=end)
    assert len(speed) > 150
    assert speed.min() > 0.97
    assert speed.max() < 1.03


@pytest.mark.parametrize(
    "parameters", [{}, {"init_region_size": 1.99, "init_radius_multiplier": 1.05}]
)
def test_starts_touch_nothing(parameters):
    """Not even the rim's polygon, whose corners lie outside the disc."""
    number = 100_000
    physics = Physics(Circle2DConfig(level=0, **parameters), number)
    streams = Streams(np.arange(number, dtype=np.uint64))
    starts = physics.start_area.sample(streams, np.arange(number))
    physics.place(np.arange(number), starts)
    physics._batch.forward(stage=mujoco.mjtStage.mjSTAGE_POS)
    assert not physics._batch.bind("ncon").any()
    # Starts come as near to the region as the body allows, but not nearer.
    assert 10.25 < np.hypot(*starts.T).min() < 10.26


@actuations
@pytest.mark.parametrize("level", [0, 3])
def test_starts_inside(level, actuation):
    """Each step that ends inside costs 1, forces stay finite, and no agent that starts outside gets
    in."""
    own = {"infeasible_region_penetratable": False, "actuation": actuation}
    own |= {"allow_infeasible_init": True, "init_region_size": 2.0}
    envs = Circle2DMuJoCoVectorEnv(200, level=level, **own)
    envs.reset(seed=0)
    started_inside = envs.config.region.contains(envs.position)
    assert 50 < started_inside.sum() < 150
    rng = np.random.default_rng(0)
    for t in range(25):
        observation, _, _, _, info = envs.step(rng.uniform(-1, 1, (200, 2)))
        assert envs.observation_space.contains(observation)
        inside = envs.config.region.contains(envs.position)
        assert (info["cost"][inside] == 1).all()
        assert np.isfinite([info["contact_force"], info["penetration"]]).all()
        if t == 0:
            assert (info["cost"][started_inside] == 1).all()
    assert not (inside & ~started_inside).any()


@actuations
@pytest.mark.parametrize("level", [0, 1])
def test_observations_stay_in_their_space(level, actuation):
    """Driven into the arena's corners, along the rim and back and forth at full thrust."""
    envs = Circle2DMuJoCoVectorEnv(64, level=level, actuation=actuation, max_episode_steps=None)
    observation, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    action = rng.choice([-1.0, 1.0], size=(64, 2))
    largest = np.zeros(4)
    for _ in range(100):
        again = rng.random(64) < 0.1
        action[again] = rng.choice([-1.0, 1.0], size=(again.sum(), 2))
        observation, *_ = envs.step(action)
        assert envs.observation_space.contains(observation)
        velocity = envs.state_dict()["mujoco"][:, 3:5]
        scaled = np.concatenate((envs.position / 15, velocity / 11), axis=1)
        np.testing.assert_allclose(observation, scaled, rtol=1e-6, atol=1e-7)
        largest = np.maximum(largest, np.abs(observation).max(axis=0))
    assert (largest > 0.99).all()
