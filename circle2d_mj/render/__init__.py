"""Pictures: canvas, figures, and off-screen OpenGL."""

from circle2d_mj.render.renderer import Renderer

__all__ = ["Renderer"]
