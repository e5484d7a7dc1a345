"""Predicts vehicles that follow their lanes.

A vehicle is on the lanes that contain its centre and have its direction (`lane_map.matches`). If
its lateral motion takes it over the marking within `CHANGE_S`, it is assigned to the neighbouring
lane, and so completes the lane change. From a lane it continues into the successors, with one
hypothesis per successor that is possible at its speed.

Along the lane, with station s, offset l, speed v, lane curvature kappa; theta = distance / v_0:

(1) v = v_0 + a_0 T_a (1 - exp(-t / T_a)), not negative: the acceleration decays;
        and v^2 <= A / |kappa| where a deceleration of B suffices for it
(2) l goes from l_0 to l_end = l_0 + l_dot T as the lateral speed decays with T:
        l = l_end - l_dot T exp(-theta / T);
    l_end is limited so that the vehicle's side stays within the marking: with e_0 = l_0 - l_end
    l = l_end + (e_0 + (l_dot + e_0 / T) theta) exp(-theta / T)
        (the same, without the limit)
(3) the heading is the lane's plus atan2(l_dot, s_dot) plus the initial difference, which fades over
    `TURN_M`

Weights: exp(-m / 2) for a lane of misfit m (`matches`), exp(-|w| / `TURN_RAD`) for a branch that
turns by w. Hypotheses below `LEAST` are dropped; those of an agent sum to 1. Vehicles off the
lanes, against them or in reverse, bicycles and pedestrians follow no lane.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import AgentKind, Agents, among
from replan.logs.frame import Predictions
from replan.logs.states import wrap
from replan.replay.prediction.lane_map import (
    MISFIT,
    LaneMap,
    LaneSamples,
    lane_point,
    lane_project,
    matches,
)
from replan.replay.prediction.off_lanes import (
    ACCEL,
    RATE,
    VX,
    VY,
    WIDTH,
    YAW,
    X,
    Y,
    turn_rate,
    turned,
)

CHANGE_S = 1.5
DRIFTING_MPS = 0.3
"""Vehicles with a lower lateral speed do not change lanes."""
SETTLE_S, SLOW_MPS = 1.0, 2.0
"""T of (2); least v_0 in theta, so that a slow vehicle does not slide sideways."""
FADE_S, LEAST_MPS2, MOST_MPS2 = 1.0, -4.0, 2.0
"""T_a of (1), about the best in measurements on recorded traffic; least and greatest a_0."""
CURVE_MPS2, EASE_MPS2 = 4.0, 2.0
"""A and B of (1)."""
HARDEST_MPS2 = 4.0
"""A branch is possible if this deceleration makes the vehicle slow enough for it."""
TURN_M, TURN_RAD = 5.0, 1.5
LEAST = 0.1
WAYS, MATCHED, DEEPEST = 4, 3, 48
"""Greatest numbers of hypotheses of an agent, of lanes that it may be on, and of lanes in a
sequence.
"""
KNOT_M, FAR_M = 2.0, 1e6
FOLLOWING = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)
FOLLOW = among(*FOLLOWING)


def followers(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """Predict only the vehicles that follow a lane (module docstring)."""
    return _predict_vehicles(agents, t, lanes, others=False)


def everybody(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """Vehicles follow their lanes.

    All that follow none keep a constant turn rate, pedestrians go straight on.
    """
    return _predict_vehicles(agents, t, lanes, others=True)


def _predict_vehicles(
    agents: Agents, t: FloatArray, lanes: LaneMap, *, others: bool
) -> Predictions:
    a = agents
    rows = np.column_stack(
        [a.x, a.y, a.yaw, a.vx, a.vy, a.yaw_rate, a.width, a.accel, np.arctan2(a.vy, a.vx)]
    )
    agent, probability, poses = _predict_all(lanes.arrays, a.codes, rows, t, others)
    x, y, yaw = frozen(poses)  # once: its rows are not copied again
    return Predictions(t, agent, probability, x, y, yaw, "lane_following")


class LaneWays(NamedTuple):
    """Lane sequences that vehicles may drive.

    Attributes:
        lanes: `(w, DEEPEST)` lanes of each.
        depth: `(w,)` their number; 0: none.
        share: `(w,)` weights.
        start: `(w, 3)` station and offset on the first lane, and half of its width, m.
    """

    lanes: IntArray
    depth: IntArray
    share: FloatArray
    start: FloatArray


@kernel
def _predict_all(
    map_: LaneSamples, codes: IntArray, rows: FloatArray, t: FloatArray, others: bool
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return hypotheses in the order of the agents: agent `(h,)`, probability `(h,)`, rows x, y,
    yaw `(3, h, k)`.

    `rows` `(n, 9)`: the agents (`COLUMNS`), whose yaw rates are limited in place; `t` `(k,)`:
    times, s, from now on. `others`: whether agents without a lane keep a constant turn rate;
    otherwise they are left out.
    """
    n, most = len(codes), 0
    follows, ahead = FOLLOW[codes], t - t[0]
    for i in range(n):
        rows[i, RATE] = turn_rate(codes[i], hypot(rows[i, VX], rows[i, VY]), rows[i, RATE])
        most += WAYS if follows[i] else 1
    agent = np.empty(most, np.int64)
    all_ways, ways, count = _no_ways(most), _no_ways(WAYS), 0
    for i in range(n):
        number = _find_ways(map_, rows[i], ahead[-1], ways) if follows[i] else 0
        total, likely = ways.share[:number].sum(), 0.0
        for h in range(number):
            likely += ways.share[h] if ways.share[h] >= LEAST * total else 0.0
        for h in range(number):
            if ways.share[h] >= LEAST * total:
                agent[count] = i
                _copy_way(ways, h, all_ways, count, ways.share[h] / likely)
                count += 1
        if number == 0 and others:
            agent[count] = i
            count += 1
    poses = np.empty((3, count, len(ahead)))
    dying = np.empty(len(ahead))  # 1 - exp(-t / T_a) of (1), midway between each time and the next
    for k in range(len(ahead)):
        middle = 0.5 * (ahead[k] + ahead[min(k + 1, len(ahead) - 1)])
        dying[k] = 1.0 - exp(-middle / FADE_S)
    for h in range(count):
        vehicle = rows[agent[h]]
        if all_ways.depth[h] > 0:
            sequence = all_ways.lanes[h, : all_ways.depth[h]]
            _roll_out(map_, vehicle, sequence, all_ways.start[h], ahead, dying, poses[:, h])
        else:
            turned(vehicle, ahead, poses[:, h])
    return agent[:count], all_ways.share[:count], poses


