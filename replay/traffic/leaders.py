"""The leader on a path, and the acceleration behind it.

Leader: the first agent that the vehicle's box, moved along its path, would touch within `LOOK_M` +
`LOOK_S` v, with the agents' boxes held where they are; boxes that touch already do not count. With
the gap s until they touch, the vehicle's speed v, the leader's speed v_l and acceleration a_l along
the path (Kesting, Treiber, Helbing, Phil. Trans. R. Soc. A 368, 2010, "enhanced IDM"; the cap of
the deceleration is ours):

(1) s*    = s0 + max(0, v T + v (v - v_l) / (2 sqrt(a b)))
(2) a_idm = a (1 - (s* / s)^2)
(3) a_cah = v^2 a_l / (v_l^2 - 2 s a_l)        if v_l (v - v_l) <= -2 s a_l,
        a_l cut to a at most
          = a_l - max(0, v - v_l)^2 / (2 s)    else
(4) dv/dt = a_idm                              if a_idm >= a_cah
          = (1 - c) a_idm + c (a_cah + b tanh((a_idm - a_cah) / b))
              else, and not below -`HARDEST_MPS2`

The ego is ahead of a vehicle where it is touched so, with its heading within `ASKEW_RAD` of the
path's heading h there, not reversing along h, and with its rearmost corner before the vehicle's
front bumper: with the vector d from the vehicle's centre, moved to the touch, to the ego's, the
angle q between h and the ego's heading, the lengths L and the ego's width W,

(5) s + d . h - (L_ego |cos q| + W_ego |sin q|) / 2 - L / 2 > 0

A vehicle that goes on as in its log drives into its leader where, within `LOOK_S`, its way w in the
log is so long that

(6) w(tau) >= s - `ROOM_M` + v_l tau + min(a_l, 0) tau^2 / 2
        (the last two no longer than until it stands)
"""

from __future__ import annotations

from math import cos, hypot, inf, pi, sin, sqrt, tanh
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.shapes import overlap
from replan.logs.tracks import Tracks
from replan.metrics.driver_models import CC_BRAKE_MPS2

ACCEL_MPS2, DECEL_MPS2 = 2.0, 3.0
TIME_GAP_S, STANDSTILL_M, COOLNESS = 1.0, 2.0, 0.99
"""a, b, T, s0, c of (1) to (4)."""
HARDEST_MPS2 = CC_BRAKE_MPS2
"""0.774 g, as the careful driver of UN R157 brakes."""
LOOK_M, LOOK_S = 20.0, 5.0
BRUSH_M, EGO_BRUSH_M = 0.2, -0.3
"""Reduction of a vehicle's width in the search of the leader, as logged boxes may brush.

Negative for the ego.
"""
ASKEW_RAD, ROOM_M = 0.25 * pi, 0.5
STANDING_MPS = 0.1
"""A logged road user at a lower speed stands."""
TOUCHING_M = 0.1
"""Least gap in (2) and (3)."""
ARRIVED_M = 1e-6
"""Tolerance of arrival: rounding must not decide whether a vehicle has reached the place where its
log stands.
"""
FINE_M = 1.0
"""Step of the box along the path; the contact is then halved down to `FINE_M` / 32."""


X, Y, YAW, LENGTH, WIDTH = range(5)
"""Columns of boxes."""


class TrafficBox(NamedTuple):
    """A box: its centre, heading and size, m, rad."""

    x: float
    y: float
    yaw: float
    length: float
    width: float


Leap = tuple[float, float, float]
"""How far a box moves in x, y, m, and turns, rad."""


@inner_kernel
def box_at(boxes: FloatArray, i: int | np.signedinteger[Any]) -> TrafficBox:
    """Row i of boxes `(n, 5)`."""
    box = boxes[i]
    return TrafficBox(box[X], box[Y], box[YAW], box[LENGTH], box[WIDTH])


class Paths(NamedTuple):
    """The logged paths, or some of them: path i owns the samples `first[i] : end[i]`."""

    first: IntArray
    end: IntArray
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray


def paths_along(tracks: Tracks) -> Paths:
    """The paths of all tracks."""
    return Paths(tracks.offsets[:-1], tracks.offsets[1:], tracks.t, tracks.x, tracks.y, tracks.yaw)


