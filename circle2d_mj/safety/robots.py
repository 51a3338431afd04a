"""The agents of the navigation tasks: their states, positions and observations.

Source: safety-gymnasium 1.0.0. This module does not import MuJoCo.
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Eye = tuple[tuple[float, float, float], tuple[float, ...], float]
"""A camera: place on the agent's body, m, x and y axes there, vertical field of view, degrees."""


class _Agent:
    """Base class of the agents."""

    sensors: int
    bounds: tuple[float, ...] = ()
    """Greatest absolute value of each action number; (): 1 for all."""
    noise = 0
    """Random numbers in [0, 1) that a start needs besides place and heading."""
    lowest: float | None = None
    """Height of the agent's origin, m, at or below which the episode ends; None: it never does."""

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the agent's part of the observation, arrays [n, any] to be put side by side.

        sensed: [n, >= sensed] values of MuJoCo's sensors; rotations: of the agent's bodies.
        """
        return (sensed[:, : self.sensors],)


class Point(_Agent):
    """A point with a heading, moved by forward thrust and a servo for the turning rate.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0 | forward thrust, which saturates at 0.05 |
    | 1 | target turning rate |

    | observation | meaning, in the agent's frame: x ahead, y left, z up | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rate | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    """

    name = "Point"
    nq, nv, nu, bodies = 3, 3, 2, 1
    sensed, sensors = 12, 12
    """How many numbers of MuJoCo's sensors, and of the observation, are the agent's."""
    height = 0.1
    radius = 0.18
    """Radius of a ball round the agent's origin that contains the agent, m."""
    stride = 0.1
    """Greatest distance that the agent, or a resting object that is pushed, moves within a step, m:
    see the tests."""
    eye: Eye = ((0, 0, 0.15), (0, -1, 0, 0.4, 0, 1), 90)
    """The original's camera "vision"."""

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 3]."""
        return np.column_stack((place, heading))

    def position(self, qpos: Floats) -> Floats:
        """Return the positions of the agents' origins in the world: [n, nq] -> [n, 3] m."""
        position = np.empty((len(qpos), 3))
        position[:, :2], position[:, 2] = qpos[:, :2], self.height
        return position


class _Free(_Agent):
    """An agent whose first joint is a free joint."""

    nq: int
    height: float

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, nq]."""
        qpos = np.zeros((len(place), self.nq))
        qpos[:, :2], qpos[:, 2] = place, self.height
        qpos[:, 3], qpos[:, 6] = np.cos(heading / 2), np.sin(heading / 2)
        return qpos

    def position(self, qpos: Floats) -> Floats:
        """Return the positions of the agents' origins in the world: [n, nq] -> [n, 3] m."""
        return qpos[:, :3].copy()


class Car(_Free):
    """A car on two driven wheels and a ball that rolls freely. It faces its -y axis.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0, 1 | torques of the left and the right wheel, which saturate at 0.02 |

    | observation | meaning, in the agent's frame | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rates | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    | 12-14 | turning rates of the ball | rad/s |
    | 15-23 | rotation matrix of the ball in the car, row by row | |
    """

    name = "Car"
    nq, nv, nu, bodies = 13, 11, 2, 4
    sensed, sensors = 15, 24
    height = 0.1
    radius = 0.22
    stride = 0.1
    eye: Eye = ((0, 0.1, 0.2), (-1, 0, 0, 0, -0.4, 1), 45)

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 13]."""
        qpos = super().qpos(place, heading)
        qpos[:, 9] = 1.0
        return qpos

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 24 numbers, as arrays [n, any], from MuJoCo's sensors
        [n, >= 15] and rotations of the agent's bodies [n, 4, 3, 3], car first, ball last."""
        # One small matrix product per car, so that a run does not depend on the number of cars.
        ball = rotations[:, 0].swapaxes(1, 2) @ rotations[:, -1]
        return sensed[:, :15], ball.reshape(-1, 9)


