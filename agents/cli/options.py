"""Options of the command line, as tyro reads them from dataclasses."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from typing import Any, Literal

import tyro

from agents.errors import UserError
from agents.lockstep.compiling import cannot_compile, compiling_is_off
from agents.training.config import Backend

BackendChoice = Literal["auto", "compiled", "eager"]


def chosen_backend(choice: BackendChoice) -> Backend:
    """What `auto` comes to on this machine; a line on stderr says where that is eager for another
    reason than that PyTorch was told so by its own TORCH_COMPILE_DISABLE."""
    if choice != "auto":
        return choice
    why = cannot_compile()
    if why and not compiling_is_off():
        print(f"circle2d: updates run in eager PyTorch, half as fast: {why}", file=sys.stderr)
    return "eager" if why else "compiled"


def parse(options: type, command: str, args: Sequence[str]) -> Any:
    """The options given. Raises UserError with tyro's message in one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(options, prog=f"circle2d {command}", args=list(args))
    except SystemExit as exit_:
        if not exit_.code:
            raise
        words = re.sub(r"\x1b\[[0-9;]*m|[─│╭╮╰╯═]+", " ", said.getvalue())
        raise UserError(" ".join(words.split()) or "the options cannot be understood") from None
