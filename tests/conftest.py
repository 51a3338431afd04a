"""What tests of all packages share."""

import os

import pytest

# Compiling takes longer than most tests; those of compiled code take it back.
os.environ.setdefault("TORCH_COMPILE_DISABLE", "1")


@pytest.fixture(scope="session")
def opengl():
    """Skips the test where nothing can draw off-screen; the error says what to install."""
    from circle2d_mj import Circle2DConfig
    from circle2d_mj.gl import NoOpenGL
    from circle2d_mj.render import Renderer

    try:
        Renderer(Circle2DConfig(), 64).close()
    except NoOpenGL as error:
        pytest.skip(str(error))
