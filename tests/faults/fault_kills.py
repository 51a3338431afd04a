"""SIGKILL, full disks, signals and failed reads at random file operations of commands; failing
tasks."""

import errno
import fcntl
import os
import re
import resource
import shutil
import signal
import sys

import toys
from fault_common import SAC, Done, Tally, difference, forked, fresh, here, leftovers
from small_runs import processes, results

import agents
from agents.cli.main import main
from agents.errors import UserError
from agents.results.reading import read_groups
from agents.training.files import numbered

SMALL = ["--steps", "150", "--seeds", "0", "1", "--checkpoint-every"]
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
EVENTS = ("open", "os.rename", "os.mkdir", "os.remove")


class Operations:
    """Counts this process's file operations below a folder, and calls a function at some of them.

    Only for short-lived processes: an audit hook cannot be removed.
    """

    def __init__(self, folder, at=-1, act=lambda file: None, until=None, reading=False):
        """act: called at the operations `at` to `until`, by default only at the first. reading:
        count files that are opened for reading, instead of operations that write."""
        self.folder, self.act, self.count, self.reading = str(folder), act, 0, reading
        self.at, self.until = at, at if until is None else until
        self.fsync = os.fsync

    def __enter__(self):
        sys.addaudithook(self._audit)
        os.fsync = self._fsync
        return self

    def __exit__(self, *exception):
        os.fsync, self.folder = self.fsync, "\0"

    def _audit(self, event, arguments):
        if event not in EVENTS or not str(arguments[0]).startswith(self.folder):
            return
        writes = event != "open" or (isinstance(arguments[2], int) and arguments[2] & WRITING)
        if bool(writes) == self.reading:
            return
        if event == "os.remove" and self.until > self.at:
            return  # files can be removed from a full disk
        self._next(None)

    def _fsync(self, file):
        if not self.reading:
            self._next(file)
        self.fsync(file)

    def _next(self, file):
        self.count += 1
        if self.at <= self.count <= self.until:
            self.act(file)


class Scene:
    """A command, its folder before it, and what the folder must hold after it is repeated."""

    def __init__(self, name, root, before, args, again):
        """before: a folder to start from, or None. args, again: functions of a folder that return
        the command, and the command that goes on after it was stopped."""
        self.name, self.before, self.args, self.again = name, before, args, again
        self.folder = root / "runs"
        self._prepare()
        self.before_it = measures(self.folder) if before else {}

        self.operations, self.reads = self._count(), None
        self.expected, self.measures = results(self.folder), measures(self.folder)

    def _count(self, reading=False):
        """Return the number of the command's operations on files of its folder."""

        def count():
            with Operations(self.folder, reading=reading) as operations:
                status = main(self.args(self.folder))
            print(f"\n{operations.count}")
            return status

        done = forked(count)
        assert done.status == 0, done.err
        return int(done.out.splitlines()[-1])

    def _prepare(self):
        if self.before is None:
            shutil.rmtree(self.folder, ignore_errors=True)
        else:
            fresh(self.before, self.folder)

    def fault(self, rng, act, allowed, lasting=False):
        """Cause a fault at a random operation, run the command again, return what was wrong."""
        self._prepare()
        at = rng.randint(1, self.operations)

        def run():
            with Operations(self.folder, at, act, 10**9 if lasting else None):
                return main(self.args(self.folder))

        done = forked(run)
        return self.after(done, allowed, f"{self.name}, operation {at} of {self.operations}")

    def unread(self, rng, error):
        """Let one read of a file fail once, which must not be taken for damage of the file."""
        self._prepare()
        if self.reads is None:
            self.reads = self._count(reading=True)
            self._prepare()
        at = rng.randint(1, self.reads)

        def fails(file):
            raise error

        def run():
            with Operations(self.folder, at, fails, reading=True):
                return main(self.args(self.folder))

        done, where = forked(run), f"{self.name}, {error!r} at read {at} of {self.reads}"
        taken = re.search("damaged|checkpoint before|missing", done.err)
        return f"{where}: {done.err[-300:]}" if taken else self.after(done, (0, 2), where)

    def limited(self, rng):
        """Run the command with a limit on the size of files."""
        self._prepare()
        limit = rng.choice([0, 100, 1000, 5000, 20_000, 50_000])

        def run():
            hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
            status = main(self.args(self.folder))
            resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
            return status

        return self.after(forked(run), (0, 2), f"{self.name}, files of at most {limit} bytes")

    def after(self, done: Done, allowed, where):
        """Go on after a command that was stopped; return what was wrong."""
        if problem := done.problem(allowed):
            return f"{where}: {problem}"
        if done.status >= 0 and (left := leftovers(self.folder)):
            return f"{where}: left {left}"
        for seed, of_run in measures(self.folder).items():
            if of_run not in (self.measures[seed], self.before_it.get(seed)):
                return f"{where}: a report gives other numbers of seed {seed}"
        goes_on = self.again if (self.folder / "config.json").exists() else self.args
        again = forked(lambda: main(goes_on(self.folder)))
        if problem := again.problem((0,)):
            return f"{where}: again: {problem}"
        if left := leftovers(self.folder):
            return f"{where}: again left {left}"
        if changed := difference(results(self.folder), self.expected):
            return f"{where}: differs: {changed}"
        return ""


