"""Describes a failing drive in words that are made only of its numbers.

F is the failing drive, P the one that passes with the change that points to the cause. Both are
compared up to t_x, when the first gate fails, or the end of the shorter one.

(1) t_a        = begin of the last stretch up to t_x in which P is slower than F by more
        than APART_MPS
(2) b(D, t)
        = begin of the first braking of D (a <= BRAKES_MPS2 while it moves) that has not ended at t
(3) t_P, t_F   = b(P, t_a), b(F, t_P);
        hardest_F and hardest_P are the least accelerations from t_P to t_x
(4) late       = t_F - t_P >= LATE_S; no t_F at all: F does not brake.
        Asked where F is APART_M ahead of P at t_x
(5) left       = how far P's path is to the left of F's place at t_x; asked where (4) is not
(6) predicted  = way of the most probable future of the road user in F's frame at t_P,
        else AHEAD_S before t_x, up to
                 the last predicted time that their track reaches, at most AHEAD_S;
                     moved = as they move in F
(7) lost       = time lost to P ((e) of `replan.metrics.route_gain`); without P,
        to the recorded driver, else to the steady speed that reaches the goal when its time ends:
        to the first cause for which the plan is not as fast. What is made up is taken off the last
        one
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np

from replan.core.arrays import FloatArray
from replan.explain.causes import KEEP, Account, CauseKind
from replan.explain.explanation import lane_options, taken_option
from replan.explain.sentences import NAMES
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.logs.trace import EndReason, Trace

BRAKES_MPS2, WEAKER_MPS2, MOVES_MPS = -0.5, 0.5, 0.1
APART_MPS, APART_M, LATE_S = 0.5, 0.3, 0.2
AHEAD_S, SAME_S = 3.0, 1e-6
MISSED_M = 1.0
"""A road user shown or predicted this far from their true place is treated as shown or predicted
elsewhere.
"""
STAYS_M = 0.5
"""A road user that moves less than this within `AHEAD_S` stands."""
FORCED_MPS2 = 3.0
"""A road user who brakes harder than this for the ego is forced to (UN R79, 5.6.4.7: a critical
lane change).
"""
REACTIONS = ("forced_braking", "braked_behind")
"""Metrics of what road users behind the ego do because of it."""
SOMEONE = "a road user"
BRAKES = ("does not brake", "brakes late", "brakes too weakly")
OUTCOMES = {
    "collision_at_fault": "collides with {}",
    "collision": "collides with {}",
    "gap_kept": "comes too near to {}",
    "gap_kept_vulnerable": "comes too near to {}",
    "passing_room": "passes {} too closely",
    "ttc": "comes close to a collision with {}",
    "ttc_vulnerable": "comes close to a collision with {}",
    "thw": "follows {} too closely",
    "forced_braking": "forces {} to brake",
    "braked_behind": "brakes for nothing before {}",
    "priority_gap": "leaves too little time to {}",
    "yielding": "crosses too shortly before {}",
    "crosswalk": "does not let {} go first at a crosswalk",
    "completed": "does not drive to the end",
    "goal": "does not reach the goal",
    "route_progress": "makes too little progress",
    "off_road": "leaves the road",
    "wrong_way": "drives against the direction of a lane",
    "lane_line": "straddles the line of its lane",
    "speed_excess": "exceeds the speed limit",
    "assumed_limit_excess": "exceeds the assumed speed limit",
    "red_light": "runs a red light",
    "yellow_light": "runs a yellow light at which it could have stopped",
    "stop_sign": "does not stop at a stop sign",
    "needless_braking": "brakes where nothing ahead calls for it",
    "needless_standing": "stands although the road is free",
    "needless_steering": "weaves where nothing calls for it",
    "needless_lane_change": "changes lanes where nothing calls for it",
    "lane_offset": "keeps beside the middle of its lane",
    "speed_swing": "swings its speed where nothing calls for it",
    "lon_accel": "accelerates or brakes too hard",
    "lat_accel": "takes a curve too fast",
    "curve_accel": "takes a curve too fast",
    "lon_jerk_nuplan": "accelerates or brakes too abruptly",
    "lat_jerk_r79": "steers too abruptly",
    "pedals_together": "uses both pedals at once",
    "tracking_lateral": "leaves its planned path",
    "tracking_speed": "does not keep its planned speed",
    "fallback": "lives on fallback plans",
    "plan_refused": "makes plans that cannot be driven",
    "plan_corrected": "makes plans that contradict themselves",
    "plan_complete": "makes plans that are too short",
    "plan_collision": "plans to collide with {}",
    "plan_off_road": "plans to leave the road",
    "plan_change": "changes its plans too much",
    "plan_change_lateral": "changes its plans too much to the side",
    "plan_kept": "does not do what it planned",
    "plan_kept_lateral": "does not drive where it planned",
    "plan_score": "makes plans of a low score",
}
"""The meaning of a broken gate, by the first part of its metric; {} is the road user."""


@dataclass(frozen=True)
class DriveDifference:
    """The failing drive compared with the one that passes: equations (1) to (5); None if a value
    does not exist.

    Attributes:
        ahead_m: Distance of F ahead of P at t_x, m.
        left_m: (5), m.
        brakes_s: t_F; `would_brake_s` is t_P.
        hardest_mps2: Hardest braking of F; `would_hardest_mps2` that of P.
    """

    ahead_m: float = 0.0
    left_m: float = 0.0
    brakes_s: float | None = None
    would_brake_s: float | None = None
    hardest_mps2: float = 0.0
    would_hardest_mps2: float = 0.0

    @classmethod
    def of(cls, failing: Trace, passing: Trace, until: float) -> DriveDifference:
        """Compare two drives of one log up to a time (inf: to the end of the shorter)."""
        f, p = failing.ego, passing.ego
        last = min(until, float(f.t[-1]), float(p.t[-1]))
        at = f.at(last)
        along, across = _relative(at, p.x, p.y)
        near = int(np.argmin(np.hypot(along, across)))
        left = float(across[near]) if abs(along[near]) <= APART_M else 0.0  # (5)
        then = p.at(last)
        ahead = -float(_relative(at, then.x, then.y)[0])
        t = f.t[f.t <= last + SAME_S]
        slower = np.flatnonzero(f.v[: len(t)] - np.interp(t, p.t, p.v) > APART_MPS)
        would = does = None
        hardest = [0.0, 0.0]
        if len(slower):
            gaps = np.flatnonzero(np.diff(slower) > 1)
            since = float(t[slower[gaps[-1] + 1 if len(gaps) else 0]])  # (1)
            would = _braking(p, since, last)
        if would is not None:
            does = _braking(f, would, inf)  # (3)
            hardest = [
                float(d.a[(d.t >= would) & (d.t <= last + SAME_S)].min(initial=0.0)) for d in (f, p)
            ]
        numbers = (ahead, left, does, would, *hardest)
        return cls(*(None if one is None else round(one, 6) for one in numbers))  # type: ignore[arg-type]

    @property
    def behaviour(self) -> tuple[str, str]:
        """The difference of F from P in words, and the numbers; empty if nothing is known."""
        does, would = self.brakes_s, self.would_brake_s
        if would is not None and self.ahead_m > APART_M:
            if does is None:
                return BRAKES[0], f"does not brake, instead of braking at {would:.1f} s"
            if does - would >= LATE_S:  # (4)
                return BRAKES[1], f"brakes at {does:.1f} s instead of {would:.1f} s"
            if self.hardest_mps2 - self.would_hardest_mps2 > WEAKER_MPS2:
                hardest, needed = -self.hardest_mps2, -self.would_hardest_mps2
                return BRAKES[2], f"brakes with {hardest:.1f} m/s² instead of {needed:.1f} m/s²"
        if abs(self.left_m) > APART_M:  # (5)
            side = "right" if self.left_m > 0.0 else "left"
            return (
                f"keeps too far {side}",
                f"drives {abs(self.left_m):.1f} m to the {side} of where it passes",
            )
        return "", ""


def _relative(
    ego: EgoState, x: float | FloatArray, y: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places in the frame of an ego: ahead and to the left, m."""
    dx, dy, c, sn = x - ego.x, y - ego.y, np.cos(ego.yaw), np.sin(ego.yaw)
    return np.asarray(dx * c + dy * sn), np.asarray(dy * c - dx * sn)


