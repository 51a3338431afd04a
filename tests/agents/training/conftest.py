"""Tests of training: its tasks, and few evaluated episodes at its end."""

import pytest
import toys
from small_runs import few_episodes

toys.register()


@pytest.fixture(autouse=True, scope="module")
def few():
    with few_episodes():
        yield
