"""A report's rows: ways, runs left out, names, and marks against the paper's; LaTeX; and how a
report was made: commands, machine, time. test_report_numbers.py checks the numbers."""

import json
import re
import shlex
import shutil
import subprocess
from dataclasses import asdict, replace
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import cells, edit_results, lines_of, write_evaluated, write_status

from agents import api
from agents.cli.main import main
from agents.errors import UserError
from agents.paper.evidence import paper_results
from agents.paper.sections import STUDY, ties_table
from agents.presets import preset
from agents.reporting import provenance
from agents.reporting.page import Section, Statement
from agents.reporting.provenance import command, made
from agents.reporting.report import report, table
from agents.reporting.study import Study
from agents.reporting.table import Number, Row, Table, markdown
from agents.reporting.tables import best
from agents.results.reading import read_groups
from agents.training import config
from agents.training.config import TrainConfig

AT = [[[-0.5, 0.0]] * 3 + [[1.0, 0.0]]]  # in units of the arena; (-7.5, 0) is in the corridor


def test_ways_in_words(tmp_path):
    """Three of four episodes end in the corridor, with the costs 4, 5 and 12 in the first run: one
    of them came round the cost region."""
    evaluated = ((4.0, 5.0, 12.0, 0.0), (0.0, 0.0, 3.0, 50.0))
    write_evaluated(tmp_path, "sac-lag", (4, 4), evaluated=evaluated, at=AT)
    words = markdown(table(tmp_path))
    rows = [row[-1] for row in cells(words) if row[0].startswith("SAC")]
    one = "1 of 2 [0.01, 0.99]"
    assert rows[0] == f"corridor, through {one}; corridor, round {one}"
    assert rows[1:] == ["corridor (75 %, 25 % round, 50 % through)", "corridor, round (75 %)"]
    assert '"through": ' in words
    written = (tmp_path / "report.csv").read_text()
    assert '"corridor (75 %, 25 % round, 50 % through)"' in written


class Own(Study):
    """A study with a printed number and a claim."""

    def printed(self, group):
        return replace(group, printed={"J_R": 7.0}, publication="book (9 seeds)")

    def sections(self, groups):
        verdict = f"of {len(groups)} groups"
        return [Section("Its claims", statements=[Statement("CPO learns", verdict, "", [])])]


def test_a_study_adds_rows_and_sections_to_a_report_and_rows_to_a_table(tmp_path, monkeypatch):
    write_evaluated(tmp_path, "cpo", costs=(1, 2))
    plain = markdown(report(tmp_path).blocks)
    assert "paper" not in plain
    written = report(tmp_path, study=Own())
    words = markdown(written.blocks)
    assert "CPO, book (9 seeds)" in words
    assert "Of 1 groups" in words
    assert "Its claims" in written.page.read_text()
    monkeypatch.setattr(Own, "sections", None)  # a table must not ask for claims
    assert "CPO, book (9 seeds)" in markdown(table(tmp_path, Own()))


def test_runs_left_out_are_in_no_mean_and_have_a_note_for_each_reason(tmp_path):
    """One of five runs is complete, two lack their last rollouts, one its steps, and one failed."""
    write_evaluated(tmp_path, "cpo", costs=(1, 2, 3, 4, 5))
    changes = {f"Circle2D-1-v0__{k}__length": np.full(8, 10) for k in (2, 3)}
    changes |= {f"Circle2D-1-v0__{k}__rollouts": np.ones(8, int) for k in (2, 3)}
    changes |= {f"Circle2D-1-v0__{k}__return": np.full(8, -1.0) for k in (2, 3)}
    changes |= {f"Circle2D-1-v0__{k}__costs__cost__steps": np.array(80) for k in (2, 3)}
    for k in (2, 3):  # of each ten steps the first k + 1 cost
        bits = np.packbits(np.arange(80) % 10 < k + 1)
        changes |= {f"Circle2D-1-v0__{k}__costs__cost__unsafe": bits}
    changes |= {"Circle2D-1-v0__1__length": None, "Circle2D-1-v0__4__failure": np.array("it fell")}
    edit_results(tmp_path, **changes)
    words = markdown(table(tmp_path))
    assert [line for line in words.splitlines() if "left out" in line] == [
        f"Note: left out: {tmp_path.name}, seed 1: has no recorded episodes",
        f"Note: left out: {tmp_path.name}, seeds 2, 3: unfinished: 80 of 100 steps",
        f"Note: left out: {tmp_path.name}, seed 4: it fell",
    ]
    assert "mean of 1" in words
    assert "seed 2 |" not in words


