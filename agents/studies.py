"""The study that tables and reports show: the paper's, until another takes its place."""

from __future__ import annotations

from agents.errors import UserError
from agents.reporting.study import Study

_used: Study | None = None


def use_study(study: Study) -> None:
    """Let a study take the paper's place in all tables and reports; `Study()` shows none.

    A module that calls it may be named by `--import`. Raises UserError for anything but a `Study`.
    """
    if not isinstance(study, Study):
        raise UserError(f"use_study takes a Study, as in use_study(MyStudy()), got {study!r}")
    global _used
    _used = study


def used_study() -> Study:
    """The study that `use_study` was given last, by default the paper's."""
    if _used is None:
        from agents.paper.sections import STUDY

        return STUDY
    return _used
