"""Intelligent Driver Model: the ego follows the middle of its route, its speed follows the nearest
leader.

Path: the reference line of the route; from an offset the ego returns to it on the quintic from (l,
l', l'') to (0, 0, 0). Speed, integrated every 0.1 s over the horizon (Treiber, Hennecke, Helbing,
Phys. Rev. E 62, 2000):

(1) dv/dt = a (1 - (v / v0)^4) - a (s* / gap)^2             v <= v0
(2) s*    = s0 + max(0, v T + v (v - v_lead) / (2 sqrt(a b)))
(3) dv/dt = max(-b, v dv0/ds - (v - v0) / tau) - a (s* / gap)^2
        v > v0 (not in IDM: (1) would brake much too hard)

v0 is the limit of the lane, and of the curve: v0^2 |kappa| <= `curve_accel_mps2`. In equilibrium
behind a leader

(4) gap = (s0 + v T) / sqrt(1 - (v / v0)^4)

The leader at a time of the roll-out is the nearest agent ahead whose predicted footprint is on the
path then or within `ahead_s`; it may be a crossing one, whose speed along the path is small. The
ego does not pass an agent in its path; it stops behind it. A stop that the traffic rules demand is
a standing leader (`replan.planners.rules`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, inf, sin, sqrt

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.settings import Config, Positive
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Artefact, Corridor, Internals, Plan, SlGraph, StGraph
from replan.logs.states import EgoState
from replan.planners.frenet.path import Path, make_path, quintic
from replan.planners.frenet.profiles import (
    HORIZON_KNOTS,
    HORIZON_STEPS,
    STEP_S,
    fall_back,
    limit_profile,
    trajectory_along,
)
from replan.planners.frenet.scene import Occupancy, RouteTracker, behind, on_path
from replan.planners.frenet.st_boundaries import (
    StBoundaries,
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
    stop_outlines,
)
from replan.planners.rules import Rulebook, RuleMemory

KNOT_M = 2.0  # Spacing of the knots of the path, m
TOUCHING_M = 0.1  # Least gap in (1) and (3), m
SLOWEST_MPS = 0.5  # Least v0 in (1) and (3), m/s
TRACK_LIMIT_S = 0.5  # tau of (3), s
EXACT = StGraphConfig(early_s=0.0, late_s=0.0)
"""No time margins around predictions: IDM's time gap covers their uncertainty."""


@dataclass(frozen=True)
class IdmConfig(Config):
    """Settings of `idm`; names of (1) to (4) in brackets."""

    accel_mps2: Positive = 1.4
    """Greatest acceleration (a)."""
    decel_mps2: Positive = 2.0
    """Comfortable deceleration (b), positive."""
    time_gap_s: Positive = 1.5
    """Time gap to the leader (T)."""
    standstill_gap_m: Positive = 2.0
    """Gap to the leader where both stand (s0)."""
    hardest_mps2: Positive = 8.0
    """Bound of the deceleration, positive."""
    jerk_mps3: Positive = 8.0
    """Bound of the jerk; IDM itself has none."""
    curve_accel_mps2: Positive = 3.0
    """Lateral acceleration in curves."""
    ease_mps2: Positive = 1.5
    """Deceleration towards a lower limit or a curve."""
    ahead_s: Positive = 2.5
    """An agent that is predicted on the path within this time is a leader now."""
    return_s: Positive = 4.0
    """Time in which the ego returns from an offset to the reference line."""


