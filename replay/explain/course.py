"""What a plan does, and what it would do if it did not slow down.

With the time t from the frame and the arc length s along the plan's path, m, the plan is held from `t_b` on:

(1) t_b    = the first time at which the plan brakes by `BRAKES_MPS2` or more while it moves
(2) s_h(t) = s(t) for t <= t_b,  s(t_b) + v(t_b) (t - t_b) after it
(3) s_h(t) = t^2 START_MPS2 / 2 up to `START_TO_MPS`, then at that speed: of a plan that stands, as if it drove off now
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Plan

BRAKES_MPS2 = -0.3
"""A plan brakes where its acceleration is no greater: less is no discomfort (ISO 2631-1: below 0.315 m/s2)."""
STANDING_MPS = 0.1
START_MPS2, START_TO_MPS = 1.0, 5.0
"""How an ego that stands is taken to drive off (3)."""
STEP_S = 0.1
LOOK_S = 12.0
"""The plan is held for so long: half as long again as the others are predicted by default."""
EASE_MPS2 = 0.75
"""... and for as far as a stop with this deceleration takes, m/s2: half of what planners slow down with far ahead."""


class Action(Enum):
    """What a plan does within the next second."""

    STANDS = "stands"
    SLOWS = "slows down"
    SPEEDS = "speeds up"
    HOLDS = "holds its speed"


@dataclass(frozen=True, slots=True)
class Course:
    """What a plan does; times are s from its frame, NaN where there is none.

    Attributes:
        action: Within the next second.
        v_start: Speed now, m/s; `v_end` at the end of the plan, `v_least` the least one.
        v_end: See there.
        v_least: See there.
        duration: Of the plan, s.
        t_least: When it is slowest.
        a_least: The hardest braking, m/s2.
        t_hardest: When.
        t_brakes: (1).
    """

    action: Action
    v_start: float
    v_end: float
    v_least: float
    duration: float
    t_least: float
    a_least: float
    t_hardest: float
    t_brakes: float

    @property
    def is_asked(self) -> bool:
        """Whether there is something to explain: it brakes at some time as it drives forward, or stands."""
        return self.action is Action.STANDS or bool(np.isfinite(self.t_brakes))

    @classmethod
    def of(cls, plan: Plan) -> Course:
        """The course of a plan."""
        path = plan.trajectory
        t = path.t - path.t[0]
        ahead = min(1.0, float(t[-1]))
        then = float(np.interp(ahead, t, path.v))
        slowest, hardest = int(np.argmin(path.v)), int(np.argmin(path.a))
        braking = np.flatnonzero((path.a <= BRAKES_MPS2) & (path.v > STANDING_MPS))
        return cls(
            _action(float(path.v[0]), then, ahead), float(path.v[0]), float(path.v[-1]), float(path.v[slowest]),
            float(t[-1]), float(t[slowest]), float(path.a[hardest]), float(t[hardest]),
            float(t[braking[0]]) if len(braking) else np.nan,
        )  # fmt: skip


def _action(now: float, then: float, ahead: float) -> Action:
    """By the speeds now and then, m/s, whichever way."""
    now, then = abs(now), abs(then)
    if max(now, then) < STANDING_MPS:
        return Action.STANDS
    accel = (then - now) / max(ahead, 1e-9)
    return Action.SLOWS if accel < BRAKES_MPS2 else Action.SPEEDS if accel > -BRAKES_MPS2 else Action.HOLDS


@dataclass(frozen=True, eq=False, slots=True)
class Held:
    """A plan held (2), (3).

    Attributes:
        t: `(n,)` s from the frame, every `STEP_S` for `LOOK_S`; `s` `(n,)` arc length, m, the
            plan's up to `t_from`.
        s: See there.
        planned: `(n,)` the plan's own arc length, m, that of its end after it.
        t_from: t_b, s; 0 for a plan that stands.
        s_from: Arc length there, m.
        v: The speed that is held, m/s; of a plan that stands the one that it would drive off to.
        stands: Whether it is (3).
    """

    t: FloatArray
    s: FloatArray
    planned: FloatArray
    t_from: float
    s_from: float
    v: float
    stands: bool

    @classmethod
    def of(cls, plan: Plan, course: Course) -> Held:
        """A plan that brakes or stands, held."""
        path, t = plan.trajectory, STEP_S * np.arange(round(LOOK_S / STEP_S) + 1)
        own, sigma = path.t - path.t[0], arc_lengths(path.x, path.y)
        planned = np.interp(t, own, sigma)
        if course.action is Action.STANDS:
            ramp = START_TO_MPS / START_MPS2
            s = np.where(t < ramp, 0.5 * START_MPS2 * t**2, START_TO_MPS * (t - 0.5 * ramp))  # (3)
            return cls(t, s, planned, 0.0, 0.0, START_TO_MPS, True)
        begin = course.t_brakes
        s_from, v = float(np.interp(begin, own, sigma)), max(float(np.interp(begin, own, path.v)), 0.0)
        s = np.where(t <= begin, planned, s_from + v * (t - begin))  # (2)
        return cls(t, s, planned, begin, s_from, v, False)

    def when(self, s: float) -> float:
        """When an arc length is reached, s from the frame; after the times at the speed that is held."""
        return float(np.interp(s, self.s, self.t)) + max(s - float(self.s[-1]), 0.0) / max(self.v, STANDING_MPS)

    @property
    def reach(self) -> float:
        """How far it is looked ahead, m."""
        far = 0.0 if self.stands else self.s_from + 0.5 * self.v**2 / EASE_MPS2
        return max(float(self.s[-1]), far)

    def need(self, ahead: float) -> float:
        """The least constant deceleration to rest within `ahead` m of the plan's start, m/s2; NaN where it stands."""
        room = ahead - self.s_from
        return self.v**2 / (2.0 * room) if room > 0.0 and not self.stands else np.nan


def arc_lengths(x: FloatArray, y: FloatArray) -> FloatArray:
    """Arc length `(n,)` along points, m."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