@inner_kernel
def _no_ways(count: int) -> LaneWays:
    return LaneWays(
        np.empty((count, DEEPEST), np.int64),
        np.zeros(count, np.int64),
        np.ones(count),
        np.empty((count, 3)),
    )


@inner_kernel
def _copy_way(ways: LaneWays, h: int, to: LaneWays, k: int, share: float) -> None:
    """Copy sequence `h` to place `k` of `to`, with another weight."""
    depth = ways.depth[h]
    to.lanes[k, :depth], to.depth[k] = ways.lanes[h, :depth], depth
    to.share[k], to.start[k] = share, ways.start[h]


@inner_kernel
def _find_ways(map_: LaneSamples, vehicle: FloatArray, horizon: float, ways: LaneWays) -> int:
    """Find the lane sequences that a vehicle (`COLUMNS`) may drive within the horizon (s).

    Return their number.
    """
    lanes, feet = np.empty(MATCHED, np.int64), np.empty((MATCHED, 4))
    matched = matches(map_, vehicle[X], vehicle[Y], vehicle[YAW], lanes, feet)
    speed = hypot(vehicle[VX], vehicle[VY])
    count = 0
    for m in range(matched):
        lane, (s, left, half, misfit) = lanes[m], feet[m]
        along, across = _velocity_along_lane(map_, lane, s, vehicle)
        if along < -0.5:
            continue
        target, then = lane, left + CHANGE_S * across
        # It changes lanes
        if abs(across) >= DRIFTING_MPS and then * across > 0.0 and abs(then) > half + TIE:
            side = map_.beside[lane, 0 if across > 0.0 else 1]
            target = side if side >= 0 else lane
        if target != lane:
            s, left, half = lane_project(map_, target, vehicle[X], vehicle[Y], FAR_M)
        known = False
        for h in range(count):
            known = known or ways.lanes[h, 0] == target
        if known:
            continue
        ways.lanes[count, 0], ways.depth[count] = target, 1
        ways.start[count, 0], ways.start[count, 1], ways.start[count, 2] = s, left, half
        best = feet[0, MISFIT]
        ways.share[count] = exp(-0.5 * (misfit - best) - _turn(map_, target, s) / TURN_RAD)
        count += 1
        if count == WAYS:
            break
    h = 0
    while h < count:
        count = _extend_way(map_, h, count, speed * horizon, speed, ways)
        h += 1
    return count


