"""The form of every check of a log: one row of a table.

A row says what is compared with what, from which difference on, and what replan does then. Rows
that refuse or repair take the scenario while it is read (`replan.logs.comparisons`,
`replan.logs.readers.admission`); rows that report make findings of the scenario that is evaluated
(`replan.metrics.health`, which has the list of all).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum
from typing import Generic, NamedTuple, TypeVar

from replan.logs.log_settings import LogSettings
from replan.logs.scenario import Scenario

Run = TypeVar("Run")


class CheckAction(Enum):
    """The strongest thing that a check does to a log."""

    REFUSE = "refuse"
    REPAIR = "repair"
    REPORT = "report"


class LogCheck(NamedTuple, Generic[Run]):
    """One row: what is compared with what, when they differ, the strongest action and what replan
    does in full, the setting of [log] that decides ("": none), and the function.

    Without a function, the comparison takes place while the log is read, where what contradicts is
    still at hand.
    """

    subject: str
    against: str
    tolerance: str
    action: CheckAction
    consequence: str
    setting: str = ""
    run: Run | None = None

    def row(self) -> tuple[str, str, str, str, str]:
        """Return the row for the documentation."""
        return self.subject, self.against, self.tolerance, self.consequence, self.setting


Step = Callable[[Scenario, LogSettings, bool], Scenario]
"""Refuses or repairs a scenario. The last argument: [log] can state conventions of headings."""


def of_scenario(check: Callable[[Scenario], Scenario]) -> Step:
    """Return a check that needs no settings as a step."""
    return lambda scenario, settings, is_table: check(scenario)


def passed(
    scenario: Scenario,
    checks: Iterable[LogCheck[Step]],
    settings: LogSettings | None = None,
    *,
    is_table: bool = True,
) -> Scenario:
    """Return the scenario after the checks, in their order.

    Raises:
        LogError: A check refuses the log.
    """
    for check in checks:
        if check.run is not None:
            scenario = check.run(scenario, settings or LogSettings(), is_table)
    return scenario
