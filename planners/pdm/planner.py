"""PDM-Closed: it proposes drivers on several tracks (`idm_drivers`), simulates them
(`lqr_tracker`), scores them (`proposal_score`), and drives the best one.

Source: Dauner, Hallgarten, Geiger, Chitta, "Parting with Misconceptions about Learning-based
Vehicle Motion Planning", CoRL 2023 (arXiv 2306.07962); parameters from its code,
autonomousvision/tuplan_garage. Differences: docs/peers.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.arrays import BoolArray
from replan.core.settings import Config, Positive
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import Internals, Plan
from replan.logs.states import Trajectory
from replan.planners.frenet.path import Path, make_path
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
from replan.planners.frenet.st_boundaries import StGraphConfig, st_boundaries
from replan.planners.pdm.idm_drivers import Driver, drive_track
from replan.planners.pdm.lqr_tracker import track_proposal
from replan.planners.pdm.pdm_artefacts import Track, make_artefacts
from replan.planners.pdm.proposal_score import scores
from replan.planners.rules import Rulebook, RuleMemory

KNOT_M = 2.0
"""Spacing of the knots of a track, m."""
BEYOND_M = 30.0
"""Length of a track beyond the way at the speed limit, m; length of the arc of an emergency stop.
"""
LOOKED_UP_S = 0.2
"""Time step of the predictions of agents, s."""
BODIES = StGraphConfig(
    margin_m=0.0, vulnerable_margin_m=0.0, step_s=LOOKED_UP_S, early_s=0.0, late_s=0.0
)
"""S-T boundaries without margins: a track is as wide as the ego."""
BRAKING_KNOT_M = 0.5
"""Spacing of the knots of the arc on which an emergency stop ends, m."""
EQUAL_DECIMALS = 9
"""Scores are equal if they are so at this many decimals; the first of equal ones is driven."""


@dataclass(frozen=True)
class PdmConfig(Config):
    """Settings of `pdm`, as published; in brackets the names in (1) of `idm_drivers`."""

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
    """Agents farther away are ignored, except by the traffic rules."""
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
        self._names = [
            f"{share:g} of the limit, {offset:+g} m"
            for offset in self._offsets
            for share in c.speed_shares
        ]
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
        proposals = [(track.path, profile) for track in tracks for profile in track.profiles]
        drives = [
            track_proposal(path, profile, scene.start, car, steps) for path, profile in proposals
        ]
        self._lap("simulation")
        weights = c.w_progress, c.w_ttc, c.w_comfort
        scored = scores(np.array(drives), scene, np.flatnonzero(is_near), weights)
        chosen = int(np.argmax(np.round(scored.total, EQUAL_DECIMALS)))
        self._lap("scores")
        (path, profile), track = proposals[chosen], tracks[chosen // len(c.speed_shares)]
        internals = Internals(
            (), lambda: make_artefacts(scene, track, profile, self._names, scored, chosen)
        )
        contact_s = scored.contact[chosen]
        if contact_s <= c.brake_within_s and ego.v <= c.brake_below_mps:
            name = scene.name(int(scored.agent[chosen]))
            reason = f"emergency brake: the best proposal meets {name} in {contact_s:.1f} s"
            trajectory = emergency_stop(scene, c.brake_mps2)
            return Plan(trajectory, reason=reason, start=start_kind, internals=internals)
        x, y, yaw, v, a, kappa = track_proposal(path, profile, scene.start, car, HORIZON_KNOTS)
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


def emergency_stop(scene: Scene, decel: float) -> Trajectory:
    """Brake to a stop with a deceleration, m/s2, on the arc of the present curvature."""
    start, sigma = scene.start, np.linspace(0.0, BEYOND_M, round(BEYOND_M / BRAKING_KNOT_M) + 1)
    half = 0.5 * start.kappa * sigma
    chord, chord_yaw = sigma * np.sinc(half / np.pi), start.yaw + half
    x, y = start.x + chord * np.cos(chord_yaw), start.y + chord * np.sin(chord_yaw)
    bent = np.full(len(sigma), start.kappa)
    arc = Path(sigma, x, y, start.yaw + 2.0 * half, bent, sigma)
    profile = braking(scene.v, start.a, decel, EMERGENCY.jerk_mps3, STEP_S, HORIZON_KNOTS)
    return trajectory_along(arc, profile, scene.frame.t)


def constant_velocity(frame: Frame) -> Predictions:
    """Predict the agents at constant velocity for the horizon of a plan."""
    agents = frame.agents
    ahead = LOOKED_UP_S * np.arange(round(HORIZON_STEPS * STEP_S / LOOKED_UP_S) + 1)
    return Predictions(
        frame.t + ahead,
        np.arange(len(agents)),
        np.ones(len(agents)),
        agents.x[:, None] + agents.vx[:, None] * ahead,
        agents.y[:, None] + agents.vy[:, None] * ahead,
        np.repeat(agents.yaw[:, None], len(ahead), axis=1),
        "constant velocity",
    )
