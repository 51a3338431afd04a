"""A few faults of each kind; `make faults` tries thousands."""

import random

import pytest
from fault_common import Tally
from fault_damage import try_costs, try_damage, try_misfits
from fault_inputs import try_arrays, try_options
from fault_kills import scenes, try_disks, try_kills, try_limits, try_reads, try_signals, try_tasks
from small_runs import checkpoints_often

QUICK = ("train", "resume", "evaluate")


@pytest.mark.filterwarnings("ignore")
def test_a_few_faults(tmp_path):
    """Killed processes, full disks, signals, files that are damaged or once unreadable, failing
    tasks, odd options and arrays."""
    rng, tally = random.Random(1), Tally()
    with checkpoints_often():
        found = scenes(tmp_path, names=QUICK)
        try_kills(tally, found, 1, rng)
        try_disks(tally, found, 2, rng)
        try_signals(tally, found, 1, rng)
        try_reads(tally, found, 4, rng)
        try_tasks(tally, 3, rng, tmp_path)
        try_limits(tally, tmp_path)
        try_damage(tally, tmp_path / "whole", 4, rng, tmp_path)
        try_costs(tally, tmp_path / "whole", 20, rng, tmp_path)
        try_misfits(tally, tmp_path / "whole", 2, rng, tmp_path)
    try_options(tally, 15, rng, tmp_path)
    try_arrays(tally, 200, rng)
    assert sum(tally.tried.values()) == 254
    assert not tally.defects
