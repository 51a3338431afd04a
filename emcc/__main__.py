"""python -m emcc PATH...: print EMCC, or the panel of all measures, of run folders and files."""

import argparse
import io
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from emcc.arrays import named
from emcc.panels import (
    INTERVALS,
    MOVING_WINDOW,
    emcc_of_thirds,
    mean_cell,
    panel,
    panel_table,
    window_words,
)
from emcc.parts import ALPHA, PARTS, TIES, cost_rate
from emcc.sources import Run, read_runs
from emcc.statistics import COST, SHARE
from emcc.table import FORMATS, MISSING, Table

_PATHS = """\
PATH is
  a run folder of `circle2d train`, a .zip archive of run folders, or a folder that holds some
  a file with the cost of each step: .npz (costs and lengths; rewards and rollouts are optional),
      .npy ([episodes, steps]), or .csv (cost; episode, or done, terminated, truncated at an
      episode's last step; reward and rollout are optional); an episode's steps are consecutive
  a .csv file with a row per episode (length, cost, longest_streak, or as
      emcc.EpisodeRecords.save writes it)

exit status: 0 EMCC is given for each third of training; 1 no rollout starts in one of them, or a
    failed run is left out; 2 wrong arguments or unreadable input
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        # One line without the usage text. Paths may contain control characters.
        shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
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
    text = "limit on an episode's undiscounted cost: print the panel of all measures"
    add("--limit", type=float, metavar="D", help=f"{text} (default: EMCC and the cost rate)")
    text = f"episodes in the panel's moving window, with --limit (default {MOVING_WINDOW})"
    add("--moving-window", type=int, metavar="N", help=text)
    windows, text = parser.add_mutually_exclusive_group(), "EMCC over windows of N consecutive"
    text = f"{text} episodes instead of rollouts: makes runs of any two algorithms comparable"
    windows.add_argument("--window", type=int, metavar="N", help=text)
    text = "EMCC over windows of all episodes that start within N steps, for unequal lengths"
    windows.add_argument("--window-steps", type=int, metavar="N", help=text)
    text = "share of the rollouts with the highest MCC, in (0, 1] (default %(default)s)"
    add("--alpha", type=float, default=ALPHA, help=text)
    text = "split: mean of exactly the share alpha of highest MCC values; all: mean of all values"
    text = f"{text} at or above the (1 - alpha) quantile (default %(default)s)"
    add("--ties", choices=TIES, default=TIES[0], help=text)
    text = "a step whose cost exceeds it is a cost step (default 0); needs the cost of each step"
    add("--threshold", type=float, default=0.0, help=text)
    text = "environment steps of the whole training (default: from the run folder, or as recorded)"
    add("--total-steps", type=int, metavar="N", help=text)
    add("--format", choices=FORMATS, default="text", help="format of the table (default text)")
    add("--per-run", action="store_true", help="print the numbers of every run instead of means")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables and return the exit status."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # the terminal's encoding may lack characters
    parser = _parser()
    options = parser.parse_args(argv)
    try:
        moving = options.moving_window
        if moving is not None and (options.limit is None or moving < 1):
            raise ValueError(f"--moving-window needs --limit and at least 1, got {moving}")
        if options.window is not None and options.limit is not None and moving is None:
            words = "since 0.4, --window sets EMCC's window; --moving-window sets the panel's"
            print(f"note: {words}", file=sys.stderr)
        runs = [run for path in options.paths for run in read_runs(path, options.threshold)]
        # Paths may overlap.
        runs = list({(run.source, run.task, run.seed, run.cost): run for run in runs}.values())
        if options.total_steps is not None:
            runs = [replace(run, total_steps=options.total_steps) for run in runs]
        complete = [run for run in runs if not run.incomplete]
        if not complete:
            raise ValueError(f"{runs[0].source}: {runs[0].incomplete}")
        groups: dict[tuple[str, ...], list[Run]] = {}
        for run in complete:
            seed = run.seed if options.per_run else ""
            groups.setdefault((run.source, run.task, run.cost, seed), []).append(run)
        if options.limit is None:
            tables = [_emcc_table(list(groups.values()), options)]
        else:
            tables = [_panel_table(group, options) for group in groups.values()]
        print("\n".join(table.render(options.format) for table in tables), end="")
    except (ValueError, OSError, ImportError) as error:
        parser.error(str(error))
    left_out = [f"{_name(run)}: {run.incomplete}" for run in runs if run.incomplete]
    for words in dict.fromkeys(left_out):  # a run with several costs is named once
        print(f"left out: {words}", file=sys.stderr)
    lacking = any(None in _emcc_by_part(run, options) for run in complete)
    return int(lacking or bool(left_out))


def _emcc_table(groups: Sequence[Sequence[Run]], options: argparse.Namespace) -> Table:
    """A row for each group of runs; the runs of a group differ only in their seeds."""
    rows = []
    for group in groups:
        first, seeds = group[0], " ".join(run.seed for run in group)
        totals = sorted({run.total_steps for run in group})
        steps = " to ".join(map(str, dict.fromkeys((totals[0], totals[-1]))))
        about = first.source, first.algorithm, _task(first), seeds, steps
        thirds = zip(*(_emcc_by_part(run, options) for run in group), strict=True)
        cells = [mean_cell(values, 3, SHARE) for values in thirds]
        rates = [cost_rate(run.records.cost, run.records.length) for run in group]
        rows.append([word or MISSING for word in about] + [*cells, mean_cell(rates, 3, COST)])
    choices = [f"alpha = {options.alpha:g}", f"ties = {options.ties}"]
    choices += filter(None, [window_words(options.window, options.window_steps)])
    choices = ", ".join(choices) + _threshold(options)
    caption = f"EMCC with {choices}; means over runs {INTERVALS}"
    head = ["source", "algorithm", "task", "seeds", "steps", *(f"EMCC_{part}" for part in PARTS)]
    return Table(caption, [*head, "cost rate"], rows)


def _emcc_by_part(run: Run, options: argparse.Namespace) -> list[float | None]:
    """EMCC of each third of training; None if no rollout or window starts in the third."""
    windows = options.window, options.window_steps
    records = run.records if windows == (None, None) else run.whole
    with named(run.source):
        choices = options.alpha, options.ties, *windows
        return [*emcc_of_thirds(records, run.total_steps, *choices).values()]


def _panel_table(group: Sequence[Run], options: argparse.Namespace) -> Table:
    first = group[0]
    # One moving window for all runs, since the rows name its length.
    moving = min(
        options.moving_window or MOVING_WINDOW, *(len(run.episodes or run.records) for run in group)
    )
    with named(first.source):
        panels = [
            panel(
                run.records,
                options.limit,
                options.alpha,
                ties=options.ties,
                window=options.window,
                window_steps=options.window_steps,
                moving_window=moving,
                total_steps=run.total_steps,
                episodes=run.episodes,
            )
            for run in group
        ]
    seeds = f"seeds {' '.join(run.seed for run in group)}" if first.seed else ""
    words = first.source, first.algorithm, _task(first), seeds
    return panel_table(panels, ", ".join(filter(None, words)) + _threshold(options))


def _threshold(options: argparse.Namespace) -> str:
    return f", cost steps above {options.threshold:g}" if options.threshold else ""


def _task(run: Run) -> str:
    return f"{run.task} ({run.cost})" if run.cost != "cost" else run.task


def _name(run: Run) -> str:
    return ", ".join(filter(None, (run.source, run.task, run.seed and f"seed {run.seed}")))


if __name__ == "__main__":
    sys.exit(main())
