"""Trainings of these tests end with few evaluated episodes, but where processes of their own train.
"""

import pytest
import toys
from small_runs import few_episodes

toys.register()


@pytest.fixture(autouse=True, scope="module")
def few():
    with few_episodes():
        yield
