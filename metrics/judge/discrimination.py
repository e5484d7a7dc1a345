"""Whether a log tells drivers apart: bad reference drives, judged by the gates of the run.

A planner that passes a log has shown something only if a bad driver fails it.
`replan.replay.loop.reference_drives` drives three in the traffic of each run: `PARKED` brakes to a
stop and stays, `CREEPING` goes on at `CREEPS_MPS`, `BLIND` drives its route as if the road were
empty. With the gates of the run on the metrics of `BAD_DRIVERS`, without excuses, since a planner
that passes needs none:

(1) discrimination.parked = 1 if the parked drive breaks a bound, else 0: the log is too easy,
        and a pass says nothing; discrimination.creeping is the same of the creeping drive
(2) discrimination.blind  = 1 if the blind drive breaks a bound, else 0: nothing was in the way,
        no road user, light or sign; a pass says that the planner drives a free road

Gates can ask for them like for any metric. A share of logs with an interaction is a gate on (2)
with `over = "pass_share"`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from types import MappingProxyType

import pandas as pd

from replan.logs.trace import Mode
from replan.metrics import evidence
from replan.metrics.judge.added_rows import Values, fill_rows
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.cases import REFERENCE
from replan.metrics.judge.gates import Gate, Gates

PARKED, CREEPING, BLIND = "parked", "creeping", "blind"
PARKED_FAILS, BLIND_FAILS = (
    f"{evidence.discrimination.name}.{driver}" for driver in (PARKED, BLIND)
)
CREEPS_MPS = 2.0


@dataclass(frozen=True)
class BadDriver:
    """A planner that a log should fail, its settings, the metrics that judge it, and what a log is
    that it passes.
    """

    planner: str
    settings: Mapping[str, object]
    judged_by: tuple[str, ...]
    passes: str


_DRIVES = ("completed", "goal", "route_progress", "needless_braking", "needless_standing")
_LOOKS = (
    "collision_at_fault",
    "gap_kept",
    "gap_kept_vulnerable",
    "ttc",
    "ttc_vulnerable",
    "passing_room",
    "red_light",
    "yellow_light",
    "stop_sign",
    "crosswalk",
    "priority_gap",
    "yielding",
)
BAD_DRIVERS: Mapping[str, BadDriver] = MappingProxyType(
    {
        PARKED: BadDriver("parked", {}, _DRIVES, "too easy"),
        CREEPING: BadDriver("parked", {"speed_mps": CREEPS_MPS}, _DRIVES, "too easy"),
        BLIND: BadDriver("blind", {}, _LOOKS, "no interaction"),
    }
)


@dataclass(frozen=True, slots=True)
class Discrimination:
    """The first gate whose bound a reference driver breaks in a log; None: it breaks none."""

    driver: str
    breaks: Gate | None

    @property
    def text(self) -> str:
        """One line: "a parked driver breaks goal.final >= 1 [closed]"."""
        if self.breaks is None:
            return f"{BAD_DRIVERS[self.driver].passes}: a {self.driver} driver breaks no gate"
        return f"a {self.driver} driver breaks {self.breaks}"


def discrimination(
    driver: str, gates: Gates, labels: LogLabels, values: Mapping[str, float]
) -> Discrimination:
    """Judge the drive of a reference driver by its values of metrics; NaN where it has none."""
    asked = (
        gate
        for gate in gates.gates
        if gate.planner is None
        and gate.mode in (None, Mode.CLOSED.value)
        and gate.selects(labels)
        and gate.metric.partition(".")[0] in BAD_DRIVERS[driver].judged_by
    )
    return Discrimination(
        driver,
        next((gate for gate in asked if gate.margin(values.get(gate.metric, nan)) < 0.0), None),
    )


def with_discrimination(
    table: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]
) -> pd.DataFrame:
    """Fill in (1) and (2) of each closed drive of the table, from the reference drives in it."""
    bad = table[(table["mode"] == REFERENCE) & table["planner"].isin(list(BAD_DRIVERS))]
    known: dict[tuple[str, str], dict[str, float]] = {}
    for log, driver, metric, value in zip(
        *(bad[name] for name in ("log", "planner", "metric", "value")), strict=True
    ):
        known.setdefault((log, driver), {})[metric] = value
    by_log: dict[str, list[Discrimination]] = {}
    for (log, driver), log_values in known.items():
        if log in labels:
            by_log.setdefault(log, []).append(
                discrimination(driver, gates, labels[log], log_values)
            )
    drives = table.loc[table["mode"] == Mode.CLOSED.value, ["log", "planner"]].drop_duplicates()
    closed, name = Mode.CLOSED.value, evidence.discrimination.name
    values: Values = {
        (log, planner, closed, f"{name}.{result.driver}"): (
            float(result.breaks is not None),
            result.text,
        )
        for log, planner in drives.itertuples(index=False)
        for result in by_log.get(log, ())
    }
    return fill_rows(table, values)
