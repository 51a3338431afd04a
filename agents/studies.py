"""The study that tables and reports show: the paper's, unless `use_study` replaces it."""

from __future__ import annotations

from agents.errors import UserError
from agents.reporting.study import Study

_used: Study | None = None


def use_study(study: Study) -> None:
    """Show a study instead of the paper's in all tables and reports; `Study()` shows none.

    On the command line, `--import` a module that calls this function. Raises UserError for anything
    but a `Study`.
    """
    if not isinstance(study, Study):
        raise UserError(f"use_study takes a Study, as in use_study(MyStudy()), got {study!r}")
    global _used
    _used = study


def used_study() -> Study:
    """Return the study of the last call of `use_study`, by default the paper's."""
    if _used is None:
        from agents.paper.sections import STUDY

        return STUDY
    return _used
