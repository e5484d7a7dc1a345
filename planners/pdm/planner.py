"""The planner's one screen: start, tracks, proposals, simulation, scores; the best one, or an emergency brake."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from logs.frame import Frame, PlannerContext, Predictions
from logs.kernel import BoolArray, FloatArray
from logs.states import EgoState, Trajectory
from logs.trace import Artefact, Candidates, Corridor, CostTerms, Internals, Plan, SlGraph, StGraph
from planners.frenet.fallback import along, fall_back
from planners.frenet.occupancy import Occupancy, on_path
from planners.frenet.path import Path, make_path
from planners.frenet.profiles import EMERGENCY, HORIZON_KNOTS, HORIZON_STEPS, STEP_S, braking
from planners.frenet.scene import RouteTracker, Scene
from planners.frenet.st_boundaries import (
    StBoundaries,
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
    stop_outlines,
)
from planners.pdm.proposals import Driver, driven, tracked
from planners.pdm.score import PARTS, WHY_NOT, Scores, scores
from planners.rules import Rulebook, RuleMemory

KNOT_M, BEYOND_M, LOOKED_UP_S = 2.0, 30.0, 0.2
"""Spacing of the knots of a track, m; how much longer it is than the ego gets at the limit, m; the others are put
forward in steps of this to find leaders, s."""
BODIES = StGraphConfig(margin_m=0.0, vulnerable_margin_m=0.0, step_s=LOOKED_UP_S, early_s=0.0, late_s=0.0)
"""A track is as wide as the ego."""


@dataclass(frozen=True)
class PdmConfig:
    """Settings of `pdm`, as published; in brackets the names in `planners.pdm.proposals` (1).

    Attributes:
        speed_shares: Wanted speeds (v0), as shares of the speed limit where the ego is.
        offsets_m: Tracks to either side of the middle of the route, beside the one in the middle.
        min_gap_m: To the leader at standstill (s0).
        headway_s: To the leader (T).
        accel_mps2: Greatest acceleration (a).
        decel_mps2: Greatest deceleration (b), positive.
        exponent: Of the free road (delta).
        horizon_s: How long proposals are simulated and scored.
        radius_m: Others farther away count for the traffic rules only.
        w_progress: Weight of progress in the score; `w_ttc` of the time to collision, `w_comfort` of comfort.
        brake_within_s: Where the best proposal has a contact at fault within this time ...
        brake_below_mps: ... and the ego is not faster than this, it brakes ...
        brake_mps2: ... with this deceleration, positive.
    """

    speed_shares: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8, 1.0)
    offsets_m: tuple[float, ...] = (1.0,)
    min_gap_m: float = 1.0
    headway_s: float = 1.5
    accel_mps2: float = 1.5
    decel_mps2: float = 3.0
    exponent: float = 10.0
    horizon_s: float = 4.0
    radius_m: float = 50.0
    w_progress: float = 5.0
    w_ttc: float = 5.0
    w_comfort: float = 2.0
    brake_within_s: float = 2.0
    brake_below_mps: float = 5.0
    brake_mps2: float = 4.05

    def __post_init__(self) -> None:
        numbers = {name: value for name, value in vars(self).items() if isinstance(value, float)}
        if not (self.speed_shares and min(*numbers.values(), *self.speed_shares, *self.offsets_m) > 0.0):
            raise ValueError("pdm settings must be positive, and there must be a share of the speed limit")
        if not 1.0 <= self.horizon_s <= HORIZON_STEPS * STEP_S:
            raise ValueError(f"pdm's horizon_s must be 1 to {HORIZON_STEPS * STEP_S:g} s")


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A path beside the middle of the route, who takes it, and the drivers' profiles s, v `(n, 2, HORIZON_KNOTS)`."""

    offset: float
    path: Path
    blocks: StBoundaries
    stops: tuple[Occupancy, ...]
    profiles: FloatArray


