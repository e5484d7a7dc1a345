"""PDM-Closed: it proposes drivers on several tracks, simulates and scores them (`score`), and
drives the best one.

A driver with the wanted speed v0 drives along a track, from the projection of the ego on it (IDM as
in PDM-Closed):

(1) dv/dt = a (1 - (v / v0)^delta - (s* / max(gap, s0))^2), kept within [-b, a]
    s*    = s0 + v T + v (v - v_lead) / (2 sqrt(a b))

The leader is the nearest one on the track whose centre is ahead of the rear axle. The ego follows
such a proposal with the two-stage LQR of nuPlan, which looks `AHEAD` steps of h = `STEP_S` ahead.
Longitudinal, with the proposal's speed v_r then:

(2) a = N q (v_r - v) / (N^2 q + 1), N = h `AHEAD`; where both are below `STOPPING_MPS`:
        (v_r - v) / 2, no steering

Lateral: e and psi are the offset and the heading from the proposal's pose, kappa_k its curvature,
v_k = v + k h a:

(3) e_k+1 = e_k + h v_k psi_k,   psi_k+1 = psi_k + h v_k (steer_k / L - kappa_k),
        steer_k+1 = steer_k + h u
    the constant rate u minimises  e_N^2 + 10 psi_N^2 + u^2  after `AHEAD` steps

The car is a kinematic bicycle with lags (the planner's own model; `replan.replay.vehicle` has those
of the simulation):

(4) a <- a + h / (h + 0.2 s) (a_wanted - a),   steer <- steer + h / (h + 0.05 s) h u,
        v <- v + h a >= 0
    yaw' = v tan(steer) / L, x and y by the midpoint rule

Source: Dauner, Hallgarten, Geiger, Chitta, "Parting with Misconceptions about Learning-based
Vehicle Motion Planning", CoRL 2023 (arXiv 2306.07962); parameters from its code,
autonomousvision/tuplan_garage. Differences: docs/peers.md.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import atan, atan2, ceil, cos, inf, sin, sqrt, tan
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.core.settings import Config, Positive
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import (
    Artefact,
    Candidates,
    Corridor,
    CostTerms,
    Internals,
    Plan,
    SlGraph,
    StGraph,
)
from replan.logs.states import EgoState, Trajectory, wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import Path, make_path, states_on_path
from replan.planners.frenet.profiles import (
    EMERGENCY,
    HORIZON_KNOTS,
    HORIZON_STEPS,
    STEP_S,
    braking,
    fall_back,
    trajectory_along,
)
from replan.planners.frenet.scene import Occupancy, RouteTracker, Scene, on_path
from replan.planners.frenet.st_boundaries import (
    StBoundaries,
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
    stop_outlines,
)
from replan.planners.pdm.proposal_score import PARTS, WHY_NOT, Scores, scores
from replan.planners.rules import Rulebook, RuleMemory

KNOT_M, BEYOND_M, LOOKED_UP_S = 2.0, 30.0, 0.2
"""Spacing of the knots of a track, m; length of a track beyond the way at the speed limit, m; time
step of the predictions of agents, s."""
BODIES = StGraphConfig(
    margin_m=0.0, vulnerable_margin_m=0.0, step_s=LOOKED_UP_S, early_s=0.0, late_s=0.0
)
"""S-T boundaries without margins: a track is as wide as the ego."""
AHEAD = 10  # Steps that (2) and (3) look ahead
# Weights of (2) and (3); the weight of the input is 1
Q_SPEED, Q_OFFSET, Q_HEADING = 10.0, 1.0, 10.0
STOPPING_MPS, STOPPING_GAIN = 0.2, 0.5
"""Speed up to which (2) only stops, m/s, and its gain there, 1/s."""
ACCEL_LAG_S, STEER_LAG_S = 0.2, 0.05
"""Lags of (4), s."""


@dataclass(frozen=True)
class PdmConfig(Config):
    """Settings of `pdm`, as published; in brackets the names in (1)."""

    speed_shares: Annotated[tuple[Positive, ...], Meta(min_length=1)] = (0.2, 0.4, 0.6, 0.8, 1.0)
    """Wanted speeds (v0), as shares of the speed limit where the ego is."""
    offsets_m: tuple[Positive, ...] = (1.0,)
    """Tracks to either side of the middle of the route, beside the one in the middle."""
    min_gap_m: Positive = 1.0
    """Gap to the leader at standstill (s0)."""
    headway_s: Positive = 1.5
    """Time gap to the leader (T)."""
    accel_mps2: Positive = 1.5
    """Greatest acceleration (a)."""
    decel_mps2: Positive = 3.0
    """Greatest deceleration (b), positive."""
    exponent: Positive = 10.0
    """Exponent of the term for the free road (delta)."""
    horizon_s: Annotated[float, Meta(ge=1.0, le=HORIZON_STEPS * STEP_S)] = 4.0
    """How long proposals are simulated and scored."""
    radius_m: Positive = 50.0
    """Only the traffic rules consider agents farther away than this."""
    w_progress: Positive = 5.0
    """Weight of progress in the score."""
    w_ttc: Positive = 5.0
    """Weight of the time to collision in the score."""
    w_comfort: Positive = 2.0
    """Weight of comfort in the score."""
    brake_within_s: Positive = 2.0
    """The ego brakes where the best proposal has a contact at fault within this time."""
    brake_below_mps: Positive = 5.0
    """It brakes so only where it is not faster than this."""
    brake_mps2: Positive = 4.05
    """Deceleration of this braking, positive."""


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A path along the route at an offset, agents and stops on it, drivers' profiles s, v
    `(n, 2, HORIZON_KNOTS)`.
    """

    offset: float
    path: Path
    blocks: StBoundaries
    stops: tuple[Occupancy, ...]
    profiles: FloatArray


