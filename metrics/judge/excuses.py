"""When a value is no evidence about a planner: excused, not reached by a yardstick, lacking
evidence, or marginal.

A value out of bounds is excused by a reference drive of `EXCUSED` that breaks the same bound in the
same event: the values are about the same road user or object, at most `SAME_S` apart, and the
planner's is not clearly worse (`WORSE`). In comfort an event without a road user excuses nothing;
but if the careful driver collides with the road user, how far out of bounds does not matter, since
a planner that avoids the collision brakes for longer, unless the recorded driver stays within the
bound. A collision is not excused where the careful driver of UN R157 collides more slowly by more
than `SLOWER_MPS`. The careful driver, who only brakes, excuses nothing that the route follower
avoids. A fallback is excused where both come too near to a road user (`TOO_NEAR`) at that time. In
the first `SAME_S` of a drive the route follower excuses, too, since there the log's start state
breaks the bound. A replayed road user that drives into the ego (`replay_contact`) also excuses
progress, and safety values about that road user. Progress is also excused if the collision that
ended the drive is excused, or if a phantom of the log stops the route follower too. A drive in
which the planner failed is never excused.

The goal is not asked of a drive to which no lanes lead (`GOAL_ROUTE`), nor progress of a drive that
ended at its goal after almost nothing (`COVERED`).

The yardsticks of a `reachable` gate are the recorded driver, and the route follower if its drive
passes the gates on safety and rules; either only where the traffic was recorded for most of its
drive. So a verdict does not depend on the other planners of the run. The follower is asked for
drives that `needs_follower` names. The careful driver is no yardstick, because it ignores traffic
rules.

Marginal: could the outcome of a gate change if the road users of the log were sampled at another
rate? A sample is up to one interval d old when the next one arrives, and a speed from two samples
is as old as their midpoint, so values are late by (1) tau = 1.5 d. A value is marginal if it is no
farther from its bound than it can change in that time:
(2) times, s: tau; distances, m: a tau^2 / 2 with a = `HARD_MPS2`, as hard as cars brake.

A gate that allows no time beyond a bound depends on the extreme value: `ttc.time_below_950ms <= 0`
is marginal if `ttc.min` is near 0.95 s. A gate that allows some time depends on that time itself.
This is tested for metrics about other road users, and for comfort, because the braking of a planner
depends on when it sees them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite, nan
from types import MappingProxyType
from typing import NamedTuple

from replan.metrics import GROUPS, METRICS
from replan.metrics.judge.gates import Gate, unit_of
from replan.metrics.progress import LEAST_COVERED
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
FALLBACKS = "fallback.rate"
NO_PHANTOM = Gate("phantom.count", max=0.0)
CLEAN = (NO_COLLISION, TOO_NEAR, Gate(FALLBACKS, max=0.0), Gate("goal.final", min=1.0), NO_PHANTOM)
"""The follower is a reference of the drives that break one of these: it takes time, and others need
none.
"""
SAME_S, SLOWER_MPS, WORSE = 2.0, 1.0, 1.5
"""A value at another time (`CC_TTC_S` of the careful driver), or a clearly harder impact, is
another event. A value that is more than `WORSE` times as far out of bounds as the reference drive's
is not explained by the same event."""
COVERED, GOAL_ROUTE = Gate("covered.final", min=LEAST_COVERED), Gate("goal_route.final", min=1.0)
REPLAY_CONTACT, IMPACT, PHANTOMS = (
    "replay_contact.final",
    "collision_severity.impact_speed.max",
    NO_PHANTOM.metric,
)
TRAFFIC = "evidence.traffic.share"
EXCUSED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"safety": (DRIVER, CAREFUL), "rules": (DRIVER,), "comfort": (CAREFUL,)}
)
"""The reference drives that may excuse a value, by group of metrics."""
LAWFUL = ("safety", "rules")  # Groups of the gates that a yardstick must pass
GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}

INTERVAL = "agent_interval.final"
HARD_MPS2 = 8.0
AGE = 1.5
OF_OTHERS = (
    "gap_kept",
    "gap_kept_vulnerable",
    "ttc",
    "ttc_vulnerable",
    "thw",
    "priority_gap",
    "priority_gap_assumed",
    "yielding",
)
_MARKED = frozenset({*OF_OTHERS, *(metric.name for metric in GROUPS["comfort"])})


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

    def row(self, metric: str) -> MetricRow:
        """Return a row of the drive; `NOTHING` if the table has none."""
        return self.drives.rows[self.planner, self.mode].get(self.log, {}).get(metric, NOTHING)

    def reference(self, planner: str, metric: str) -> MetricRow:
        """Return a row of a reference drive of the log; `NOTHING` if the table has none, or it is
        not asked for.
        """
        if planner == FOLLOWER and not needs_follower(
            {gate.metric: self.value(gate.metric) for gate in CLEAN}
        ):
            return NOTHING
        return self.drives.rows.get((planner, REFERENCE), {}).get(self.log, {}).get(metric, NOTHING)

    def value(self, metric: str) -> float:
        """Return a value of the drive; NaN if it has none."""
        row = self.row(metric)
        return row.value if row.known else nan

    @property
    def crashed(self) -> str:
        """The reason why the planner failed in the drive; empty if it did not."""
        return self.drives.crashed.get((self.log, self.planner, self.mode), "")


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
    known = f"evidence about {gate.evidence} covers {100.0 * share.value:.3g} % of the drive"
    return f"{known}, less than {100.0 * gate.min_evidence:g} %" + (
        f" ({share.reason})" if share.reason else ""
    )


def excuse(case: GateCase) -> str:
    """Return why a value out of bounds is no evidence against the planner.

    Empty if it is evidence.
    """
    gate, group, row = case.gate, group_of(case.gate), case.row(case.gate.metric)
    if case.crashed:
        return ""
    for asked, concerns in ((GOAL_ROUTE, gate.reachable), (COVERED, group == "progress")):
        found = case.row(asked.metric)
        if concerns and found.known and asked.margin(found.value) < 0.0:
            return found.reason
    if gate.reachable and not _any_yardstick_holds(case):
        return "no yardstick stays within it: neither the recorded driver nor the route follower"
    contact, crash, phantom = (
        case.row(name) for name in (REPLAY_CONTACT, NO_COLLISION.metric, PHANTOMS)
    )
    concerned = group == "progress" or (group == "safety" and row.about == contact.about)
    if concerned and contact.known and contact.value > 0.0:
        return f"the replay ran into the ego ({contact.reason})"
    if gate.metric == FALLBACKS:
        return _excuse_fallback(case)
    if group in EXCUSED:
        return _excuse_by_reference(gate, case)
    if group != "progress":
        return ""
    if crash.known and NO_COLLISION.margin(crash.value) < 0.0:
        return _excuse_by_reference(NO_COLLISION, case)
    follower = case.reference(FOLLOWER, gate.metric)
    if (
        follower.known
        and gate.margin(follower.value) < 0.0
        and phantom.known
        and phantom.value > 0.0
    ):
        return f"a phantom of the log ({phantom.reason}) also stops the route follower"
    return ""


def _any_yardstick_holds(case: GateCase) -> bool:
    """Return whether a yardstick stays within the bound in this log (module docstring)."""
    for planner in (DRIVER, FOLLOWER):
        rules = () if planner == DRIVER else case.drives.lawful
        values = {
            rule: case.reference(planner, rule.metric).value
            for rule in rules
            if rule.mode in (None, case.mode)
        }
        lawful = all(rule.margin(value) >= 0.0 for rule, value in values.items() if isfinite(value))
        traffic, reached = (
            case.reference(planner, TRAFFIC),
            case.reference(planner, case.gate.metric),
        )
        seen = not traffic.known or traffic.value >= case.gate.min_evidence
        if lawful and seen and reached.known and case.gate.margin(reached.value) >= 0.0:
            return True
    return False


def _excuse_by_reference(gate: Gate, case: GateCase) -> str:
    """Return which reference drive breaks the bound in the same event (module docstring), as text;
    empty: none.
    """
    row, group = case.row(gate.metric), group_of(gate)
    if group == "comfort" and (met := _met_by_careful(gate, case)):
        return met
    impact, careful = case.row(IMPACT), case.reference(CAREFUL, IMPACT)
    harder = impact.known and not (careful.known and impact.value <= careful.value + SLOWER_MPS)
    follower = case.reference(FOLLOWER, gate.metric)
    avoided = group == "safety" and follower.known and gate.margin(follower.value) >= 0.0
    for planner in (*EXCUSED[group], *((FOLLOWER,) if row.time_s <= SAME_S else ())):
        found = case.reference(planner, gate.metric)
        if (
            not found.known
            or gate.margin(found.value) >= 0.0
            or (planner != DRIVER and (harder or avoided))
        ):
            continue
        same = row.about == found.about and abs(row.time_s - found.time_s) <= SAME_S
        if (
            same
            and (row.about or group != "comfort")
            and gate.margin(row.value) >= WORSE * gate.margin(found.value)
        ):
            about = f" ({found.reason})" if found.reason else ""
            return (
                f"{REFERENCES[planner]} breaks {gate} too: "
                f"{found.value:.4g}{unit_of(found.unit)}{about}"
            )
    return ""


def _met_by_careful(gate: Gate, case: GateCase) -> str:
    """Return the collision of the careful driver with the road user that a comfort value is about;
    empty: none.
    """
    row, met, driver = (
        case.row(gate.metric),
        case.reference(CAREFUL, NO_COLLISION.metric),
        case.reference(DRIVER, gate.metric),
    )
    collides = met.known and NO_COLLISION.margin(met.value) < 0.0 and met.about == row.about
    same = collides and abs(row.time_s - met.time_s) <= SAME_S
    smooth = driver.known and gate.margin(driver.value) >= 0.0
    return (
        f"{REFERENCES[CAREFUL]} collides ({met.reason})"
        if same and row.about and not smooth
        else ""
    )


def _excuse_fallback(case: GateCase) -> str:
    """Return the reason if the careful driver and the route follower come too near to a road user
    at that time.
    """
    when = case.row(FALLBACKS).time_s
    rows = [case.reference(planner, TOO_NEAR.metric) for planner in (CAREFUL, FOLLOWER)]
    if all(
        row.known and TOO_NEAR.margin(row.value) < 0.0 and abs(row.time_s - when) <= SAME_S
        for row in rows
    ):
        return (
            f"{REFERENCES[CAREFUL]} and {REFERENCES[FOLLOWER]} break {TOO_NEAR} then, too "
            f"({rows[0].reason})"
        )
    return ""


def marginal(gate: Gate, value_of: Callable[[str], float]) -> str:
    """Return why a gate's outcome on a drive is marginal: "marginal: at 5 Hz ..."; empty if it is
    not.

    `value_of` returns the drive's value by its name in the table ("ttc.min"); NaN if there is none.
    """
    name, _, reduced = gate.metric.rpartition(".")
    metric, interval = METRICS.get(name.partition(".")[0]), value_of(INTERVAL)
    if metric is None or metric.name not in _MARKED or not interval > 0.0:
        return ""
    reduction = next(one for one in metric.reductions if one.name == reduced)
    value, unit = value_of(gate.metric), reduction.unit or metric.unit
    bound = gate.max if gate.min is None else gate.min
    if bound == 0.0 and reduction.bounds is not None and metric.name in OF_OTHERS:
        value, unit, bound = value_of(f"{name}.min"), metric.unit, reduction.bounds[0]
    # (1), (2)
    near = {"s": AGE * interval, "m": 0.5 * HARD_MPS2 * (AGE * interval) ** 2}.get(unit, 0.0)
    if bound is None or near == 0.0 or value == 0.0 or not abs(value - bound) <= near:
        return ""
    found = f"the bound of {bound:g} {unit} is within {near:.2g} {unit} of {value:.3g} {unit}"
    return f"marginal: at {1.0 / interval:.3g} Hz {found}"
