"""A failing drive in numbers: its difference from a drive that passes, what was seen and predicted,
where it misses its goal, to what it loses time; and the sentence of these (`failure_words`).

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
(6) predicted  = distance in the most probable future of the road user in F's frame at t_P,
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
from replan.experiments.failure_words import BRAKING, OUTCOMES, ROAD_USER, DriveFault
from replan.explain.causes import KEEP, Account, CauseKind
from replan.explain.explanation import lane_options, taken_option
from replan.explain.sentences import NAMES
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.logs.trace import EndReason, PlannedFrame, Trace

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
PROGRESS = ("goal", "route_progress")
"""Metrics of how far a drive gets."""
FEW_S = 0.05
"""Less lost time than this is not listed."""
MISSED_STEPS = 500
"""Largest number of states at which a miss of the goal is measured."""
NO_CAUSE = "nothing found in its way"


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
        state = f.at(last)
        along, across = _relative(state, p.x, p.y)
        nearest = int(np.argmin(np.hypot(along, across)))
        left = float(across[nearest]) if abs(along[nearest]) <= APART_M else 0.0  # (5)
        other = p.at(last)
        ahead = -float(_relative(state, other.x, other.y)[0])
        brakes = would_brake = None
        hardest = [0.0, 0.0]
        since = _begin_of_lead(f, p, last)
        if since is not None:
            would_brake = _begin_of_braking(p, since, last)
        if would_brake is not None:
            brakes = _begin_of_braking(f, would_brake, inf)  # (3)
            hardest = [_hardest_braking(ego, would_brake, last) for ego in (f, p)]
        return cls(
            round(ahead, 6),
            round(left, 6),
            None if brakes is None else round(brakes, 6),
            None if would_brake is None else round(would_brake, 6),
            *(round(accel, 6) for accel in hardest),
        )

    @property
    def fault(self) -> DriveFault:
        """How F differs from P; NONE if nothing is known."""
        brakes, would_brake = self.brakes_s, self.would_brake_s
        if would_brake is not None and self.ahead_m > APART_M:
            if brakes is None:
                return DriveFault.DOES_NOT_BRAKE
            if brakes - would_brake >= LATE_S:  # (4)
                return DriveFault.BRAKES_LATE
            if self.hardest_mps2 - self.would_hardest_mps2 > WEAKER_MPS2:
                return DriveFault.BRAKES_WEAKLY
        if self.aside_m > APART_M:  # (5)
            return DriveFault.KEEPS_RIGHT if self.left_m > 0.0 else DriveFault.KEEPS_LEFT
        return DriveFault.NONE

    @property
    def braking_mps2(self) -> float:
        """How hard F brakes."""
        return -self.hardest_mps2

    @property
    def would_braking_mps2(self) -> float:
        """How hard P brakes."""
        return -self.would_hardest_mps2

    @property
    def aside_m(self) -> float:
        """How far F is beside P."""
        return abs(self.left_m)


def _begin_of_lead(failing: Trajectory, passing: Trajectory, last: float) -> float | None:
    """(1); None if the drive that passes is never slower."""
    t = failing.t[failing.t <= last + SAME_S]
    faster = failing.v[: len(t)] - np.interp(t, passing.t, passing.v) > APART_MPS
    steps = np.flatnonzero(faster)
    if not len(steps):
        return None
    gaps = np.flatnonzero(np.diff(steps) > 1)
    return float(t[steps[gaps[-1] + 1 if len(gaps) else 0]])


def _begin_of_braking(ego: Trajectory, since: float, until: float) -> float | None:
    """(2), up to a time."""
    brakes = (ego.a <= BRAKES_MPS2) & (ego.v > MOVES_MPS)
    later = np.flatnonzero(brakes & (ego.t >= since - SAME_S) & (ego.t <= until + SAME_S))
    if not len(later):
        return None
    before = np.flatnonzero(~brakes[: later[0]])
    return float(ego.t[before[-1] + 1 if len(before) else 0])


def _hardest_braking(ego: Trajectory, since: float, until: float) -> float:
    """The least acceleration between two times, at most 0, m/s2."""
    return float(ego.a[(ego.t >= since) & (ego.t <= until + SAME_S)].min(initial=0.0))


def _relative(
    ego: EgoState, x: float | FloatArray, y: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Places in the frame of an ego: ahead and to the left, m."""
    dx, dy = x - ego.x, y - ego.y
    cos, sin = np.cos(ego.yaw), np.sin(ego.yaw)
    return np.asarray(dx * cos + dy * sin), np.asarray(dy * cos - dx * sin)


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
    def of(cls, trace: Trace, agent: str, time: float) -> Foresight:
        """The perception and prediction of a road user of the trace in the frame at a time."""
        frame = _frame_at(trace, time + SAME_S)
        if frame is None or agent not in trace.agents.ids or frame.predictions is None:
            return cls()
        now = trace.agents.truth(frame.t)
        if agent not in now.ids:
            return cls()
        if agent not in frame.agents:
            return cls(frame.t, False)
        futures, track = frame.predictions, trace.agents.only([agent])
        rows = np.flatnonzero(futures.agent == frame.agents.index(agent))
        row = max(rows, key=lambda i: futures.probability[i])
        x, y = futures.x[row], futures.y[row]
        end = np.inf if track.static[0] else float(track.t[-1])
        until = min(frame.t + AHEAD_S, float(trace.ego.t[-1]), end)
        last = np.flatnonzero(futures.t <= until + SAME_S)[-1]
        later = track.truth(float(futures.t[last]))
        i = now.ids.index(agent)
        predicted_x, predicted_y = x[last] - x[0], y[last] - y[0]
        moved_x, moved_y = later.x[0] - now.x[i], later.y[0] - now.y[i]
        numbers = (
            hypot(x[0] - now.x[i], y[0] - now.y[i]),
            futures.t[last] - frame.t,
            hypot(predicted_x, predicted_y),
            hypot(moved_x, moved_y),
            hypot(predicted_x - moved_x, predicted_y - moved_y),
        )
        return cls(frame.t, True, *(round(float(number), 6) for number in numbers))

    @property
    def fault(self) -> DriveFault:
        """The error of the perception, else of the prediction; NONE if none is known."""
        if not self.is_seen:
            return DriveFault.NOT_SEEN
        if self.seen_off_m > MISSED_M:
            return DriveFault.SEEN_ELSEWHERE
        if self.off_m <= MISSED_M:
            return DriveFault.NONE
        if self.predicted_m < STAYS_M:
            return DriveFault.PREDICTED_TO_STAND
        return (
            DriveFault.PREDICTED_TO_MOVE
            if self.moved_m < STAYS_M
            else DriveFault.PREDICTED_ELSEWHERE
        )


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


