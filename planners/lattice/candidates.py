"""Which polynomials are tried in a scene, and what each pair costs.

Cost of a pair, Delta s being what it misses its wanted point by:

(1) J = K_LAT (k_j J_l + k_u T_l + k_l l1^2) + k_j J_s + k_t T + k_v (v1 - v_wanted)^2 + k_s (Delta s)^2 + k_gap H
    J_s = integral of s_dddot^2 dt
    J_l = (D / T_l)^5 integral of l'''^2 ds, which is the integral of l_dddot^2 dt at constant speed
(2) H = mean over the horizon, sum over the agents on the track of l1, of  max(0, 1 - gap / (g0 + tau v))^2: the share
    of the wanted gap that is missing, to who is ahead, and, where the track changes, to who is behind

Where the traffic rules demand a stop soon, v_wanted is 0, and a pair that ends before that place misses it. All but H
is Werling's. Without H, a pair that ends a hand's breadth behind its leader would be as good as any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, floor, sin, tan

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.road import line_frame, line_project
from logs.shapes import overlap
from logs.states import wrap
from logs.vehicle import VehicleParameters
from planners.frenet.occupancy import Occupancy, open_end, upper_bound
from planners.frenet.path import quintic
from planners.frenet.profiles import HORIZON_KNOTS, HORIZON_STEPS, STEP_S, braking, limit_profile
from planners.frenet.reference_path import ReferencePath
from planners.frenet.scene import TRACK_M, Scene, behind
from planners.lattice.checks import (
    LEAST_M,
    REST_MPS,
    Ego,
    Fault,
    Futures,
    Longitudinal,
    Pairs,
    keep_speed,
    reach_point,
    sampled,
    speed_faults,
    third_square,
)

SIDE_M = 0.1
"""Who is nearer than this beside a track is on it."""
SHORT = 4.0
"""Weight of each metre short of a stop that the rules require: the ego should visibly have stopped there."""
STOP_S = 1.0
"""The ego brakes for a stop that the rules demand so long, s ..."""
STOP_M = 2.0
"""... and so far, m, before gentle braking would have to begin."""
COST_PARTS = ("jerk along", "time", "speed", "sideways", "gap")
"""The terms of (1) as a recording names them."""
STRIDE = 4
"""Samples of the plan per sample of the others' Frenet coordinates."""
NEAR_M = 30.0
"""Who stays farther than this from what the ego can reach is not in the scene."""


@dataclass(frozen=True)
class LatticeConfig:
    """Settings of `lattice`; in brackets the names of (1) and (2).

    Attributes:
        speeds: Number of end speeds between 0 and the wanted one.
        durations_s: Of longitudinal polynomials (T).
        lateral_durations_s: Of lateral ones (T_l).
        offset_spacing_m: Between two end offsets.
        w_jerk: Weight k_j; `w_time` k_t, `w_offset` k_l, `w_speed` k_v, `w_point` k_s, `w_gap` k_gap.
        w_lateral: Weight of the lateral part (K_LAT).
        w_lateral_time: Weight of the lateral duration (k_u): so small that an offset of `offset_spacing_m` is undone.
        standstill_gap_m: Wanted gap at standstill (g0).
        time_gap_s: Wanted time gap (tau).
        accel_mps2: Greatest acceleration.
        decel_mps2: Hardest deceleration, positive.
        lat_accel_mps2: Greatest lateral acceleration.
        curve_accel_mps2: Lateral acceleration from which the wanted speed in curves comes.
        ease_mps2: Deceleration towards lower limits and curves.
        margin_m: To vehicles and objects; `vulnerable_margin_m` to pedestrians and riders.
        edge_m: To the road's edge.
    """

    speeds: int = 8
    durations_s: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0, 8.0)
    lateral_durations_s: tuple[float, ...] = (2.5, 4.0, 6.0)
    offset_spacing_m: float = 0.5
    w_jerk: float = 1.0
    w_time: float = 1.0
    w_offset: float = 2.0
    w_speed: float = 1.0
    w_point: float = 0.1
    w_gap: float = 150.0
    w_lateral: float = 1.0
    w_lateral_time: float = 0.1
    standstill_gap_m: float = 2.0
    time_gap_s: float = 1.2
    accel_mps2: float = 2.5
    decel_mps2: float = 7.5
    lat_accel_mps2: float = 4.0
    curve_accel_mps2: float = 2.5
    ease_mps2: float = 1.5
    margin_m: float = 0.3
    vulnerable_margin_m: float = 0.5
    edge_m: float = 0.1

    def __post_init__(self) -> None:
        if self.speeds < 2 or not self.durations_s or not self.lateral_durations_s or not self.offset_spacing_m > 0.0:
            raise ValueError("lattice needs two speeds, durations and a positive offset_spacing_m")
        if min((*self.durations_s, *self.lateral_durations_s)) < STEP_S:
            raise ValueError(f"lattice durations must be at least {STEP_S} s")


