"""The planner: start, scene, pairs, the first feasible pair in order of cost; or the fallback.

The module also selects the polynomials to try.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, floor, tan
from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.arrays import FloatArray, IntArray
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Artefact, Candidates, Internals, Plan
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory, wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import curvature_slope
from replan.planners.frenet.profiles import (
    HORIZON_KNOTS,
    HORIZON_STEPS,
    STEP_S,
    braking,
    fall_back,
    limit_profile,
)
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import (
    TRACK_M,
    Occupancy,
    RouteTracker,
    Scene,
    behind,
    on_reference,
    open_end,
    upper_bound,
)
from replan.planners.frenet.st_boundaries import StGraphConfig
from replan.planners.lattice.artefacts import ChosenPair, make_artefacts
from replan.planners.lattice.candidates import (
    KAPPA,
    REASONS,
    REST_MPS,
    STRIDE,
    EgoLimits,
    Fault,
    FrenetStart,
    Longitudinal,
    NearFutures,
    Pairs,
    Room,
    first_feasible,
    futures_frenet,
    headway,
    keep_speed,
    lateral_costs,
    lateral_polynomial,
    reach_point,
    sample_polynomials,
    speed_faults,
    squared_jerks,
    states,
)
from replan.planners.rules import Rulebook, RuleMemory

# Weight of each metre short of a stop that the rules require, so that the ego stops visibly at that
# place
SHORT = 4.0
STOP_S = 1.0  # The ego brakes for a stop that the rules demand from this time, s ...
STOP_M = 2.0  # ... and this distance, m, before gentle braking would have to begin.
NEAR_M = 30.0  # Agents that stay farther than this from the ego's reach are left out, m
Row = tuple[float, float, float, float, float, float, float]
"""A longitudinal polynomial: c3, c4, c5, duration, end speed, missed distance, track or -1."""


Durations = Annotated[tuple[Annotated[float, Meta(ge=STEP_S)], ...], Meta(min_length=1)]
"""Durations of polynomials, s."""


@dataclass(frozen=True)
class LatticeConfig(Config):
    """Settings of `lattice`; in brackets the names of `candidates`, (4) and (5)."""

    speeds: Annotated[int, Meta(ge=2)] = 8
    """Number of end speeds between 0 and the wanted one."""
    durations_s: Durations = (2.0, 3.0, 4.0, 6.0, 8.0)
    """Durations of longitudinal polynomials (T)."""
    lateral_durations_s: Durations = (2.5, 4.0, 6.0)
    """Durations of lateral polynomials (T_l)."""
    offset_spacing_m: Positive = 0.5
    """Distance between two end offsets."""
    w_jerk: NotNegative = 1.0
    """Weight of the squared jerk (k_j)."""
    w_time: NotNegative = 1.0
    """Weight of the duration (k_t)."""
    w_offset: NotNegative = 2.0
    """Weight of the squared offset at the end (k_l)."""
    w_speed: NotNegative = 1.0
    """Weight of the squared difference from the wanted speed (k_v)."""
    w_point: NotNegative = 0.1
    """Weight of the squared distance to a stopping point (k_s)."""
    w_gap: NotNegative = 150.0
    """Weight of a gap that is smaller than the wanted one (k_gap)."""
    w_lateral: NotNegative = 1.0
    """Weight of the lateral part (K_LAT)."""
    w_lateral_time: NotNegative = 0.1
    """Weight of the lateral duration (k_u); small, so that an offset of `offset_spacing_m` is
    undone.
    """
    standstill_gap_m: NotNegative = 2.0
    """Wanted gap at standstill (g0)."""
    time_gap_s: NotNegative = 1.2
    """Wanted time gap (tau)."""
    accel_mps2: NotNegative = 2.5
    """Greatest acceleration."""
    decel_mps2: NotNegative = 7.5
    """Greatest deceleration, positive."""
    lat_accel_mps2: NotNegative = 4.0
    """Greatest lateral acceleration."""
    curve_accel_mps2: NotNegative = 2.5
    """Lateral acceleration of the wanted speed in curves."""
    ease_mps2: NotNegative = 1.5
    """Deceleration towards lower limits and curves."""
    margin_m: NotNegative = 0.3
    """Distance to vehicles and objects."""
    vulnerable_margin_m: NotNegative = 0.5
    """Distance to pedestrians and riders."""
    edge_m: NotNegative = 0.1
    """Distance to the road's edge."""


