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


class Point:
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

    def qpos(self, place: Floats, heading: Floats) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 3]."""
        return np.column_stack((place, heading))

    def position(self, qpos: Floats) -> Floats:
        """Return where the agents' origins are in the world: [n, nq] -> [n, 3] m."""
        position = np.empty((len(qpos), 3))
        position[:, :2], position[:, 2] = qpos[:, :2], self.height
        return position

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 12 numbers, [n, any] side by side, of MuJoCo's sensors
        [n, >= 12] and rotations of the agent's bodies."""
        return (sensed[:, : self.sensors],)


class _Free:
    """An agent on a free joint, the first of its joints."""

    nq: int
    height: float

    def qpos(self, place: Floats, heading: Floats) -> Floats:
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

    def qpos(self, place: Floats, heading: Floats) -> Floats:
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
        angles = sensed[:, 32:44]
        pairs = np.stack((np.sin(angles), np.cos(angles)), axis=2)
        return sensed[:, :32], pairs.reshape(len(sensed), -1)


Agent = Point | Car | Doggo
AGENTS: dict[str, Agent] = {agent.name: agent for agent in (Point(), Car(), Doggo())}


def action_space(agent: Agent) -> Box:
    """Return the action space of an agent, in float64 as in safety-gymnasium.

    Stable-Baselines3 advises float32. Actions of that type are taken too, and without loss; the
    space keeps the original's type, so that its samples and those who compare are not rounded.
    """
    return Box(-1.0, 1.0, (agent.nu,), np.float64)
