"""Imports between packages and layers go one way, and in no cycle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("agents", "circle2d_mj", "emcc")
LAYERS = (
    "errors",
    "checks",
    "lockstep",
    "on_policy",
    "trust_region",
    "first_order",
    "sac",
    "algorithms",
    "presets",
    "training",
    "results",
    "reporting",
    "paper",
    "studies",
    "export",
    "runs",
    "zoo",
    "api",
    "cli",
)
"""Modules and packages of agents, the lowest layer first."""
MODULES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imports_of(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def within(names, package):
    return {name for name in names if name == package or name.startswith(package + ".")}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_one_way(path):
    """agents may import circle2d_mj and emcc, which import neither agents nor each other; inside
    agents, each of LAYERS may import those before it."""
    names = set(imports_of(ast.parse(path.read_text())))
    parts = path.relative_to(ROOT).parts
    others = {"circle2d_mj": ("agents", "emcc"), "emcc": ("agents", "circle2d_mj")}
    forbidden = others.get(parts[0], ())
    layer = parts[1].removesuffix(".py")
    if parts[0] == "agents" and layer != "__init__":
        above = LAYERS[LAYERS.index(layer) + 1 :]
        forbidden = tuple(f"agents.{part}" for part in above)
    for package in forbidden:
        assert not within(names, package)


def needs(path, files):
    """Return the files that a file imports at run time; for `from package import module`, only the
    module."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    names = set(imports_of(tree)) & files.keys()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            names -= {node.module} if members <= files.keys() else set()
    return names


def test_imports_form_no_cycle():
    """Between the files of all packages; imports inside functions count, imports only for type
    checkers do not."""
    modules = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in MODULES]
    files = dict(zip((m.removesuffix(".__init__") for m in modules), MODULES, strict=True))
    graph = {name: needs(path, files) for name, path in files.items()}
    assert "circle2d_mj.circle2d.region" in graph["circle2d_mj.circle2d.config"]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))
