"""Pictures of Circle2D from above, drawn off-screen by MuJoCo: see `circle2d_mj.render.gl`."""

# mujoco has no stubs for its enums.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from circle2d_mj.assets import asset
from circle2d_mj.circle2d.config import Circle2DConfig
from circle2d_mj.circle2d.view import Circle2DView
from circle2d_mj.core.simulation import positive_integer
from circle2d_mj.core.view import Picture, histogram
from circle2d_mj.render import canvas
from circle2d_mj.render.gl import Offscreen, check_backend

SIZE = 640
CELLS = 160
LEAST_BALL = 2.5
"""Least radius of the agent in pixels; in a wide arena its body would be invisible."""


class Renderer:
    """Draws a task: frames, trajectories, heat maps, each [size, size, 3] uint8.

    size: pixels along each side of the arena. The floor's picture is a texture of the scene; the
    agent is the scene's ball. It is a context manager; `close` frees its memory. Raises
    `circle2d_mj.render.gl.NoOpenGL`, which says what to install, if nothing can be drawn.
    """

    def __init__(self, config: Circle2DConfig, size: int = SIZE) -> None:
        size = positive_integer("size", size)
        check_backend()
        from circle2d_mj.core.engine import mujoco

        self.config, self.size, self._view = config, size, Circle2DView(config)
        self._ground = self._view.background(size)
        self.background = self._view.overlay(self._ground)
        self._model = _model(config, size)
        self._data = mujoco.MjData(self._model)
        self._agent = self._model.geom("agent").id
        self._offscreen = Offscreen(self._model, size, size)
        self._offscreen.upload(0, self.background)
        self._painted = False  # whether the floor shows anything but the background

    def frame(self, position: ArrayLike | None = None, floor: Picture | None = None) -> Picture:
        """Draw the task with the agent at `position`, [2] world units, or without it.

        floor: picture to paint on the floor, [size, size, 3] uint8; by default the task's
        background. Raises ValueError for a wrong position or picture.
        """
        from circle2d_mj.core.engine import mujoco

        if position is not None:
            self._data.qpos[:] = _checked(position) / self.config.arena
        if floor is not None or self._painted:
            picture = self.background if floor is None else floor
            got, needed = (f"{[*p.shape]} {p.dtype}" for p in (picture, self.background))
            if got != needed:
                raise ValueError(f"floor must be a picture {needed}, got {got}")
            self._offscreen.upload(0, picture)
            self._painted = floor is not None
        self._model.geom_rgba[self._agent, 3] = position is not None
        mujoco.mj_forward(self._model, self._data)
        return self._offscreen.draw(self._data, self._model.camera("top").id)

    def trajectories(
        self,
        paths: Sequence[ArrayLike],
        costs: Sequence[ArrayLike],
        agent: ArrayLike | None = None,
    ) -> Picture:
        """Draw trajectories as blue dots, with orange boxes around streaks of cost steps.

        paths: [T + 1, 2] each, world units, the start first; costs: [T] each; agent: position of
        the agent, [2]; None: without the agent.
        """
        floor = canvas.with_trajectories(self._ground, self._view.extent, paths, costs)
        return self.frame(agent, self._view.overlay(floor))

    def heatmap(self, positions: ArrayLike, cells: int = CELLS, most: int | None = None) -> Picture:
        """Draw a heat map of visited states: the more visits, the darker, on a log scale.

        positions: [N, 2] world units; cells: number along each side of the arena; most: number of
        visits with the darkest colour, by default `canvas.most_visits`.
        """
        cells = positive_integer("cells", cells)
        counts = histogram(self._view.extent, positions, cells)
        most = canvas.most_visits([counts]) if most is None else positive_integer("most", most)
        heat = canvas.with_counts(self._ground, counts, most)
        return self.frame(floor=self._view.overlay(heat))

    def close(self) -> None:
        """Free the OpenGL context."""
        self._offscreen.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _checked(position: ArrayLike) -> NDArray[np.float64]:
    try:
        values = np.asarray(position, dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (2,) or not np.isfinite(values).all():
        raise ValueError(f"position must be two finite numbers, got {position!r}")
    return values


def _model(config: Circle2DConfig, size: int) -> Any:
    """Compile the base scene with a texture on its floor.

    Lengths are in units of the arena's half-width, so that tasks that are too large, small or
    narrow for the physics can be drawn as well.
    """
    from circle2d_mj.circle2d.physics_config import BASE, BASE_RADIUS
    from circle2d_mj.core.engine import mujoco

    spec = mujoco.MjSpec.from_file(str(asset(BASE)))
    floor, agent, top = spec.geom("floor"), spec.geom("agent"), spec.camera("top")
    body = agent.size[0] / (BASE_RADIUS * config.init_radius_multiplier)
    agent.size = [max(body, LEAST_BALL * 2 / size), 0, 0]
    top.pos, top.fovy = [0, 0, 2], 2
    floor.size = [1, 1, 0.1]
    spec.stat.extent, spec.stat.center = 2, [0, 0, 0]
    spec.visual.global_.offwidth = spec.visual.global_.offheight = size
    # Flat light keeps the floor's colours as they are.
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [1, 1, 1], [0, 0, 0]
    spec.visual.quality.shadowsize = 0  # no shadows here, whose buffer would take 64 MB
    picture = spec.add_texture(name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D)
    picture.builtin, picture.width, picture.height = mujoco.mjtBuiltin.mjBUILTIN_FLAT, size, size
    material = spec.add_material(name="floor")
    textures = material.textures
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    material.textures = textures
    floor.material, floor.rgba = "floor", [1, 1, 1, 1]
    return spec.compile()
