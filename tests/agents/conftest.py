"""Tests of training run under the settings of training."""

import pytest
from small_runs import few_episodes

from agents.lockstep import backend


@pytest.fixture(autouse=True, scope="session")
def as_in_training():
    backend.configure(backend.choose("c++")[0])
    with few_episodes():
        yield
