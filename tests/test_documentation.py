"""README and documentation: code runs, commands and links exist, and pages that are generated from
the code are complete."""

import dataclasses
import importlib
import os
import re
import shlex
import tomllib
from pathlib import Path
from urllib.parse import urlparse

import gymnasium as gym
import pytest

from agents.algorithms import ALGORITHMS
from agents.cli.main import COMMANDS
from agents.training.policy import pretrained
from circle2d_mj import Circle2DConfig
from circle2d_mj.registration import CIRCLE2D, SAFETY

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "emcc" / "README.md", *sorted(DOCS.rglob("*.md"))]
PAGES = [page for page in PAGES if not {"made", "_build", "_ext"} & set(page.parts)]
TEXTS = {str(page.relative_to(ROOT)): page.read_text() for page in PAGES}
SLOW = ("docs/training.md",)
ELSEWHERE = ("docs/extending.md", "docs/first_steps.md", "docs/ray.md")
"""Pages whose code other files test: test_extending.py, test_first_steps.py, the tests of ray."""
DRAWING = ("docs/environments.md",)
README = TEXTS["README.md"]
OWN = {name: {"--price"} for name in ("sac-fixed", "trpo-price", "ppo-price")}
OWN |= {"sac-mw": {"--gain"}}
OWN |= {"sac-quantile": {"--cost-critics"}, "reinforce-state": {"--std"}}
OWN |= {"ppo-two": {"--cost-limit", "--second-limit"}}
"""Algorithms of docs/extending.md and docs/first_steps.md, and their options."""
TITLES = ("Description", "Action space", "Observation space", "Reward", "Cost", "Start", "End")
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def code_of(text):
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def train_randomly(env):
    env.reset(seed=0)
    for _ in range(500):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
        for name, text in TEXTS.items()
        if code_of(text) and name not in ELSEWHERE
    ],
)
def test_the_code_of_a_page_runs(name, request, tmp_path, monkeypatch):
    """The examples run one after another, as a reader would type them, with shorter trainings; a
    random agent stands for the reader's training."""
    if name in DRAWING:
        request.getfixturevalue("opengl")
    monkeypatch.chdir(tmp_path)
    env = gym.make("circle2d_mj:Circle2D-1-v0")
    names = {"your_env": env, "your_training": train_randomly}
    names |= {"records": recorded()} if name == "emcc/README.md" else {}
    for code in code_of(TEXTS[name]):
        exec(compile(re.sub("[12]0_000", "1_500", code), name, "exec"), names)
    if "your_env" in TEXTS[name] and "env" in names:
        assert names["env"].records.total_steps == 500


def recorded():
    import emcc

    env = emcc.RecordCosts(gym.make("circle2d_mj:Circle2D-1-v0"))
    train_randomly(env)
    return env.records


def commands():
    """Yield the page and the words of every `circle2d` and `make` command that is shown."""
    for name, text in TEXTS.items():
        lines = text.replace("\\\n", " ")
        shown = re.findall(r"^((?:circle2d|make) .*)$", lines, re.MULTILINE)
        shown += re.findall(r"`((?:circle2d|make) [^`]*)`", text)
        yield from ((name, tuple(shlex.split(line, comments=True))) for line in shown)


def options_of(command, words):
    """Return the options of a command; those of `train` and `grid` include the algorithms'."""
    module = importlib.import_module(f"agents.cli.{COMMANDS[command][0]}")
    fields = list(dataclasses.fields(getattr(module, f"{command.capitalize()}Options")))
    for name in {"train": words[2:3], "grid": words[2:]}.get(command, ()):
        fields += dataclasses.fields(ALGORITHMS[name].config) if name in ALGORITHMS else ()
    if command == "scene":
        fields += dataclasses.fields(Circle2DConfig)
    names = {"import" if field.name == "imports" else field.name for field in fields}
    return {f"--{name.replace('_', '-')}" for name in names} | {"--help"}