def ego_frenet(scene: Scene) -> Ego:
    """The start in the Frenet frame: `checks.states` read backwards.

    Near standstill a deceleration that would soon be a reverse is not taken over.
    """
    line, start, s0, l0, lateral = scene.reference.line, scene.start, scene.s, scene.l, scene.frenet
    _, _, yaw_r, kappa_r = line.frame(s0)
    R, turn = 1.0 - kappa_r * l0, wrap(start.yaw - yaw_r)
    speed = max(start.v, 0.0) * cos(turn) / R
    dkappa_r = 2.0 * (line.frame(s0 + 0.25)[3] - line.frame(s0 - 0.25)[3])
    turning = R * tan(turn) * (start.kappa * R / cos(turn) - kappa_r) - (dkappa_r * l0 + kappa_r * lateral[1])
    accel = (start.a - speed**2 / cos(turn) * turning) * cos(turn) / R
    return Ego(s0, lateral, speed, max(accel, -6.0 * speed))


def futures_of(scene: Scene, ego: Ego, config: LatticeConfig) -> Futures:
    """The others of a scene as they are predicted."""
    frame, start, line, car = scene.frame, scene.start, scene.reference.line, scene.vehicle
    agents, futures = frame.agents, frame.predictions
    used = _near(scene, ego)
    agent = futures.agent[used]
    pose = _on_grid(futures.t - frame.t, np.stack([futures.x[used], futures.y[used], futures.yaw[used]]))
    sizes = np.vstack([agents.length[agent], agents.width[agent], np.zeros(len(agent))])
    x, y = start.x + car.axle_to_center * cos(start.yaw), start.y + car.axle_to_center * sin(start.yaw)
    for j, i in enumerate(agent):
        margin = config.vulnerable_margin_m if scene.vulnerable[i] else config.margin_m
        length, width = car.length + 2.0 * margin, car.width + 2.0 * margin
        px, py, yaw = pose[:, j, 0]
        is_near = overlap(x, y, start.yaw, length, width, px, py, yaw, sizes[0, j], sizes[1, j])
        sizes[2, j] = 0.0 if is_near else margin  # nothing is kept to who is nearer already
    thin = [np.ascontiguousarray(rows[:, ::STRIDE]) for rows in pose]
    frenet = futures_frenet(line.s, line.coef, thin[0], thin[1], thin[2], sizes, ego.s)
    speed = (frenet[0, :, 1] - frenet[0, :, 0]) / (STRIDE * STEP_S)
    follow = [behind(scene, keeps_track=keeps) for keeps in (True, False)]
    return Futures(agent, pose, frenet, speed, sizes, np.array([rows[agent] for rows in follow]))


def _near(scene: Scene, ego: Ego) -> IntArray:
    """The predictions that come near the reference line as far as the ego can get."""
    line, futures, start = scene.reference.line, scene.frame.predictions, scene.start
    if not len(futures):
        return np.empty(0, np.int64)
    reach = HORIZON_STEPS * STEP_S * (ego.speed + 3.0) + NEAR_M
    way = np.vstack([line.xy[(line.s > ego.s - NEAR_M) & (line.s < ego.s + reach)], [[start.x, start.y]]])
    low, high = way.min(axis=0) - NEAR_M, way.max(axis=0) + NEAR_M
    near = (futures.x.max(axis=1) > low[0]) & (futures.x.min(axis=1) < high[0])
    near &= (futures.y.max(axis=1) > low[1]) & (futures.y.min(axis=1) < high[1])
    return np.flatnonzero(near)