@inner_kernel
def _velocity_along_lane(
    map_: LaneSamples, lane: int, s: float, vehicle: FloatArray
) -> tuple[float, float]:
    """Return the velocity of a vehicle along and across (to the left of) a lane at its foot,
    m/s.
    """
    yaw = lane_point(map_, lane, s)[2]
    cosine, sine = cos(yaw), sin(yaw)
    return vehicle[VX] * cosine + vehicle[VY] * sine, vehicle[VY] * cosine - vehicle[VX] * sine


@inner_kernel
def _length(map_: LaneSamples, lane: int) -> float:
    return map_.step[lane] * (map_.first[lane + 1] - map_.first[lane] - 1)


@inner_kernel
def _turn(map_: LaneSamples, lane: int, s: float) -> float:
    """Return by how much a lane turns from station `s` to its end, rad, not negative."""
    return abs(map_.yaw[map_.first[lane + 1] - 1] - lane_point(map_, lane, s)[2])


@inner_kernel
def _extend_way(
    map_: LaneSamples, h: int, count: int, reach: float, speed: float, ways: LaneWays
) -> int:
    """Extend sequence `h` to `reach` m from its start; forks add sequences.

    Return the number of sequences.
    """
    lanes, depth, share = ways.lanes, ways.depth, ways.share
    covered = -ways.start[h, 0]
    for d in range(depth[h]):
        covered += _length(map_, lanes[h, d])
    while covered < reach and depth[h] < DEEPEST:
        last = lanes[h, depth[h] - 1]
        begin, end = map_.next_first[last], map_.next_first[last + 1]
        if begin == end:
            break
        total, best = 0.0, begin
        for k in range(begin, end):
            weight = _weight(map_, map_.following[k], speed, covered)
            total += weight
            if weight > _weight(map_, map_.following[best], speed, covered):
                best = k
        for k in range(begin, end):
            weight = _weight(map_, map_.following[k], speed, covered)
            if k != best and count < WAYS and weight >= LEAST * total > 0.0:
                _copy_way(ways, h, ways, count, share[h] * weight / total)
                lanes[count, depth[h]] = map_.following[k]
                depth[count] += 1
                count += 1
        if total > 0.0:
            share[h] *= _weight(map_, map_.following[best], speed, covered) / total
        lanes[h, depth[h]] = map_.following[best]
        depth[h] += 1
        covered += _length(map_, map_.following[best])
    return count


@inner_kernel
def _weight(map_: LaneSamples, lane: int, speed: float, away: float) -> float:
    """Return the weight of a branch that begins `away` m ahead.

    Almost 0 if the vehicle is too fast for it.
    """
    weight = exp(-_turn(map_, lane, 0.0) / TURN_RAD)
    tightest = map_.tightest[lane]
    if (
        tightest > 0.0
        and speed * speed - 2.0 * HARDEST_MPS2 * max(away, 0.0) > 1.5 * CURVE_MPS2 / tightest
    ):
        return 1e-6 * weight
    return weight


@inner_kernel
def _on_way(map_: LaneSamples, way: IntArray, s: float) -> tuple[float, float, float, float]:
    """Return x, y, yaw, kappa at a station from the start of the first lane of a sequence."""
    d = 0
    while d < len(way) - 1:
        length = _length(map_, way[d])
        if s <= length:
            break
        s -= length
        d += 1
    return lane_point(map_, way[d], s)