def ego_frenet(scene: Scene) -> FrenetStart:
    """The start in the Frenet frame: the inverse of `candidates.states`.

    Near standstill it drops a deceleration that would soon make the ego reverse.
    """
    line, start = scene.reference.line, scene.start
    s0, l0, (_, dl0, _) = scene.s, scene.l, scene.frenet
    _, _, yaw_r, kappa_r = line.frame(s0)
    R, turn = 1.0 - kappa_r * l0, wrap(start.yaw - yaw_r)
    speed = max(start.v, 0.0) * cos(turn) / R
    dkappa_r = curvature_slope(line, s0)
    turning = R * tan(turn) * (start.kappa * R / cos(turn) - kappa_r) - (
        dkappa_r * l0 + kappa_r * dl0
    )
    accel = (start.a - speed**2 / cos(turn) * turning) * cos(turn) / R
    return FrenetStart(s0, scene.frenet, speed, max(accel, -6.0 * speed))


def futures_of(scene: Scene, ego: FrenetStart, config: LatticeConfig) -> NearFutures:
    """The predicted agents of a scene on the plan's grid of times.

    Before and after the predictions they stay.
    """
    frame, start = scene.frame, scene.start
    line, car = scene.reference.line, scene.vehicle
    agents, futures = frame.agents, frame.predictions
    reach = HORIZON_STEPS * STEP_S * (ego.speed + 3.0) + NEAR_M  # farther than the ego can get
    within_reach = (line.s > ego.s - NEAR_M) & (line.s < ego.s + reach)
    points = np.vstack([line.xy[within_reach], [[start.x, start.y]]])
    low, high = points.min(axis=0) - NEAR_M, points.max(axis=0) + NEAR_M
    near = np.zeros(len(futures), np.bool_)
    if len(futures):
        near = (futures.x.max(axis=1) > low[0]) & (futures.x.min(axis=1) < high[0])
        near &= (futures.y.max(axis=1) > low[1]) & (futures.y.min(axis=1) < high[1])
    used = np.flatnonzero(near)
    agent, t = futures.agent[used], futures.t - frame.t
    times = np.clip(STEP_S * np.arange(HORIZON_KNOTS), t[0], t[-1])
    before = np.clip(np.searchsorted(t, times + 1e-9) - 1, 0, max(len(t) - 2, 0))
    after = np.minimum(before + 1, len(t) - 1)
    share = (times - t[before]) / np.where(after > before, t[after] - t[before], 1.0)
    rows = np.stack([futures.x[used], futures.y[used], futures.yaw[used]])
    pose = np.ascontiguousarray(
        rows[:, :, before] + share * (rows[:, :, after] - rows[:, :, before])
    )
    sizes = np.vstack([agents.length[agent], agents.width[agent], np.zeros(len(agent))])
    x, y = start.ahead(car.axle_to_center)
    for j, i in enumerate(agent):
        margin = config.vulnerable_margin_m if scene.vulnerable[i] else config.margin_m
        length, width = car.length + 2.0 * margin, car.width + 2.0 * margin
        px, py, yaw = pose[:, j, 0]
        is_near = overlap(x, y, start.yaw, length, width, px, py, yaw, sizes[0, j], sizes[1, j])
        sizes[2, j] = 0.0 if is_near else margin  # no margin to agents that are nearer already
    thin = [np.ascontiguousarray(rows[:, ::STRIDE]) for rows in pose]
    frenet = futures_frenet(line.s, line.coef, thin[0], thin[1], thin[2], sizes, ego.s)
    speed = (frenet[0, :, 1] - frenet[0, :, 0]) / (STRIDE * STEP_S)
    follow = np.array([behind(scene, keeps_track=keeps)[agent] for keeps in (True, False)])
    return NearFutures(agent, pose, frenet, speed, sizes, follow)