def _braking(ego: Trajectory, since: float, until: float) -> float | None:
    """The time (2) of the first braking, up to a time."""
    brakes = (ego.a <= BRAKES_MPS2) & (ego.v > MOVES_MPS)
    later = np.flatnonzero(brakes & (ego.t >= since - SAME_S) & (ego.t <= until + SAME_S))
    if not len(later):
        return None
    before = np.flatnonzero(~brakes[: later[0]])
    return float(ego.t[before[-1] + 1 if len(before) else 0])


@dataclass(frozen=True)
class Foresight:
    """The perception and the prediction (6) of a road user; None if a value is unknown.

    Attributes:
        is_seen: Whether they are in the frame.
        seen_off_m: Distance of the perceived from the true position, m.
        ahead_s: Length of the prediction, s.
        predicted_m: Distance that they are predicted to move, m.
        moved_m: Distance that they move, m.
        off_m: Distance between the predicted and the true position, m.
    """

    at_s: float | None = None
    is_seen: bool = True
    seen_off_m: float = 0.0
    ahead_s: float = 0.0
    predicted_m: float = 0.0
    moved_m: float = 0.0
    off_m: float = 0.0

    @classmethod
    def of(cls, trace: Trace, who: str, at: float) -> Foresight:
        """The perception and prediction of a road user of the trace in the frame at a time."""
        frame = next((one for one in reversed(trace.frames) if one.t <= at + SAME_S), None)
        if frame is None or who not in trace.agents.ids or frame.predictions is None:
            return cls()
        now = trace.agents.truth(frame.t)
        if who not in now.ids:
            return cls()
        if who not in frame.agents:
            return cls(frame.t, False)
        some, track = frame.predictions, trace.agents.only([who])
        row = max(
            np.flatnonzero(some.agent == frame.agents.index(who)), key=lambda i: some.probability[i]
        )
        end = np.inf if track.static[0] else float(track.t[-1])
        known = np.flatnonzero(
            some.t <= min(frame.t + AHEAD_S, float(trace.ego.t[-1]), end) + SAME_S
        )
        then = track.truth(float(some.t[known[-1]]))
        i = now.ids.index(who)
        dx, dy = some.x[row, known[-1]] - some.x[row, 0], some.y[row, known[-1]] - some.y[row, 0]
        mx, my = then.x[0] - now.x[i], then.y[0] - now.y[i]
        numbers = (
            hypot(some.x[row, 0] - now.x[i], some.y[row, 0] - now.y[i]),
            some.t[known[-1]] - frame.t,
            hypot(dx, dy),
            hypot(mx, my),
            hypot(dx - mx, dy - my),
        )
        return cls(frame.t, True, *(round(float(one), 6) for one in numbers))

    @property
    def error(self) -> tuple[str, str]:
        """The error in words that follow a noun (" predicted to stand"), and the numbers.

        Empty if none is known.
        """
        if not self.is_seen:
            return " not seen", f"not seen at {self.at_s:.1f} s"
        if self.seen_off_m > MISSED_M:
            return (
                " seen elsewhere",
                f"seen {self.seen_off_m:.1f} m from where they are at {self.at_s:.1f} s",
            )
        if self.off_m <= MISSED_M:
            return "", ""
        moves = (
            f"predicted to move {self.predicted_m:.1f} m in {self.ahead_s:.1f} s, moves "
            f"{self.moved_m:.1f} m"
        )
        numbers = f"{moves}, {self.off_m:.1f} m from there"
        if self.predicted_m < STAYS_M:
            return " predicted to stand", numbers
        return (
            " predicted to move although they stand"
            if self.moved_m < STAYS_M
            else " predicted elsewhere",
            numbers,
        )