@inner_kernel
def _in_bends(map_: LaneSamples, way: IntArray, s: float, speed: float, reach: float) -> FloatArray:
    """Return the squared speeds that the bends allow (1), every `KNOT_M` from station `s`.

    Not above `speed`.
    """
    count = int(reach / KNOT_M) + 2
    square = np.empty(count)
    for i in range(count):
        _, _, _, kappa = _on_way(map_, way, s + i * KNOT_M)
        bend = abs(kappa)
        square[i] = CURVE_MPS2 / bend if bend * speed * speed > CURVE_MPS2 else speed * speed
    for i in range(count - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2.0 * EASE_MPS2 * KNOT_M)
    return square


@inner_kernel
def _stations(
    map_: LaneSamples,
    way: IntArray,
    s: float,
    speed: float,
    accel: float,
    ahead: FloatArray,
    dying: FloatArray,
) -> FloatArray:
    """Return the distance of the vehicle along its lanes at each time `(k,)`, m (1)."""
    pull = min(max(accel, LEAST_MPS2), MOST_MPS2) * FADE_S
    wished = np.maximum(speed + pull * dying, 0.0)  # mean speeds (1) without the bends
    fastest, reach, tightest = 0.0, 0.0, 0.0
    for k in range(len(ahead) - 1):
        fastest, reach = max(fastest, wished[k]), reach + wished[k] * (ahead[k + 1] - ahead[k])
    for lane in way:
        tightest = max(tightest, map_.tightest[lane])
    gone = np.zeros(len(ahead))
    # Slightly below the threshold of `_in_bends`
    if not tightest * fastest * fastest > (1.0 - TIE) * CURVE_MPS2:
        for k in range(len(ahead) - 1):
            gone[k + 1] = gone[k] + wished[k] * (ahead[k + 1] - ahead[k])
        return gone
    square = _in_bends(map_, way, s, fastest, reach)
    for k in range(len(ahead) - 1):
        i = min(int(gone[k] / KNOT_M), len(square) - 2)
        u = min(gone[k] / KNOT_M - i, 1.0)
        allowed = sqrt(max(square[i] + u * (square[i + 1] - square[i]), 0.0))
        gone[k + 1] = gone[k] + min(allowed, wished[k]) * (ahead[k + 1] - ahead[k])
    return gone


@inner_kernel
def _roll_out(
    map_: LaneSamples,
    vehicle: FloatArray,
    way: IntArray,
    start: FloatArray,
    ahead: FloatArray,
    dying: FloatArray,
    out: FloatArray,
) -> None:
    """Follow a lane sequence (1)-(3): write rows x, y, yaw `(3, k)` to `out`.

    The first is the vehicle's pose.
    """
    s, left, half = start[0], start[1], start[2]
    along, across = _velocity_along_lane(map_, way[0], s, vehicle)
    speed = max(along, 0.0)
    gone = _stations(map_, way, s, speed, vehicle[ACCEL], ahead, dying)
    paced = max(speed, SLOW_MPS)
    drift = across * paced / speed if speed > DRIFTING_MPS else 0.0
    room = max(half - 0.5 * vehicle[WIDTH], 0.3)
    end = min(max(left + drift * SETTLE_S, -room), room)
    off = left - end
    rate = drift + off / SETTLE_S
    askew = full_turns = 0.0
    shift_x = shift_y = 0.0
    for k in range(len(ahead)):
        if k > 1 and gone[k] == gone[k - 1]:
            out[:, k] = out[:, k - 1]  # standing vehicles stay
            continue
        theta = gone[k] / paced
        fade = exp(-theta / SETTLE_S)
        offset = end + (off + rate * theta) * fade
        x, y, yaw, _ = _on_way(map_, way, s + gone[k])
        x, y = x - offset * sin(yaw), y + offset * cos(yaw)
        yaw += atan2((rate - (off + rate * theta) / SETTLE_S) * fade, paced)
        if k == 0:
            askew, shift_x, shift_y = wrap(vehicle[YAW] - yaw), vehicle[X] - x, vehicle[Y] - y
            full_turns = 2.0 * pi * np.round((vehicle[YAW] - yaw - askew) / (2.0 * pi))
        out[0, k], out[1, k] = x + shift_x, y + shift_y
        out[2, k] = yaw + full_turns + askew * exp(-gone[k] / TURN_M)