class Pdm:
    """Drives the best of its simulated proposals.

    Its memory is the last station and the memory of the rules.
    """

    def __init__(self, context: PlannerContext, config: PdmConfig | None = None) -> None:
        c = self._config = config or PdmConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        self._rules = Rulebook(context.road, self._tracker.reference, context.vehicle)
        self._memory = RuleMemory()
        side = 1.0 if context.road.drives_on_right else -1.0
        self._offsets = (0.0, *(sign * offset for offset in c.offsets_m for sign in (side, -side)))
        self._driver = Driver(c.accel_mps2, c.decel_mps2, c.headway_s, c.min_gap_m, c.exponent)

    def plan(self, frame: Frame) -> Plan:
        """Return the simulated drive along the best proposal (the first of equals), or a stop off
        the route's frame.
        """
        c, car = self._config, self._vehicle
        scene, start_kind = self._tracker.scene(
            replace(frame, predictions=constant_velocity(frame))
        )
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, scene.start, start_kind, None, scene.trouble, (), car)
        demanded, self._memory = self._rules.stops(scene, self._memory)
        self._lap("scene")
        agents, ego = frame.agents, frame.ego
        is_near = np.hypot(agents.x - ego.x, agents.y - ego.y) <= c.radius_m
        tracks = [self._track(scene, demanded, is_near, offset) for offset in self._offsets]
        self._lap("proposals")
        steps = round(c.horizon_s / STEP_S) + 1
        profiles = [(driven.path, profile) for driven in tracks for profile in driven.profiles]
        drives = [
            track_proposal(path, profile, scene.start, car, steps) for path, profile in profiles
        ]
        self._lap("simulation")
        weights = c.w_progress, c.w_ttc, c.w_comfort
        scored = scores(np.array(drives), scene, np.flatnonzero(is_near), weights)
        chosen = int(np.argmax(np.round(scored.total, 9)))
        self._lap("scores")
        track, row = tracks[chosen // len(c.speed_shares)], chosen % len(c.speed_shares)
        internals = Internals((), lambda: self._artefacts(scene, track, row, scored, chosen))
        if scored.contact[chosen] <= c.brake_within_s and frame.ego.v <= c.brake_below_mps:
            start, sigma = scene.start, np.linspace(0.0, BEYOND_M, 61)  # with the present curvature
            half = 0.5 * start.kappa * sigma
            x, y = (
                sigma * np.sinc(half / np.pi) * turn(start.yaw + half) for turn in (np.cos, np.sin)
            )
            bent = np.full(len(sigma), start.kappa)
            arc = Path(sigma, start.x + x, start.y + y, start.yaw + 2.0 * half, bent, sigma)
            profile = braking(
                scene.v, start.a, c.brake_mps2, EMERGENCY.jerk_mps3, STEP_S, HORIZON_KNOTS
            )
            name, within = scene.name(int(scored.agent[chosen])), scored.contact[chosen]
            reason = f"emergency brake: the best proposal meets {name} in {within:.1f} s"
            return Plan(
                trajectory_along(arc, profile, frame.t),
                reason=reason,
                start=start_kind,
                internals=internals,
            )
        x, y, yaw, v, a, kappa = track_proposal(
            track.path, track.profiles[row], scene.start, car, HORIZON_KNOTS
        )
        trajectory = Trajectory(frame.t + STEP_S * np.arange(HORIZON_KNOTS), x, y, yaw, v, a, kappa)
        return Plan(trajectory, start=start_kind, internals=internals)

    def _track(
        self, scene: Scene, demanded: tuple[Occupancy, ...], is_near: BoolArray, offset: float
    ) -> Track:
        """A path `offset` m beside the middle of the route, and the drivers on it."""
        c = self._config
        knots = ceil((HORIZON_STEPS * STEP_S * max(scene.v, scene.limit) + BEYOND_M) / KNOT_M) + 1
        path = make_path(
            scene.reference.line, scene.s, KNOT_M, np.outer([offset, 0.0, 0.0], np.ones(knots))
        )
        blocks = st_boundaries(scene, path, ~is_near, frozenset(), BODIES)
        stops = on_path(demanded, path, self._vehicle)
        lead = blocks.with_stops([replace(stop, s_from=stop.aim + c.min_gap_m) for stop in stops])
        speeds = scene.limit * np.array(c.speed_shares)
        center = self._vehicle.axle_to_center
        profiles = drive_track(
            speeds, lead.t, lead.lower, lead.upper, lead.speed, scene.v, center, self._driver
        )
        return Track(offset, path, blocks, stops, profiles)

    def _artefacts(
        self, scene: Scene, track: Track, row: int, scored: Scores, chosen: int
    ) -> tuple[Artefact, ...]:
        """Both graphs of the chosen proposal, its leaders, the score terms of all, why others were
        not chosen.
        """
        named = [
            f"{share:g} of the limit, {offset:+g} m"
            for offset in self._offsets
            for share in self._config.speed_shares
        ]
        t, driven_m = STEP_S * np.arange(HORIZON_KNOTS), track.profiles[row, 0]
        decisions = decide_speed(track.blocks, scene, np.interp(track.blocks.t, t, driven_m))
        drawn = (
            *outlines(track.blocks, decisions),
            *stop_outlines(track.stops, float(t[-1]), track.path.length),
        )
        st_graph = StGraph(None, None, np.empty((0, 2)), np.column_stack([t, driven_m]), drawn)
        s, side, reference = track.path.s[::8], 0.5 * scene.vehicle.width, scene.reference
        edges = (reference.facing_right, reference.facing_left)
        right, left = (np.interp(s, reference.line.s, edge) for edge in edges if edge is not None)
        line = np.column_stack([s, np.full(len(s), track.offset)])
        sl_graph = SlGraph(None, Corridor(s, right + side, left - side), np.empty((0, 2)), line, ())
        decided = {decision.agent: decision for decision in decisions}.values()
        rows = [chosen, *(n for n in range(len(named)) if n != chosen)]
        terms = [tuple(zip(PARTS[3:], scored.weighted[:, n].tolist(), strict=True)) for n in rows]
        costs = [
            CostTerms("taken: " * (n == chosen) + named[n], named_terms)
            for n, named_terms in zip(rows, terms, strict=True)
        ]
        worse = (scored.parts < scored.parts[:, chosen, None] - 1e-9)[:, rows[1:]].T
        why = Counter(WHY_NOT[np.argmax(parts)] if parts.any() else "not better" for parts in worse)
        counted = Candidates("proposals", len(named), tuple(why.items()))
        return (
            st_graph,
            sl_graph,
            *decided,
            *(stop.decision for stop in track.stops),
            *costs,
            counted,
        )


def constant_velocity(frame: Frame) -> Predictions:
    """Predict the agents at constant velocity for the horizon of a plan."""
    agents, ahead = (
        frame.agents,
        LOOKED_UP_S * np.arange(round(HORIZON_STEPS * STEP_S / LOOKED_UP_S) + 1),
    )
    x, y = (
        agents.x[:, None] + agents.vx[:, None] * ahead,
        agents.y[:, None] + agents.vy[:, None] * ahead,
    )
    yaw = np.repeat(agents.yaw[:, None], len(ahead), axis=1)
    return Predictions(
        frame.t + ahead,
        np.arange(len(agents)),
        np.ones(len(agents)),
        x,
        y,
        yaw,
        "constant velocity",
    )


class Driver(NamedTuple):
    """Parameters of (1): a, b (m/s2), T (s), s0 (m), delta."""

    accel: float
    decel: float
    headway: float
    min_gap: float
    exponent: float


@kernel
def idm_acceleration(v: float, v0: float, gap: float, v_lead: float, driver: Driver) -> float:
    """Acceleration (1), m/s2; an infinite gap is a free road."""
    a, b = driver.accel, driver.decel
    wanted_gap = driver.min_gap + v * driver.headway + v * (v - v_lead) / (2.0 * sqrt(a * b))
    return min(
        max(
            a * (1.0 - (v / v0) ** driver.exponent - (wanted_gap / max(gap, driver.min_gap)) ** 2),
            -b,
        ),
        a,
    )


@kernel
def drive_track(
    speeds: FloatArray,
    t: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    start_v: float,
    center: float,
    driver: Driver,
) -> FloatArray:
    """Rows s, v `(n, 2, HORIZON_KNOTS)` of a driver per wanted speed `(n,)`, m/s, along one track.

    `t` `(k,)`, `lower`, `upper` `(m, k)` and `speed` `(m,)` are those of `StBoundaries`; `center`
    is the distance from the rear axle to the box's centre, m.
    """
    profiles = np.empty((len(speeds), 2, HORIZON_KNOTS))
    for n in range(len(speeds)):
        s, v, k = 0.0, start_v, 0
        for j in range(HORIZON_KNOTS):
            profiles[n, 0, j], profiles[n, 1, j] = s, v
            while k < len(t) - 1 and t[k + 1] <= j * STEP_S + 1e-9:
                k += 1
            gap, v_lead = inf, 0.0
            for i in range(len(lower)):
                if 0.5 * (lower[i, k] + upper[i, k]) + center > s and lower[i, k] - s < gap:
                    gap, v_lead = lower[i, k] - s, speed[i]
            a = idm_acceleration(v, max(speeds[n], 0.1), gap, v_lead, driver)
            s, v = s + STEP_S * v, max(v + STEP_S * a, 0.0)
    return profiles


def track_proposal(
    path: Path, profile: FloatArray, start: EgoState, car: VehicleParameters, knots: int
) -> FloatArray:
    """Simulate the ego on a proposal (`follow_proposal`): a profile s, v `(2, HORIZON_KNOTS)` on a
    path.
    """
    pose = states_on_path(
        path.sigma, path.x, path.y, path.yaw, path.kappa, np.ascontiguousarray(profile[0])
    )
    state = np.array(
        [start.x, start.y, start.yaw, max(start.v, 0.0), start.a, atan(car.wheelbase * start.kappa)]
    )
    return follow_proposal(pose, profile[1], state, car.wheelbase, car.max_steer, knots)


@kernel
def follow_proposal(
    pose: FloatArray,
    speed: FloatArray,
    start: FloatArray,
    wheelbase: float,
    max_steer: float,
    knots: int,
) -> FloatArray:
    """Rows x, y, yaw, v, a, kappa `(6, knots)` of the ego that follows a proposal.

    The proposal has the rows x, y, yaw, kappa `(4, n)` and the `speed` `(n,)`; `start` is x, y,
    yaw, v, a, steer.
    """
    states, last = np.empty((6, knots)), pose.shape[1] - 1
    x, y, yaw, v, a, steer = start
    for k in range(knots):
        states[0, k], states[1, k] = x, y
        states[2, k], states[3, k] = yaw, v
        states[4, k], states[5, k] = a, tan(steer) / wheelbase
        knot, then = min(k, last), min(k + AHEAD, last)
        if speed[then] <= STOPPING_MPS and v <= STOPPING_MPS:
            wanted_accel, rate = STOPPING_GAIN * (speed[then] - v), 0.0
        else:
            N = STEP_S * AHEAD
            wanted_accel = N * Q_SPEED * (speed[then] - v) / (N * N * Q_SPEED + 1.0)  # (2)
            e = (y - pose[1, knot]) * cos(pose[2, knot]) - (x - pose[0, knot]) * sin(pose[2, knot])
            psi = wrap(yaw - pose[2, knot])
            # The response to a rate of 1; e and psi become that to a rate of 0
            e1, psi1, steer1 = 0.0, 0.0, 0.0
            for i in range(AHEAD):
                step_m = STEP_S * max(v + i * STEP_S * wanted_accel, 0.0)
                e, psi = (
                    e + step_m * psi,
                    psi + step_m * (steer / wheelbase - pose[3, min(knot + i, last)]),
                )
                e1, psi1, steer1 = (
                    e1 + step_m * psi1,
                    psi1 + step_m * steer1 / wheelbase,
                    steer1 + STEP_S,
                )
            psi = atan2(sin(psi), cos(psi))
            gain = Q_OFFSET * e1**2 + Q_HEADING * psi1**2 + 1.0
            rate = -(Q_OFFSET * e1 * e + Q_HEADING * psi1 * psi) / gain  # (3)
        a += STEP_S / (STEP_S + ACCEL_LAG_S) * (wanted_accel - a)  # (4)
        v_next = max(v + STEP_S * a, 0.0)
        if v_next == 0.0:
            a = 0.0
        turn = STEP_S * 0.5 * (v + v_next) * tan(steer) / wheelbase
        x += STEP_S * 0.5 * (v + v_next) * cos(yaw + 0.5 * turn)
        y += STEP_S * 0.5 * (v + v_next) * sin(yaw + 0.5 * turn)
        yaw, v = yaw + turn, v_next
        steer = min(
            max(steer + STEP_S / (STEP_S + STEER_LAG_S) * STEP_S * rate, -max_steer), max_steer
        )
    return states
