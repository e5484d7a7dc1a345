"""The part of a drive that a planner can drive: planners drive forward only.

(1) w_k = sum of (p_k - p_(k-1)) . h_k,
        h_k the mean heading of the step: the way along the heading, m
(2) the ego reverses from a maximum of w, where w falls by `REVERSE_M`, to the next minimum,
        from which it rises by as
    much; the standstills at both do not count.
        It comes from a standstill (|v| <= max(`SLOW_MPS`, `BRAKING_MPS2` dt)), and the speed
        supports the last half of `REVERSE_M`: it takes at most `LONGEST_S`, and the integral of |v|
        is at least half of it
(3) the part to drive: the first between two reversals with `FORWARD_M` of way, else the longest of
    `REVERSE_M` at least

(4) a drive without lanes is tighter than the vehicle if the curvature of its path, between chords
    of 1 m that are `BENDS` apart, is above `ABOVE_LOCK` times that at full lock on more than
    `TIGHT_SHARE` of the way

The sign of the speed is not used, because many logs have none. The conditions of (2) leave out
other motion backward: corrections of the localisation at speed, its drift at rest, and headings
that are not the ego's. (4) finds robots that turn on the spot where the vehicle is assumed to be a
car: no planner follows that path with that vehicle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.core.names import listed
from replan.core.once import once
from replan.logs.polylines import thinned
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory, wrapped

REVERSE_M = 1.0
"""A shorter way back leaves no trace in a lane, whose points are 1 m apart (`Road.along`)."""
FORWARD_M = 5.0
SLOW_MPS, BRAKING_MPS2, LONGEST_S = 0.5, 3.0, 5.0
NEAR_M, STANDS_MPS = 0.1, 0.1
"""The ego stands at a maximum or minimum of w where w differs from it by less, m, and the speed is
less, m/s.
"""
BENDS, ABOVE_LOCK, TIGHT_SHARE = 3, 1.2, 0.1
"""Constants of (4): one correction of the localisation is a small share of a drive."""


def _way(ego: Trajectory) -> FloatArray:  # (1)
    yaw = 0.5 * (ego.yaw[1:] + ego.yaw[:-1])
    return np.r_[0.0, np.cumsum(np.diff(ego.x) * np.cos(yaw) + np.diff(ego.y) * np.sin(yaw))]


def reversals(ego: Trajectory) -> tuple[tuple[int, int], ...]:
    """Return the first and last state of each way in reverse (2)."""
    w = _way(ego)
    if (np.maximum.accumulate(w) - w).max() < REVERSE_M:
        return ()
    spans: list[tuple[int, int]] = []
    begin: int | None = None
    top = bottom = 0
    for k, station in enumerate(w.tolist()):
        if begin is None and station > w[top]:
            top = k
        elif begin is None and w[top] - station >= REVERSE_M:
            if _is_reverse(ego, w, top, k):
                begin, bottom = max(_standing(ego, w, top, k), default=top), k
            else:
                top = k
        elif begin is not None and station < w[bottom]:
            bottom = k
        elif begin is not None and station - w[bottom] >= REVERSE_M:
            spans.append((begin, bottom))
            begin, top = None, k
    if begin is not None:
        spans.append((begin, bottom))
    return tuple(
        (first, min(_standing(ego, w, last, first), default=last)) for first, last in spans
    )


def _standing(ego: Trajectory, w: FloatArray, extreme: int, until: int) -> list[int]:
    """Return the states between two at which the ego stands at the extreme of w."""
    first, last = sorted((extreme, until))
    stands = (np.abs(w - w[extreme]) <= NEAR_M) & (np.abs(ego.v) <= STANDS_MPS)
    return (np.flatnonzero(stands[first : last + 1]) + first).tolist()


def _is_reverse(ego: Trajectory, w: FloatArray, top: int, k: int) -> bool:
    """Return whether the way back from state `top` to `k` is driven in reverse: the conditions of
    (2).
    """
    dt, v = np.diff(ego.t), np.abs(ego.v)
    half = int(np.flatnonzero(w[top:k] >= w[k] + 0.5 * REVERSE_M)[-1]) + top
    moved = float((0.5 * (v[half + 1 : k + 1] + v[half:k]) * dt[half:k]).sum())
    stood = w[top] - w[0] < REVERSE_M or v[top : k + 1].min() <= max(
        SLOW_MPS, BRAKING_MPS2 * float(np.median(dt))
    )
    return bool(
        stood and ego.t[k] - ego.t[half] <= max(LONGEST_S, dt[half]) and moved >= 0.25 * REVERSE_M
    )


def forward_part(ego: Trajectory, backward: tuple[tuple[int, int], ...]) -> tuple[int, int] | None:
    """Return the first and last state of the part to drive (3) between reversals; None: there is
    none.
    """
    if not backward:
        return 0, len(ego) - 1
    w = _way(ego)
    begins, ends = (
        (0, *(last for _, last in backward)),
        (*(first for first, _ in backward), len(ego) - 1),
    )
    gains = [float(w[end] - w[begin]) for begin, end in zip(begins, ends, strict=True)]
    best = next((k for k, gain in enumerate(gains) if gain >= FORWARD_M), int(np.argmax(gains)))
    return (begins[best], ends[best]) if gains[best] >= REVERSE_M else None


def drivable_part(scenario: Scenario) -> Scenario:
    """Return the part of a scenario that planners drive and are judged in; LogError if the ego only
    reverses.

    Only a lane that is made from the drive ends where the ego reverses; on the lanes of a map all
    is driven.
    """
    ego = scenario.ego
    backward = reversals(ego) if scenario.road.source is RoadSource.DRIVEN_PATH else ()
    if not backward:
        return scenario
    part = forward_part(ego, backward)
    if part is None:
        raise LogError(
            f"{scenario.name}: the log reverses from {described(ego, backward)}: planners drive "
            "forward only, so none of it is driven",
            remedy="choose a part that goes forward with --from and --to",
        )
    first, last = part
    # A goal behind a reversal is reached in reverse
    goal = scenario.goal if last == len(ego) - 1 else None
    duration = scenario.duration if last == len(ego) - 1 else float(ego.t[last])
    return replace(scenario, ego=ego.taken(slice(first, last + 1)), duration=duration, goal=goal)


@once
def tighter_than_vehicle(scenario: Scenario) -> str:
    """Return that a driven path without lanes is tighter than the vehicle (4), as text; "" if it is
    not.
    """
    path = thinned(np.column_stack([scenario.ego.x, scenario.ego.y]), 1.0)
    if scenario.road.source is not RoadSource.DRIVEN_PATH or len(path) < BENDS + 2:
        return ""
    chord, lock = np.diff(path, axis=0), scenario.vehicle.max_kappa
    heading, length = np.arctan2(chord[:, 1], chord[:, 0]), np.hypot(*chord.T)
    middle = np.cumsum(length) - 0.5 * length
    bend = np.abs(wrapped(heading[BENDS:] - heading[:-BENDS])) / (middle[BENDS:] - middle[:-BENDS])
    tight = bend[bend > ABOVE_LOCK * lock]
    if len(tight) <= TIGHT_SHARE * len(bend):
        return ""
    return (
        f"the log has no lanes, and its driver turns within {1.0 / np.median(tight):.1f} m: no "
        f"planner can follow with the vehicle, which needs {1.0 / lock:.1f} m (--car names another)"
    )


def described(ego: Trajectory, backward: tuple[tuple[int, int], ...]) -> str:
    """Return the times of reversals as text: "14.0 to 24.0 s, 31.0 to 33.5 s and 2 more"."""
    return listed([f"{ego.t[first]:.1f} to {ego.t[last]:.1f} s" for first, last in backward], 3)