def test_names_of_other_people_are_neither_html_nor_control_sequences(tmp_path):
    """In report.md and on the terminal; test_page.py has the page."""
    folder = tmp_path / "<script>alert(1)<" / "\x1b[31mred"
    write_evaluated(folder, "cpo", costs=(4, 4))
    edit_results(folder, **{"Circle2D-1-v0__1__evaluation__deterministic__returns": None})
    text = markdown(table(tmp_path))
    assert text == (tmp_path / "report.md").read_text()
    assert "&lt;script>alert" in text
    assert "<script" not in text
    assert "\x1b" not in text


def test_equal_runs_of_several_folders_have_names_of_their_own(tmp_path):
    """In every table and legend; a group whose name is unique keeps the short name."""
    for folder, name in {"first": "cpo", "second": "cpo", "alone": "trpo-lag"}.items():
        write_evaluated(tmp_path / "runs" / folder, name, costs=(1, 2))
    text = markdown(report(tmp_path / "runs").blocks)
    names = [row[0] for row in cells(text)]
    ours = [name for name in names if re.search("mean of|seed ", name)]
    for folder in ("first", "second"):
        label = f"CPO (in runs/{folder})"
        assert {f"{label}, mean of 2", f"{label}, seed 0", f"{label}, seed 1"} <= set(ours)
        assert label in (tmp_path / "runs" / "index.html").read_text()
    assert "TRPO-Lag, seed 0" in ours
    assert len(set(ours)) == len(ours) == 9
    assert "CPO, mean of 2" in markdown(table(tmp_path / "runs" / "first"))


MEASURES = ("EMCC_0.33", "EMCC_0.66", "EMCC_0.99", "cost_rate", "J_R", "J_C", "CVaR_0.5")
NAMES = {"TRPO-Lag": 0, "CPO": 1, "SAC-Lag": 2, "SAC-LB": 3, "WCSAC": 4}
T, C, S, B, W = range(5)
# The bold cells of the paper's two tables, from its LaTeX source, in the order of MEASURES.
BOLD = {
    "Circle2D-0": [{B}, {B, W}, {S}, {W}, {S}, {S}, {S}],
    "Circle2D-1": [{T}, {T}, {T}, {W}, {S}, {S, W}, {S, W}],
    "Circle2D-2": [{T}, {T}, {T}, {B}, {W}, {W}, {W}],
    "Circle2D-3": [{T}, {T}, {T}, {C, B, W}, {B}, {B}, {B}],
    "SafetyPointCircle1-v0": [{C}, {S}, {S}, {C}, {C}, {C}, {C}],
    "SafetyPointGoal1-v0": [{S, B}, {S, B}, {S}, {C}, set(), set(), set()],
    "SafetyHopperVelocity-v1": [{S}, {C}, {C}, {C}, {T}, {T}, {T}],
}
BEYOND_ITS_RULE = {("Circle2D-1", W, "J_C"), ("Circle2D-1", W, "CVaR_0.5")}
"""The paper marks WCSAC's costs as well, though its return is not the highest."""


