"""Common parts of the faults: commands in forked processes, and a tally of tries and defects."""

import contextlib
import io
import os
import re
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from agents.cli.main import main

SAC = ["--random-steps", "50", "--gradient-steps", "1", "--batch-size", "32"]
EVERY = 100
"""A line of progress is printed after so many tries: the whole suite takes long."""


@dataclass
class Tally:
    """Number of faults tried of each kind, and the defects that followed."""

    tried: Counter = field(default_factory=Counter)
    defects: list[tuple[str, str]] = field(default_factory=list)

    def note(self, kind: str, problem: str) -> None:
        """Count a try. problem: what was wrong; empty if nothing was."""
        self.tried[kind] += 1
        if self.tried[kind] % EVERY == 0:
            print(f"{self.tried[kind]:,} tried: {kind}", file=sys.stderr, flush=True)
        if problem:
            self.defects.append((kind, problem))
            print(f"defect: {kind}: {problem}", file=sys.stderr, flush=True)

    def table(self) -> str:
        """Return a Markdown table with a row for each kind."""
        wrong = Counter(kind for kind, _ in self.defects)
        rows = [(kind, n, n - wrong[kind], wrong[kind]) for kind, n in self.tried.items()]
        rows.append(("all", *(sum(row[k] for row in rows) for k in (1, 2, 3))))
        head = "| fault | tried | clean | defects |\n| --- | ---: | ---: | ---: |\n"
        return head + "".join(f"| {a} | {b:,} | {c:,} | {d:,} |\n" for a, b, c, d in rows)


@dataclass
class Done:
    """A command that ended."""

    status: int
    """Exit status of the process; negative: the number of the signal that killed it."""
    out: str
    err: str

    def problem(self, allowed: tuple[int, ...]) -> str:
        """Return what is wrong; empty if nothing is. allowed: statuses that are right."""
        if "Traceback" in self.err or "Exception ignored" in self.err:
            return f"a traceback: {self.err[-600:]}"
        if self.status not in allowed:
            return f"status {self.status}, not one of {allowed}: {self.err[-300:]}"
        own = [line for line in self.err.splitlines() if line.startswith("circle2d: ")]
        if self.status == 2 and len(own) != 1:
            return f"not one line: {self.err[-400:]}"
        return ""


def forked(act: Callable[[], int]) -> Done:
    """Run a function in a forked process, which has all loaded modules of this one."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        sys.stdout.flush()
        sys.stderr.flush()
        pid = os.fork()
        if not pid:
            status = 70
            try:
                os.dup2(out.fileno(), 1)
                os.dup2(err.fileno(), 2)
                sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
                signal.signal(signal.SIGINT, signal.default_int_handler)
                status = act()
            except BaseException:
                traceback.print_exc()
            finally:
                with contextlib.suppress(Exception):
                    sys.stdout.flush()
                    sys.stderr.flush()
                os._exit(status)
        _, code = os.waitpid(pid, 0)
        for file in (out, err):
            file.seek(0)
        return Done(os.waitstatus_to_exitcode(code), out.read(), err.read())


def here(args: list[str]) -> Done:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(args)
        except BaseException:
            traceback.print_exc()
            status = 70
    return Done(status, out.getvalue(), err.getvalue())


def leftovers(folder: Path) -> list[str]:
    """Return the temporary files below a folder."""
    return [str(path) for path in folder.rglob("*") if re.search("unfinished|tmp", path.name)]


def difference(found: dict[str, bytes], expected: dict[str, bytes]) -> str:
    """Return the names of files that differ, joined by commas."""
    names = found.keys() | expected.keys()
    return ", ".join(sorted(name for name in names if found.get(name) != expected.get(name)))


def fresh(of: Path, to: Path) -> Path:
    """Replace the folder `to` by a copy of `of`; return its path."""
    shutil.rmtree(to, ignore_errors=True)
    return shutil.copytree(of, to)