def places(who: IntArray, wanted: IntArray) -> IntArray:
    """The index of each of `some` `(m,)` in `who` `(k,)`, which increases; -1: not in it."""
    rows = np.searchsorted(who, wanted)
    return np.where(np.append(who, -1)[rows] == wanted, rows, -1)


@inner_kernel
def sample_at(paths: Paths, i: int, phase: float) -> int:
    """The last sample of path i not later than its phase.

    The first of its samples, where there is none.
    """
    first, end = paths.first[i], paths.end[i]
    return max(first, first + np.searchsorted(paths.t[first:end], phase, side="right") - 1)


class TrafficScene(NamedTuple):
    """Boxes and motion of all now; the last row is the ego.

    Attributes:
        boxes: `(n + 1, 5)` x, y, yaw, length, width.
        motion: `(n + 1, 3)` velocity x, y, and rate of the speed.
        present: `(n + 1,)` whether it is in the scene.
        as_logged: `(n + 1,)` whether it is where the log has it at this time.
    """

    boxes: FloatArray
    motion: FloatArray
    present: BoolArray
    as_logged: BoolArray


class Leaders(NamedTuple):
    """Per vehicle `(n,)`: gap to the leader (inf: none), its speed and acceleration along the
    path.
    """

    gap: FloatArray
    speed: FloatArray
    accel: FloatArray


@inner_kernel
def desired_gap(v: float, v_lead: float) -> float:
    """The desired gap behind a leader, m."""
    closing = v * (v - v_lead) / (2.0 * sqrt(ACCEL_MPS2 * DECEL_MPS2))
    return STANDSTILL_M + max(v * TIME_GAP_S + closing, 0.0)  # (1)


@kernel
def accelerations(speed: FloatArray, leaders: Leaders) -> FloatArray:
    """(4) `(n,)`; without a leader the greatest acceleration."""
    accels = np.full(len(speed), ACCEL_MPS2)
    for i in range(len(speed)):
        if np.isfinite(leaders.gap[i]):
            accels[i] = enhanced_idm(speed[i], leaders.gap[i], leaders.speed[i], leaders.accel[i])
    return accels


@kernel
def enhanced_idm(v: float, gap: float, v_lead: float, a_lead: float) -> float:
    """Acceleration (4) behind a leader, m/s2."""
    gap = max(gap, TOUCHING_M)
    idm = ACCEL_MPS2 * (1.0 - (desired_gap(v, v_lead) / gap) ** 2)  # (2)
    pull = min(a_lead, ACCEL_MPS2)
    if v_lead * (v - v_lead) <= -2.0 * gap * pull and v_lead * v_lead - 2.0 * gap * pull > 0.0:
        cah = v * v * pull / (v_lead * v_lead - 2.0 * gap * pull)  # (3)
    else:
        cah = pull - max(v - v_lead, 0.0) ** 2 / (2.0 * gap)
    if idm < cah:
        # (4)
        idm = (1.0 - COOLNESS) * idm + COOLNESS * (
            cah + DECEL_MPS2 * tanh((idm - cah) / DECEL_MPS2)
        )
    return max(idm, -HARDEST_MPS2)


@kernel
def covered(paths: Paths, phase: FloatArray, span: float) -> FloatArray:
    """Length of each logged path from its phase to `span` s later `(n,)`, m."""
    t, x, y = paths.t, paths.x, paths.y
    lengths = np.zeros(len(phase))
    for i in range(len(phase)):
        until = phase[i] + span
        for k in range(sample_at(paths, i, phase[i]), paths.end[i] - 1):
            if t[k] >= until:
                break
            part = min(until, t[k + 1]) - max(phase[i], t[k])
            if part > 0.0:
                lengths[i] += part / (t[k + 1] - t[k]) * hypot(x[k + 1] - x[k], y[k + 1] - y[k])
    return lengths