def test_the_best_cells_are_those_that_the_paper_marks():
    printed = json.loads(files("agents.paper").joinpath("printed.json").read_text())["results"]
    assert set(printed) == set(BOLD)
    for task, bold in BOLD.items():
        name = f"{task}-v0" if task.startswith("Circle2D") else f"circle2d_mj/{task}"
        limit = preset("cpo", name).cost_limit
        assert limit == (5 if task.startswith("Circle2D") else 25)
        candidates = {
            k: (values := paper_results(name, title), values["J_C"] <= limit)
            for title, k in NAMES.items()
        }
        expected = {(k, m) for m, marked in zip(MEASURES, bold, strict=True) for k in marked}
        expected -= {(k, m) for of, k, m in BEYOND_ITS_RULE if of == task}
        assert best(candidates) == expected, task


def values(emcc, j_r, j_c):
    return dict.fromkeys(MEASURES[:4], emcc) | {"J_R": j_r, "J_C": j_c, "CVaR_0.5": j_c}


def test_equal_to_two_digits_is_equal_and_one_alone_is_not_best():
    one, two = values(0.301, -3.001, 4.0), values(0.304, -3.002, 6.0)
    marked = best({3: (one, True), 7: (two, True)})
    assert {key for key, name in marked if name.startswith("EMCC")} == {3, 7}
    assert {key for key, name in marked if name == "J_R"} == {3, 7}
    assert best({3: (one, True)}) == set()
    assert {key for key, name in best({3: (one, True), 7: (two, False)}) if name == "J_R"} == {3}
    assert not {m for m in best({0: (two, False), 1: (two, False)}) if m[1] == "J_R"}


def test_unknown_values_are_not_marked():
    """Nor is the return of a row without a cost limit, nor a measure that only one row has."""
    one, two = values(0.3, -3.0, 1.0), values(0.4, -2.0, 1.0)
    marked = best({0: (one | {"EMCC_0.33": None}, True), 1: (two, True), 2: (two, None)})
    assert {key for key, name in marked if name == "EMCC_0.33"} == {1, 2}
    assert {key for key, name in marked if name == "J_R"} == {1}
    unknown = best({0: (one | {"cost_rate": None}, True), 1: (two, True)})
    assert not {m for m in unknown if m[1] == "cost_rate"}
    assert not {m for m in marked if m[1] == "mean_streak"}


def test_the_command_trains_the_same(tmp_path):
    hyperparameters = replace(preset("sac-lag", "Circle2D-3-v0"), cost_limit=3.0, hidden=(32, 64))
    parameters = {"constraint_radius": 3.0, "optima_perturbation": (1.0, 0.5)}
    config = TrainConfig("sac-lag", ("Circle2D-3-v0",), (4, 7), 150, hyperparameters, parameters)
    config = replace(config, vectorization="sync", evaluation_episodes=2)
    said = command(config, str(tmp_path / "with a space"), {})
    program, *arguments = shlex.split(said)
    assert program == "circle2d"
    assert main(arguments) == 0
    read_again = TrainConfig.read(tmp_path / "with a space")
    assert replace(read_again, task_parameters=parameters) == config
    assert "--hidden 32 64 " in said
    assert "--discount" not in said  # as the preset has it
    assert "--backend" not in said
    other = replace(config, backend="numpy")
    assert "--vectorization sync --backend numpy --eval" in command(other, "x", {})


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("trpo-pid", {"normalize_observations": True}),
        ("focops", {"standardize_cost_advantages": False}),
        ("ppo-lag", {"streak_limit": 3.0, "streak_alpha": 0.25, "normalize_observations": True}),
    ],
)
def test_settings_of_true_or_false_are_flags_of_the_command(name, changes, tmp_path, monkeypatch):
    """`main` reads the command; the configuration is compared, and nothing is trained."""
    own = replace(preset(name, "Circle2D-1-v0"), **changes)
    config = TrainConfig(name, ("Circle2D-1-v0",), (4,), 150, own)
    read = []

    def noted(given, *_, **__):
        read.append(given)
        raise UserError("enough")

    monkeypatch.setattr(api, "train_config", noted)
    assert main(shlex.split(command(config, str(tmp_path / "x"), {}))[1:]) == 2
    assert read == [config]


