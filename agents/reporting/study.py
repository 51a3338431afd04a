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
    """A study that adds nothing; a subclass adds its own, such as a paper's numbers."""

    def printed(self, group: Group) -> Group:
        """The group with the numbers that it prints for the group's algorithm and task."""
        return group

    def set_apart(self, groups: Sequence[Group]) -> tuple[list[Group], dict[str, Table]]:
        """The groups to report as usual, and tables, by title, of the others."""
        return [*groups], {}

    def notes(self, groups: Sequence[Group]) -> list[str]:
        """Notes below the table of a task. groups: the usual ones on it."""
        return []

    def details(self, groups: Sequence[Group]) -> dict[str, Table]:
        """Tables of details, by title. groups: the usual ones."""
        return {}

    def sections(self, groups: Sequence[Group]) -> list[Section]:
        """Figures, or claims with their verdicts, first on the page. groups: all of them."""
        return []


def ask(method: Callable[[Given], Told], given: Given) -> Told:
    """Return what a method of a study tells. Raises OwnCodeError where it fails."""
    try:
        return method(given)
    except UserError:
        raise
    except OWN_ERRORS as error:
        words = f"{method.__qualname__} of the study failed: {described(error)}"
        raise OwnCodeError(words) from error
