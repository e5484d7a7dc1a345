"""The agents that the ego would meet if its plan were held: predicted boxes against the ego's, swept along its way.

For each prediction (`sweep` of `planners.frenet.st_boundaries`, without any margin of time), [lower(t), upper(t)] are
the stations at which the ego's box, widened by `MARGIN_M` (`VULNERABLE_MARGIN_M` for pedestrians and riders) on either
side, overlaps the agent's. After the last prediction all agents go straight on. With `held` (`replay.explain.course`),
the arc length s_h(t):

(1) met at the first t with  lower(t) - GAP_M < s_h(t) < upper(t),  unless their centre is behind the ego's then
(2) else, if they go along the way: followed from the first t with  s_h(t) > lower(t) - HEADWAY_S v_h
(3) need = the least constant deceleration from t_b on that stays GAP_M behind them at all times from (1) on:
    max over t of 2 (v_h T - room) / T^2, and v_h^2 / (2 room) where it stops before t;  T = t - t_b,
    room = lower(t) - s(t_b) - GAP_M, half of lower(t) - s(t_b) where that is more
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, nan, sin

import numpy as np

from logs.agents import Agents
from logs.frame import Predictions
from logs.kernel import BoolArray, FloatArray
from logs.shapes import distance
from logs.vehicle import VehicleParameters
from planners.frenet.scene import STANDING_MPS, VULNERABLE, Bodies, Futures
from planners.frenet.st_boundaries import ALONG, Roles, Swept, sweep
from planners.frenet.st_boundaries import Way as SweptWay
from replay.explain.course import LOOK_S, STEP_S, Held, Way

MARGIN_M, VULNERABLE_MARGIN_M = 0.3, 0.6
GAP_M = 2.0
"""An ego that comes nearer than this behind an agent has met them: the gap at standstill (IDM's s0)."""
HEADWAY_S = 2.0
"""A follower should be no nearer: the rule of two seconds."""
TOO_LATE_M = 0.1
"""With less space than this the ego cannot stay behind."""


@dataclass(frozen=True, slots=True)
class Meeting:
    """An agent in the way of a plan that is held.

    Attributes:
        agent: Their id.
        away_m: Distance between the boxes now, m.
        speed_mps: Their speed now.
        time_s: Time of (1) or (2), s from the frame; NaN: neither, they are only in the way.
        distance_m: How far the ego would have driven until then, m.
        need_mps2: (3); NaN if the ego stands, for (2), and if it is too late to stay behind.
        left_m: The least gap of the plan itself behind them, m; NaN if it is not behind them.
        left_at_s: Time of the least gap, s from the frame.
        is_met: Whether it is (1).
    """

    agent: str
    away_m: float
    speed_mps: float
    time_s: float
    distance_m: float
    need_mps2: float
    left_m: float
    left_at_s: float
    is_met: bool


def meetings(
    held: Held, way: Way, agents: Agents, futures: Predictions, car: VehicleParameters, passed: BoolArray
) -> list[Meeting]:
    """One meeting for each agent that occupies a part of the way: that of their most demanding future.

    Args:
        held: The plan.
        way: Long enough for it.
        agents: The agents of the frame.
        futures: Their predictions.
        car: The ego.
        passed: `(agents,)` whether an agent has no margin.
    """
    times, poses = fine(futures)
    x, y, yaw = poses
    ego = Swept(car.axle_to_center, car.length, car.width, MARGIN_M, VULNERABLE_MARGIN_M, 0.0, 0.0, 0.0)
    none, rows = np.zeros(len(agents), np.bool_), np.arange(float(len(futures)))
    _, who, lower, upper, along, row = sweep(
        SweptWay(way.s, way.x, way.y, way.yaw),
        Futures(times, futures.agent, rows, x, y, yaw),  # row numbers instead of probabilities
        Bodies(agents.x, agents.y, agents.yaw, agents.vx, agents.vy, agents.length, agents.width),
        Roles(none, VULNERABLE[agents.codes], passed), ego, float(times[0]), 1,
    )  # fmt: skip
    found: dict[int, Meeting] = {}
    for i, agent in enumerate(who.tolist()):
        taken = _Taken(agent, poses[:, int(row[i])], lower[i], upper[i], float(along[i]))
        one = _meeting(held, way, agents, taken, car)
        if one is not None and (agent not in found or _order(one) < _order(found[agent])):
            found[agent] = one
    return list(found.values())


@dataclass(frozen=True, eq=False, slots=True)
class _Taken:
    """What a prediction takes of a way: agent, rows x, y, yaw `(3, k)`, stations `(k,)`, speed along the way, m/s."""

    agent: int
    pose: FloatArray
    lower: FloatArray
    upper: FloatArray
    along: float


def fine(futures: Predictions) -> tuple[FloatArray, FloatArray]:
    """Times `(k,)` for `LOOK_S`, s, and the poses x, y, yaw `(3, n, k)` there: linear in between, straight on after."""
    t = futures.t
    times = t[0] + STEP_S * np.arange(round(LOOK_S / STEP_S) + 1)
    poses = np.stack([futures.x, futures.y, np.unwrap(futures.yaw, axis=1)])
    if len(t) == 1:
        return times, np.repeat(poses, len(times), axis=2)
    i = np.clip(np.searchsorted(t, times + 1e-9, side="right") - 1, 0, len(t) - 2)
    u = (times - t[i]) / (t[i + 1] - t[i])
    turn = np.minimum(u, 1.0)
    weight = np.stack([u, u, turn])[:, None]
    return times, np.ascontiguousarray(poses[:, :, i] * (1.0 - weight) + poses[:, :, i + 1] * weight)


def _order(one: Meeting) -> tuple[bool, bool, float, float]:
    """The most demanding first: met too late, met by need, met sooner; then followed too near."""
    late = one.is_met and np.isnan(one.need_mps2)
    return not one.is_met, not late, -np.nan_to_num(one.need_mps2), float(np.nan_to_num(one.time_s, nan=np.inf))


def _meeting(held: Held, way: Way, agents: Agents, taken: _Taken, car: VehicleParameters) -> Meeting | None:
    """The meeting with an agent; None: they come only from behind."""
    here, lower, upper = np.isfinite(taken.lower), taken.lower, taken.upper
    first = int(np.flatnonzero(here)[0])
    if _is_behind(way, held.s[first], taken.pose[:, first], car):
        return None
    i, (x, y, yaw) = taken.agent, taken.pose[:, 0]
    ex, ey, eyaw = _center(way, 0.0, car)
    away = distance(ex, ey, eyaw, car.length, car.width, x, y, yaw, agents.length[i], agents.width[i])
    speed = float(hypot(agents.vx[i], agents.vy[i]))
    with np.errstate(invalid="ignore"):
        met = np.flatnonzero(here & (held.s > lower - GAP_M) & (held.s < upper))  # (1)
        close = np.flatnonzero(here & (held.s > lower - HEADWAY_S * held.v) & (held.s < upper))  # (2)
        left = np.where(held.planned <= lower, lower - held.planned, np.nan)
    follows = taken.along > ALONG * speed and speed > STANDING_MPS and not held.drives_off
    k = int(met[0]) if len(met) else int(close[0]) if len(close) and follows else -1
    if len(met) and _is_behind(way, held.s[k], taken.pose[:, k], car):
        return None
    least = int(np.nanargmin(left)) if np.isfinite(left).any() else -1
    return Meeting(
        agents.ids[i], float(away), speed,
        float(held.t[k]) if k >= 0 else nan, float(held.s[k]) if k >= 0 else nan,
        _need(held, lower, k) if len(met) else nan,
        float(left[least]) if least >= 0 else nan, float(held.t[least]) if least >= 0 else nan, len(met) > 0,
    )  # fmt: skip


def _need(held: Held, lower: FloatArray, first: int) -> float:
    """(3) from the step `first` on."""
    if held.drives_off:
        return nan
    k = np.flatnonzero(np.isfinite(lower) & (np.arange(len(lower)) >= first) & (held.t > held.t_from))
    ahead, T = lower[k] - held.s_from, held.t[k] - held.t_from
    room = np.maximum(ahead - GAP_M, 0.5 * ahead)  # nearer already: half of it is kept
    if not len(k) or (room < TOO_LATE_M).any():
        return nan
    slower = 2.0 * np.maximum(held.v * T - room, 0.0) / T**2
    stops = slower * T > held.v
    return float(np.where(stops, held.v**2 / (2.0 * room), slower).max())


def _is_behind(way: Way, s: float, pose: FloatArray, car: VehicleParameters) -> bool:
    """Whether an agent's centre is behind that of the ego at a station."""
    x, y, yaw = _center(way, s, car)
    return bool((pose[0] - x) * cos(yaw) + (pose[1] - y) * sin(yaw) < 0.0)


def _center(way: Way, s: float, car: VehicleParameters) -> tuple[float, float, float]:
    """The ego's box at a station: centre and heading."""
    x, y, yaw = way.pose(s)
    return x + car.axle_to_center * cos(yaw), y + car.axle_to_center * sin(yaw), yaw