def test_the_command_imports_what_registers_algorithm_and_task():
    preset_of = preset("sac-lag", "Circle2D-3-v0")
    config = TrainConfig("sac-lag", ("Circle2D-3-v0",), (4,), 150, preset_of)
    own_task = {"modules": ["my_tasks"]}
    assert command(config, "x", own_task).startswith("circle2d train sac-lag --import my_tasks ")
    by_prefix = replace(config, tasks=("my_tasks:Mine-v0",))
    assert "--import" not in command(by_prefix, "x", own_task)
    content = asdict(config) | {"algorithm": "mine"}
    own = TrainConfig.parse(content, "x", strict=False)  # not registered here
    for modules, imports in ((["a", "b"], ["a", "b"]), (["__main__"], []), ([], [])):
        said = command(own, "x", {"modules": modules}).partition(" --task")[0]
        assert said == " ".join(["circle2d train mine", *(f"--import {m}" for m in imports)])


def test_a_report_tells_commands_steps_and_training_time(tmp_path):
    for name in ("cpo", "wcsac"):
        write_evaluated(tmp_path / name, name, costs=(1, 2))
        write_status(tmp_path / name, 1.0, **{name: 300.4})
    told = made(read_groups([tmp_path], []))
    assert told["training time"] == "10 min, all processes together"
    assert told["program"].startswith("circle2d-mj ")
    first, second = told["command"].splitlines()
    assert first == (
        f"circle2d train cpo --task Circle2D-1-v0 --seeds 0 1 --steps 100 --out {tmp_path.name}/cpo"
    )
    assert "wcsac" in second
    assert (told["runs"], told["steps"]) == ("4", "100")
    (tmp_path / "cpo" / "status.json").unlink()
    groups = read_groups([tmp_path], [])
    assert made(groups)["training time"] == "5 min, all processes together, of 1 of 2 folders"
    assert not {"machine", "training time"} & made(groups[:1]).keys()


