"""Run these tests with the process settings of a training and few evaluated episodes."""

import pytest
from small_runs import few_episodes

from agents.lockstep import backend


@pytest.fixture(autouse=True, scope="session")
def as_in_training():
    backend.configure(backend.choose("c++")[0])
    with few_episodes():
        yield
