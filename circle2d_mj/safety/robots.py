"""The agents of the navigation tasks: their states as positions, and their observations.

Source: safety-gymnasium 1.0.0; loads no MuJoCo.
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Eye = tuple[tuple[float, float, float], tuple[float, ...], float]
"""A camera's place on the agent's body, m, its x and y axes there, its height of view, degrees"""


class _Agent:
    """Common part of the agents."""

    sensors: int
    bounds: tuple[float, ...] = ()
    """Greatest size of each action; none: 1 of all"""
    noise = 0
    """How many numbers in [0, 1) its start takes, besides place and heading"""
    lowest: float | None = None
    """Height of its origin, m, at or below which the episode ends; None: it never does."""

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the agent's numbers of the observation, [n, any] side by side: the values of its
        sensors, [n, >= sensors]. rotations: of its bodies."""
        return (sensed[:, : self.sensors],)


class Point(_Agent):
    """A point with a heading, moved by thrust ahead and a servo for its turning rate.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0 | thrust ahead, which saturates at 0.05 |
    | 1 | turning rate aimed at |

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
    """Numbers of MuJoCo's sensors, and of the observation, that are the agent's"""
    height = 0.1
    radius = 0.18
    """Radius of a ball round its origin that holds it, m"""
    stride = 0.1
    """How far it, or what stood and is pushed, may move within a step, m: see the tests"""
    eye: Eye = ((0, 0, 0.15), (0, -1, 0, 0.4, 0, 1), 90)
    """The original's camera "vision" """

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 3]."""
        return np.column_stack((place, heading))

    def position(self, qpos: Floats) -> Floats:
        """Return where the agents' origins are in the world: [n, nq] -> [n, 3] m."""
        position = np.empty((len(qpos), 3))
        position[:, :2], position[:, 2] = qpos[:, :2], self.height
        return position


class _Free(_Agent):
    """An agent on a free joint, the first of its joints."""

    nq: int
    height: float

    def qpos(self, place: Floats, heading: Floats, noise: Floats | None = None) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, nq]."""
        qpos = np.zeros((len(place), self.nq))
        qpos[:, :2], qpos[:, 2] = place, self.height
        qpos[:, 3], qpos[:, 6] = np.cos(heading / 2), np.sin(heading / 2)
        return qpos

    def position(self, qpos: Floats) -> Floats:
        """Return where the agents' origins are in the world: [n, nq] -> [n, 3] m."""
        return qpos[:, :3].copy()


class Car(_Free):
    """A car on two driven wheels and a ball that rolls freely. Its front is its -y axis.

    | action | meaning; MuJoCo clips it to [-1, 1] |
    | --- | --- |
    | 0, 1 | torque of the left and the right wheel, which saturates at 0.02 |

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
        """Return the observation's first 24 numbers, [n, any] side by side, of MuJoCo's sensors
        [n, >= 15] and rotations of the agent's bodies [n, 4, 3, 3], car first, ball last."""
        # A small product for each car, whatever their number: a run does not depend on others.
        ball = rotations[:, 0].swapaxes(1, 2) @ rotations[:, -1]
        return sensed[:, :15], ball.reshape(-1, 9)


class Doggo(_Free):
    """A dog on four legs, each with two hinges at the hip and one at the ankle, and a waist that
    turns freely. Its front is its x axis.

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
    | 12-15, 16-19 | forces of contacts at the upper and the lower ends of the shins | N |
    | 20-31 | turning rates of the hinges, as the actions | rad/s |
    | 32-55 | sine and cosine of each hinge's angle, as the actions | |
    """

    name = "Doggo"
    nq, nv, nu, bodies = 20, 19, 12, 1
    sensed, sensors = 44, 56
    height = 0.22
    radius = 0.28
    stride = 0.5
    eye: Eye = ((0.0625, 0, 0.1), (0, -0.5, 0, 0.2, 0, 0.5), 100)

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 56 numbers, [n, any] side by side, of MuJoCo's sensors
        [n, >= 44] and rotations of the agent's bodies."""
        return sensed[:, :32], _sines_and_cosines(sensed[:, 32:44])


class Racecar(_Free):
    """A car with a driven rear axle and two front wheels that are steered together. Its front is
    its x axis.

    | action | meaning; MuJoCo clips it to its bound |
    | --- | --- |
    | 0 | turning rate of the axle aimed at, rad/s, at most 20 |
    | 1 | angle of the front wheels aimed at, rad, at most 0.785 |

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
    """A ball on four legs, each with a hinge at the hip and one at the ankle. Its front is its y
    axis. An episode ends where the middle of the ball is at most 0.08 m high.

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
    | 12-19 | turning rates of the hinges, as the actions | rad/s |
    | 20 | height of the ball's middle, less 0.02 along its z | m |
    | 21-23 | turning rates in the world | rad/s |
    | 24-39 | sine and cosine of each hinge's angle, as the actions | |
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
        """Return the state at rest at places [n, 2] with headings [n]: [n, 15]. noise: [n, 8], of
        the hinges, up to 0.1 rad from straight hips and ankles at right angles; None: none."""
        qpos = super().qpos(place, heading)
        joints = qpos[:, 7:]
        if noise is not None:
            joints[:] = 0.1 * (2.0 * noise - 1.0)
        joints[:, 1::2] += np.pi / 2
        joints[:, [3, 5]] *= -1.0
        return qpos

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 40 numbers, [n, any] side by side, of MuJoCo's sensors
        [n, >= 34] and rotations of the agent's bodies."""
        return sensed[:, :20], sensed[:, 22:26], _sines_and_cosines(sensed[:, 26:34])


def _sines_and_cosines(angles: Floats) -> Floats:
    pairs = np.stack((np.sin(angles), np.cos(angles)), axis=2)
    return pairs.reshape(len(angles), -1)


Agent = Point | Car | Doggo | Racecar | Ant
_ALL = (Point(), Car(), Doggo(), Racecar(), Ant())
AGENTS: dict[str, Agent] = {agent.name: agent for agent in _ALL}


def action_space(agent: Agent) -> Box:
    """Return the action space of an agent, in float64 as in safety-gymnasium.

    Stable-Baselines3 advises float32. Actions of that type are taken too, and without loss; the
    space keeps the original's type, so that its samples and those who compare are not rounded.
    """
    bounds = np.array(agent.bounds or (1.0,) * agent.nu)
    return Box(-bounds, bounds, dtype=np.float64)