@inner_kernel
def moved_on(paths: Paths, phase: FloatArray, way: FloatArray, now: float) -> FloatArray:
    """Return the phases after `way` m of each path `(n,)`.

    Standstills of the log are skipped, but not beyond `now`.
    """
    t, x, y = paths.t, paths.x, paths.y
    phases = phase.copy()
    for i in range(len(phase)):
        left, k, end = way[i], sample_at(paths, i, phase[i] + 1e-12), paths.end[i]
        while k < end - 1:
            speed = hypot(x[k + 1] - x[k], y[k + 1] - y[k]) / (t[k + 1] - t[k])
            rest = t[k + 1] - phases[i]
            if speed < STANDING_MPS:
                if t[k + 1] > now:
                    phases[i] = max(phases[i], now)
                    break
                phases[i] = t[k + 1]
            elif left < speed * rest - ARRIVED_M:
                phases[i] += left / speed
                break
            else:
                left = max(left - speed * rest, 0.0)
                phases[i] = t[k + 1]
            k += 1
        if k == end - 1 and left > 1e-9:
            phases[i] = t[end - 1] + 1e-3
    return phases


@inner_kernel
def taken(boxes: FloatArray, coming: BoolArray, others: BoolArray) -> BoolArray:
    """Which boxes `coming` overlap one of the `others`."""
    overlaps = np.zeros(len(coming), np.bool_)
    for i in range(len(coming)):
        for j in range(len(boxes)):
            if coming[i] and others[j] and j != i:
                overlaps[i] = overlaps[i] or _touch(box_at(boxes, i), box_at(boxes, j), 0.0)
    return overlaps


@inner_kernel
def _touch(box: TrafficBox, other: TrafficBox, narrower: float) -> bool:
    width = max(box.width - narrower, 0.1)
    return overlap(
        box.x,
        box.y,
        box.yaw,
        box.length,
        width,
        other.x,
        other.y,
        other.yaw,
        other.length,
        other.width,
    )


@inner_kernel
def ego_ahead(
    paths: Paths, phase: FloatArray, speed: FloatArray, whose: BoolArray, scene: TrafficScene
) -> BoolArray:
    """Whether the ego is ahead of each of the vehicles `whose` (5), `(n,)`."""
    n, boxes = len(phase), scene.boxes
    is_ahead, last = np.zeros(n, np.bool_), np.array([n])
    ego, (vx, vy, _) = box_at(boxes, n), scene.motion[n]
    for i in range(n):
        box, reach = box_at(boxes, i), LOOK_M + LOOK_S * speed[i]
        away = hypot(ego.x - box.x, ego.y - box.y)
        if not whose[i] or away > reach + box.length + ego.length or _touch(box, ego, 0.0):
            continue
        gap, touched, place = _first_touched(paths, i, phase[i], reach, boxes, last)
        c, s, askew = cos(place.yaw), sin(place.yaw), ego.yaw - place.yaw
        half = 0.5 * (ego.length * abs(cos(askew)) + ego.width * abs(sin(askew)))
        rear = (ego.x - place.x) * c + (ego.y - place.y) * s - half
        onward = vx * c + vy * s > -STANDING_MPS
        # (5)
        is_ahead[i] = (
            touched >= 0
            and onward
            and cos(askew) >= cos(ASKEW_RAD)
            and gap + rear - 0.5 * box.length > 0.0
        )
    return is_ahead


@inner_kernel
def drives_into(paths: Paths, phase: FloatArray, leaders: Leaders) -> BoolArray:
    """Which vehicles `(n,)`, going on as in the log, drive into their leaders (6)."""
    gap, pace, accel = leaders.gap, leaders.speed, leaders.accel
    drives = np.zeros(len(phase), np.bool_)
    for i in range(len(phase)):
        if not np.isfinite(gap[i]):
            continue
        driven_m, brake = 0.0, max(-accel[i], 0.0)
        for k in range(sample_at(paths, i, phase[i]), paths.end[i] - 1):
            start = max(phase[i], paths.t[k])
            if start > phase[i] + LOOK_S or drives[i]:
                break
            part = (paths.t[k + 1] - start) / (paths.t[k + 1] - paths.t[k])
            driven_m += part * hypot(paths.x[k + 1] - paths.x[k], paths.y[k + 1] - paths.y[k])
            tau = paths.t[k + 1] - phase[i]
            rolls = min(tau, pace[i] / brake) if brake > 0.0 else tau
            # (6)
            drives[i] = driven_m >= gap[i] - ROOM_M + pace[i] * rolls - 0.5 * brake * rolls * rolls
    return drives