class Pdm:
    """Drives the best of its simulated proposals; its memory is the last station and what the rules remember."""

    def __init__(self, context: PlannerContext, config: PdmConfig | None = None) -> None:
        c = self._config = config or PdmConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        self._rules = Rulebook(context.road, self._tracker.reference, context.vehicle)
        self._memory = RuleMemory()
        side = 1.0 if context.road.drives_on_right else -1.0
        self._offsets = (0.0, *(sign * each for each in c.offsets_m for sign in (side, -side)))
        self._driver = Driver(c.accel_mps2, c.decel_mps2, c.headway_s, c.min_gap_m, c.exponent)

    def plan(self, frame: Frame) -> Plan:
        """The simulated drive along the best proposal, ties to the first; a stop outside of the route's frame."""
        c, car = self._config, self._vehicle
        scene, start_kind = self._tracker.scene(replace(frame, predictions=straight_on(frame)))
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, scene.start, start_kind, None, scene.trouble, (), car)
        demanded, self._memory = self._rules.stops(scene, self._memory)
        self._lap("scene")
        agents, ego = frame.agents, frame.ego
        near = np.hypot(agents.x - ego.x, agents.y - ego.y) <= c.radius_m
        tracks = [self._track(scene, demanded, near, offset) for offset in self._offsets]
        self._lap("proposals")
        steps = round(c.horizon_s / STEP_S) + 1
        drives = [tracked(each.path, profile, scene.start, car, steps) for each in tracks for profile in each.profiles]
        self._lap("simulation")
        weights = c.w_progress, c.w_ttc, c.w_comfort
        found = scores(np.array(drives), scene, np.flatnonzero(near), weights)
        chosen = int(np.argmax(np.round(found.total, 9)))
        self._lap("scores")
        track, row = tracks[chosen // len(c.speed_shares)], chosen % len(c.speed_shares)
        internals = Internals((), lambda: self._artefacts(scene, track, row, found, chosen))
        if found.contact[chosen] <= c.brake_within_s and frame.ego.v <= c.brake_below_mps:
            profile = braking(scene.v, scene.start.a, c.brake_mps2, EMERGENCY.jerk_mps3, STEP_S, HORIZON_KNOTS)
            way, name = along(_arc(scene.start), profile, frame.t), scene.name(int(found.agent[chosen]))
            reason = f"emergency brake: the best proposal meets {name} in {found.contact[chosen]:.1f} s"
            return Plan(way, reason=reason, start=start_kind, internals=internals)
        x, y, yaw, v, a, kappa = tracked(track.path, track.profiles[row], scene.start, car, HORIZON_KNOTS)
        way = Trajectory(frame.t + STEP_S * np.arange(HORIZON_KNOTS), x, y, yaw, v, a, kappa)
        return Plan(way, start=start_kind, internals=internals)

    def _track(self, scene: Scene, demanded: tuple[Occupancy, ...], near: BoolArray, offset: float) -> Track:
        """A path `offset` m beside the middle of the route, and the drivers on it."""
        c = self._config
        knots = ceil((HORIZON_STEPS * STEP_S * max(scene.v, scene.limit) + BEYOND_M) / KNOT_M) + 1
        path = make_path(scene.reference.line, scene.s, KNOT_M, np.outer([offset, 0.0, 0.0], np.ones(knots)))
        blocks = st_boundaries(scene, path, ~near, frozenset(), BODIES)
        stops = on_path(demanded, path, self._vehicle)
        lead = blocks.with_stops([replace(stop, s_from=stop.aim + c.min_gap_m) for stop in stops])
        speeds = scene.limit * np.array(c.speed_shares)
        center = self._vehicle.axle_to_center
        profiles = driven(speeds, lead.t, lead.lower, lead.upper, lead.speed, scene.v, center, self._driver)
        return Track(offset, path, blocks, stops, profiles)

    def _artefacts(self, scene: Scene, track: Track, row: int, found: Scores, chosen: int) -> tuple[Artefact, ...]:
        """Both graphs of the chosen proposal, who leads, and the scores of all: what they are made of, and why not."""
        named = [f"{share:g} of the limit, {at:+g} m" for at in self._offsets for share in self._config.speed_shares]
        t, driven_m = STEP_S * np.arange(HORIZON_KNOTS), track.profiles[row, 0]
        decisions = decide_speed(track.blocks, scene, np.interp(track.blocks.t, t, driven_m))
        shown = (*outlines(track.blocks, decisions), *stop_outlines(track.stops, float(t[-1]), track.path.length))
        st_graph = StGraph(None, None, np.empty((0, 2)), np.column_stack([t, driven_m]), shown)
        s, side, reference = track.path.s[::8], 0.5 * scene.vehicle.width, scene.reference
        edges = (reference.facing_right, reference.facing_left)
        right, left = (np.interp(s, reference.line.s, edge) for edge in edges if edge is not None)
        line = np.column_stack([s, np.full(len(s), track.offset)])
        sl_graph = SlGraph(None, Corridor(s, right + side, left - side), np.empty((0, 2)), line, ())
        near = {decision.agent: decision for decision in decisions}.values()
        rows = [chosen, *(n for n in range(len(named)) if n != chosen)]
        terms = [tuple(zip(PARTS[3:], found.weighted[:, n].tolist(), strict=True)) for n in rows]
        costs = [CostTerms("taken: " * (n == chosen) + named[n], some) for n, some in zip(rows, terms, strict=True)]
        worse = (found.parts < found.parts[:, chosen, None] - 1e-9)[:, rows[1:]].T
        why = Counter(WHY_NOT[np.argmax(parts)] if parts.any() else "not better" for parts in worse)
        counted = Candidates("proposals", len(named), tuple(why.items()))
        return (st_graph, sl_graph, *near, *(stop.decision for stop in track.stops), *costs, counted)


def straight_on(frame: Frame) -> Predictions:
    """The others going on with their velocity, for the horizon of a plan."""
    agents, ahead = frame.agents, LOOKED_UP_S * np.arange(round(HORIZON_STEPS * STEP_S / LOOKED_UP_S) + 1)
    x, y = agents.x[:, None] + agents.vx[:, None] * ahead, agents.y[:, None] + agents.vy[:, None] * ahead
    yaw = np.repeat(agents.yaw[:, None], len(ahead), axis=1)
    return Predictions(frame.t + ahead, np.arange(len(agents)), np.ones(len(agents)), x, y, yaw, "constant velocity")


def _arc(start: EgoState) -> Path:
    """The way on with the curvature of now, as far as an emergency brake needs it."""
    sigma = np.linspace(0.0, BEYOND_M, 61)
    half = 0.5 * start.kappa * sigma
    chord = sigma * np.sinc(half / np.pi)
    x, y = start.x + chord * np.cos(start.yaw + half), start.y + chord * np.sin(start.yaw + half)
    return Path(sigma, x, y, start.yaw + 2.0 * half, np.full(len(sigma), start.kappa), sigma)
