"""Files of costs, run folders and archives: all layouts of the same costs give the same EMCC; what
is damaged or cannot give EMCC is an error that names the file."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from written import arrays_of, write_run

import emcc
from emcc.sources import read_runs


def episodes(count=200, seed=1):
    rng = np.random.default_rng(seed)
    return [(rng.random(n) < 0.3).astype(int) for n in rng.integers(2, 60, count)]


def streak(costs):
    """Return the longest streak."""
    return max(map(len, "".join(map(str, costs)).split("0")))


def by_hand(costs):
    """Return EMCC of each third at alpha 0.1: the highest tenth of ten copies of every value."""
    total, start, thirds = sum(map(len, costs)), 0, ([], [], [])
    for episode in costs:
        if 100 * start < 99 * total:
            thirds[100 * start // (33 * total)].append(streak(episode) / len(episode))
        start += len(episode)
    return [np.mean(sorted(values * 10)[-len(values) :]) for values in thirds]


def write(path, head, rows):
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


STEPS = [(c, t == len(of) - 1, k) for k, of in enumerate(episodes()) for t, c in enumerate(of)]
SUMS = [(sum(costs), len(costs), streak(costs)) for costs in episodes()]
LAYOUTS = {
    "episode": ("episode,cost", [(k, cost) for cost, _, k in STEPS]),
    "done": ("cost,done", [(cost, int(end)) for cost, end, _ in STEPS]),
    "Python's words": (
        "terminated,cost,truncated",
        [(end and k % 2 == 0, cost, end and k % 2 == 1) for cost, end, k in STEPS],
    ),
    "still running": ("cost,done", [(c, int(end and k < STEPS[-1][2])) for c, end, k in STEPS]),
    "unmarked ends": ("episode,cost,terminated", [(k, c, e and k % 2 == 0) for c, e, k in STEPS]),
    "blanks": (" cost , done", [(f" {cost} ", f" {end}") for cost, end, _ in STEPS]),
    "a byte order mark": ("\ufeffcost,done", [(cost, end) for cost, end, _ in STEPS]),
    "a row per episode": ("cost,length,longest_streak", SUMS),
}


@pytest.mark.parametrize(("head", "rows"), LAYOUTS.values(), ids=LAYOUTS)
def test_csv_files_in_any_layout(tmp_path, head, rows):
    records = emcc.read(write(tmp_path / "log.csv", head, rows))
    assert list(records.emcc_by_part().values()) == pytest.approx(by_hand(episodes()), rel=1e-12)


def test_rollouts_end_where_they_say_and_episodes_at_done(tmp_path):
    rows = ["a,1,0,2", "a,1,1,2", "a,0,0,2", "b,1,0,4", "b,0,0,4", "c,0,0,8", "c,0,1,8"]
    path = write(tmp_path / "log.csv", "rollout,cost,done,reward", [r.split(",") for r in rows])
    (run,) = read_runs(path)
    assert run.records.length.tolist() == [2, 1, 2, 2]
    assert run.records.reward.tolist() == [4.0, 2.0, 8.0, 16.0]
    assert run.records.mcc_per_rollout()[0].tolist() == [1.0, 0.5, 0.0]
    assert (run.episodes.cost.tolist(), run.episodes.length.tolist()) == ([2.0, 1.0], [2, 5])
    rows = ["0,1,3", "0,1,3", "1,1,3", "1,0,4"]
    (run,) = read_runs(write(path, "rollout,cost,episode", [r.split(",") for r in rows]))
    assert (run.records.length.tolist(), run.episodes.cost.tolist()) == ([2, 1, 1], [3.0, 0.0])
    assert emcc.read(path).cost.tolist() == [2.0, 1.0, 0.0]
    assert emcc.read(path, episodes=True).cost.tolist() == [3.0, 0.0]


OTHER_COLUMNS = {
    "a step's number": ("step", [0, 1, 2, 3] * 4),
    "a step's number, all along": ("global_step", list(range(100, 116))),
    "a step that ends one episode and begins the next": ("step", [3, 4, 5, 6, 6, 7, 8, 9] * 2),
    "one environment": ("env", [5] * 16),
    "one run": ("seed", [5] * 16),
    "a seed for each episode": ("seed", [7] * 4 + [3] * 4 + [9] * 4 + [8] * 4),
    "an episode's seed that comes again": ("seed", [7] * 4 + [3] * 8 + [7] * 4),
    "a number": ("speed", [0, 1, 0, 1, 1, 0] + [2, 3] * 5),
}


@pytest.mark.parametrize(("name", "values"), OTHER_COLUMNS.values(), ids=OTHER_COLUMNS)
def test_other_columns_are_left_alone(tmp_path, name, values):
    rows = [(k // 4, value, int(k % 3 == 0)) for k, value in enumerate(values)]
    records = emcc.read(write(tmp_path / "log.csv", f"episode,{name},cost", rows))
    assert records.cost.tolist() == [2, 1, 1, 2]


def test_whole_numbers_may_be_written_as_floats(tmp_path):
    """pandas does so where a column of integers has had a missing value."""
    header = "length,cost,longest_streak"
    whole = emcc.read(write(tmp_path / "a.csv", header, [(4, 2, 2), (5, 1, 1)]))
    floats = emcc.read(write(tmp_path / "b.csv", header, [("4.0", "2.0", "2.0"), ("5.0", 1, 1.0)]))
    assert floats.to_csv() == whole.to_csv()
    for text in ("4.5", "inf", "nan", ""):
        with pytest.raises(ValueError, match=f"line 2, column length: '{text}' is not a whole"):
            emcc.read(write(tmp_path / "c.csv", header, [(text, 1, 1)]))


def test_arrays_are_the_arguments_of_from_costs(tmp_path):
    costs = np.array([[0, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 0.5]])
    expected = emcc.EpisodeRecords.from_costs(costs).to_csv()
    np.save(tmp_path / "c.npy", costs)
    np.savez(tmp_path / "c.npz", costs=costs.ravel(), lengths=[4, 4, 4])
    for name in ("c.npy", "c.npz"):
        assert emcc.read(str(tmp_path / name)).to_csv() == expected
        assert emcc.read(tmp_path / name, threshold=0.5).longest_streak.tolist() == [2, 3, 0]
    np.savez(tmp_path / "c.npz", costs=costs, rewards=costs, rollouts=[0, 0, 1])
    assert emcc.read(tmp_path / "c.npz").mcc_per_rollout()[0].tolist() == [0.75, 0.25]


TWO_IN_TURNS = "0,0,1\n1,0,0\n0,0,1\n1,0,0\n0,1,1\n1,1,0\n"
"""Steps of two environments in turns, with the costs 1 1 1 and 0 0 0."""
BAD_FILES = {
    "a row per episode": ("cost,done\n3,1\n2,1\n", "every episode has one row"),
    "sums": ("cost,length\n3,10\n", "Sums over episodes and means over epochs cannot give EMCC"),
    "no episodes": ("cost\n0\n1\n", "cost and one of episode, done"),
    "no steps": ("cost,done\n", "no steps"),
    "a flag of 2": ("cost,done\n0,0\n0,2\n", "column done: must be 0 or 1, got '2'"),
    "a word": ("cost,done\n0,0\n\nhigh,1\n", "line 4, column cost: 'high' is not a number"),
    "a negative cost": ("cost,done\n0,0\n-1,1\n", "costs must be finite and >= 0, got -1"),
    "interleaved": ("episode,cost\n0,1\n1,1\n0,1\n1,0\n", "an episode must be consecutive rows"),
    "two at once": ("env,episode,cost\n0,0,1\n1,0,1\n0,0,0\n1,0,1\n", "several environments"),
    "two by marks": ("env_id,done,cost\n0,0,1\n1,0,1\n0,1,0\n1,1,1\n", "the column env_id"),
    **{
        f"two by {name}": (f"{name},done,cost\n" + TWO_IN_TURNS, f"the column {name}")
        for name in (
            "env_no",
            "environment",
            "env_num",
            "env_idx",
            "worker_id",
            "process",
            "Env ID",
        )
    },
    **{
        f"two at each {name}": (
            f"{name},done,cost\n0,0,1\n0,0,0\n1,0,1\n1,0,0\n2,1,1\n2,1,0\n",
            f"the column {name}",
        )
        for name in ("step", "global_step", "Timesteps", "num_timesteps", "t")
    },
    "two of unequal places": (
        "t,done,cost\n4,0,1\n9,0,0\n5,1,1\n10,0,0\n0,0,1\n11,1,0\n",
        "the column t does not rise within an episode",
    ),
    "an end at a time limit that is not marked": (
        "step,terminated,cost\n0,0,1\n1,0,1\n0,0,1\n1,0,0\n2,1,0\n",
        "the column step does not rise within an episode: .* the end of an episode is not marked",
    ),
    **{
        f"two by {name}": (
            f"{name},done,cost\na,0,1\na,1,1\na,0,1\na,1,0\nb,0,0\nb,1,0\n",
            f"several runs in the column {name}: write a file for each run",
        )
        for name in ("seed", "run_id", "Algorithm", "algo")
    },
    "two by seeds, each with its episodes": (
        "seed,episode,cost\n1,0,1\n1,0,1\n1,1,0\n2,0,1\n2,0,0\n2,1,0\n",
        "several runs in the column seed",
    ),
    "two in turns": ("k,done,cost\n" + TWO_IN_TURNS, "the column k"),
    "two logs": ("rollout,cost,done\n0,1,0\n1,1,1\n0,1,1\n", "a rollout must be consecutive rows"),
    "monitor.csv": ('#{"t": 1, "env": 2}\nr,l,t\n1,2,3\n', "has the columns r, l, t. EMCC needs"),
    "a column twice": ("cost,done,cost\n1,0,0\n", "names a column twice"),
    "a long streak": ("cost,length,longest_streak\n\n3,2,3\n", "cannot have longest_streak 3"),
    "a length below 1": ("cost,length,longest_streak\n1,2,1\n0,-9,0\n", "length must be .* got -9"),
    "a binary file": ("\0\n", "log.csv"),
    "both names": ("cost,costs,done\n0,0,1\n", "has both cost and costs"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_csv_files_without_emcc_are_named(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as error:
        emcc.read(path)
    assert str(path) in str(error.value)


def test_arrays_without_emcc_are_named(tmp_path):
    path = tmp_path / "costs.npz"
    for arrays, message in (
        ({"costs": np.zeros((3, 20, 5))}, "costs of trajectory 0 must be 1-D"),
        ({"costs": np.ones(4), "lengths": [1]}, "lengths add up to 1 steps"),
        ({"costs": np.ones((2, 2)), "dones": [0, 1]}, "dones"),
        ({"lengths": [4]}, "missing .*costs"),
        ({"costs": np.array([{}])}, "pickle"),
    ):
        np.savez(path, **arrays)
        with pytest.raises(ValueError, match=rf"costs\.npz: .*{message}"):
            emcc.read(path)
    for content in (b"", b"nothing", path.read_bytes()[:100]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"costs\.npz: "):
            emcc.read(path)


def test_no_flipped_bit_gives_other_numbers(tmp_path):
    """Every bit of the header and of the zip directory is flipped, and some bits between them."""
    costs, path = (np.arange(1000).reshape(20, 50) % 7 == 0).astype(np.uint8), tmp_path / "c.npz"
    np.savez(path, costs=costs)
    content, expected = path.read_bytes(), emcc.read(path).to_csv()
    header, size = content.index(b"NUMPY") + 128, len(content)
    for place in (*range(header), *range(header, size, 61), *range(size - 90, size)):
        for bit in range(8):
            damaged = bytearray(content)
            damaged[place] ^= 1 << bit
            path.write_bytes(damaged)
            try:
                found = emcc.read(path).to_csv()
            except ValueError as error:
                assert str(path) in str(error)
            else:
                assert found == expected, (place, bit)


def test_a_header_with_another_shape_than_the_data_is_refused(tmp_path):
    np.save(path := tmp_path / "c.npy", np.zeros((20, 50)))
    path.write_bytes(path.read_bytes().replace(b"(20, 50)", b"(20, 40)"))
    with pytest.raises(ValueError, match=r"holds 8000 bytes, its header says \[20, 40\] float64"):
        emcc.read(path)


def test_a_small_file_does_not_unpack_to_gigabytes(tmp_path, monkeypatch):
    monkeypatch.setattr("emcc.npz.MOST_BYTES", 10**6)
    np.savez_compressed(path := tmp_path / "c.npz", costs=np.zeros((2, 10**6), np.uint8))
    with pytest.raises(ValueError, match=r"costs unpacks from .* to 2,000,128, which"):
        emcc.read(path)
    np.savez(path, costs=np.zeros((2, 10**6), np.uint8))
    assert emcc.read(path).cost.tolist() == [0, 0]


def records_of(costs, threshold=0.0):
    rewards = [np.full(len(episode), -0.5) for episode in costs]
    return emcc.EpisodeRecords.from_costs(costs, rewards=rewards, threshold=threshold)


def described(runs):
    names = ("task", "algorithm", "seed", "cost", "total_steps")
    return [(*(getattr(run, n) for n in names), run.records.to_csv()) for run in runs]


@pytest.fixture
def two_tasks(tmp_path):
    """Write a run folder of two tasks and two seeds; return it and what reading it must give."""
    keys = [(task, seed) for task in ("A-v0", "m/B-v1") for seed in (0, 3)]
    runs = {key: episodes(50, number) for number, key in enumerate(keys)}
    folder = write_run(tmp_path / "runs" / "first", {key: arrays_of(runs[key]) for key in runs})
    expected = [
        (task, "cpo", str(seed), "cost", 10_000, records_of(costs).to_csv())
        for (task, seed), costs in runs.items()
    ]
    return folder, expected


def test_run_folders(two_tasks):
    folder, expected = two_tasks
    assert described(read_runs(folder)) == expected
    shutil.copytree(folder, folder.parent / "deeper" / "second")
    assert described(read_runs(folder.parent)) == 2 * expected


@pytest.mark.parametrize("prefixes", [("",), ("c/", "a/b/")])
def test_archives(two_tasks, tmp_path, prefixes):
    folder, expected = two_tasks
    path = tmp_path / "runs.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for prefix in prefixes:
            for file in folder.iterdir():
                archive.write(file, prefix + file.name)
    assert described(read_runs(path)) == expected * len(prefixes)


def test_one_run_is_read_as_records(two_tasks, tmp_path):
    folder, _ = two_tasks
    with pytest.raises(ValueError, match="one run is needed, but there are 4"):
        emcc.read(folder)
    write_run(tmp_path / "one", {("A-v0", 5): arrays_of(episodes(50, 5))})
    assert emcc.read(tmp_path / "one").to_csv() == records_of(episodes(50, 5)).to_csv()


@pytest.mark.parametrize("recorded", [50, 0])
def test_a_run_that_failed_is_refused(tmp_path, recorded):
    """The thirds of the recorded episodes would not be the thirds of the planned training."""
    arrays = arrays_of(episodes(50, 5)) if recorded else {}
    arrays["failure"] = np.array("failed at step 500: its reward is not finite")
    folder = write_run(tmp_path / "one", {("A-v0", 5): arrays})
    with pytest.raises(ValueError, match="one: failed at step 500: its reward is not finite"):
        emcc.read(folder)


def test_every_named_cost_has_its_own_records(tmp_path):
    """Costs other than 0 and 1 are stored as values; a step whose cost exceeds the threshold is a
    cost step."""
    first = episodes(50)
    second = [4.0 * episode[::-1] + 2.0 * (episode > 0) for episode in first]
    arrays = arrays_of(first) | arrays_of(second, "cost_2")
    arrays |= arrays_of([0 * episode for episode in first], "never")
    costs = ["cost", "cost_2", "never"]
    folder = write_run(tmp_path / "run", {("A-v0", 0): arrays}, costs=costs)
    runs = {run.cost: run.records for run in read_runs(folder)}
    assert list(runs) == costs
    assert runs["cost"].to_csv() == records_of(first).to_csv()
    assert runs["cost_2"].to_csv() == records_of(second).to_csv()
    assert runs["never"].longest_streak.max() == 0
    assert emcc.read(folder).to_csv() == records_of(first).to_csv()
    assert emcc.read(folder, cost="cost_2").to_csv() == records_of(second).to_csv()
    with pytest.raises(ValueError, match="no cost 'c'; its costs: cost, cost_2, never"):
        emcc.read(folder, cost="c")
    above = {run.cost: run.records for run in read_runs(folder, 3.0)}
    assert above["cost"].longest_streak.max() == 0
    assert above["cost_2"].to_csv() == records_of(second, 3.0).to_csv()
    assert above["cost_2"].cost_steps.sum() < runs["cost_2"].cost_steps.sum()


def test_a_rollout_of_several_episodes_has_one_mcc(tmp_path):
    costs = [[0, 1, 1, 0], [1, 0], [0, 0], [1, 1, 1, 0]]
    arrays = arrays_of([np.array(c) for c in costs]) | {"rollouts": np.array([2, 1, 1])}
    records = emcc.read(write_run(tmp_path / "run", {("A-v0", 0): arrays}))
    assert records.mcc_per_rollout()[0].tolist() == [0.5, 0.0, 0.75]


@pytest.mark.parametrize("how", ["nowhere", "empty", "no.zip"])
def test_a_path_without_a_run_is_named(tmp_path, how):
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.zip").write_text("nothing")
    with pytest.raises(ValueError, match=rf"{how}: (no such file or|no run|File is not a zip)"):
        emcc.read(tmp_path / how)


BAD_RUNS = {
    "no settings": ([1], {}, r"config\.json: "),
    "no steps": ({"steps": 0}, {}, r"config\.json: steps must be >= 1"),
    "no name": ({"algorithm": None}, {}, r"config\.json: algorithm must be a name, got None"),
    "another seed": ({"seeds": [0, 4]}, {}, r"results\.npz: missing: A-v0/4/"),
    "no length": ({}, {"length": np.zeros(50, int)}, r"results\.npz: lengths"),
    "cut off": ({}, None, r"results\.npz: "),
}


@pytest.mark.parametrize(("config", "arrays", "message"), BAD_RUNS.values(), ids=BAD_RUNS)
def test_damaged_run_folders_are_named(tmp_path, config, arrays, message):
    good = arrays_of(episodes(50, 0))
    folder = write_run(tmp_path / "run", {("A-v0", 0): good | (arrays or {})})
    old = json.loads((folder / "config.json").read_text())
    new = old | config if isinstance(config, dict) else config
    (folder / "config.json").write_text(json.dumps(new))
    if arrays is None:
        content = (folder / "results.npz").read_bytes()
        (folder / "results.npz").write_bytes(content[:-100])
    with pytest.raises(ValueError, match=f"run/{message}"):
        emcc.read(folder)


def test_a_run_folder_without_results_is_named(tmp_path):
    folder = write_run(tmp_path / "run", {("A-v0", 0): arrays_of(episodes(50, 0))})
    (folder / "results.npz").unlink()
    with pytest.raises(ValueError, match=r"run: no results\.npz"):
        emcc.read(folder)


def test_a_damaged_directory_of_an_archive_hides_no_run(tmp_path):
    """One bit flipped at some bytes of each config.json's name in the archive's directory."""
    arrays = arrays_of(episodes(50, 0))
    for name in ("a", "b"):
        write_run(tmp_path / "runs" / name, {("A-v0", 0): arrays})
    path = Path(shutil.make_archive(str(tmp_path / "all"), "zip", tmp_path / "runs"))
    content, count = path.read_bytes(), len(read_runs(path))
    directory = content.index(b"PK\1\2")
    names = [k for k in range(directory, len(content)) if content[k : k + 11] == b"config.json"]
    assert (count, len(names)) == (2, 2)
    for place in (start + k for start in names for k in (-1, 0, 5, 10)):
        damaged = bytearray(content)
        damaged[place] ^= 2
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"all\.zip: File name in directory"):
            read_runs(path)


def test_a_binary_file_in_place_of_text_is_named(tmp_path):
    (tmp_path / "log.csv").write_bytes(b"cost,done\n\xff\xfe\x00")
    with pytest.raises(
        ValueError, match=r"log\.csv: no text at byte 10: a file of costs must be a \.csv"
    ):
        emcc.read(tmp_path / "log.csv")
    (tmp_path / "config.json").write_bytes(b"{\xff")
    with pytest.raises(ValueError, match=r"config\.json: no text at byte 1$"):
        emcc.read(tmp_path)


@pytest.mark.parametrize("name", ["unsafe", "values"])
def test_too_few_costs_in_a_run_are_named(tmp_path, name):
    costs = [np.array([0, 2, 3, 0, 0, 0, 0, 0, 0, 4])] * 5
    arrays = arrays_of(costs)
    arrays[f"costs/cost/{name}"] = arrays[f"costs/cost/{name}"][:1]
    with pytest.raises(ValueError, match=rf"results\.npz: .*{name} has shape \(1,\)"):
        emcc.read(write_run(tmp_path / "run", {("A-v0", 0): arrays}))


@pytest.mark.parametrize("names", ["cost reward", "costs rewards"])
def test_columns_and_arrays_may_be_named_in_singular_or_plural(tmp_path, names):
    cost, reward = names.split()
    table = write(tmp_path / "log.csv", f"{cost},{reward},done", [(1, 2, 0), (0, 3, 1)])
    np.savez(tmp_path / "log.npz", **{cost: [[1, 0]], reward: [[2, 3]]})
    for path in (table, tmp_path / "log.npz"):
        records = emcc.read(path)
        assert (records.cost.tolist(), records.reward.tolist()) == ([1], [5])


def test_damage_that_changes_the_compression_is_named(tmp_path):
    """Given bytes that are not its format, bz2 raises an OSError without an errno."""
    np.savez_compressed(tmp_path / "costs.npz", costs=np.zeros((20, 50)))
    content = bytearray((tmp_path / "costs.npz").read_bytes())
    for mark, place in ((b"PK\3\4", 8), (b"PK\1\2", 10)):
        content[content.index(mark) + place] = zipfile.ZIP_BZIP2
    (tmp_path / "costs.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"costs\.npz: Invalid data stream"):
        emcc.read(tmp_path / "costs.npz")
