"""`circle2d scene`: print the MuJoCo scene of a Circle2D task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from agents.cli.options import parse
from agents.errors import UserError
from circle2d_mj import Circle2DConfig
from circle2d_mj.render.gl import NoOpenGL, check_backend


@dataclass(frozen=True)
class SceneOptions:
    """Print the MuJoCo scene of a task as MJCF, to be opened in MuJoCo's viewer."""

    config: Annotated[Circle2DConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=Circle2DConfig
    )
    actuation: str = "velocity"
    """velocity: servos; force: motors against a damping."""


def run(args: Sequence[str]) -> int:
    """Run `circle2d scene`; returns the exit status."""
    options = parse(SceneOptions, "scene", args)
    try:
        check_backend()
        from circle2d_mj.circle2d.scene import scene

        spec = scene(options.config, options.actuation)
    except (ValueError, NoOpenGL) as error:
        raise UserError(str(error)) from None
    spec.compile()
    print(spec.to_xml(), end="")
    return 0
