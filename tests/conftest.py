"""What tests of all packages share."""

import os

import pytest
from hypothesis import settings

# The same examples each time, however slow the machine: a failure can be seen again.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")

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
