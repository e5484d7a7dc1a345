"""Which of the found road users there were: what was seen too little, moves as nothing does, or is where another is.

And what the log's own drive says: nothing stood where the ego drove. A box that it only grazes, within the noise of
boxes, is smaller; a track that it meets for a moment ends there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.kernel import BoolArray, FloatArray, kernel
from logs.repair.groups import CLUSTER, GROUPS, PERSON, VEHICLE, Boxes
from logs.repair.overlap import OTHER_PART, shared_area
from logs.repair.pieces import Piece
from logs.repair.users import User
from logs.shapes import clearance
from logs.states import Trajectory
from logs.vehicle import VehicleParameters

SURE_SCORE = 1.2
"""With so many times `Group.least_score` the time does not count: some are there only when the log begins or ends."""
LEAST_SEEN = 0.3
"""Share of the frames in which who moves is detected; measured: 0.93 close by to 0.69 at 90 m."""
CLUSTER_SEEN = 0.6
"""And of the frames in which a cluster that moves is."""
SIDEWAYS_RAD, SIDEWAYS_MPS, SIDEWAYS_COUNT = np.radians(35.0), 2.0, 2
"""A vehicle that moves so far off its axis is parts of several: yaw is exact to 3 to 4 degrees."""
SAME_PART, SAME_SHARE = 0.3, 0.33
"""Two tracks are one object if they share so much of the smaller box for so much of the time; a person and a vehicle
`OTHER_PART`, as people stand close to cars."""
BEFORE_S = 2.0
"""What stands did not vanish within this before the ego came."""
GRAZE_M, LEAST_SIDE = 0.3, 0.5
"""A box reaches this much too far at most; no side becomes less than this share of it."""
MOMENT = 0.2
"""A track that the ego meets for a larger share of its samples is none."""
RANGE_M, RANGE_SIDE_M, EXTEND_S, EXTEND_STILL_MPS = 42.0, 20.0, 10.0, 0.2
"""Sight ends about 50 m ahead and 25 m to the side. Who stands when seen first beyond `RANGE_M` stood there before."""


def too_little(piece: Piece, boxes: Boxes) -> str | None:
    """Why a piece of motion is no evidence of a road user; None: it is."""
    group, count = GROUPS[piece.group], len(piece.rows)
    score = boxes.score[piece.rows]
    sure = group.least_score > 0.0 and np.nansum(score) >= SURE_SCORE * group.least_score
    if count < group.least_count or (piece.span < group.least_time - 1e-6 and not sure):
        return f"Seen {count} times within {piece.span:.1f} s: too little for a road user."
    if np.isfinite(score).all() and score.sum() < group.least_score:
        return f"The scores of its {count} detections sum up to {score.sum():.1f}: too little for a road user."
    seen = count / len(piece.t)
    if not piece.still and seen < (CLUSTER_SEEN if piece.group == CLUSTER else LEAST_SEEN):
        return f"Moves, and was seen in {seen:.0%} of the frames only."
    return None


def sideways(user: User, boxes: Boxes) -> str | None:
    """Why a vehicle's motion is none: it is across the axis of its boxes."""
    piece = user.piece
    if piece.group != VEHICLE:
        return None
    vx, vy = user.vx[piece.seen], user.vy[piece.seen]
    fast = np.hypot(vx, vy) > SIDEWAYS_MPS
    if fast.sum() < SIDEWAYS_COUNT:
        return None
    off = np.arctan2(vy, vx)[fast] - boxes.yaw[piece.rows][fast]
    median = float(np.median(np.abs(off - np.pi * np.round(off / np.pi))))
    if median <= SIDEWAYS_RAD:
        return None
    return f"A {user.kind.value} that moves {np.degrees(median):.0f} degrees off its axis: parts of several objects."


def in_anothers_place(users: Sequence[User], boxes: Boxes) -> dict[int, int]:
    """Which users are in the place of another one that is seen better, by their places in `users`.

    Better: no cluster, then the larger sum of scores.
    """
    named = np.array([user.piece.group != CLUSTER for user in users], np.float64)
    proof = np.array([boxes.weight[user.piece.rows].sum() for user in users]) + len(boxes) * named
    poses = [user.poses for user in users]
    reach = [0.5 * float(np.hypot(user.length, user.width)) for user in users]
    low = np.array([pose[:, :2].min(axis=0) - r for pose, r in zip(poses, reach, strict=True)]).reshape(-1, 2)
    high = np.array([pose[:, :2].max(axis=0) + r for pose, r in zip(poses, reach, strict=True)]).reshape(-1, 2)
    out: dict[int, int] = {}
    for a in np.argsort(proof, kind="stable").tolist():
        one = users[a]
        near = ((low <= high[a]) & (high >= low[a])).all(axis=1) & (proof >= proof[a])
        for b in np.flatnonzero(near).tolist():
            both = users[b].piece.group == PERSON and one.piece.group == PERSON  # people walk close together
            if b == a or b in out or both:
                continue
            apart = PERSON in (users[b].piece.group, one.piece.group)
            part = OTHER_PART if apart else SAME_PART
            if _same_place(one.t, poses[a], users[b].t, poses[b], part).mean() > SAME_SHARE:
                out[a] = b
                break
    return out