class Sampler:
    """Makes the pairs along one reference: `limit` is the speed limit along its line, curves
    included, m/s.

    `left` is the greatest offset of the rear axle along it, m, `right` the least.
    """

    def __init__(
        self,
        reference: ReferencePath,
        vehicle: VehicleParameters,
        config: LatticeConfig,
        *,
        passes_left: bool,
    ) -> None:
        self._reference, self._vehicle, self._config = reference, vehicle, config
        self._first_side = 1.0 if passes_left else -1.0
        line = reference.line
        self.limit = limit_profile(
            line.s, line.kappa, reference.limit, config.curve_accel_mps2, config.ease_mps2
        )
        side, middle = (
            0.5 * vehicle.width + config.edge_m,
            0.5 * (reference.road_left + reference.road_right),
        )
        self.left = np.maximum(reference.road_left - side, middle)
        self.right = np.minimum(reference.road_right + side, middle)

    def pairs(
        self, ego: FrenetStart, futures: NearFutures, stops: Sequence[Occupancy] = ()
    ) -> Pairs:
        """All longitudinal polynomials that keep limits and stops, each with all lateral ones of
        its tracks.
        """
        config, stations, aim = self._config, self._reference.line.s, open_end(stops)
        spacing, ahead = config.offset_spacing_m, ego.s + 2.0 * ego.speed + 10.0
        left, right = (float(np.interp(ahead, stations, edge)) for edge in (self.left, self.right))
        count = max(floor(left / spacing), floor(-right / spacing), 0)
        all_offsets = [
            side * k * spacing
            for k in range(1, count + 1)
            for side in (self._first_side, -self._first_side)
        ]
        # The middle first
        offsets = np.array([0.0, *(offset for offset in all_offsets if right <= offset <= left)])
        rests = aim < ego.speed * STOP_S + 0.5 * ego.speed**2 / config.ease_mps2 + STOP_M
        soon = np.linspace(ego.s, ego.s + 3.0 * ego.speed + 5.0, 8)  # within the next 3 s
        wanted_speed = 0.0 if rests else float(np.interp(soon, stations, self.limit).min())
        rows = [
            *self._keeping(ego, wanted_speed, aim if rests else np.inf),
            *self._reaching(ego, futures, offsets),
        ]
        c3, c4, c5, duration, end_speed, missed, track = np.array(rows).T.copy()
        start = (0.0, ego.speed, 0.5 * ego.accel)
        coef = np.column_stack([np.tile(start, (len(rows), 1)), c3, c4, c5])
        lon = Longitudinal(coef, duration, end_speed, missed, track.astype(np.int64))
        motion = sample_polynomials(lon.coef, lon.T, HORIZON_STEPS)
        allowed = (
            braking(ego.speed, ego.accel, config.ease_mps2, 3.0, STEP_S, HORIZON_KNOTS)[1] + 0.3
        )
        bounds, t = (
            np.array([config.accel_mps2, config.decel_mps2, 0.5]),
            STEP_S * np.arange(HORIZON_KNOTS),
        )
        upper = upper_bound(stops, t, np.inf)  # the greatest station that the rules permit
        if not rests:  # a far, open stop binds for `STOP_S`
            timed = upper_bound([stop for stop in stops if stop.until < np.inf], t, np.inf)
            upper = np.where(t < STOP_S, upper, timed)
        faults = speed_faults(motion, ego.s, stations, self.limit, allowed, upper, bounds)
        pairs = np.where(lon.track < 0, len(offsets), 1) * len(config.lateral_durations_s)
        counts = np.bincount(faults, weights=pairs, minlength=len(Fault)).astype(np.int64)
        counts[Fault.NONE] = 0
        fit = faults == Fault.NONE
        fitting = Longitudinal(*(column[fit] for column in lon))
        return self._pair_candidates(
            ego, futures, fitting, motion[fit], offsets, wanted_speed, counts
        )

    def _keeping(self, ego: FrenetStart, wanted_speed: float, aim: float) -> list[Row]:
        """Polynomials to speeds up to the wanted one, to the ego's own speed, and to rest, from
        gentle to hard braking.

        Where the rules demand a stop at `aim`, m (inf: none), rows that end before it miss it;
        further rows reach it.
        """
        config, rows = self._config, list[Row]()
        speeds = [*np.linspace(0.0, wanted_speed, config.speeds), min(ego.speed, wanted_speed)]
        decels = (0.4 * config.ease_mps2, config.ease_mps2, 3.0, 5.0, 0.95 * config.decel_mps2)
        ends = [(v1, T) for v1 in speeds for T in config.durations_s]
        # A cubic s_dot: 1.5 times the mean
        ends += [(0.0, max(1.5 * ego.speed / decel, 0.5)) for decel in decels]
        for v1, T in ends:
            c3, c4, c5 = keep_speed(ego.speed, ego.accel, v1, T)
            end = T * (ego.speed + T * (0.5 * ego.accel + T * (c3 + T * (c4 + T * c5))))
            rows.append(
                (c3, c4, c5, T, v1, SHORT * max(aim - end, 0.0) if aim < np.inf else 0.0, -1.0)
            )
        if 0.0 < aim < np.inf:
            rows += [
                (*reach_point(ego.speed, ego.accel, aim, 0.0, T), T, 0.0, 0.0, -1.0)
                for T in config.durations_s
            ]
        return rows

    def _reaching(self, ego: FrenetStart, futures: NearFutures, offsets: FloatArray) -> list[Row]:
        """Points behind the first agent on each track at time T: at the wanted gap, and nearer."""
        config, car, rows = self._config, self._vehicle, list[Row]()
        if not len(futures.agent):
            return rows
        samples = [
            min(round(T / (STRIDE * STEP_S)), futures.frenet.shape[2] - 1)
            for T in config.durations_s
        ]
        s, l, half_s, half_l = futures.frenet[:, :, samples]
        is_ahead = ((futures.frenet[0, :, 0] > ego.s) & ~futures.behind[0])[:, None]
        for track, offset in enumerate(offsets.tolist()):
            on_track = np.abs(l - offset) < half_l + (0.5 * car.width + config.margin_m)
            rears = np.where(on_track & is_ahead, s - half_s, np.inf)
            for T, leader, rear in zip(
                config.durations_s, np.argmin(rears, axis=0), rears.min(axis=0), strict=True
            ):
                if not np.isfinite(rear):
                    continue
                v1 = max(float(futures.speed[leader]), 0.0)
                for share in (1.0, 0.5):
                    time_gap = share * config.time_gap_s * v1
                    s1 = rear - (ego.s + car.axle_to_front) - config.standstill_gap_m - time_gap
                    if s1 > 0.0 or v1 > 0.0:
                        c3, c4, c5 = reach_point(ego.speed, ego.accel, s1, v1, T)
                        rows.append((c3, c4, c5, T, v1, config.time_gap_s * v1 - time_gap, track))
        return rows

    def _pair_candidates(
        self,
        ego: FrenetStart,
        futures: NearFutures,
        lon: Longitudinal,
        motion: FloatArray,
        offsets: FloatArray,
        wanted_speed: float,
        faults: IntArray,
    ) -> Pairs:
        """The pairs with their costs (`candidates`, (4))."""
        c, car = self._config, self._vehicle
        T = np.array(c.lateral_durations_s)
        jerk = squared_jerks(lon.coef, lon.T)
        own_costs = np.array(
            [
                c.w_jerk * jerk,
                c.w_time * lon.T,
                c.w_speed * (lon.v1 - wanted_speed) ** 2 + c.w_point * lon.missed**2,
            ]
        )
        box = np.array([car.axle_to_front, car.rear_overhang, 0.5 * car.width])
        gaps, weights = (
            np.array([c.standstill_gap_m, c.time_gap_s]),
            np.array([c.w_jerk, c.w_lateral_time, c.w_offset]),
        )
        columns, costs = [], []
        for track, offset in enumerate(offsets):
            rows = np.flatnonzero((lon.track < 0) | (lon.track == track))
            moves = abs(float(offset) - ego.lateral[0]) > TRACK_M
            tracked = motion[rows]
            missing = headway(
                tracked,
                ego.s,
                futures.frenet,
                futures.speed,
                futures.behind,
                offset,
                box,
                gaps,
                moves,
            )
            sideways, D = lateral_costs(tracked, np.array(ego.lateral), offset, T, weights)
            n = len(rows) * len(T)
            pairs = (np.repeat(rows, len(T)), np.full(n, offset), D.ravel(), np.full(n, moves))
            columns.append(pairs)
            lateral = np.array(
                [c.w_lateral * sideways.ravel(), np.repeat(c.w_gap * missing, len(T))]
            )
            costs.append(np.vstack([np.repeat(own_costs[:, rows], len(T), axis=1), lateral]))
        row, l1, length, changes = (np.concatenate(column) for column in zip(*columns, strict=True))
        return Pairs(lon, row, l1, length, changes, np.concatenate(costs, axis=1), faults)


