"""The files and commands of docs/extending.md: users' own algorithms, tasks, measures, studies."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
import toys
from fault_common import forked
from small_runs import write_evaluated

import agents
from agents import studies
from agents.algorithms import _algorithms
from agents.cli.main import main
from agents.paper.sections import STUDY
from agents.reporting.study import Study

toys.register()
ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()


def circle2d(folder, *args, status=0):
    """Run a command in a forked process, in which nothing of the user's is registered yet."""

    def command():
        os.chdir(folder)
        try:
            return main(args)
        except SystemExit as done:  # of --help
            return done.code

    done = forked(command)
    assert done.status == status, done.err
    return done


@pytest.fixture
def folder(tmp_path):
    """A folder outside the package with the page's files."""
    for name, code in re.findall(r"```python\n# (my_\w+\.py)\n(.*?)```", PAGE, re.DOTALL):
        (tmp_path / name).write_text(code)
    for path in (ROOT / "examples").glob("my_*.py"):
        shutil.copy(path, tmp_path)
    return tmp_path


ALGORITHMS = {
    "my_algorithm": ("sac-fixed", "SAC-Fixed", "price 0.5", "Price of a unit of discounted cost"),
    "my_trpo": ("trpo-price", "TRPO-Price", "price 0.5", "Price of cost, added to the multiplier"),
    "my_quantiles": ("sac-quantile", "SAC-Quantile", "cost_critics 8", "Number N of quantiles"),
    "my_learner": ("reinforce-state", "REINFORCE-State", "std 0.3", "Standard deviation"),
    "my_law": ("sac-mw", "SAC-MW", "gain 0.002", "Growth of the multiplier's logarithm"),
}
"""Module -> name, title, hyper-parameter as the page's command sets it, and its help."""


def command_of(module):
    """Return the page's command for a module, with the folder `runs`."""
    page = PAGE.replace("\\\n", " ")
    (line,) = re.findall(rf"^circle2d (train \S+ --import {module} .*)$", page, re.MULTILINE)
    return re.sub(r"runs/\w+", "runs", line).split()


def trained(folder, module):
    """Train with the page's command for a module; the help and the table show what it adds."""
    name, title, changed, said = ALGORITHMS[module]
    done = circle2d(folder, *command_of(module), "--seeds", "0", "--steps", "1100")
    assert re.search(rf"{title} \({re.escape(changed)}\), mean of 1", done.out)
    assert json.loads((folder / "runs/config.json").read_text())["algorithm"] == name
    text = circle2d(folder, "train", name, "--import", module, "--help").out
    assert f"--{changed.partition(' ')[0].replace('_', '-')}" in text
    assert said in re.sub(r"[│\s]+", " ", text)


@pytest.mark.parametrize("module", ["my_trpo", "my_law", "my_quantiles", "my_learner"])
def test_algorithms_of_other_families_and_another_multiplier_law(folder, module):
    trained(folder, module)


@pytest.fixture
def example(monkeypatch):
    """A function that loads an example; its algorithm is registered for one test."""
    for name in ("registered", "modules"):
        monkeypatch.setattr(_algorithms, name, getattr(_algorithms, name).copy())

    def load(name):
        spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)  # where dataclasses and pickle look
        spec.loader.exec_module(module)
        return module

    return load


def test_quantiles_by_hand(example):
    """The quantile Huber loss, summed over pairs of output and target by a plain loop; the risk is
    the mean of the worst quarter."""
    own, rng = example("my_quantiles"), np.random.default_rng(0)
    config = own.SACQuantileConfig(cost_critics=8, discount=0.9)
    values, after = rng.normal(0, 2, (2, 2, 8, 3))
    batch = SimpleNamespace(
        cost=torch.tensor(rng.random((2, 3))), cost_terminal=torch.tensor([[0.0, 1, 0]] * 2)
    )
    found = own.critic_loss(config, torch.tensor(values), torch.tensor(after), batch)
    for run in range(2):
        expected = 0.0
        for i, j, b in product(range(8), range(8), range(3)):
            left = 0.9 * (1 - float(batch.cost_terminal[run, b]))
            error = float(batch.cost[run, b]) + left * after[run, j, b] - values[run, i, b]
            huber = error**2 / 2 if abs(error) < 1 else abs(error) - 0.5
            expected += abs((i + 0.5) / 8 - (error < 0)) * huber / (8 * 3)
        assert float(found[run]) == pytest.approx(expected)
    worst = np.sort(values, axis=1)[:, -2:].mean(axis=1)
    np.testing.assert_allclose(own.risk(config, torch.tensor(values)), worst)


