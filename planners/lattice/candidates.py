"""Which polynomials are tried, and what each pair costs.

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
from math import floor

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.vehicle import VehicleParameters
from planners.frenet.occupancy import Occupancy, open_end, upper_bound
from planners.frenet.profiles import HORIZON_KNOTS, HORIZON_STEPS, STEP_S, braking, limit_profile
from planners.frenet.quintic import quintic
from planners.frenet.reference_path import ReferencePath
from planners.frenet.scene import TRACK_M
from planners.lattice.checks import REST_MPS, Fault, speed_faults
from planners.lattice.config import LatticeConfig
from planners.lattice.futures import STRIDE, Ego, Futures
from planners.lattice.polynomials import LEAST_M, keep_speed, reach_point, sampled, third_square

SIDE_M = 0.1
"""Who is nearer than this beside a track is on it."""
SHORT = 4.0
"""A metre short of a stop that the rules demand counts as so many: who rests there should be seen to have stopped."""
STOP_S = 1.0
"""The ego brakes for a stop that the rules demand so long, s ..."""
STOP_M = 2.0
"""... and so far, m, before gentle braking would have to begin."""
COST_PARTS = ("jerk along", "time", "speed", "sideways", "gap")
"""The terms of (1) as a recording names them."""


@dataclass(frozen=True, eq=False, slots=True)
class Longitudinal:
    """Longitudinal polynomials that keep the limits, m of them.

    Attributes:
        coef: `(m, 6)`, lowest power first.
        T: Durations `(m,)`, s.
        v1: End speeds `(m,)`, m/s.
        missed: What they miss their wanted point by `(m,)`, m.
        track: Index of the end offset that they belong to `(m,)`, -1 where to any.
    """

    coef: FloatArray
    T: FloatArray
    v1: FloatArray
    missed: FloatArray
    track: IntArray

    def picked(self, at: BoolArray) -> Longitudinal:
        """Those where `at` `(m,)`."""
        return Longitudinal(*(getattr(self, name)[at] for name in ("coef", "T", "v1", "missed", "track")))


@dataclass(frozen=True, eq=False, slots=True)
class Pairs:
    """Candidates, n of them: a row of `Longitudinal`, and where and how long they move sideways.

    Attributes:
        lon: The longitudinal polynomials.
        row: `(n,)` index into `lon`.
        l1: End offset `(n,)`, m; `length` D of the lateral polynomial.
        length: `(n,)` m.
        changes: `(n,)` whether the end is on another track.
        costs: (1) by `COST_PARTS` `(5, n)`.
        faults: How many pairs were not made, since their longitudinal polynomial breaks a limit.
    """

    lon: Longitudinal
    row: IntArray
    l1: FloatArray
    length: FloatArray
    changes: BoolArray
    costs: FloatArray
    faults: IntArray

    def __len__(self) -> int:
        return len(self.row)


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
        aim = open_end(stops)
        rests = aim < ego.speed * STOP_S + 0.5 * ego.speed**2 / config.ease_mps2 + STOP_M
        wanted, offsets = 0.0 if rests else self._wanted_speed(ego), self._offsets(ego)
        keeping = _keeping(ego, wanted, config)
        if rests:
            keeping = [replace(row, missed=SHORT * max(aim - _end(ego, row), 0.0)) for row in keeping]
            keeping += _resting(ego, aim, config)
        lon = _stacked(ego, [*keeping, *self._reaching(ego, futures, offsets)])
        motion = sampled(lon.coef, lon.T, HORIZON_STEPS)
        allowed = braking(ego.speed, ego.accel, config.ease_mps2, 3.0, STEP_S, HORIZON_KNOTS)[1] + 0.3
        bounds = np.array([config.accel_mps2, config.decel_mps2, 0.5])
        faults = speed_faults(motion, ego.s, stations, self.limit, allowed, _kept(stops, rests=rests), bounds)
        each = np.where(lon.track < 0, len(offsets), 1) * len(config.lateral_durations_s)
        counts = np.bincount(faults, weights=each, minlength=len(Fault)).astype(np.int64)
        counts[Fault.NONE] = 0
        fit = faults == Fault.NONE
        return self._paired(ego, futures, lon.picked(fit), motion[fit], offsets, wanted, counts)

    def _wanted_speed(self, ego: Ego) -> float:
        """The least limit within the next 3 s."""
        s = np.linspace(ego.s, ego.s + 3.0 * ego.speed + 5.0, 8)
        return float(np.interp(s, self._reference.line.s, self.limit).min())

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


def _keeping(ego: Ego, wanted: float, config: LatticeConfig) -> list[Row]:
    """Polynomials to speeds up to the wanted one, also the ego's own; and rests, from gentle to as hard as allowed."""
    speeds = [*np.linspace(0.0, wanted, config.speeds), min(ego.speed, wanted)]
    rows = [Row(keep_speed(ego.speed, ego.accel, v1, T), T, v1) for v1 in speeds for T in config.durations_s]
    for decel in (0.4 * config.ease_mps2, config.ease_mps2, 3.0, 5.0, 0.95 * config.decel_mps2):
        T = max(1.5 * ego.speed / decel, 0.5)  # the hardest braking of the cubic s_dot is 1.5 times the mean
        rows.append(Row(keep_speed(ego.speed, ego.accel, 0.0, T), T, 0.0))
    return rows


def _resting(ego: Ego, aim: float, config: LatticeConfig) -> list[Row]:
    """Polynomials that come to rest `aim` m ahead."""
    if aim <= 0.0:
        return []
    return [Row(reach_point(ego.speed, ego.accel, aim, 0.0, T), T, 0.0) for T in config.durations_s]


def _kept(stops: Sequence[Occupancy], *, rests: bool) -> FloatArray:
    """How far the traffic rules let the ego go `(HORIZON_KNOTS,)`, m; far from an open stop only at first."""
    t = STEP_S * np.arange(HORIZON_KNOTS)
    upper = upper_bound(stops, t, np.inf)
    if rests:
        return upper
    timed = upper_bound([stop for stop in stops if stop.until < np.inf], t, np.inf)
    return np.where(t < STOP_S, upper, timed)


def _end(ego: Ego, row: Row) -> float:
    """Where a polynomial ends, m from the start."""
    c3, c4, c5 = row.polynomial
    return row.T * (ego.speed + row.T * (0.5 * ego.accel + row.T * (c3 + row.T * (c4 + row.T * c5))))


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
