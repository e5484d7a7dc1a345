"""What a gate is judged by: the rows of a drive, those of the reference drives of its log, and the
evidence that it needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from typing import NamedTuple

from replan.metrics import GROUPS
from replan.metrics.judge.gates import Gate
from replan.metrics.time_to_collision import CLOSE_S

REFERENCE = "reference"  # Mode of the rows of reference drives
DRIVER, CAREFUL, FOLLOWER = "driver", "careful", "follower"
REFERENCES = {
    DRIVER: "the recorded driver",
    CAREFUL: "the careful driver",
    FOLLOWER: "the route follower",
}
"""Planner names of these rows: the log's own driver; the careful driver of UN R157, which only
brakes and ignores traffic rules; and the route follower, which steers and obeys the rules
(`replan.replay.loop.reference_drives`)."""
# A collision ends a drive: if it is excused, so is progress
NO_COLLISION = Gate("collision_at_fault.count", max=0.0)
TOO_NEAR = Gate("ttc.min", min=CLOSE_S)
NO_FALLBACK = Gate("fallback.rate", max=0.0)
NO_PHANTOM = Gate("phantom.count", max=0.0)
CLEAN = (NO_COLLISION, TOO_NEAR, NO_FALLBACK, Gate("goal.final", min=1.0), NO_PHANTOM)
"""The follower is a reference of the drives that break one of these: it takes time, and others need
none.
"""
REPLAY_CONTACT, IMPACT = "replay_contact.final", "collision_severity.impact_speed.max"
LAWFUL = ("safety", "rules")  # Groups of the gates that a yardstick must pass
GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}


class MetricRow(NamedTuple):
    """A row of the table; `about`: the road user or object that its value is about, with the full
    id ("car 12").
    """

    value: float
    available: bool
    reason: str
    unit: str
    time_s: float
    about: str = ""

    @property
    def known(self) -> bool:
        """Whether there is a value."""
        return self.available and isfinite(self.value)

    def breaks(self, gate: Gate) -> bool:
        """Whether there is a value, and it is out of a gate's bounds."""
        return self.known and gate.margin(self.value) < 0.0


NOTHING = MetricRow(nan, False, "not measured", "", nan)


@dataclass(frozen=True, eq=False, slots=True)
class DrivesTable:
    """The table of a run: rows by (planner, mode), log and metric.

    Its oracles, crashed drives and `LAWFUL` gates.
    """

    rows: Mapping[tuple[str, str], Mapping[str, Mapping[str, MetricRow]]]
    oracles: frozenset[str]
    crashed: Mapping[tuple[str, str, str], str]
    lawful: tuple[Gate, ...]


@dataclass(frozen=True, eq=False, slots=True)
class GateCase:
    """A gate, the judged drive (planner, mode and log), and all drives of the run."""

    gate: Gate
    log: str
    planner: str
    mode: str
    drives: DrivesTable

    @property
    def judged(self) -> MetricRow:
        """The row of the drive that the gate judges."""
        return self.row(self.gate.metric)

    @property
    def crashed(self) -> str:
        """The reason why the planner failed in the drive; empty if it did not."""
        return self.drives.crashed.get((self.log, self.planner, self.mode), "")

    def row(self, metric: str) -> MetricRow:
        """Return a row of the drive; `NOTHING` if the table has none."""
        return self.drives.rows[self.planner, self.mode].get(self.log, {}).get(metric, NOTHING)

    def value(self, metric: str) -> float:
        """Return a value of the drive; NaN if it has none."""
        row = self.row(metric)
        return row.value if row.known else nan

    def reference(self, planner: str, metric: str) -> MetricRow:
        """Return a row of a reference drive of the log; `NOTHING` if the table has none, or it is
        not asked for.
        """
        if planner == FOLLOWER and not needs_follower(
            {gate.metric: self.value(gate.metric) for gate in CLEAN}
        ):
            return NOTHING
        return self.drives.rows.get((planner, REFERENCE), {}).get(self.log, {}).get(metric, NOTHING)


def needs_follower(values: Mapping[str, float]) -> bool:
    """Return whether the route follower is a reference of a drive with these values; NaN where it
    has none.
    """
    return any(gate.margin(values.get(gate.metric, nan)) < 0.0 for gate in CLEAN)


def group_of(gate: Gate) -> str:
    """Return the group of a gate's metric."""
    return GROUP.get(gate.metric.partition(".")[0], "")


def lacking_evidence(case: GateCase) -> str:
    """Return why a value within the bounds is no pass (too little evidence).

    Empty if there is enough evidence.
    """
    gate, share = case.gate, case.row(f"evidence.{case.gate.evidence}.share")
    if not share.known or share.value >= gate.min_evidence:
        return ""
    covered = f"evidence about {gate.evidence} covers {100.0 * share.value:.3g} % of the drive"
    reason = f" ({share.reason})" if share.reason else ""
    return f"{covered}, less than {100.0 * gate.min_evidence:g} %{reason}"