class Doggo(_Free):
    """A dog on four legs, each with two hinges at the hip and one at the ankle, and a waist that
    turns freely. It faces its x axis.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0-3, 4-7, 8-11 | torques of the hips about z, of the hips about y, and of the ankles |

    Legs: front left, hind left, hind right, front right.

    | observation | meaning, in the agent's frame | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rates | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    | 12-15, 16-19 | contact forces at the upper and the lower ends of the shins | N |
    | 20-31 | turning rates of the hinges, in the actions' order | rad/s |
    | 32-55 | sine and cosine of each hinge's angle, in the actions' order | |
    """

    name = "Doggo"
    nq, nv, nu, bodies = 20, 19, 12, 1
    sensed, sensors = 44, 56
    height = 0.22
    radius = 0.28
    stride = 0.5
    eye: Eye = ((0.0625, 0, 0.1), (0, -0.5, 0, 0.2, 0, 0.5), 100)

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 56 numbers, as arrays [n, any], from MuJoCo's sensors
        [n, >= 44]."""
        return sensed[:, :32], _sines_and_cosines(sensed[:, 32:44])


class Racecar(_Free):
    """A car with a driven rear axle and two front wheels that are steered together. It faces its
    x axis.

    | action | meaning; MuJoCo clips it to its bound |
    | --- | --- |
    | 0 | target turning rate of the axle, rad/s, at most 20 |
    | 1 | target angle of the front wheels, rad, at most 0.785 |

    | observation | meaning, in the agent's frame | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rates | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    """

    name = "Racecar"
    nq, nv, nu, bodies = 12, 11, 2, 1
    sensed, sensors = 12, 12
    height = 0.05
    radius = 0.28
    stride = 0.1
    bounds = 20.0, float(np.float32(0.785))
    eye: Eye = ((0.2, 0, 0.05), (8e-4, -1, 8e-4, 0, 8e-4, 1), 45)


class Ant(_Free):
    """A ball on four legs, each with a hinge at the hip and one at the ankle. It faces its y axis.
    An episode ends if the ball's centre is at most 0.08 m high.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0-1, 2-3, 4-5, 6-7 | torques of the hip and the ankle of each leg, over 150 N m |

    Legs: towards x and y of (1, 1), (-1, 1), (-1, -1), (1, -1).

    | observation | meaning, in the agent's frame | unit |
    | --- | --- | --- |
    | 0-2 | accelerometer | m/s² |
    | 3-5 | velocity | m/s |
    | 6-8 | turning rates | rad/s |
    | 9-11 | magnetometer: a field along the world's -y | |
    | 12-19 | turning rates of the hinges, in the actions' order | rad/s |
    | 20 | height of a point 0.02 m below the ball's centre on the ball's z axis | m |
    | 21-23 | turning rates in the world's frame | rad/s |
    | 24-39 | sine and cosine of each hinge's angle, in the actions' order | |
    """

    name = "Ant"
    nq, nv, nu, bodies = 15, 14, 8, 1
    sensed, sensors = 34, 40
    height = 0.18
    radius = 0.31
    stride = 0.5
    noise = 8
    lowest = 0.08
    eye: Eye = ((0, 0.05, 0.05), (1, 0, 0, 0, 8e-4, 1), 45)

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 15]. noise: [n, 8] in
        [0, 1), turns each hinge by up to 0.1 rad from straight hips and right-angled ankles."""
        qpos = super().qpos(place, heading)
        joints = qpos[:, 7:]
        if noise is not None:
            joints[:] = 0.1 * (2.0 * noise - 1.0)
        joints[:, 1::2] += np.pi / 2
        joints[:, [3, 5]] *= -1.0
        return qpos

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 40 numbers, as arrays [n, any], from MuJoCo's sensors
        [n, >= 34]."""
        return sensed[:, :20], sensed[:, 22:26], _sines_and_cosines(sensed[:, 26:34])


def _sines_and_cosines(angles: Floats) -> Floats:
    pairs = np.stack((np.sin(angles), np.cos(angles)), axis=2)
    return pairs.reshape(len(angles), -1)


Agent = Point | Car | Doggo | Racecar | Ant
_ALL = (Point(), Car(), Doggo(), Racecar(), Ant())
AGENTS: dict[str, Agent] = {agent.name: agent for agent in _ALL}


def action_space(agent: Agent) -> Box:
    """Return the action space of an agent, in float64 as in safety-gymnasium.

    Stable-Baselines3 recommends float32; such actions are accepted too, without loss. The space
    keeps the original's type, so that samples and comparisons are not rounded.
    """
    bounds = np.array(agent.bounds or (1.0,) * agent.nu)
    return Box(-bounds, bounds, dtype=np.float64)