PROGRESS = ("goal", "route_progress")
"""Metrics of how far a drive gets."""
FEW_S, MISSED_STEPS = 0.05, 500
NOTHING = "nothing found in its way"


@dataclass(frozen=True)
class Wait:
    """The time that a drive loses to one cause (7).

    Attributes:
        who: The road user, stop line or other cause.
        seconds: In all, s.
        since_s: Its begin, s from the log's start.
    """

    who: str
    seconds: float
    since_s: float


def waits(found: Sequence[Account], lost: Sequence[float]) -> list[Wait]:
    """The time that is lost (7), by cause, from the accounts of plans and the time lost in each;
    the most first.
    """
    spent: dict[str, Wait] = {}
    last = ""
    for one, seconds in zip(found, lost, strict=True):
        cause = one.causes[0] if one.causes else None
        if seconds > 0.0 and cause is not None:
            last = (
                NOTHING
                if cause.kind is CauseKind.NONE
                else NAMES.get(cause.kind, cause.who) or cause.kind.value
            )
            spent.setdefault(last, Wait(last, 0.0, one.t))
        if last and (seconds < 0.0 or cause is not None):
            spent[last] = replace(
                spent[last], seconds=round(max(spent[last].seconds + seconds, 0.0), 6)
            )
    return sorted(
        (one for one in spent.values() if one.seconds >= FEW_S),
        key=lambda one: (-one.seconds, one.since_s),
    )