@kernel
def _same_place(t: FloatArray, boxes: FloatArray, times: FloatArray, others: FloatArray, part: float) -> BoolArray:
    """At which t `(k,)` a box of `boxes` `(k, 5)` shares `part` with that of `others` at the same time."""
    out = np.zeros(len(t), np.bool_)
    j = 0
    for i in range(len(t)):
        while j < len(times) and times[j] < t[i] - 1e-6:
            j += 1
        if j < len(times) and times[j] <= t[i] + 1e-6:
            a, b = boxes[i], others[j]
            both = shared_area(a[0], a[1], a[2], a[3], a[4], b[0], b[1], b[2], b[3], b[4])
            out[i] = both > part * min(a[3] * a[4], b[3] * b[4])
    return out


def _depths(t: FloatArray, boxes: FloatArray, ego: Trajectory, vehicle: VehicleParameters) -> FloatArray:
    """How deep boxes `(k, 5)` are within the ego's at t `(k,)`, m; 0: they are apart, or the log has no ego then."""
    x, y, yaw = (np.interp(t, ego.t, column) for column in (ego.x, ego.y, ego.yaw))
    x, y = x + vehicle.axle_to_center * np.cos(yaw), y + vehicle.axle_to_center * np.sin(yaw)
    own = np.column_stack([x, y, yaw, np.full(len(t), vehicle.length), np.full(len(t), vehicle.width)])
    return np.where((t >= ego.t[0]) & (t <= ego.t[-1]), _shared_depths(own, boxes), 0.0)


@kernel
def _shared_depths(one: FloatArray, two: FloatArray) -> FloatArray:
    """By how much boxes `(k, 5)` would have to be shifted apart `(k,)`, m."""
    out = np.empty(len(one))
    for i in range(len(one)):
        a, b = one[i], two[i]
        out[i] = max(0.0, -clearance(a[0], a[1], a[2], a[3], a[4], b[0], b[1], b[2], b[3], b[4]))
    return out


def beside_ego(user: User, ego: Trajectory, vehicle: VehicleParameters) -> tuple[User | None, str]:
    """A user with what the ego's drive says of it, and why; None where it was not there."""
    t, boxes = user.t, user.poses
    if user.piece.still:
        near = (ego.t >= t[0] - BEFORE_S) & (ego.t <= t[-1] + BEFORE_S)
        t, boxes = ego.t[near], np.repeat(boxes[:1], near.sum(), axis=0)
    depth = _depths(t, boxes, ego, vehicle)
    deepest = float(depth.max(initial=0.0))
    sides = user.length - 2.0 * deepest, user.width - 2.0 * deepest
    if deepest == 0.0:
        return user, ""
    if deepest <= GRAZE_M and sides[0] >= LEAST_SIDE * user.length and sides[1] >= LEAST_SIDE * user.width:
        return replace(user, length=sides[0], width=sides[1]), f"Its box reached {deepest:.2f} m into the ego's."
    share = float((depth > 0.0).mean())
    if user.piece.still or share > MOMENT:
        return None, f"The ego drove through it: their boxes overlap by {deepest:.2f} m."
    return _longest(user, depth == 0.0), f"Its box was {deepest:.2f} m within the ego's for {share:.0%} of its time."


def _longest(user: User, free: BoolArray) -> User:
    """The longest part of a user's time that is `free` `(k,)`."""
    ends = np.flatnonzero(np.diff(np.r_[False, free, False]))
    first, last = max(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True), key=lambda run: run[1] - run[0])
    return user.at(np.arange(first, last))


def extended(
    user: User, users: Sequence[User], frames: FloatArray, ego: Trajectory, vehicle: VehicleParameters
) -> User:
    """A user who stands where sight ends, standing there before the first (after the last) sight as well.

    Until the ego, or another one of `users`, is in that place.
    """
    if user.piece.group == PERSON:
        return user
    for at, side in ((0, -1), (-1, 1)):
        near = np.abs(user.t - user.t[at]) <= 1.0
        x, y, yaw = (float(np.interp(user.t[at], ego.t, column)) for column in (ego.x, ego.y, ego.yaw))
        dx, dy = user.x[at] - x, user.y[at] - y
        ahead, aside = abs(dx * np.cos(yaw) + dy * np.sin(yaw)), abs(dy * np.cos(yaw) - dx * np.sin(yaw))
        moves = np.hypot(user.vx[near], user.vy[near]).max() > EXTEND_STILL_MPS
        if moves or user.piece.span < 0.5 or (ahead < RANGE_M and aside < RANGE_SIDE_M):
            continue
        since = side * (frames - user.t[at])
        times = frames[(since > 1e-6) & (since <= EXTEND_S)]
        boxes = np.repeat(user.poses[[at]], len(times), axis=0)
        taken = _depths(times, boxes, ego, vehicle) > 0.0
        for other in users:
            if other.piece is not user.piece:
                taken |= _same_place(times, boxes, other.t, other.poses, 0.0)
        free = ~np.logical_or.accumulate(taken[::side])[::side]
        user = _with(user, times[free], at)
    return user


def _with(user: User, times: FloatArray, at: int) -> User:
    """A user who also stands at `times`, as at its sample `at`, first or last."""
    if not len(times):
        return user
    more = np.full(len(times), at % len(user.t))
    own = np.arange(len(user.t))
    rows, new = (np.r_[more, own], np.r_[times, user.t]) if at == 0 else (np.r_[own, more], np.r_[user.t, times])
    longer = user.at(rows)
    added = ~np.isin(new, user.t)
    return replace(
        longer, t=new, extended=longer.extended | added, vx=np.where(added, 0.0, longer.vx),
        vy=np.where(added, 0.0, longer.vy),
    )  # fmt: skip