class Idm:
    """Follows the middle of the route.

    Its memory is the last station and the memory of the rules.
    """

    def __init__(self, context: PlannerContext, config: IdmConfig | None = None) -> None:
        self._config = config or IdmConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        c = self._config
        self._rules = Rulebook(
            context.road,
            self._tracker.reference,
            context.vehicle,
            curve_accel_mps2=c.curve_accel_mps2,
            ease_mps2=c.ease_mps2,
        )
        self._memory = RuleMemory()

    def plan(self, frame: Frame) -> Plan:
        """Return the roll-out of (1) to (3) along the path.

        A stop where the ego is outside the line's frame.
        """
        scene, start_kind = self._tracker.scene(frame)
        start, car, agents = scene.start, self._vehicle, frame.agents
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, start, start_kind, None, scene.trouble, (), car)
        reach = HORIZON_STEPS * STEP_S * (scene.v + 4.0) + 20.0  # longer than any roll-out
        d, (l0, dl0, ddl0) = KNOT_M * np.arange(int(reach / KNOT_M) + 2), scene.frenet
        span = max(15.0, self._config.return_s * scene.v)
        back = np.polynomial.Polynomial([l0, dl0, 0.5 * ddl0, *quintic(l0, dl0, ddl0, 0.0, span)])
        offsets = np.array(
            [np.where(d < span, part(d), 0.0) for part in (back, back.deriv(), back.deriv(2))]
        )
        path = make_path(scene.reference.line, scene.s, KNOT_M, offsets)
        self._lap("path")
        x, y = agents.x - start.x, agents.y - start.y
        # Behind the front axle: not followed
        aside = x * cos(start.yaw) + y * sin(start.yaw) < car.wheelbase
        skip = behind(scene, keeps_track=True) | (
            aside & (np.hypot(x, y) < car.length + 0.5 * agents.length)
        )
        blocks = st_boundaries(scene, path, skip, frozenset(), EXACT)
        demanded, self._memory = self._rules.stops(scene, self._memory)
        stops = on_path(demanded, path, car)
        self._lap("S-T graph")
        profile, leader = self._profile(path, blocks, stops, start)
        self._lap("speed")

        def artefacts() -> tuple[Artefact, ...]:
            t, nothing = STEP_S * np.arange(profile.shape[1]), np.empty((0, 2))
            decisions = decide_speed(blocks, scene, np.interp(blocks.t, t, profile[0]))
            leads = [decision for i, decision in enumerate(decisions) if (leader == i).any()]
            upper, lead = np.full(len(t), path.length), blocks.with_stops(stops)
            for n in np.flatnonzero(leader >= 0):
                k = int(np.searchsorted(lead.t, t[n] + 1e-9)) - 1
                upper[n] = np.fmin(lead.lower[leader[n], k], path.length)
            drawn = (*outlines(blocks, decisions), *stop_outlines(stops, float(t[-1]), path.length))
            free, driven = Corridor(t, np.zeros(len(t)), upper), np.column_stack([t, profile[0]])
            points = np.arange(0, len(path.s), 8)  # every few metres
            s, side, lane = path.s[points], 0.5 * scene.vehicle.width, scene.reference
            right, left = (
                np.interp(s, lane.line.s, edge) for edge in (lane.lane_right, lane.lane_left)
            )
            offset = np.array(
                [lane.line.project(path.x[i], path.y[i], path.s[i], 2.0)[1] for i in points]
            )
            sl_graph = SlGraph(
                None,
                Corridor(s, right + side, left - side),
                nothing,
                np.column_stack([s, offset]),
                (),
            )
            # Several hypotheses of an agent may lead
            by_agent = {decision.agent: decision for decision in leads}
            st_graph = StGraph(None, free, nothing, driven, drawn)
            return (st_graph, sl_graph, *by_agent.values(), *(stop.decision for stop in stops))

        trajectory = trajectory_along(path, profile, frame.t)
        return Plan(trajectory, start=start_kind, internals=Internals((), artefacts))

    def _profile(
        self, path: Path, blocks: StBoundaries, stops: tuple[Occupancy, ...], start: EgoState
    ) -> tuple[FloatArray, IntArray]:
        """Rows s, v, a `(3, HORIZON_KNOTS)`.

        The leader per knot: a row of `blocks`, after them a stop; -1: none.
        """
        c, line = self._config, self._tracker.reference.line
        limit = np.interp(path.s, line.s, self._tracker.reference.limit)
        v0 = limit_profile(path.sigma, path.kappa, limit, c.curve_accel_mps2, c.ease_mps2)
        driver = np.array(
            [
                c.accel_mps2,
                c.decel_mps2,
                c.time_gap_s,
                c.standstill_gap_m,
                c.hardest_mps2,
                c.jerk_mps3,
            ]
        )
        ahead = round(c.ahead_s / blocks.step) if np.isfinite(blocks.step) else 0
        state = np.array([max(start.v, 0.0), start.a])
        lead = blocks.with_stops(
            [replace(stop, s_from=stop.aim + c.standstill_gap_m) for stop in stops]
        )
        return _rolled_out(
            path.sigma, v0, lead.t, lead.lower, lead.upper, lead.speed, ahead, state, driver
        )