@dataclass(frozen=True)
class GoalMiss:
    """Where a drive comes nearest to its goal's place.

    Attributes:
        ahead_m: How far the nearest point of the place is ahead of the middle of the ego; `left_m`
            to its left.
        left_m: How far it is to the left.
        unmet: What is missed then: "place", "time", "speed", "heading".
    """

    at_s: float
    ahead_m: float
    left_m: float
    unmet: tuple[str, ...]

    @classmethod
    def of(cls, trace: Trace, scenario: Scenario) -> GoalMiss | None:
        """None if the goal is no place, or is reached."""
        goal, ego, middle = scenario.goal, trace.ego, scenario.vehicle.axle_to_center
        if goal is None or not goal.regions or trace.end is EndReason.GOAL:
            return None
        steps = np.unique(np.linspace(0, len(ego) - 1, MISSED_STEPS).round().astype(int)).tolist()
        x, y = ego.x + middle * np.cos(ego.yaw), ego.y + middle * np.sin(ego.yaw)
        to = [goal.nearest_place(float(x[k]), float(y[k])) for k in steps]
        i = min(range(len(steps)), key=lambda i: hypot(*to[i]))
        at, k = ego.state(steps[i]), steps[i]
        ahead, left = _relative(at, at.x + to[i][0], at.y + to[i][1])
        return cls(
            at.t,
            float(ahead),
            float(left),
            goal.unmet(at.t, float(x[k]), float(y[k]), at.yaw, at.v),
        )

    @property
    def behaviour(self) -> tuple[str, str]:
        """The miss in words, and the numbers."""
        if "place" not in self.unmet:
            missed = " and ".join(self.unmet)
            return (
                f"misses the {missed} of its goal",
                f"is at its goal's place at {self.at_s:.1f} s, not by {missed}",
            )
        if abs(self.ahead_m) >= abs(self.left_m):
            return "is too slow", f"is {self.ahead_m:.1f} m before its goal at {self.at_s:.1f} s"
        side, other = ("right", "left") if self.left_m > 0.0 else ("left", "right")
        return (
            f"keeps too far {side}",
            f"has its goal {abs(self.left_m):.1f} m to its {other} at {self.at_s:.1f} s",
        )


@dataclass(frozen=True)
class DriveFailure:
    """The failure of a drive.

    Attributes:
        gate: The first gate that it fails, of `metric`.
        who: Kind and short name of the road user that this is about: "pedestrian 17"; "" if there
            is none.
        lane: "left" or "right": the lane change that is under way then; "" if there is none.
        difference: The difference from the drive that passes.
        brakes_for: Whether its plan names the road user as a reason to slow down when it begins to
            brake.
        foresight: The perception and prediction of the road user.
        missed: Where it misses its goal, if the metric is how far it gets.
    """

    gate: str
    metric: str
    who: str = ""
    lane: str = ""
    difference: DriveDifference = DriveDifference()
    brakes_for: bool = False
    foresight: Foresight = Foresight()
    missed: GoalMiss | None = None

    @property
    def behaviour(self) -> tuple[str, str]:
        """The miss of the goal, else the difference from the drive that passes, in words, and the
        numbers.
        """
        return self.difference.behaviour if self.missed is None else self.missed.behaviour

    @property
    def kind(self) -> str:
        """The kind of the road user."""
        return self.who.partition(" ")[0]

    @property
    def details(self) -> str:
        """The road user by name, and the numbers."""
        who = ": ".join(filter(None, (self.who, self.foresight.error[1])))
        return "; ".join(filter(None, (who, self.behaviour[1])))

    @property
    def sentence(self) -> str:
        """The failure without names and numbers: the same sentence for all drives that fail in this
        way.
        """
        template = OUTCOMES.get(self.metric.partition(".")[0], f"fails {self.gate}")
        behaviour, them = self.behaviour[0], "it" if self.kind == "object" else "them"
        who = (
            f"{'an' if self.kind == 'object' else 'a'} {self.kind}{self.foresight.error[0]}"
            if self.who
            else SOMEONE
        )
        lane = f" while changing to the {self.lane} lane" if self.lane else ""
        if not behaviour:
            return f"{template.replace('{}', who)}{lane}"
        if self.who and (behaviour == BRAKES[0] or (self.brakes_for and behaviour in BRAKES)):
            return f"{behaviour} for {who}, and {template.replace('{}', them)}{lane}"
        return f"{behaviour}, and {template.replace('{}', who)}{lane}"


def lane_change(trace: Trace, at: float) -> str:
    """The lane change that a drive's plan makes at a time: "left", "right", or ""."""
    plan = next((frame.plan for frame in reversed(trace.frames) if frame.t <= at), None)
    name = KEEP if plan is None else taken_option(lane_options(plan))
    return name if name in ("left", "right") else ""
