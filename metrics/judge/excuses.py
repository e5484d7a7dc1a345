"""Excuses: when a value out of bounds is no evidence against the planner.

`EXCUSES` is the table of them: the first that concerns the gate and has a reason applies. A drive
in which the planner failed is never excused.

Same event: a reference drive breaks the same bound, the values are about the same road user or
object, at most `SAME_S` apart, and the planner's is not clearly worse (`WORSE`). In comfort an
event without a road user excuses nothing; but if the careful driver collides with the road user,
how far out of bounds does not matter, since a planner that avoids the collision brakes for longer,
unless the recorded driver stays within the bound. A collision is not excused where the careful
driver of UN R157 collides more slowly by more than `SLOWER_MPS`. The careful driver, who only
brakes, excuses nothing that the route follower avoids. In the first `SAME_S` of a drive the route
follower excuses, too, since there the log's start state breaks the bound.

The yardsticks of a `reachable` gate are the recorded driver, and the route follower if its drive
passes the gates on safety and rules; either only where the traffic was recorded for most of its
drive. So a verdict does not depend on the other planners of the run. The follower is asked for
drives that `needs_follower` names. The careful driver is no yardstick, because it ignores traffic
rules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite

from replan.metrics.judge.cases import (
    CAREFUL,
    DRIVER,
    FOLLOWER,
    IMPACT,
    NO_COLLISION,
    NO_FALLBACK,
    NO_PHANTOM,
    REFERENCES,
    REPLAY_CONTACT,
    TOO_NEAR,
    GateCase,
    group_of,
)
from replan.metrics.judge.gates import Gate, unit_of
from replan.metrics.progress import LEAST_COVERED

SAME_S, SLOWER_MPS, WORSE = 2.0, 1.0, 1.5
"""A value at another time (`CC_TTC_S` of the careful driver), or a clearly harder impact, is
another event. A value that is more than `WORSE` times as far out of bounds as the reference drive's
is not explained by the same event."""
COVERED, GOAL_ROUTE = Gate("covered.final", min=LEAST_COVERED), Gate("goal_route.final", min=1.0)
TRAFFIC = "evidence.traffic.share"


def excuse(case: GateCase) -> str:
    """Return why a value out of bounds is no evidence against the planner.

    Empty if it is evidence.
    """
    if case.crashed:
        return ""
    concerned = (excuse for excuse in EXCUSES if excuse.concerns(case.gate))
    return next(filter(None, (excuse.reason(case, excuse.by) for excuse in concerned)), "")


def _no_route_to_goal(case: GateCase, by: tuple[str, ...]) -> str:
    row = case.row(GOAL_ROUTE.metric)
    return row.reason if row.breaks(GOAL_ROUTE) else ""


def _covers_little(case: GateCase, by: tuple[str, ...]) -> str:
    row = case.row(COVERED.metric)
    return row.reason if row.breaks(COVERED) else ""


def _no_yardstick(case: GateCase, by: tuple[str, ...]) -> str:
    if any(_is_yardstick(case, planner) for planner in by):
        return ""
    names = " nor ".join(REFERENCES[planner] for planner in by)
    return f"no yardstick stays within it: neither {names}"


def _is_yardstick(case: GateCase, planner: str) -> bool:
    """Return whether a reference drive stays within the bound, by law and with recorded traffic."""
    rules = () if planner == DRIVER else case.drives.lawful
    for rule in rules:
        value = case.reference(planner, rule.metric).value
        asked = rule.mode in (None, case.mode) and isfinite(value)
        if asked and rule.margin(value) < 0.0:
            return False
    traffic = case.reference(planner, TRAFFIC)
    recorded = not traffic.known or traffic.value >= case.gate.min_evidence
    row = case.reference(planner, case.gate.metric)
    return recorded and row.known and case.gate.margin(row.value) >= 0.0


def _replay_ran_into_ego(case: GateCase, by: tuple[str, ...]) -> str:
    contact = case.row(REPLAY_CONTACT)
    concerned = group_of(case.gate) == "progress" or case.judged.about == contact.about
    if not concerned or not contact.known or contact.value <= 0.0:
        return ""
    return f"the replay ran into the ego ({contact.reason})"


def _references_come_too_near(case: GateCase, by: tuple[str, ...]) -> str:
    rows = [case.reference(planner, TOO_NEAR.metric) for planner in by]
    time_s = case.judged.time_s
    if not all(row.breaks(TOO_NEAR) and abs(row.time_s - time_s) <= SAME_S for row in rows):
        return ""
    names = " and ".join(REFERENCES[planner] for planner in by)
    return f"{names} break {TOO_NEAR} then, too ({rows[0].reason})"


def _careful_driver_collides(case: GateCase, by: tuple[str, ...]) -> str:
    """With the road user that the value is about, unless the recorded driver keeps the bound."""
    row, driver = case.judged, case.reference(DRIVER, case.gate.metric)
    if not row.about or (driver.known and not driver.breaks(case.gate)):
        return ""
    for planner in by:
        collision = case.reference(planner, NO_COLLISION.metric)
        same = collision.about == row.about and abs(row.time_s - collision.time_s) <= SAME_S
        if collision.breaks(NO_COLLISION) and same:
            return f"{REFERENCES[planner]} collides ({collision.reason})"
    return ""


def _reference_breaks_it_too(case: GateCase, by: tuple[str, ...]) -> str:
    """In the same event (module docstring)."""
    planners = (*by, FOLLOWER) if case.judged.time_s <= SAME_S else by
    return next(filter(None, (_breaks_it_too(case, planner) for planner in planners)), "")


def _breaks_it_too(case: GateCase, planner: str) -> str:
    gate, row = case.gate, case.judged
    reference = case.reference(planner, gate.metric)
    if not reference.breaks(gate) or (planner != DRIVER and _could_do_better(case)):
        return ""
    same = row.about == reference.about and abs(row.time_s - reference.time_s) <= SAME_S
    worse = gate.margin(row.value) < WORSE * gate.margin(reference.value)
    nameless = group_of(gate) == "comfort" and not row.about
    if not same or worse or nameless:
        return ""
    about = f" ({reference.reason})" if reference.reason else ""
    value = f"{reference.value:.4g}{unit_of(reference.unit)}"
    return f"{REFERENCES[planner]} breaks {gate} too: {value}{about}"


def _could_do_better(case: GateCase) -> bool:
    """Return whether the planner hits harder than the careful driver, or in safety the follower
    keeps the bound.
    """
    impact, careful = case.row(IMPACT), case.reference(CAREFUL, IMPACT)
    if impact.known and not (careful.known and impact.value <= careful.value + SLOWER_MPS):
        return True
    follower = case.reference(FOLLOWER, case.gate.metric)
    return group_of(case.gate) == "safety" and follower.known and not follower.breaks(case.gate)


def _collision_is_excused(case: GateCase, by: tuple[str, ...]) -> str:
    collision = case.row(NO_COLLISION.metric)
    if not collision.breaks(NO_COLLISION):
        return ""
    return _reference_breaks_it_too(replace(case, gate=NO_COLLISION), by)


def _phantom_stops_follower(case: GateCase, by: tuple[str, ...]) -> str:
    phantom, collision = case.row(NO_PHANTOM.metric), case.row(NO_COLLISION.metric)
    stopped = all(case.reference(planner, case.gate.metric).breaks(case.gate) for planner in by)
    if collision.breaks(NO_COLLISION) or not phantom.breaks(NO_PHANTOM) or not stopped:
        return ""
    return f"a phantom of the log ({phantom.reason}) also stops the route follower"


@dataclass(frozen=True, slots=True)
class Excuse:
    """A condition under which a value out of bounds is no evidence.

    Attributes:
        name: The condition, in words.
        reason: The test of a case: returns the reason, empty if the condition does not hold.
        groups: Groups of metrics whose gates it excuses; empty: all.
        metric: The only metric whose gates it excuses; empty: all.
        reachable: It excuses only gates that are `reachable`.
        by: The reference drives that excuse.
    """

    name: str
    reason: Callable[[GateCase, tuple[str, ...]], str]
    groups: tuple[str, ...] = ()
    metric: str = ""
    reachable: bool = False
    by: tuple[str, ...] = ()

    def concerns(self, gate: Gate) -> bool:
        """Return whether it may excuse the value of a gate."""
        if self.groups and group_of(gate) not in self.groups:
            return False
        return self.metric in ("", gate.metric) and (gate.reachable or not self.reachable)


EXCUSES = (
    Excuse("no lanes lead to the goal", _no_route_to_goal, reachable=True),
    Excuse("the drive ended at its goal after almost nothing", _covers_little, ("progress",)),
    Excuse("no yardstick keeps it", _no_yardstick, reachable=True, by=(DRIVER, FOLLOWER)),
    Excuse("a replayed road user drove into the ego", _replay_ran_into_ego, ("safety", "progress")),
    Excuse(
        "the references come too near to a road user then",
        _references_come_too_near,
        metric=NO_FALLBACK.metric,
        by=(CAREFUL, FOLLOWER),
    ),
    Excuse("the careful driver collides", _careful_driver_collides, ("comfort",), by=(CAREFUL,)),
    Excuse("same event", _reference_breaks_it_too, ("safety",), by=(DRIVER, CAREFUL)),
    Excuse("same event", _reference_breaks_it_too, ("rules",), by=(DRIVER,)),
    Excuse("same event", _reference_breaks_it_too, ("comfort",), by=(CAREFUL,)),
    Excuse(
        "the collision that ended the drive is excused",
        _collision_is_excused,
        ("progress",),
        by=(DRIVER, CAREFUL),
    ),
    Excuse("a phantom stops the follower", _phantom_stops_follower, ("progress",), by=(FOLLOWER,)),
)
"""In order."""