def test_a_users_learner_finds_the_constrained_optimum(tmp_path, example):
    """Episodes have one step, with the reward -(a - 0.8)² and the cost (1 + a) / 2, limited to 0.6:
    the optimum is a = 0.2 at λ = 2.4. The training goes on bit for bit after an interruption, and
    no run depends on the others."""
    example("my_learner")
    how = {"steps": 12_000, "cost_limit": 0.6, "multiplier_lr": 0.1, "learning_rate": 0.01}
    how |= {"std": 0.3, "episodes": 20, "evaluation_episodes": 2}
    whole = agents.train("reinforce-state", "Target-v0", seeds=(0, 1), out=tmp_path / "x", **how)
    last = whole.to_pandas("updates").query("step > 9000")
    costs = whole.to_pandas("episodes").groupby("seed").cost
    assert costs.tail(3_000).mean() == pytest.approx(0.6, abs=0.02)
    assert last.multiplier.mean() == pytest.approx(2.4, abs=0.4)
    policy = agents.load_policy(whole.folder, seed=1)
    assert float(policy([0.0])[0]) == pytest.approx(0.2, abs=0.1)
    inputs = np.linspace(-1, 1, 5, dtype=np.float32)[:, None]
    module = policy.to_torch()(torch.tensor(inputs)).detach()
    np.testing.assert_allclose(module, policy(inputs), atol=1e-6)
    how |= {"steps": 2_000}
    whole = agents.train("reinforce-state", "Target-v0", seeds=(0, 1), out=tmp_path / "w", **how)
    more = how | {"on_epoch": lambda epoch: epoch.runs[0]["step"] < 1_000}
    agents.train("reinforce-state", "Target-v0", seeds=(0, 1), out=tmp_path / "y", **more)
    agents.resume(tmp_path / "y")
    name = "results.npz"
    assert (tmp_path / "y" / name).read_bytes() == (whole.folder / name).read_bytes()
    alone = agents.train("reinforce-state", "Target-v0", seeds=1, out=tmp_path / "z", **how)
    ours = whole.to_pandas("episodes").query("seed == 1")["return"]
    assert ours.tolist() == alone.to_pandas("episodes")["return"].tolist()


def test_two_limits_on_two_costs(folder):
    """Both costs are in the table; the replay of visited states is shown once, with the first cost.
    test_two_limits.py checks the multipliers."""
    done = circle2d(folder, *command_of("my_limits"), "--seeds", "0", "--steps", "1100")
    assert len(re.findall(r"PPO-Two \(.*cost_2.*\), mean of 1", done.out)) == 1
    updates = agents.load_runs(folder / "runs").to_pandas("updates")
    assert {"multiplier", "multiplier_2"} < {*updates}
    done = circle2d(folder, "report", "runs", "--import", "my_limits")
    assert "replay are of the first cost alone" in " ".join(done.out.split())
    page = (folder / "runs/index.html").read_text()
    (replayed,) = re.findall(r'"algorithm": ?"(.*?)"', page)
    assert replayed.startswith("PPO-Two") and "cost_2)" not in replayed


def test_a_number_comes_to_its_cell_as_the_page_says(tmp_path):
    """The functions that the page lists are called in its order, from a training to the table."""
    listed = PAGE[PAGE.index("reaches its cell") : PAGE.index("## A study")]
    named = re.findall(r"`([\w/]+\.py)`,\s+`([\w.]+)`", listed)
    assert len(named) == listed.count(".py`") - 1  # that of archives has no function
    called = []

    def note(frame, event, argument):
        file = Path(frame.f_code.co_filename)
        if event == "call" and file.is_relative_to(ROOT):
            name = frame.f_code.co_qualname
            called.append((file.relative_to(ROOT).as_posix(), name.partition(".<locals>")[0]))

    sys.setprofile(note)
    try:
        agents.train("trpo-lag", seeds=0, steps=500, out=tmp_path / "runs").table()
    finally:
        sys.setprofile(None)
    calls = iter(called)
    for step in named:
        assert step in calls, f"{step} is not called after the one before it"
    assert "EMCC_0.33" in (tmp_path / "runs/report.md").read_text()


def test_a_users_study(folder):
    """The page's study, with CPO as its algorithm, is in the output of every command. No command
    needs the paper's study, which cannot be imported here."""
    write_evaluated(folder / "runs/a", "cpo", costs=(1, 2))
    write_evaluated(folder / "runs/b", "trpo-lag", costs=(3, 3))
    own = folder / "my_study.py"
    own.write_text(own.read_text().replace("sac-fixed", "cpo"))
    (folder / "no_paper.py").write_text("import sys\n\nsys.modules['agents.paper'] = None\n")
    small = "--seeds 0 --steps 200 --episodes 2 --evaluation-episodes 2"
    commands = ("report runs", "compare runs/a runs/b", "plot runs", f"train cpo --out t {small}")
    commands = (*commands, f"grid cpo --out g --workers 1 {small}")
    code = (
        "import sys, no_paper\n"
        "from agents.cli.main import main\n"
        "for line in sys.argv[1:]:\n"
        "    own = ('--import', 'no_paper', '--import', 'my_study')\n"
        "    assert main([*line.split(), *own]) == 0, line\n"
    )
    python = [sys.executable, "-c", code, *commands]
    subprocess.run(python, cwd=folder, check=True, timeout=240)
    for name in ("runs", "t", "g"):
        words = (folder / name / "report.md").read_text()
        (row,) = re.findall(r"\| CPO, book \(5 seeds\) .*", words)
        assert "-8.10" in row and "4.90" in row and "paper" not in words
    words = (folder / "runs/report.md").read_text()
    assert "among the book's" in words and "Return against cost" not in words
    page = (folder / "runs/index.html").read_text()
    assert "cross: the book." in page and "cross: the paper" not in page
    (figure,) = re.findall(r"Return against cost</h2>\s*<figure>.*?</figure>", page, re.DOTALL)
    assert "svg" in figure and "A dot for each run.</figcaption>" in figure