def measures(folder):
    """Return, by seed, the measures of the runs that a report takes for complete."""
    try:
        groups = read_groups([folder], [])
    except UserError:
        return {}
    return {run.seed: run.measures for group in groups for run in group.runs}


def scenes(root, names=()):
    """Return scenes of every command that writes, except reproduce. names: of some scenes only."""
    options = [*SMALL, "50"]
    whole, stopped = root / "whole", root / "stopped"
    sac = ["train", "sac-lag", "--evaluate-every", "100", *SAC, *options]
    cpo = ["train", "cpo", "--episodes", "1", *options]
    assert here([*sac, "--out", str(whole)]).status == 0
    settings = {"random_steps": 50, "gradient_steps": 1, "batch_size": 32, "evaluate_every": 100}
    settings |= {"seeds": (0, 1), "steps": 150, "checkpoint_every": 50}
    stop = {"on_epoch": lambda epoch: epoch.runs[0]["step"] < 100, "out": stopped}
    agents.train("sac-lag", **settings, **stop)

    def of(command, *more):
        return lambda folder: [command, str(folder), *(m.format(folder) for m in more)]

    resume, evaluate = of("resume"), of("evaluate", "--episodes", "5")
    longer = of("resume", "--steps", "220")
    heatmap, packed = of("heatmap", "--size", "64"), of("report", "--archive", "{}/archive.zip")
    film = of("render", "--size", "64", "--episodes", "1", "--out", "{}/film.gif")
    found = {
        "train": (None, lambda f: [*sac, "--out", str(f)], resume),
        "train cpo": (None, lambda f: [*cpo, "--out", str(f)], resume),
        "resume": (stopped, resume, resume),
        "resume of a finished run": (whole, resume, resume),
        "resume --steps": (whole, longer, longer),
        "evaluate": (whole, evaluate, evaluate),
        "heatmap": (whole, heatmap, heatmap),
        "film": (whole, film, film),
        "report": (whole, packed, packed),
    }
    return [Scene(name, root, *found[name]) for name in names or found]


def kill_of(rng):
    """Return an act that kills the process, sometimes with the end of its last file cut off."""

    def act(file):
        if file is not None and rng.random() < 0.5:
            size = os.fstat(file).st_size
            os.ftruncate(file, max(0, size - rng.randrange(1, 200)))
        os.kill(os.getpid(), signal.SIGKILL)

    return act


def no_space(file):
    """Act as a full disk."""
    raise OSError(errno.ENOSPC, "No space left on device")