def test_the_commit_is_told_where_it_is_known(tmp_path, monkeypatch):
    module = tmp_path / "agents" / "training" / "config.py"
    monkeypatch.setattr(config, "__file__", str(module))
    origin = SimpleNamespace(read_text=lambda name: None)
    monkeypatch.setattr(config, "distribution", lambda name: origin)
    assert "commit" not in provenance.program()
    origin.read_text = lambda name: '{"url": "", "vcs_info": {"vcs": "git", "commit_id": "b1c2"}}'
    assert provenance.program().endswith(", commit b1c2")  # as pip notes it
    (tmp_path / "a").write_text("")
    for words in ("init -q", "add a", "-c user.name=a -c user.email=b commit -qm x"):
        subprocess.run(["git", "-C", str(tmp_path), *words.split()], check=True)
    head = subprocess.run(
        ["git", "-C", str(tmp_path), "rev-parse", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    assert provenance.program().endswith(f", commit {head}")
    (tmp_path / "a").write_text("changed")
    assert provenance.program().endswith(f", commit {head}-dirty")


def test_latex_has_the_means_and_escapes_characters():
    mean = Number(-4.25, 2, -5.0, -3.5, marked=True)
    rows = [
        Row(
            "A & B (x_y 2), mean of 2",
            [mean, Number(5.0, 1, -1.0, 3.0, is_range=True)],
            kind="mean",
        ),
        Row("A, seed 0", [Number(1.0), Number(2.0)]),
        Row("paper", [Number(0.0004, 3, is_p=True), Number(None)], kind="paper"),
    ]
    table = Table("50 % of\nall", ["Task_1", "J_R", "solved"], rows, ["a note"])
    assert table.latex(("J_R", "solved")).splitlines() == [
        r"\begin{table}",
        r"\centering",
        r"\caption{50 \% of all; (lowest, highest run).}",
        r"\smallskip",
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        "% 50 % of all",
        r"\begin{tabular}{@{}lrr@{}}",
        r"\toprule",
        r"Task\_1 & $J_{R}$ & solved \\",
        r"\midrule",
        r"A \& B & \textbf{$-$4.25} & 5.0 \\",
        r"{\scriptsize (x\_y 2), mean of 2} & {\scriptsize [$-$5.00, $-$3.50]} & "
        r"{\scriptsize ($-$1.0, 3.0)} \\",
        r"paper & $<$0.001 & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
        "}",
        r"\end{table}",
        "% Note: a note",
    ]
    # The default columns are the paper's, of which this table has one.
    assert r"Task\_1 & $J_{R}$ \\" in table.latex().splitlines()
    table = Table("", ["", "EMCC_0.33", "my_measure"], [Row("A", [Number(1.0), Number(2.0)])])
    assert r" & EMCC$_{0.33}$ & my\_measure \\" in table.latex(("EMCC_0.33", "my_measure"))


@pytest.mark.parametrize(
    ("seeds", "at", "said"),
    [
        ((1,), None, {"over 1 seed;"}),
        ((3, 1), None, {"over 1 to 3 seeds", "(lowest, highest)"}),
        ((5,), None, {"over 5 seeds", r"[95 \% t interval]"}),
        ((5,), AT, {"over 5 seeds", "(lowest, highest)"}),
        ((6, 3), None, {"over 3 to 6 seeds", "[95", "(lowest, highest)", "fewer than 5"}),
    ],
)
def test_the_caption_in_latex_explains_what_stands_below_the_means(tmp_path, seeds, at, said):
    """It explains brackets and parentheses only where there are some, and gives the cost limit."""
    for name, number in zip(("cpo", "trpo-lag"), seeds, strict=False):
        ends = at and [[[-0.5, 0.0]]] + [[[1.0, 0.0]]] * (number - 1)
        write_evaluated(tmp_path / name, name, range(1, number + 1), at=ends)
    report(tmp_path)
    tex = (tmp_path / "report.tex").read_text()
    found = re.search(r"^\\caption\{(.*)\}$", tex, re.M)
    assert found
    assert {words for words in said if words in found[1]} == said
    assert "cost limit 5" in found[1]
    body = re.sub("^%.*$", "", tex[found.end() :], flags=re.M)
    assert ("[95" in found[1]) == (r"& {\scriptsize [" in body)
    assert ("(lowest" in found[1]) == (r"& {\scriptsize (" in body)
    if shutil.which("pdflatex"):
        start = r"\documentclass{article}\usepackage{booktabs,graphicx}\begin{document}"
        (tmp_path / "paper.tex").write_text(rf"{start}\input{{report}}\end{{document}}")
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, encoding="latin-1")
        assert done.returncode == 0 and "Overfull" not in done.stdout, done.stdout


def test_columns_of_latex_are_chosen_by_their_heads(tmp_path):
    write_evaluated(tmp_path, "cpo", costs=(1, 2))
    report(tmp_path, columns=("J_C", "mean streak (steps)"))
    lines = (tmp_path / "report.tex").read_text().splitlines()
    head = [line for line in lines if "& $J_{C}$" in line]
    assert head == [r"Circle2D-1-v0 & $J_{C}$ & mean streak (steps) \\"]
    with pytest.raises(UserError, match=r"no table has a column 'J_c': did you mean 'J_C'"):
        report(tmp_path, columns=("J_c",))


def test_no_printed_numbers_beside_a_task_with_other_parameters(tmp_path):
    write_evaluated(tmp_path, "cpo", costs=(1, 2))
    path = tmp_path / "config.json"
    content = json.loads(path.read_text())
    for parameters, kinds in (
        ({}, {"mean", "run", "paper"}),
        ({"optima_perturbation": 0.5}, {"mean", "run"}),
    ):
        path.write_text(json.dumps(content | {"task_parameters": parameters}))
        assert ("paper (3 seeds)" in markdown(table(tmp_path, STUDY))) is ("paper" in kinds)
        found = {line["kind"] for line in lines_of(tmp_path / "report.csv")}
        assert found & {"mean", "run", "paper"} == kinds
        ties = ties_table([*map(STUDY.printed, read_groups([tmp_path], []))])
        assert {row.kind for row in ties.rows} == kinds - {"run"}