@pytest.mark.parametrize(
    ("name", "words"), sorted(set(commands())), ids=lambda of: " ".join(of)[:60]
)
def test_a_command_that_is_shown_exists(name, words):
    program, command, *rest = words
    if program == "make":
        assert re.search(rf"^{command}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
        return
    if command in ("--version", "--help", "COMMAND"):
        return
    assert command in COMMANDS
    for name in (word.partition(":")[2] for word in rest if word.startswith("pretrained:")):
        pretrained(*name.split("/"))
    if command == "train":
        assert rest[0] in {*ALGORITHMS, *OWN, "zoo", "NAME", "--help", "ALGORITHM"}, (
            "the algorithm first"
        )
    own = OWN.get(rest[0], set()) if rest else set()
    for option in (word for word in rest if word.startswith("--")):
        assert option in options_of(command, words) | own


def test_every_command_is_in_the_table_of_commands():
    for command in COMMANDS:
        assert f"\n| `{command}` | " in TEXTS["docs/training.md"]
    assert {words[1] for _, words in commands()} >= {"train", "resume", "report", "demo", "test"}


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name):
    """Relative links lead to files of a fresh clone; addresses are well formed."""
    for target in links(TEXTS[name]):
        if re.match(r"[a-z]+:", target):
            address = urlparse(target)
            assert address.scheme == "https"
            assert "." in address.netloc
        else:
            assert DOCS / "made" not in ((ROOT / name).parent / target).resolve().parents
            assert ((ROOT / name).parent / target).exists()


def links(text):
    """Return the targets of links, without those within a page."""
    plain = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    found = [of.partition("#")[0] for of in re.findall(r"\]\(<?([^)<>\s]+)>?\)", plain)]
    return [target for target in found if target]


@pytest.fixture(scope="module")
def made_pages():
    """Return name -> text of the generated pages; making them takes seconds."""
    import made

    return made.pages()


@pytest.mark.parametrize("name", [name for name in TEXTS if name.startswith("docs/")])
def test_links_of_the_site_lead_to_its_pages(name, made_pages):
    """They lead neither to texts outside the site nor to the source of a page."""
    import made

    assert "```{include} made/metric.md" in made.on_site("metric", TEXTS["docs/metric.md"])
    produced = {Path(page) for page in made_pages} | {Path("emcc_of_your_logs/index.md")}
    text = made.on_site(str(Path(name).relative_to("docs").with_suffix("")), TEXTS[name])
    for target in (of for of in links(text) if not re.match(r"[a-z]+:", of)):
        path = ((ROOT / name).parent / target).resolve()
        if path.suffix in (".md", ".ipynb"):
            assert path in PAGES or path.relative_to(DOCS / "made") in produced
        else:
            assert path.exists()


def prose(path):
    """Return the number of words outside of code, tables and targets of links."""
    left_out = r"```[\s\S]*?```|^\|.*$|</?\w[^>]*>|(?<=\])\([^)]*\)"
    text = re.sub(left_out, "", path.read_text(), flags=re.MULTILINE)
    return sum(bool(re.search("[A-Za-z]", word)) for word in text.split())


def test_the_pages_stay_short():
    """The README, each page of results, and all pages together have a limit; the changelog, which
    has to grow, does not count."""
    assert len(README.splitlines()) <= 105
    results = sorted((ROOT / "results").rglob("README.md"))
    for page in results:
        assert prose(page) <= {"results": 1_200, "streaks": 800}.get(page.parent.name, 600), page
    assert sum(map(prose, [*PAGES, *results, ROOT / "benchmarks" / "README.md"])) <= 14_000


def test_one_version_everywhere():
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"version = {{{VERSION}}}" in README


