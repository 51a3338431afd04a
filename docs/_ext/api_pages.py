"""The API reference, generated from the public names of each package and their docstrings.

The docstrings are Markdown with doctests, so MyST can read them.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import typing
from types import ModuleType

from hyperparameters import texts

PACKAGES = ("agents", "circle2d_mj", "emcc")
_NOT_SHOWN = {"__version__", "render", "sb3"}
"""Public names that are modules or plain strings, which have no entry."""


def pages() -> dict[str, str]:
    """Return the pages by package name."""
    return {name: _page(importlib.import_module(name)) for name in PACKAGES}


def public(package: ModuleType) -> list[str]:
    """Return the public names of a package that the reference describes."""
    return sorted((n for n in package.__all__ if n not in _NOT_SHOWN), key=str.lower)


def _page(package: ModuleType) -> str:
    name = package.__name__
    first = _text(inspect.getdoc(package) or "").partition("\n\n")[0]
    parts = [f"# {name}", first, f"```{{py:module}} {name}\n```"]
    members = [_member(name, of, getattr(package, of)) for of in public(package)]
    if name == "emcc":
        callback = importlib.import_module("emcc.sb3").EMCCCallback
        members.append(_member("emcc.sb3", "EMCCCallback", callback))
    return "\n\n".join([*parts, *members]) + "\n"


def _member(module: str, name: str, member: typing.Any) -> str:
    """Return the entry of a function or a class."""
    title = f"## {name}"
    if not inspect.isclass(member):
        if callable(member):
            return f"{title}\n\n" + _entry("function", f"{module}.{name}", member, _body(member))
        return title
    own = [_body(member), *_fields(member)]
    for key, value in vars(member).items():
        function = value.fget if isinstance(value, property) else value
        function = getattr(function, "__func__", function)
        hidden = key.startswith("_") and key != "__call__"
        if hidden or not inspect.isfunction(function) or not function.__doc__:
            continue
        kind = "property" if isinstance(value, property) else "method"
        own.append(_entry(kind, key, value, _body(function), depth=4))
    return f"{title}\n\n" + _entry("class", f"{module}.{name}", member, "\n\n".join(own))


def _entry(kind: str, name: str, member: typing.Any, body: str, depth: int = 5) -> str:
    shown = name if kind == "property" else f"{name}{_signature(member)}"
    fence = ":" * depth
    return f"{fence}{{py:{kind}}} {shown}\n\n{body}\n{fence}"


def _signature(member: typing.Any) -> str:
    try:
        found = inspect.signature(getattr(member, "__func__", member))
    except ValueError:
        return "()"
    kept = [
        parameter.replace(annotation=parameter.empty)
        for parameter in found.parameters.values()
        if parameter.name != "self"
    ]
    plain = found.replace(parameters=kept, return_annotation=found.empty)
    return re.sub(r"<[^>]*>", "...", str(plain))


def _fields(cls: type) -> list[str]:
    """List the annotated attributes of a class, with the text below each."""
    try:
        found = texts(cls)
    except (TypeError, OSError):
        return []
    if not found:
        return []
    defaults = {}
    if dataclasses.is_dataclass(cls):
        defaults = {f.name: f.default for f in dataclasses.fields(cls)}
    lines = []
    for name, text in found.items():
        default = defaults.get(name, dataclasses.MISSING)
        shown = "" if default is dataclasses.MISSING else f" = `{default!r}`"
        lines.append(f"- `{name}`{shown}: {text}")
    return ["\n".join(lines)]


def _body(member: typing.Any) -> str:
    """Return a docstring as Markdown for MyST."""
    doc = inspect.getdoc(member) or ""
    names = _parameters(member)
    return _text(doc, names)


def _parameters(member: typing.Any) -> set[str]:
    try:
        return {*inspect.signature(member).parameters, "Raises"}
    except (ValueError, TypeError):
        return set()


def _text(doc: str, names: typing.Collection[str] = ()) -> str:
    """Format a docstring: doctests and indented examples as code, parameters as a list."""
    blocks = []
    for block in re.split(r"\n\n+", doc):
        lines = block.splitlines()
        if lines and lines[0].lstrip().startswith(">>>"):
            blocks.append("```pycon\n" + inspect.cleandoc(block) + "\n```")
        elif lines and all(line.startswith("    ") for line in lines):
            blocks.append("```python\n" + inspect.cleandoc("\n" + block) + "\n```")
        elif lines and lines[0].startswith("|"):
            blocks.append(block)
        else:
            blocks.append(_paragraph(block, names))
    return "\n\n".join(blocks)


def _paragraph(block: str, names: typing.Collection[str]) -> str:
    """Format a paragraph: lines that begin with parameters become a list."""
    lines, listed, before = [], False, ""
    for line in block.splitlines():
        found = re.match(r"(\w+(?:(?:, | and )\w+)*): ", line)
        words = re.split(r", | and ", found[1]) if found else []
        choice = re.match(r"\s+(\S+)\s{2,}(\S.*)", line)
        if found and all(word in names for word in words):
            lines += [] if listed or not lines else [""]
            lines.append(f"- {line}")
            listed = True
        elif re.match(r"\w+Error: |Raises |Source: ", line) or (
            listed and before.endswith(".") and line[:1].isupper()
        ):
            lines += ["", line]
            listed = False
        elif choice and listed:
            lines.append(f"  - `{choice[1]}`: {choice[2]}")
        else:
            lines.append(f"  {line.strip()}" if listed else line)
        before = line
    marked = "\n".join(lines)
    for name in names:
        marked = re.sub(
            rf"(?m)(?:^|(?<=[.;,] )|(?<=- ))({re.escape(name)})(?=(?:, `?\w+`?)*:\s)",
            r"`\1`",
            marked,
        )
    # A separate entry for each parameter, and a paragraph for the errors raised.
    if any(line.startswith("- ") for line in lines):
        marked = re.sub(r"(?<=[.;])\s+(?=`\w+`(, `?\w+`?)*:\s)", "\n- ", marked)
        marked = re.sub(r"(?<=\.)\s+(?=Raises |\w+Error: )", "\n\n", marked)
    return re.sub(r"(?<!`)<(?=\w)", r"\\<", marked)  # <names> are not tags
