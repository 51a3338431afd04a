"""Additions of a study to the report of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from agents.errors import OWN_ERRORS, OwnCodeError, UserError, described
from agents.reporting.page import Section
from agents.reporting.table import Table
from agents.results.groups import Group

Given = TypeVar("Given")
Told = TypeVar("Told")


class Study:
    """A study that adds nothing; subclasses add for example a paper's numbers."""

    def printed(self, group: Group) -> Group:
        """Return the group with the study's published numbers for its algorithm and task."""
        return group

    def set_apart(self, groups: Sequence[Group]) -> tuple[list[Group], dict[str, Table]]:
        """Return the groups to report as usual, and tables, by title, about the others."""
        return [*groups], {}

    def notes(self, groups: Sequence[Group]) -> list[str]:
        """Return notes for below a task's table. groups: the usual ones on the task."""
        return []

    def details(self, groups: Sequence[Group]) -> dict[str, Table]:
        """Return tables of details, by title. groups: the usual ones."""
        return {}

    def sections(self, groups: Sequence[Group]) -> list[Section]:
        """Return sections for the top of the page: figures, or claims and verdicts. groups: all."""
        return []


def ask(method: Callable[[Given], Told], given: Given) -> Told:
    """Call a method of a study and return its result. Raises OwnCodeError if it fails."""
    try:
        return method(given)
    except UserError:
        raise
    except OWN_ERRORS as error:
        words = f"{method.__qualname__} of the study failed: {described(error)}"
        raise OwnCodeError(words) from error
