"""A section of a report: a table, lines and remarks, as terminal, Markdown and HTML render them.

A table is a tuple of columns and the rows that they show: rows of a table of results, or objects. A
column makes a cell of a row, so that its title and its contents stand in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite, nan
from typing import Any

MISSING = "-"
NO_UNIT = ("", "1", "count")  # Units that are not written after a value
MOST_IN_TERMINAL = 30


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str = MISSING  # The value as text
    value: float = nan  # The value as a number; NaN: there is none
    bad: bool = False  # Whether it is marked
    outcome: str = ""  # The outcome that it states; "" if it states none
    # Logs and planners of the drives that it names, or of the one that it is about
    drives: tuple[tuple[str, str], ...] = ()
    code: bool = False  # Whether it is a rule or a command
    file: str = ""  # The file that shows it, relative to the result folder

    @property
    def is_list(self) -> bool:
        """Whether its text is the names of its drives."""
        return bool(self.drives) and self.text == ", ".join(log for log, _ in self.drives)


@dataclass(frozen=True)
class ReportColumn:
    """A column of a section."""

    title: str
    cell: Callable[[Any], Cell]  # The cell of a row
    # Whether its cells are numbers: aligned to the right, and sorted by their value
    is_number: bool = False
    short: str = ""  # The title in short lines, where there is little room; "": `title`
    about: str = ""  # More about it, where a pointer can rest on the title


@dataclass(frozen=True, eq=False)
class ReportSection:
    """A part of a report."""

    title: str
    columns: Sequence[ReportColumn] = ()  # The columns of its table; none: it has no table
    items: Sequence[Any] = ()  # The rows of its table, the ones to look at first
    lines: Sequence[str] = ()
    remarks: Sequence[str] = ()
    # Whether it is only for those who look for it: folded where a report can fold
    folded: bool = False
    most: int = MOST_IN_TERMINAL  # Largest number of rows and of lines that a terminal shows
    rest: str = ""  # The file that has all rows
    # A row in words, for a terminal, which is narrow; None: it shows a table
    as_line: Callable[[Any], str] | None = None
    key: str = ""  # A name for links, and for what an output adds to the section

    @cached_property
    def rows(self) -> list[list[Cell]]:
        """The cells of its table, by rows."""
        return [[column.cell(item) for column in self.columns] for item in self.items]


def with_contents(sections: Iterable[ReportSection]) -> list[ReportSection]:
    """The sections that have something to show."""
    return [section for section in sections if section.items or section.lines or section.remarks]


def text_column(title: str, attribute: str = "") -> ReportColumn:
    """A column of words: an attribute of the rows, by default the one with the name of the
    title.
    """
    name = attribute or title
    return ReportColumn(title, lambda row: Cell(getattr(row, name)))


def number_column(
    title: str, attribute: str = "", show: Callable[[float], str] = "{:.4g}".format
) -> ReportColumn:
    """A column of numbers: an attribute of the rows, by default the one with the name of the
    title.
    """
    name = attribute or title
    return ReportColumn(title, lambda row: number_cell(getattr(row, name), show), is_number=True)


def seconds_column(title: str, attribute: str) -> ReportColumn:
    """A column of times, s."""
    return number_column(title, attribute, "{:.2f} s".format)


def number_cell(
    value: float, show: Callable[[float], str] = "{:.4g}".format, unit: str = ""
) -> Cell:
    """A number with its unit; `MISSING` where it is NaN."""
    return Cell(f"{show(value)}{unit_suffix(unit)}", value) if isfinite(value) else Cell()


def outcome_cell(outcome: str, suffix: str = "") -> Cell:
    """An outcome, with what follows it; `MISSING` where it is ""."""
    return Cell(f"{outcome}{suffix}" if outcome else MISSING, outcome=outcome)


def unit_suffix(unit: str) -> str:
    """The unit with a space before it; "" for numbers without one."""
    return "" if unit in NO_UNIT else f" {unit}"
