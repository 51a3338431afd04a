"""Options as `--help` shows them: a paragraph each, and short names of their types."""

from __future__ import annotations

import dataclasses
import inspect
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from agents.cli.hyperparameters import texts

_METAVARS = {int: "INT", float: "FLOAT", str: "STR", Path: "PATH"}


def explained(options: type) -> type:
    """Return the same options, described for a reader.

    By itself tyro breaks lines where the source does, and shows an option that need not be given as
    `{None}|INT ... (default: None)`.
    """
    hints = get_type_hints(options, include_extras=True)
    words = {name: text for cls in reversed(options.__mro__) for name, text in _texts(cls).items()}
    fields = []
    for field in dataclasses.fields(options):
        hint, *marks = _parts(hints[field.name])
        factory = field.default_factory
        default = field.default if factory is dataclasses.MISSING else factory()
        if dataclasses.is_dataclass(hint):
            hint, default = _nested(hint, default)
        else:  # the field's own marks come later, and win
            marks = [_described(hint, words.get(field.name), default), *marks]
        hint = Annotated[(hint, *marks)] if marks else hint
        given = ()
        if default is not dataclasses.MISSING:
            given = (dataclasses.field(default_factory=lambda own=default: own),)
        fields.append((field.name, hint, *given))
    return dataclasses.make_dataclass(
        options.__name__, fields, frozen=True, namespace={"__doc__": options.__doc__}
    )


def _nested(options: Any, default: Any) -> tuple[type, Any]:
    """Options within options, by the first paragraph of their text, and their default."""
    made = explained(options)
    made.__doc__ = (inspect.getdoc(options) or "").partition("\n\n")[0]
    return made, made(**{f.name: getattr(default, f.name) for f in dataclasses.fields(made)})


def _texts(cls: type) -> dict[str, str]:
    """The texts of a class that a file declares, none of one that the program made."""
    try:
        return texts(cls) if dataclasses.is_dataclass(cls) else {}
    except (OSError, TypeError):
        return {}


def _parts(hint: Any) -> tuple[Any, ...]:
    """A type and its marks."""
    return get_args(hint) if get_origin(hint) is Annotated else (hint,)


def _described(hint: Any, text: str | None, default: Any) -> Any:
    """A mark of tyro: the text, the type's short name, and no default where that is nothing."""
    shown = "" if default is None or default in ((), {}) else None
    if default is dataclasses.MISSING and ... in get_args(hint):
        shown = "(required)"
    return tyro.conf.arg(help=text, metavar=_metavar(hint), help_behavior_hint=shown)


def _metavar(hint: Any) -> str | None:
    """Short name of a type, None where tyro has one."""
    kinds = [kind for kind in get_args(hint) if kind is not NoneType]
    if get_origin(hint) is Literal:
        return "{" + ",".join(kinds) + "}"
    if get_origin(hint) is tuple:
        return " ".join("..." if kind is ... else str(_metavar(kind)) for kind in kinds)
    if get_origin(hint) is dict:
        return "NAME VALUE ..."
    return _metavar(kinds[0]) if kinds else _METAVARS.get(hint)