@kernel
def idm_acceleration(
    v: float,
    v0: float,
    slope: float,
    gap: float,
    v_lead: float,
    a: float,
    b: float,
    time_gap: float,
    s0: float,
) -> float:
    """Acceleration (1) to (3), m/s2; `slope` is dv0/ds, an infinite gap is a free road."""
    v0 = max(v0, SLOWEST_MPS)
    tracking = max(-b, v * min(slope, 0.0) - (v - v0) / TRACK_LIMIT_S)  # (3)
    free = a * (1.0 - (v / v0) ** 4) if v <= v0 else tracking  # (1)
    if gap == inf:
        return free
    wanted_gap = s0 + max(0.0, v * time_gap + v * (v - v_lead) / (2.0 * sqrt(a * b)))  # (2)
    return free - a * (wanted_gap / max(gap, TOUCHING_M)) ** 2  # (1), (3)


@kernel
def _rolled_out(
    sigma: FloatArray,
    limit: FloatArray,
    t: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    ahead: int,
    start: FloatArray,
    driver: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Simulate the driver (a, b, T, s0, hardest, jerk) from `start` (v, a).

    Returns what `Idm._profile` returns.
    """
    profile, led = np.zeros((3, HORIZON_KNOTS)), np.full(HORIZON_KNOTS, -1)
    accel, decel, time_gap, standstill_gap, hardest, jerk = driver
    s, point, k = 0.0, 0, 0
    v, a = start
    for n in range(HORIZON_KNOTS):
        profile[0, n], profile[1, n], profile[2, n] = s, v, a
        while point < len(sigma) - 2 and sigma[point + 1] <= s:
            point += 1
        while k < len(t) - 1 and t[k + 1] <= n * STEP_S + 1e-9:
            k += 1
        # To the nearest block ahead, 0 inside one; blocks that begin later behind the ego are
        # skipped
        gap = inf
        for i in range(len(lower)):
            for j in range(k, min(k + ahead + 1, lower.shape[1])):
                if not np.isfinite(lower[i, j]) or upper[i, j] <= s or (j > k and lower[i, j] <= s):
                    continue
                if max(lower[i, j] - s, 0.0) < gap:
                    led[n], gap = i, max(lower[i, j] - s, 0.0)
                break
        v_lead = max(speed[led[n]], 0.0) if led[n] >= 0 else 0.0
        slope = (limit[point + 1] - limit[point]) / (sigma[point + 1] - sigma[point])
        accel_wanted = idm_acceleration(
            v, limit[point], slope, gap, v_lead, accel, decel, time_gap, standstill_gap
        )
        change = jerk * STEP_S
        a = min(max(accel_wanted, -hardest, a - change), a + change)
        v_next = v + a * STEP_S
        if v_next <= 0.0:
            s, v, a = s + (0.5 * v * v / -a if a < 0.0 else 0.0), 0.0, 0.0
            continue
        s, v = s + 0.5 * STEP_S * (v + v_next), v_next
    return profile, led
