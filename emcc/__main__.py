"""python -m emcc PATH...: EMCC, or the panel of all measures, of run folders and cost files."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from emcc.inputs import EpisodeSums, EpochMeans, Run
from emcc.panels import WINDOW
from emcc.parts import ALPHA
from emcc.readers import find_files, read_file
from emcc.run_tables import bounds_table, emcc_table, epochs_table, panel_tables
from emcc.table import FORMATS
from emcc.tail import TIES

_PATHS = """\
PATH is
  a folder: every episodes.csv in it or below; a config.json beside one may give the task,
      the algorithm, the seed and the steps of the whole training. A folder without one:
      every progress.csv and *monitor.csv
  a file of records, as emcc.EpisodeRecords.save writes it, or a .csv with a row per episode
      (cost, length, longest_streak)
  costs of steps: .npy, .npz (costs, lengths), .csv (cost; if several, episode and rollout,
      or done, terminated, truncated, which mark an episode's last step)
  sums of episodes: .csv (cost, length), or a monitor file of Stable-Baselines3 with the
      column cost. They bound the longest streak, but have no EMCC
  means of epochs: progress.csv of OmniSafe or SafePO. They give the cost rate, but no EMCC

exit status: 0 the table is complete; 1 a number is missing (no rollout starts in a third of
  training), or the file holds sums or means; 2 a mistake
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        # One line, without the usage, and without control characters that paths may hold.
        words = " ".join(message.splitlines())
        shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)
        self.exit(2, f"{self.prog}: error: {shown}\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m emcc",
        description="Print EMCC (expected maximum consecutive cost steps) of training runs.",
        epilog=_PATHS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("paths", nargs="+", type=Path, metavar="PATH", help="run folder or file, see below")
    add(
        "--limit",
        type=float,
        metavar="D",
        help="cost limit of an episode, undiscounted: print the panel of all measures "
        "(default: print EMCC and the cost rate)",
    )
    add(
        "--window",
        type=int,
        default=WINDOW,
        metavar="N",
        help="episodes of the panel's moving window (default %(default)s)",
    )
    add(
        "--alpha",
        type=float,
        default=ALPHA,
        help="share of the rollouts with the highest MCC, in (0, 1] (default %(default)s)",
    )
    add(
        "--ties",
        choices=TIES,
        default="all",
        help="all: the mean of all values at or above the quantile; split: of exactly the share "
        "alpha of highest values (default all)",
    )
    add(
        "--threshold",
        type=float,
        default=0.0,
        help="a step that costs more is a cost step (default 0)",
    )
    add("--total-steps", type=int, metavar="N", help="environment steps of the whole training "
        "(default: steps in config.json, else those recorded)")  # fmt: skip
    add("--format", choices=FORMATS, default="text", help="form of the table (default text)")
    add(
        "--per-run", action="store_true", help="also the numbers of every run (default: means only)"
    )
    add(
        "--seed",
        type=int,
        default=0,
        help="random seed of bootstrap intervals, which stand in for t intervals where scipy is "
        "missing (default 0)",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = _parser()
    options = parser.parse_args(argv)
    try:
        files = dict.fromkeys(file for path in options.paths for file in find_files(path))
        contents = [read_file(file, options.threshold) for file in files]
        runs = [content for content in contents if isinstance(content, Run)]
        sums = [content for content in contents if isinstance(content, EpisodeSums)]
        means = [content for content in contents if isinstance(content, EpochMeans)]
        if options.total_steps is not None:
            planned = {"total_steps": options.total_steps, "total_from": "--total-steps"}
            runs = [replace(run, **planned) for run in runs]
        tables = []
        if runs and options.limit is not None:
            tables += panel_tables(
                runs, options.limit, options.alpha, options.ties, options.window, options.seed,
                options.per_run,
            )  # fmt: skip
        elif runs:
            tables.append(
                emcc_table(runs, options.alpha, options.ties, options.seed, options.per_run)
            )
        if sums:
            tables.append(bounds_table(sums, options.limit))
        if means:
            tables.append(epochs_table(means, options.limit))
        print("\n".join(table.render(options.format) for table in tables), end="")
    except (ValueError, OSError) as error:
        parser.error(str(error))
    for entry in (*sums, *means):
        print(f"{parser.prog}: {entry.path}: {entry.contents} cannot give EMCC", file=sys.stderr)
    return 0 if not sums and not means and all(table.complete for table in tables) else 1


if __name__ == "__main__":
    sys.exit(main())
