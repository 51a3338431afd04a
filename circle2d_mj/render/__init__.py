"""Pictures: canvas, figures, and off-screen OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from circle2d_mj.render.renderer import Renderer

__all__ = ["Renderer"]


def __getattr__(name: str) -> Any:
    # When asked for, since `Renderer` imports Circle2D, which imports modules of this package.
    if name != "Renderer":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from circle2d_mj.render.renderer import Renderer

    return Renderer
