"""Damaged files: every file of a run folder is cut off, has bits flipped, or is replaced."""

import contextlib
import io
import json
import warnings

import numpy as np
from fault_common import Tally, difference, fresh, here
from fault_kills import measures
from small_runs import results

import agents
from agents.errors import UserError
from emcc.__main__ import main as emcc

NOT_OF_RESULTS = (
    ".lock",
    "status.json",
    "report.md",
    "report.csv",
    "measures.csv",
    "heatmap.png",
    "film.gif",
)
"""Files that commands do not read, or that hold no results."""


def saved(save, *arrays, **named):
    """Return the bytes of the file that np.save or np.savez writes."""
    buffer = io.BytesIO()
    save(buffer, *arrays, **named)
    return buffer.getvalue()


OTHERS = [
    b"", b"\0", b"\xff\xfe\x00", b"x" * 1000, b"[" * 100_000, b'{"a":' * 100_000, b"null", b"true",
    b"3", b'"x"', b"[1, 2]", b"{}", b'{"seed": 0}', b'{"task": null}', b"NaN", b"1e999", b"\n" * 50,
    b"PK\x03\x04" + b"\0" * 50, b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'",
    *(saved(np.save, array) for array in (np.zeros((3, 4, 5)), np.array(["a"]), np.array(3.0))),
    saved(np.save, np.array([{}], dtype=object), allow_pickle=True),
    *(saved(np.savez, **arrays) for arrays in ({"a": np.zeros(3)}, {"epoch": np.array(3)}, {})),
]  # fmt: skip


def edit_json(data, rng):
    """Return JSON with one value replaced; data that is not JSON is cut in half."""
    try:
        content = json.loads(data)
    except ValueError:
        return data[: len(data) // 2]
    at = content
    while isinstance(at, (dict, list)) and at:
        key = rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))
        if not isinstance(at[key], (dict, list)) or not at[key] or rng.random() < 0.3:
            values = [None, True, -1, 7.5, "x", [], {}, [[1]], 10**400, float("nan")]
            at[key] = rng.choice([v for v in values if v != at[key]])
            break
        at = at[key]
    return json.dumps(content).encode()


def damaged(data, rng):
    """Return the name of a random kind of damage, and the damaged data."""
    kind = rng.choice(["cut off", "flipped bit", "flipped bit", "another kind", "edited", "longer"])
    if kind == "cut off" and data:
        return kind, data[: rng.randrange(len(data))]
    if kind == "flipped bit" and data:
        changed = bytearray(data)
        # As often near the ends, where headers and directories are.
        at = rng.choice([rng.randrange(len(data)), rng.randrange(min(200, len(data)))])
        at = rng.choice([at, len(data) - 1 - rng.randrange(min(400, len(data)))])
        changed[at] ^= 1 << rng.randrange(8)
        return kind, bytes(changed)
    if kind == "edited":
        return kind, edit_json(data, rng)
    if kind == "longer":
        return kind, data + rng.choice([b"\0", b"\n", b"1", data[-50:]])
    return "another kind", rng.choice(OTHERS)