def _on_grid(t: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows `(3, n, k)` at times `t` `(k,)` from the frame, at `HORIZON_KNOTS` times every `STEP_S`; the ends hold."""
    at = np.clip(STEP_S * np.arange(HORIZON_KNOTS), t[0], t[-1])
    first = np.clip(np.searchsorted(t, at + 1e-9) - 1, 0, max(len(t) - 2, 0))
    after = np.minimum(first + 1, len(t) - 1)
    span = np.where(after > first, t[after] - t[first], 1.0)
    u = (at - t[first]) / span
    return np.ascontiguousarray(rows[:, :, first] + u * (rows[:, :, after] - rows[:, :, first]))


@kernel
def futures_frenet(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, sizes: FloatArray, s_ego: float
) -> FloatArray:
    """Predictions `(n, k)` in the Frenet frame: s, l, half length along s, half width along l `(4, n, k)`."""
    out = np.empty((4, x.shape[0], x.shape[1]))
    for i in range(len(x)):
        guess, window = s_ego, 150.0
        for k in range(x.shape[1]):
            s, l = line_project(knots, coef, x[i, k], y[i, k], guess, window)  # noqa: E741
            guess, window = s, 25.0
            turn = yaw[i, k] - line_frame(knots, coef, s)[2]
            c, d = abs(cos(turn)), abs(sin(turn))
            out[0, i, k], out[1, i, k] = s, l
            out[2, i, k] = 0.5 * (sizes[0, i] * c + sizes[1, i] * d)
            out[3, i, k] = 0.5 * (sizes[0, i] * d + sizes[1, i] * c)
    return out


class Sampler:
    """Makes the pairs along one reference.

    Attributes:
        left: Greatest offset of the rear axle along the reference line, m; `right` the least.
        limit: Speed limit along it, curves included, m/s.
    """

    def __init__(
        self, reference: ReferencePath, vehicle: VehicleParameters, config: LatticeConfig, *, passes_left: bool
    ) -> None:
        self._reference, self._vehicle, self._config = reference, vehicle, config
        self._first_side = 1.0 if passes_left else -1.0
        line = reference.line
        self.limit = limit_profile(line.s, line.kappa, reference.limit, config.curve_accel_mps2, config.ease_mps2)
        side, middle = 0.5 * vehicle.width + config.edge_m, 0.5 * (reference.road_left + reference.road_right)
        self.left = np.maximum(reference.road_left - side, middle)
        self.right = np.minimum(reference.road_right + side, middle)

    def pairs(self, ego: Ego, futures: Futures, stops: Sequence[Occupancy] = ()) -> Pairs:
        """Every longitudinal polynomial that keeps limits and stops, with every lateral one of its tracks."""
        config, stations = self._config, self._reference.line.s
        aim, offsets = open_end(stops), self._offsets(ego)
        rests = aim < ego.speed * STOP_S + 0.5 * ego.speed**2 / config.ease_mps2 + STOP_M
        soon = np.linspace(ego.s, ego.s + 3.0 * ego.speed + 5.0, 8)  # within the next 3 s
        wanted = 0.0 if rests else float(np.interp(soon, stations, self.limit).min())
        keeping = _keeping(ego, wanted, config)
        if rests:
            keeping = [replace(row, missed=SHORT * max(aim - row.end(ego), 0.0)) for row in keeping]
        if rests and aim > 0.0:
            keeping += [Row(reach_point(ego.speed, ego.accel, aim, 0.0, T), T, 0.0) for T in config.durations_s]
        lon = _stacked(ego, [*keeping, *self._reaching(ego, futures, offsets)])
        motion = sampled(lon.coef, lon.T, HORIZON_STEPS)
        allowed = braking(ego.speed, ego.accel, config.ease_mps2, 3.0, STEP_S, HORIZON_KNOTS)[1] + 0.3
        bounds = np.array([config.accel_mps2, config.decel_mps2, 0.5])
        faults = speed_faults(motion, ego.s, stations, self.limit, allowed, _kept(stops, rests=rests), bounds)
        each = np.where(lon.track < 0, len(offsets), 1) * len(config.lateral_durations_s)
        counts = np.bincount(faults, weights=each, minlength=len(Fault)).astype(np.int64)
        counts[Fault.NONE] = 0
        fit = faults == Fault.NONE
        kept = Longitudinal(*(column[fit] for column in lon))
        return self._paired(ego, futures, kept, motion[fit], offsets, wanted, counts)

    def _offsets(self, ego: Ego) -> FloatArray:
        """End offsets `(o,)` that are on the road soon: the middle first, then pairs, the passing side first."""
        spacing = self._config.offset_spacing_m
        soon = ego.s + 2.0 * ego.speed + 10.0
        left, right = (float(np.interp(soon, self._reference.line.s, edge)) for edge in (self.left, self.right))
        count = max(floor(left / spacing), floor(-right / spacing), 0)
        both = [side * k * spacing for k in range(1, count + 1) for side in (self._first_side, -self._first_side)]
        return np.array([0.0, *(offset for offset in both if right <= offset <= left)])

    def _reaching(self, ego: Ego, futures: Futures, offsets: FloatArray) -> list[Row]:
        """Points behind whoever is first on each track when T has passed: at the wanted gap, and nearer."""
        config, car, rows = self._config, self._vehicle, []
        nose = ego.s + car.axle_to_front
        samples = [min(round(T / (STRIDE * STEP_S)), futures.frenet.shape[2] - 1) for T in config.durations_s]
        for track, offset in enumerate(offsets):
            first, rear = _leaders(futures, ego, float(offset), 0.5 * car.width + config.margin_m, samples)
            for T, leader, ahead in zip(config.durations_s, first, rear, strict=True):
                if not np.isfinite(ahead):
                    continue
                v1 = max(float(futures.speed[leader]), 0.0)
                for share in (1.0, 0.5):
                    time_gap = share * config.time_gap_s * v1
                    s1 = ahead - nose - config.standstill_gap_m - time_gap
                    if s1 > 0.0 or v1 > 0.0:
                        polynomial = reach_point(ego.speed, ego.accel, s1, v1, T)
                        rows.append(Row(polynomial, T, v1, config.time_gap_s * v1 - time_gap, track))
        return rows

    def _paired(
        self, ego: Ego, futures: Futures, lon: Longitudinal, motion: FloatArray, offsets: FloatArray, wanted: float,
        faults: IntArray,
    ) -> Pairs:  # fmt: skip
        """The pairs with their costs (1)."""
        c, car = self._config, self._vehicle
        T = np.array(c.lateral_durations_s)
        jerk = squared_jerks(lon.coef, lon.T)
        own = np.array(
            [c.w_jerk * jerk, c.w_time * lon.T, c.w_speed * (lon.v1 - wanted) ** 2 + c.w_point * lon.missed**2]
        )  # (1)
        box = np.array([car.axle_to_front, car.rear_overhang, 0.5 * car.width])
        gaps, weights = np.array([c.standstill_gap_m, c.time_gap_s]), np.array([c.w_jerk, c.w_lateral_time, c.w_offset])
        row, l1, length, changes, costs = [], [], [], [], []
        for track, offset in enumerate(offsets):
            rows = np.flatnonzero((lon.track < 0) | (lon.track == track))
            moves = abs(float(offset) - ego.lateral[0]) > TRACK_M
            tracked = motion[rows]
            missing = headway(tracked, ego.s, futures.frenet, futures.speed, futures.behind, offset, box, gaps, moves)
            sideways, D = lateral_costs(tracked, np.array(ego.lateral), offset, T, weights)
            n = len(rows) * len(T)
            row.append(np.repeat(rows, len(T)))
            l1.append(np.full(n, offset))
            length.append(D.ravel())
            changes.append(np.full(n, moves))
            lateral = np.array([c.w_lateral * sideways.ravel(), np.repeat(c.w_gap * missing, len(T))])
            costs.append(np.vstack([np.repeat(own[:, rows], len(T), axis=1), lateral]))
        flat = [np.concatenate(part) for part in (row, l1, length, changes)]
        return Pairs(lon, flat[0], flat[1], flat[2], flat[3], np.concatenate(costs, axis=1), faults)


@dataclass(frozen=True, slots=True)
class Row:
    """One longitudinal polynomial: c3, c4, c5, duration, end speed, missed distance, track."""

    polynomial: tuple[float, float, float]
    T: float
    v1: float
    missed: float = 0.0
    track: int = -1

    def end(self, ego: Ego) -> float:
        """Where it ends, m from the start."""
        c3, c4, c5 = self.polynomial
        return self.T * (ego.speed + self.T * (0.5 * ego.accel + self.T * (c3 + self.T * (c4 + self.T * c5))))


def _keeping(ego: Ego, wanted: float, config: LatticeConfig) -> list[Row]:
    """Polynomials to speeds up to the wanted one, also the ego's own; and rests, from gentle to as hard as allowed."""
    speeds = [*np.linspace(0.0, wanted, config.speeds), min(ego.speed, wanted)]
    rows = [Row(keep_speed(ego.speed, ego.accel, v1, T), T, v1) for v1 in speeds for T in config.durations_s]
    for decel in (0.4 * config.ease_mps2, config.ease_mps2, 3.0, 5.0, 0.95 * config.decel_mps2):
        T = max(1.5 * ego.speed / decel, 0.5)  # the hardest braking of the cubic s_dot is 1.5 times the mean
        rows.append(Row(keep_speed(ego.speed, ego.accel, 0.0, T), T, 0.0))
    return rows


def _kept(stops: Sequence[Occupancy], *, rests: bool) -> FloatArray:
    """How far the traffic rules let the ego go `(HORIZON_KNOTS,)`, m; far from an open stop only at first."""
    t = STEP_S * np.arange(HORIZON_KNOTS)
    upper = upper_bound(stops, t, np.inf)
    if rests:
        return upper
    timed = upper_bound([stop for stop in stops if stop.until < np.inf], t, np.inf)
    return np.where(t < STOP_S, upper, timed)


def _stacked(ego: Ego, rows: Sequence[Row]) -> Longitudinal:
    return Longitudinal(
        np.array([(0.0, ego.speed, 0.5 * ego.accel, *row.polynomial) for row in rows]),
        np.array([row.T for row in rows]),
        np.array([row.v1 for row in rows]),
        np.array([row.missed for row in rows]),
        np.array([row.track for row in rows], np.int64),
    )


def _leaders(
    futures: Futures, ego: Ego, offset: float, side: float, samples: Sequence[int]
) -> tuple[IntArray, FloatArray]:
    """Who is first on a track at some samples `(t,)` of those that are ahead now, and its rear; inf: there is none."""
    if not len(futures.agent):
        return np.zeros(len(samples), np.int64), np.full(len(samples), np.inf)
    s, l, half_s, half_l = futures.frenet[:, :, samples]  # noqa: E741
    on_track = np.abs(l - offset) < half_l + side
    on_track &= ((futures.frenet[0, :, 0] > ego.s) & ~futures.behind[0])[:, None]
    rear = np.where(on_track, s - half_s, np.inf)
    return np.argmin(rear, axis=0), rear.min(axis=0)


@kernel
def squared_jerks(coef: FloatArray, T: FloatArray) -> FloatArray:
    """Integral of the squared third derivative of each polynomial `(m, 6)` over its duration `(m,)`."""
    out = np.empty(len(T))
    for i in range(len(T)):
        out[i] = third_square(coef[i, 3], coef[i, 4], coef[i, 5], T[i])
    return out


@kernel
def headway(
    motion: FloatArray, s0: float, others: FloatArray, speed: FloatArray, behind: BoolArray, l1: float,
    box: FloatArray, wanted: FloatArray, changes: bool,
) -> FloatArray:  # fmt: skip
    """(2) of longitudinal candidates `(m, 3, k)` on the track at offset `l1`: `(m,)`.

    Args:
        motion: As of `sampled`.
        s0: Station of the start.
        others: `futures_frenet`, every `STRIDE`-th sample.
        speed: Of the agents along the line `(n,)`, m/s.
        behind: `(2, n)`, as of `Futures`.
        l1: m.
        box: Rear axle to front, to rear, half width, m.
        wanted: g0, tau.
        changes: Whether the track is another than the ego's.
    """
    out = np.zeros(len(motion))
    for j in range(others.shape[1]):
        if behind[1, j] or (behind[0, j] and not changes):
            continue
        for k in range(others.shape[2]):
            if abs(others[1, j, k] - l1) > others[3, j, k] + box[2] + SIDE_M:
                continue
            for i in range(len(motion)):
                s, v = s0 + motion[i, 0, k * STRIDE], motion[i, 1, k * STRIDE]
                gap = others[0, j, k] - others[2, j, k] - s - box[0]
                if behind[0, j]:
                    gap, v = s - box[1] - others[0, j, k] - others[2, j, k], max(speed[j], 0.0)
                elif v < REST_MPS:
                    continue
                missing = 1.0 - max(gap, 0.0) / (wanted[0] + wanted[1] * v)
                out[i] += max(missing, 0.0) ** 2 / others.shape[2]  # (2)
    return out


@kernel
def lateral_costs(
    motion: FloatArray, start: FloatArray, l1: float, T: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The lateral part of (1), without K_LAT, and the lengths D, of the pairs with durations `T` `(p,)`: `(m, p)` each.

    Args:
        motion: `(m, 3, k)`, as of `sampled`.
        start: l, l', l''.
        l1: End offset, m.
        T: s.
        weights: k_j, k_u, k_l.
    """
    cost, length = np.empty((len(motion), len(T))), np.empty((len(motion), len(T)))
    for i in range(len(motion)):
        for p in range(len(T)):
            D = max(motion[i, 0, min(int(T[p] / STEP_S + 0.5), motion.shape[2] - 1)], LEAST_M)
            c3, c4, c5 = quintic(start[0], start[1], start[2], l1, D)
            jerk = third_square(c3, c4, c5, D) * (D / T[p]) ** 5  # (1), J_l
            cost[i, p], length[i, p] = weights[0] * jerk + weights[1] * T[p] + weights[2] * l1**2, D
    return cost, length