def test_every_algorithm_has_a_page_and_every_hyper_parameter_a_row():
    import hyperparameters
    import made

    tables = hyperparameters.tables()
    for name, algorithm in ALGORITHMS.items():
        page = TEXTS[f"docs/algorithms/{name}.md"]
        assert f"# {algorithm.title}\n" in page
        assert "**Source**" in page
        on_site = made.on_site(f"algorithms/{name}", page)
        assert on_site.rstrip().endswith(f"```{{include}} ../made/hyperparameters/{name}.md\n```")
        assert f"algorithms/{name}.md" in TEXTS["docs/algorithms.md"]
        rows = [line for line in tables[name].splitlines() if line.startswith("| `--")]
        assert len(rows) == len(dataclasses.fields(algorithm.config))
        assert all(row.split(" | ")[-1].strip(" |") for row in rows)


def test_every_task_has_a_page_with_its_own_numbers(made_pages):
    import task_pages

    pages = {Path(name).stem: text for name, text in made_pages.items() if name[:6] == "tasks/"}
    assert set(pages) == {*CIRCLE2D, *task_pages.SAFETY_PAGES}
    for name in pages:
        assert f"made/tasks/{name}\n" in TEXTS["docs/environments.md"]
        for title in TITLES:
            assert re.search(rf"^## {title}\n\n\S", pages[name], re.MULTILINE)
    variants = "\n".join(pages[name] for name in task_pages.SAFETY_PAGES)
    for name in SAFETY:
        size = gym.make(name).observation_space.shape[0]
        assert re.search(rf"^\| `{name.rpartition('/')[2]}` \|.* {size} \|", variants, re.MULTILINE)
    for name in CIRCLE2D:
        page, env = pages[name], gym.make(name)
        assert f"`{env.action_space}`" in page
        assert f"After {env.spec.max_episode_steps} steps" in page
        env.close()
    for name in SAFETY:
        page = pages[re.sub(r".*/Safety[A-Z].*?([A-Z][a-z]+)\d?-v.", r"Safety\1", name)]
        steps = gym.spec(name).max_episode_steps
        assert f"After {steps} steps" in page
        assert f"| `max_episode_steps` | `{steps}` |" in page
    for field in dataclasses.fields(Circle2DConfig)[1:]:
        assert f"| `{field.name}` | `{field.default!r}` |" in pages["Circle2D-3-v0"]


def test_the_rows_of_a_table_have_the_cells_of_its_head(made_pages):
    """Markdown drops text after an additional bar, as in a cell with |a|."""
    every = "\n\n".join([*TEXTS.values(), *made_pages.values()])
    tables = re.findall(r"(?:^\|.*\n)+", every, re.M)
    assert len(tables) > 100
    for table in tables:
        rows = table.splitlines()
        cells = [len(re.findall(r"(?<!\\)\|", row)) for row in rows]
        assert cells == cells[:1] * len(rows), rows[0]


def test_every_public_name_has_an_entry():
    import api_pages

    import agents
    import circle2d_mj
    import emcc

    pages = api_pages.pages()
    for package in (agents, circle2d_mj, emcc):
        for name in api_pages.public(package):
            assert re.search(rf"\}} {package.__name__}\.{name}\b", pages[package.__name__]), name
    assert "- `seeds`: one run for each" in pages["agents"]
    assert "```pycon\n>>> import agents" in pages["agents"]


def test_the_notebook_runs():
    """Its two agents have equal cost rates and the EMCC that its text says; it draws a figure."""
    import notebook

    here = os.getcwd()
    cells = notebook.run(DOCS / "emcc_of_your_logs.ipynb")
    assert os.getcwd() == here
    printed = "\n".join(text for _, text, _ in cells)
    assert "stays   cost rate 0.20   EMCC {0.33: 0.2, 0.66: 0.2, 0.99: 0.2}" in printed
    assert "leaves  cost rate 0.20   EMCC {0.33: 0.05, 0.66: 0.05, 0.99: 0.05}" in printed
    assert "(1, 20)" in printed
    assert sum(len(pictures) for *_, pictures in cells) == 1
