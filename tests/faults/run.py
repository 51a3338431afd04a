"""The long fault suite: `make faults`. Prints how many faults were tried, and the defects."""

import argparse
import os
import random
import sys
import tempfile
import time
import warnings
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT / "tests" / "agents"), str(ROOT)]

from fault_common import Tally  # noqa: E402
from fault_damage import try_costs, try_damage, try_misfits  # noqa: E402
from fault_inputs import try_arrays, try_options  # noqa: E402
from fault_kills import (  # noqa: E402
    scenes,
    try_disks,
    try_kills,
    try_limits,
    try_reads,
    try_signals,
    try_tasks,
)
from small_runs import checkpoints_often  # noqa: E402


def main():
    """Run as many faults of each kind as the options say."""
    parser = argparse.ArgumentParser(description=__doc__)
    counts = {"kills": 1000, "disks": 150, "signals": 100, "reads": 150}
    counts |= {"damage": 2000, "options": 1500, "arrays": 9000, "environments": 40}
    for name, count in counts.items():
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    rng, tally, started = random.Random(chosen.seed), Tally(), time.monotonic()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder, checkpoints_often():
        root = Path(folder)
        if chosen.kills + chosen.disks + chosen.signals + chosen.reads + chosen.damage:
            found = scenes(root)
            try_kills(tally, found, chosen.kills, rng)
            try_disks(tally, found, chosen.disks, rng)
            try_signals(tally, found, chosen.signals, rng)
            try_reads(tally, found, chosen.reads, rng)
            try_damage(tally, root / "whole", chosen.damage, rng, root)
            try_costs(tally, root / "whole", chosen.damage, rng, root)
            try_misfits(tally, root / "whole", chosen.damage // 20, rng, root)
        if chosen.options:
            try_options(tally, chosen.options, rng, root)
        if chosen.arrays:
            try_arrays(tally, chosen.arrays, rng)
        try_tasks(tally, chosen.environments, rng, root)
        try_limits(tally, root)
    print(tally.table())
    print(f"{time.monotonic() - started:.0f} s")
    return int(bool(tally.defects))


if __name__ == "__main__":
    sys.exit(main())
