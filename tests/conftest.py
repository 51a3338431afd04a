"""What tests of all packages share."""

import pytest


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
