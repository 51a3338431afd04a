"""Options of the command line, as tyro reads them from dataclasses."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Sequence
from typing import Any

import tyro

from agents.errors import UserError


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