@inner_kernel
def leaders(
    paths: Paths,
    phase: FloatArray,
    speed: FloatArray,
    whose: BoolArray,
    heeds: BoolArray,
    scene: TrafficScene,
) -> Leaders:
    """The leaders of the vehicles `whose` `(n,)` at their phases; pairs that are both on their logs
    are ignored.

    The ego leads only the vehicles for which `heeds` `(n,)` holds.
    """
    n, boxes = len(phase), scene.boxes
    nearest = Leaders(np.full(n, inf), np.zeros(n), np.zeros(n))
    near = np.empty(n + 1, np.int64)  # agents that may be in the way
    present = np.flatnonzero(scene.present)
    off_log = np.flatnonzero(scene.present & ~scene.as_logged)  # mostly few of very many
    for i in range(n):
        if not whose[i]:
            continue
        box, reach, count = box_at(boxes, i), LOOK_M + LOOK_S * speed[i], 0
        for j in off_log if scene.as_logged[i] else present:
            if j == i or (j == n and not heeds[i]):
                continue
            other = box_at(boxes, j)
            away = hypot(other.x - box.x, other.y - box.y)
            if away <= reach + box.length + other.length and not _touch(box, other, 0.0):
                near[count] = j
                count += 1
        if count == 0:
            continue
        gap, leader, place = _first_touched(paths, i, phase[i], reach, boxes, near[:count])
        if leader >= 0:
            vx, vy, accel = scene.motion[leader]
            ahead, pace = vx * cos(place.yaw) + vy * sin(place.yaw), hypot(vx, vy)
            nearest.gap[i], nearest.speed[i] = gap, max(ahead, 0.0)
            nearest.accel[i] = accel * ahead / pace if pace > STANDING_MPS else 0.0
    return nearest


@inner_kernel
def _first_touched(
    paths: Paths, i: int, phase: float, reach: float, boxes: FloatArray, near: IntArray
) -> tuple[float, int, TrafficBox]:
    """Distance along path i to the first touch, the agent (-1: none within reach), and the box of i
    there.
    """
    k = sample_at(paths, i, phase)
    begin = box_at(boxes, i)
    # Half of length and width: more than half of the diagonal
    station, own = 0.0, 0.5 * (begin.length + begin.width) + 1.0
    free = 0.0  # the station up to which no other box is within reach
    while k < paths.end[i] - 1 and station < reach:
        leap = (
            paths.x[k + 1] - begin.x,
            paths.y[k + 1] - begin.y,
            paths.yaw[k + 1] - begin.yaw,
        )
        length = hypot(leap[0], leap[1])
        steps = int(length / FINE_M) + 1
        for m in range(1, steps + 1):
            ahead = station + m / steps * length
            if ahead < free:
                continue
            first, agent, apart = 2.0, -1, inf
            box = _box_after(begin, leap, m / steps)
            for j in near:
                brush = EGO_BRUSH_M if j == len(boxes) - 1 else BRUSH_M
                other = box_at(boxes, j)
                away = (
                    hypot(other.x - box.x, other.y - box.y)
                    - own
                    - 0.5 * (other.length + other.width)
                )
                apart = min(apart, away)
                if away <= 0.0 and _touch(box, other, brush):
                    u = _touch_at(begin, leap, (m - 1.0) / steps, m / steps, other, brush)
                    if u < first:
                        first, agent = u, j
            if agent >= 0:
                return station + first * length, agent, _box_after(begin, leap, first)
            free = ahead + apart
        begin = _box_after(begin, leap, 1.0)
        station += length
        k += 1
    return inf, -1, begin


@inner_kernel
def _box_after(box: TrafficBox, leap: Leap, u: float) -> TrafficBox:
    """A box after the part u of a leap."""
    dx, dy, turn = leap
    return TrafficBox(box.x + u * dx, box.y + u * dy, box.yaw + u * turn, box.length, box.width)


@inner_kernel
def _touch_at(
    begin: TrafficBox, leap: Leap, low: float, high: float, other: TrafficBox, narrower: float
) -> float:
    """The last part of a leap, between `low` (apart) and `high` (touching), at which the boxes are
    still apart.
    """
    for _ in range(5):
        middle = 0.5 * (low + high)
        if _touch(_box_after(begin, leap, middle), other, narrower):
            high = middle
        else:
            low = middle
    return low
