"""The agents of the navigation tasks: their states as positions, and their observations.

Source: safety-gymnasium 1.0.0; loads no MuJoCo.
"""

from __future__ import annotations

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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
    nq, nv, bodies = 3, 3, 1
    sensors = 12
    height = 0.1
    radius = 0.18
    """Radius of a ball round its origin that holds it, m"""

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


class Car:
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
    nq, nv, bodies = 13, 11, 4
    sensors = 24
    height = 0.1
    radius = 0.22

    def qpos(self, place: Floats, heading: Floats) -> Floats:
        """Return the state at rest at places [n, 2] with headings [n]: [n, 13]."""
        qpos = np.zeros((len(place), self.nq))
        qpos[:, :2], qpos[:, 2] = place, self.height
        qpos[:, 3], qpos[:, 6] = np.cos(heading / 2), np.sin(heading / 2)
        qpos[:, 9] = 1.0
        return qpos

    def position(self, qpos: Floats) -> Floats:
        """Return where the agents' origins are in the world: [n, nq] -> [n, 3] m."""
        return qpos[:, :3].copy()

    def observe(self, sensed: Floats, rotations: Floats) -> tuple[Floats, ...]:
        """Return the observation's first 24 numbers, [n, any] side by side, of MuJoCo's sensors
        [n, >= 15] and rotations of the agent's bodies [n, 4, 3, 3], car first, ball last."""
        # A small product for each car, whatever their number: a run does not depend on others.
        ball = rotations[:, 0].swapaxes(1, 2) @ rotations[:, -1]
        return sensed[:, :15], ball.reshape(-1, 9)


Agent = Point | Car
AGENTS: dict[str, Agent] = {agent.name: agent for agent in (Point(), Car())}


def action_space() -> Box:
    """Return the space of both agents, in float64 as in safety-gymnasium.

    Stable-Baselines3 advises float32. Actions of that type are taken too, and without loss; the
    space keeps the original's type, so that its samples and those who compare are not rounded.
    """
    return Box(-1.0, 1.0, (2,), np.float64)