class Lattice:
    """Chooses among pairs of polynomials; its memory is the last station and the memory of the
    rules.

    Where no pair is feasible, it uses the ladder of `replan.planners.frenet.profiles`: the rest of
    the previous plan, else a comfortable stop, else a hard one. Agents behind are ignored while the
    ego keeps its track.
    """

    def __init__(self, context: PlannerContext, config: LatticeConfig | None = None) -> None:
        self._config = config or LatticeConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        self._rules = Rulebook(context.road, self._tracker.reference, context.vehicle)
        self._memory = RuleMemory()
        passes_left = context.road.drives_on_right
        self._sampler = Sampler(
            self._tracker.reference, self._vehicle, self._config, passes_left=passes_left
        )
        self._margins = StGraphConfig(
            self._config.margin_m, self._config.vulnerable_margin_m, early_s=0.0, late_s=0.0
        )

    def plan(self, frame: Frame) -> Plan:
        """Return the cheapest feasible pair (the first of equals).

        Else the fallback and the reason.
        """
        scene, start_kind = self._tracker.scene(frame)
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, scene.start, start_kind, None, scene.trouble, (), self._vehicle)
        ego = ego_frenet(scene)
        futures = futures_of(scene, ego, self._config)
        self._lap("scene")
        demanded, self._memory = self._rules.stops(scene, self._memory)
        stops = on_reference(demanded, scene.s, self._vehicle)
        pairs = self._sampler.pairs(ego, futures, stops)
        self._lap("candidates")
        car, line = self._vehicle, self._tracker.reference.line
        order = np.argsort(np.round(pairs.costs.sum(axis=0), 9), kind="stable")
        room = Room(line.s, line.coef, self._sampler.left, self._sampler.right)
        body = EgoLimits(
            car.axle_to_center, car.length, car.width, car.max_kappa, self._config.lat_accel_mps2
        )
        chosen, faults = first_feasible(pairs, order, ego, room, futures, body)
        dearer = len(pairs.row) - int(faults.sum()) - 1 if chosen >= 0 else 0
        counts = [(why, int((pairs.faults + faults)[fault])) for fault, why in REASONS.items()]
        counts = [count for count in (*counts, ("dearer than the chosen one", dearer)) if count[1]]
        counted = Candidates("lattice", len(pairs.row) + int(pairs.faults.sum()), tuple(counts))
        self._lap("choice")
        if chosen < 0:
            reason = "no candidate can be driven: " + ", ".join(
                f"{n} {why}" for why, n in counted.rejected
            )
            return fall_back(
                frame, scene.start, start_kind, None, reason, (counted,), self._vehicle
            )
        row = int(pairs.row[chosen])
        motion = sample_polynomials(
            pairs.lon.coef[row, None], pairs.lon.T[row, None], HORIZON_STEPS
        )[0]
        lateral = lateral_polynomial(np.array(ego.lateral), pairs.l1[chosen], pairs.length[chosen])
        drive = states(line.s, line.coef, scene.s, lateral, pairs.length[chosen], motion)
        x, y, yaw, v, a, kappa = drive[: KAPPA + 1]
        rests = v < 1e-3  # standstill is exact
        t = frame.t + STEP_S * np.arange(len(v))
        v = np.where(rests, 0.0, v)
        a = np.where(rests & (np.abs(a) < REST_MPS), 0.0, a)

        def internals() -> tuple[Artefact, ...]:
            pair = ChosenPair(scene, ego, futures, pairs, chosen, drive, motion)
            drawn = make_artefacts(pair, self._margins)
            return (*drawn, *(stop.decision for stop in stops), counted)

        trajectory = Trajectory(t, x, y, yaw, v, a, kappa)
        return Plan(trajectory, start=start_kind, internals=Internals((), internals))