def waits(accounts: Sequence[Account], lost: Sequence[float]) -> list[Wait]:
    """The time that is lost (7), by cause, from the accounts of plans and the time lost in each;
    the most first.
    """
    by_cause: dict[str, Wait] = {}
    last = ""
    for account, seconds in zip(accounts, lost, strict=True):
        cause = account.causes[0] if account.causes else None
        if seconds > 0.0 and cause is not None:
            last = NO_CAUSE
            if cause.kind is not CauseKind.NONE:
                last = NAMES.get(cause.kind, cause.who) or cause.kind.value
            by_cause.setdefault(last, Wait(last, 0.0, account.t))
        if last and (seconds < 0.0 or cause is not None):
            wait = by_cause[last]
            by_cause[last] = replace(wait, seconds=round(max(wait.seconds + seconds, 0.0), 6))
    long = [wait for wait in by_cause.values() if wait.seconds >= FEW_S]
    return sorted(long, key=lambda wait: (-wait.seconds, wait.since_s))


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
        vectors = [goal.nearest_place(float(x[k]), float(y[k])) for k in steps]
        nearest = min(range(len(steps)), key=lambda i: hypot(*vectors[i]))
        k, (dx, dy) = steps[nearest], vectors[nearest]
        state = ego.state(k)
        ahead, left = _relative(state, state.x + dx, state.y + dy)
        unmet = goal.unmet(state.t, float(x[k]), float(y[k]), state.yaw, state.v)
        return cls(state.t, float(ahead), float(left), unmet)

    @property
    def fault(self) -> DriveFault:
        """How the goal is missed."""
        if "place" not in self.unmet:
            return DriveFault.MISSES_CONDITION
        if abs(self.ahead_m) >= self.aside_m:
            return DriveFault.IS_SLOW
        return DriveFault.PASSES_RIGHT if self.left_m > 0.0 else DriveFault.PASSES_LEFT

    @property
    def conditions(self) -> str:
        """The conditions that are not met."""
        return " and ".join(self.unmet)

    @property
    def aside_m(self) -> float:
        """How far the ego is beside the place."""
        return abs(self.left_m)


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
    def kind(self) -> str:
        """The kind of the road user."""
        return self.who.partition(" ")[0]

    @property
    def details(self) -> str:
        """The road user by name, and the numbers."""
        behaviour = self.missed or self.difference
        foresight = self.foresight.fault.numbers(self.foresight)
        agent = ": ".join(filter(None, (self.who, foresight)))
        return "; ".join(filter(None, (agent, behaviour.fault.numbers(behaviour))))

    @property
    def sentence(self) -> str:
        """The failure without names and numbers: the same sentence for all drives that fail in this
        way.
        """
        agent, pronoun = ROAD_USER, "them"
        if self.who:
            article, pronoun = ("an", "it") if self.kind == "object" else ("a", "them")
            agent = f"{article} {self.kind}{self.foresight.fault.words(self.foresight)}"
        outcome = OUTCOMES.get(self.metric.partition(".")[0], f"fails {self.gate}")
        lane = f" while changing to the {self.lane} lane" if self.lane else ""
        behaviour = self.missed or self.difference
        fault, words = behaviour.fault, behaviour.fault.words(behaviour)
        if fault is DriveFault.NONE:
            return f"{outcome.replace('{}', agent)}{lane}"
        is_for_agent = fault is DriveFault.DOES_NOT_BRAKE or (self.brakes_for and fault in BRAKING)
        if self.who and is_for_agent:
            return f"{words} for {agent}, and {outcome.replace('{}', pronoun)}{lane}"
        return f"{words}, and {outcome.replace('{}', agent)}{lane}"


def lane_change(trace: Trace, time: float) -> str:
    """The lane change that a drive's plan makes at a time: "left", "right", or ""."""
    frame = _frame_at(trace, time)
    name = KEEP if frame is None else taken_option(lane_options(frame.plan))
    return name if name in ("left", "right") else ""


def _frame_at(trace: Trace, time: float) -> PlannedFrame | None:
    """The last frame that is not later than a time."""
    return next((frame for frame in reversed(trace.frames) if frame.t <= time), None)