def test_use_study_replaces_the_papers(tmp_path, monkeypatch):
    """A report can still be given another study."""
    write_evaluated(tmp_path, "cpo", costs=(1, 2))
    runs = agents.load_runs(tmp_path)
    monkeypatch.setattr(studies, "_used", None)
    assert "CPO, paper (3 seeds)" in runs.table()
    agents.use_study(Study())
    assert ", paper" not in runs.table() + agents.report(tmp_path)
    assert "CPO, paper (3 seeds)" in agents.report(tmp_path, study=STUDY)
    with pytest.raises(agents.UserError, match=r"as in use_study\(MyStudy\(\)\), got <class"):
        agents.use_study(Study)


def test_a_study_that_fails_is_named(folder):
    """One line below the traceback names it; a training is saved before."""
    code = "import agents\nfrom agents.reporting.study import Study\n\n\nclass Bad(Study):\n"
    code += "    def notes(self, groups):\n        return 1 / 0\n\n\nagents.use_study(Bad())\n"
    (folder / "my_bad.py").write_text(code)
    write_evaluated(folder / "runs", "cpo", costs=(1, 2))
    done = circle2d(folder, "report", "runs", "--import", "my_bad", status=1)
    assert "Traceback" in done.err
    last = done.err.splitlines()[-1]
    assert last.startswith("circle2d: Bad.notes of the study failed: ZeroDivisionError")
    small = ("--seeds", "0", "--steps", "200", "--episodes", "2", "--evaluation-episodes", "2")
    done = circle2d(folder, "train", "cpo", "--out", "t", *small, "--import", "my_bad", status=1)
    assert "no table: Bad.notes of the study failed" in done.err
    assert (folder / "t/results.npz").exists()


@pytest.mark.slow
def test_a_users_algorithm(folder):
    """It trains with the page's command, resumes, is evaluated and reported; the report has its
    command."""
    trained(folder, "my_algorithm")
    done = circle2d(folder, "resume", "runs", status=2)
    assert done.err.count("\n") == 1
    assert "my_algorithm" in done.err
    known = ("--import", "my_algorithm")
    circle2d(folder, "resume", "runs", *known)
    assert "J_R" in circle2d(folder, "evaluate", "runs", "--episodes", "2", *known).out
    assert "SAC-Fixed (price 0.5" in circle2d(folder, "report", "runs", *known).out
    page = (folder / "runs/index.html").read_text()
    assert "circle2d train sac-fixed " in page
    assert "--import my_algorithm" in page


@pytest.mark.slow
def test_a_task_from_the_suites_parts(folder):
    """It trains with the page's command, one episode per epoch, and is drawn."""
    train = [*command_of("my_suite_task"), "--seeds", "0", "--steps", "1200", "--episodes", "1"]
    train += ["--evaluation-episodes", "2"]
    assert "PPO-Lag" in circle2d(folder, *train).out
    runs = ("--import", "my_suite_task", "runs")
    circle2d(folder, "heatmap", *runs)
    circle2d(folder, "render", *runs, "--out", "film.gif")
    heat = imageio.imread(folder / "runs/heatmap.png")[..., :3]
    assert len(set(map(tuple, heat.reshape(-1, 3)))) > 2
    assert len(imageio.imread(folder / "film.gif")) > 20


@pytest.mark.slow
def test_a_users_task_and_measure(folder):
    """The task trains with the page's command; the measure is a column of the report."""
    train = [word.replace("2e4", "1.1e3") for word in command_of("my_tasks")]
    assert "PPO-Lag" in circle2d(folder, *train, "--seeds", "0").out
    shown = re.findall(r"circle2d ((?:heatmap|render) .*)", PAGE)
    for line in shown:
        circle2d(folder, *line.replace("runs/stay", "runs").split())
    heat = imageio.imread(folder / "runs/heatmap.png")[..., :3]
    assert {(220, 220, 220), (255, 255, 255)} < set(map(tuple, heat.reshape(-1, 3)))
    assert len(imageio.imread(folder / "stay.gif")) == 3 * (20 + 1)  # states
    known = ("--import", "my_measures", "--import", "my_tasks")
    done = circle2d(folder, "report", "runs", *known)
    assert "middle" in done.out
    assert "clean episodes (share)" in done.out
    assert "--import my_tasks" in (folder / "runs/index.html").read_text()
    assert "clean" in (folder / "runs/report.csv").read_text().splitlines()[0]