def signal_of(rng):
    """Return an act that sends a signal which ends commands, and the statuses that may follow."""
    number = rng.choice([signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
    return lambda file: os.kill(os.getpid(), number), (0, 128 + number)


def chosen(found, count, rng):
    """Choose random commands; those that take seconds are rarer."""
    weights = {"report": 1, "film": 2, "heatmap": 3}
    return rng.choices(found, [weights.get(scene.name, 10) for scene in found], k=count)


def try_kills(tally: Tally, found, count, rng):
    """SIGKILL at random operations of random commands."""
    for scene in chosen(found, count, rng):
        problem = scene.fault(rng, kill_of(rng), (-signal.SIGKILL, 0))
        tally.note(f"SIGKILL: {scene.name}", problem)


def try_disks(tally: Tally, found, count, rng):
    """Full disks, and files that cannot grow."""
    for k, scene in enumerate(chosen(found, count, rng)):
        if k % 3:
            tally.note("full disk", scene.fault(rng, no_space, (0, 2), lasting=True))
        else:
            tally.note("limit of file sizes", scene.limited(rng))


def try_reads(tally: Tally, found, count, rng):
    """Reads that fail once, as on a network's disk or for lack of memory."""
    numbers = (errno.EIO, errno.ESTALE, errno.EACCES, errno.EMFILE)
    errors = [*(OSError(number, os.strerror(number)) for number in numbers), MemoryError()]
    scenes = [scene for scene in found if scene.name in ("resume", "evaluate")]
    for scene in chosen(scenes, count, rng):
        tally.note("file not read once", scene.unread(rng, rng.choice(errors)))


def try_limits(tally: Tally, root):
    """A training that leaves more files than a process may open; a file system without locks."""
    out = root / "limits"
    short = ["--task-parameters", "max_episode_steps", "2", "--evaluation-episodes", "1"]
    short += ["--hidden", "8", "--critic-iterations", "2"]
    command = ["train", "cpo", "--episodes", "1", *short, *SMALL, "1", "--backend", "numpy"]
    command += ["--out", str(out)]

    def few_handles():
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
        return main(command)

    problem = forked(few_handles).problem((0,))
    files = len(list((out / "steps").iterdir()))
    tally.note("few file handles", problem or ("" if files > 64 else f"{files} files alone"))
    shutil.rmtree(out)

    def without_locks():
        def fails(*args):
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

        fcntl.flock = fails
        return main(command)

    done = forked(without_locks)
    problem = done.problem((2,)) or ("a folder was left" if out.exists() else "")
    tally.note("no file locks", problem or ("" if ".lock" in done.err else done.err))


def try_signals(tally: Tally, found, count, rng):
    """SIGTERM, SIGINT and SIGHUP at random operations."""
    for scene in chosen(found, count, rng):
        act, allowed = signal_of(rng)
        tally.note("SIGTERM, SIGINT, SIGHUP", scene.fault(rng, act, allowed))


HOW = ("observation", "reward", "cost", "raise", "exit", "complex", "missing", "negative")
ENDS = ("die", "hang")
"""Failures that end the training; the others end only the run in which they happen."""


def try_tasks(tally: Tally, count, rng, root):
    """Tasks that fail: the command prints one line, has status 1 and leaves no process. If the
    training ended, its newest checkpoint is the last before that; if a run ended, resuming does not
    start it again."""
    toys.register()
    out = root / "failing"
    for _ in range(count):
        how, at, apart = rng.choice(HOW + ENDS), rng.randrange(21, 140), rng.random() < 0.4
        shutil.rmtree(out, ignore_errors=True)
        command = ["train", "sac-lag", "--task", "Broken-v0", *SMALL, "20", *SAC]
        command += ["--backend", "numpy", "--task-parameters", "how", how, "at", str(at)]
        if apart or how in ENDS:
            command += ["--vectorization", "async", "--step-timeout", "1.5"]
        done = forked(lambda it=(*command, "--out", str(out)): main(it))
        told = [line for line in done.err.splitlines() if line.startswith("circle2d: ")]
        problem = "" if (done.status, len(told)) == (1, 1) else f"{done.status}: {done.err[-600:]}"
        newest = max(numbered(out, "checkpoints"), default=0)
        if not problem and how in ENDS and newest != (at - 1) // 20 * 20:  # episodes have 20 steps
            problem = f"checkpoint at {newest}"
        if not problem and how not in ENDS:
            before = results(out)
            again = forked(lambda: main(["resume", str(out)]))
            problem = "" if again.status == 1 else f"again: {again.status}: {again.err[-300:]}"
            problem = problem or difference(results(out), before)
        if not problem and (left := processes(out)):
            problem = f"processes are left: {left}"
        tally.note("failing environments", f"{how} at {at}: {problem}" if problem else "")
