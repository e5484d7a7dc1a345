"""One drive of a result folder: the one that the options name, else the worst of those that fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from logs.errors import ConfigError, unknown_name
from replay.cli.app import option

if TYPE_CHECKING:
    from replay.results.load import DriveResult, Results

Loop = Literal["open", "closed"]
OfLog = Annotated[str | None, option(None, "Which log. Default: the worst drive.", "--log", metavar="NAME")]
OfPlanner = Annotated[str | None, option(None, "Which planner. Default: the worst drive.", "--planner", metavar="NAME")]
OfMode = Annotated[Loop | None, option(None, "Default: the loop with a failed gate, else closed.", "--mode")]


class Chosen(NamedTuple):
    """A drive, and why it is this one: a remark in brackets that follows its name; "" where no other fits."""

    drive: DriveResult
    remark: str

    @property
    def title(self) -> str:
        """Log, planner and loop."""
        return f"{self.drive.log}, {self.drive.planner}, {self.drive.mode} loop"


def chosen_drive(results: Results, log: str | None, planner: str | None, mode: Loop | None) -> Chosen:
    """The worst drive of those that fit, as `worst_drive`.

    Args:
        results: The run.
        log: Name of a log; None: any.
        planner: Name of a planner; None: any.
        mode: "open" or "closed"; None: either.

    Raises:
        ConfigError: No drive fits.
    """
    table, asked = results.drives, {"log": log, "planner": planner, "mode": mode}
    for column, value in asked.items():
        if value is not None and value not in set(table[column]):
            raise unknown_name(f"{column} (in the run)", value, list(dict.fromkeys(table[column])))
        table = table if value is None else table[table[column] == value]
    if table.empty:
        raise ConfigError(f"{results.path}: no drive with these options")
    drives = [results.drive(*key) for key in table[["log", "planner", "mode"]].itertuples(index=False, name=None)]
    return worst_drive(results, drives, ", ".join(f"--{name}" for name, value in asked.items() if value is None))


def worst_drive(results: Results, drives: Sequence[DriveResult], options: str) -> Chosen:
    """The worst of some drives of a run; the remark says by which options another is chosen.

    Worst is a drive with a failed gate, then an inconclusive one, then the one with the most coloured cells in the
    report; of two loops the one in which a gate failed, else the closed one.
    """
    from replay.draw.report.overview import overview

    if len(drives) == 1:
        return Chosen(drives[0], "")
    order = {"fail": 0, "inconclusive": 1}
    rows = {(row.log, row.planner): (order.get(row.verdict, 2), -row.trouble) for row in overview(results).drives}

    def rank(drive: DriveResult) -> tuple[tuple[int, int], bool, bool]:
        failed = bool((drive.verdicts["outcome"] == "fail").any())
        return rows[drive.log, drive.planner], not failed, drive.mode != "closed"

    return Chosen(min(drives, key=rank), f" (the worst of {len(drives)} drives; another: {options})")