def emcc_of(folder):
    """Return the status and the output of `python -m emcc`."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = emcc([str(folder), "--per-run"])
        except SystemExit as exit_:
            status = exit_.code
    return status, out.getvalue()


class Readers:
    """Commands that read a folder, and their output for the undamaged folder."""

    def __init__(self, whole, folder):
        self.folder = fresh(whole, folder)
        self.expected, self.measures = results(folder), measures(folder)
        self.emcc = emcc_of(folder)[1]
        self.table = here(["evaluate", str(folder), "--episodes", "2"]).out
        self.action = agents.load_policy(folder, seed=1)(np.zeros(2)).tolist()
        fresh(whole, folder)

    def problems(self, rng, name):
        """Yield what is wrong with the output of some commands. name: of the damaged file."""
        status, out = emcc_of(self.folder)
        if status == 0 and out != self.emcc:
            yield "emcc gives other numbers"
        for seed, found in measures(self.folder).items():
            if found != self.measures[seed]:
                yield f"the report gives other numbers of seed {seed}"
        # If the last checkpoint is damaged, a message says that the one before is used.
        with contextlib.suppress(UserError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            action = agents.load_policy(self.folder, seed=1)(np.zeros(2)).tolist()
            if action != self.action and not name.startswith("checkpoints"):
                yield "another policy"
        evaluates = rng.random() < 0.3
        command = ["evaluate", "--episodes", "2"] if evaluates else ["resume"]
        done = here([*command, str(self.folder)])
        text = done.err.replace("going on from the checkpoint before", "")
        if "Traceback" in text or done.status not in (0, 2):
            yield f"{command[0]}: status {done.status}: {text[-500:]}"
        elif evaluates:
            if "circle2d: " not in done.err and done.out != self.table:
                yield "evaluate: other numbers"
        elif done.status == 0:
            changed = difference(results(self.folder), self.expected)
            # Files that are not written again are checked only when they are loaded.
            if changed and (changed != name or name.startswith("results")):
                yield f"resume: differs: {changed}"


def try_costs(tally: Tally, whole, count, rng, root):
    """Flip bits of a file of costs and of an archive of runs: `emcc` must print the same numbers or
    an error."""
    costs, archive = root / "costs.npz", root / "archive.zip"
    np.savez(costs, costs=(np.arange(1000).reshape(20, 50) % 7 == 0).astype(np.uint8))
    agents.report(whole, archive=archive, out=root / "report_of_whole")
    contents = {path: (path.read_bytes(), emcc_of(path)) for path in (costs, archive)}
    for k in range(count):
        path, (content, expected) = list(contents.items())[k % 2]
        at = rng.choice([rng.randrange(len(content)), rng.randrange(200)])
        at = rng.choice([at, len(content) - 1 - rng.randrange(min(400, len(content)))])
        changed = bytearray(content)
        changed[at] ^= 1 << rng.randrange(8)
        path.write_bytes(changed)
        try:
            found = emcc_of(path)
            wrong = found != expected and found[0] != 2
            problem = f"byte {at}: status {found[0]}, {found[1]}" if wrong else ""
        except Exception as error:
            problem = f"byte {at}: {type(error).__name__}: {error}"
        tally.note("flipped bit of a file of costs", f"{path.name}, {problem}" * bool(problem))


def try_misfits(tally: Tally, whole, count, rng, root):
    """Change the size of an array of `results.npz`, which stays readable: the report shows the
    rest, or names the file in a line."""
    folder = root / "misfits"
    with np.load(whole / "results.npz") as file:
        arrays = dict(file)
    names = [name for name, array in arrays.items() if array.ndim and array.size > 1]
    for _ in range(count):
        name = rng.choice(names)
        array = arrays[name]
        other = rng.choice([array[:-1], array[:1], np.concatenate([array, array[:1]]), array[None]])
        fresh(whole, folder)
        np.savez(folder / "results.npz", **arrays | {name: other})
        done = here(["report", str(folder)])
        problem = done.problem((0, 1, 2))
        where = f"{name}, {array.shape} to {other.shape}: {problem}" if problem else ""
        tally.note("an array of another size", where)


def try_damage(tally: Tally, whole, count, rng, root):
    """Damage one file after another, each in a random way, and read the folder."""
    readers = Readers(whole, root / "damaged")
    paths = sorted(p for p in whole.rglob("*") if p.is_file() and p.name not in NOT_OF_RESULTS)
    for k in range(count):
        path = paths[k % len(paths)]
        name = path.relative_to(whole).as_posix()
        fresh(whole, readers.folder)
        kind, data = damaged(path.read_bytes(), rng)
        (readers.folder / name).write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("always")  # commands print them
                problem = next(filter(None, readers.problems(rng, name)), "")
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        where = "" if not problem else f"{name}, {kind} ({data[:40]!r}): {problem}"
        tally.note(f"damaged file: {kind}", where)
