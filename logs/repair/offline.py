"""Makes tracks from raw detections with the whole log, for metrics, traffic and drawing (not
causal).

1. twins     keep the best of the boxes of a frame that show one object (`boxes`)
2. join      detections to tracks, frame by frame (`tracker`)
3. stitch    tracks whose ends meet across a gap (`users`)
4. smooth    forward and backward, with less weight for outliers; standing users have no speed
             (`users`)
5. vote      kind, size, front (`users`)
6. remove    users seen too rarely, with impossible motion, in the place of a better one, or where
             the ego drove; a box that the ego only grazes, within the noise of boxes, is shrunk; of
             a track that the ego meets for a moment, only the longest part without contact stays
7. extend    users who stand at the edge of sight
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.logs.agents import codes_of
from replan.logs.repair.detected_boxes import (
    CLUSTER,
    NOISE,
    OTHER_PART,
    PERSON,
    VEHICLE,
    Boxes,
    shares,
    stronger_twins,
)
from replan.logs.repair.detections import Detections, Repair, TrackChange
from replan.logs.repair.tracker import Association
from replan.logs.repair.users import Piece, User, fitted, stitched, user_of
from replan.logs.shapes import clearance
from replan.logs.states import Trajectory
from replan.logs.tracks import SAMPLE_COLUMNS, Tracks
from replan.logs.vehicle import VehicleParameters

STEADY, STEADY_MPS = 3, 5.0
"""Index of the group of road users with a constant speed above `STEADY_MPS`, m/s. They are in sight
for a few frames only, and clutter does not move along a line."""
LEAST_TIME, LEAST_COUNT = frozen([0.7, 0.7, 1.5, 0.25]), frozen([5, 5, 10, 4])
LEAST_SCORE, LEAST_SEEN = frozen([2.5, 2.0, 0.0, 1.2]), frozen([0.3, 0.3, 0.6, 0.15])
"""By group, least evidence of a road user: time, s, number of detections, sum of scores (clutter
lasts 0.1 to 0.5 s), and the share of frames in which a moving one is detected (measured: 0.93 close
by to 0.69 at 90 m)."""
SURE_SCORE = 1.2
"""From this multiple of `LEAST_SCORE` on, no least time is required: some users appear only at the
ends of the log.
"""
SIDEWAYS_RAD, SIDEWAYS_MPS, SIDEWAYS_COUNT = np.radians(35.0), 2.0, 2
"""A vehicle that moves this far off its axis consists of parts of several objects: yaw is exact to
3 to 4 degrees.
"""
SAME_PART, SAME_SHARE = 0.3, 0.33
"""Two tracks are one object if they share more than `SAME_PART` of the smaller box for more than
`SAME_SHARE` of the time; for a person and a vehicle the part is `OTHER_PART`, as people stand close
to cars."""
BEFORE_S = 2.0
"""A standing object does not vanish within this time before the ego arrives, s."""
GRAZE_M, LEAST_SIDE, MOMENT = 0.3, 0.5, 0.2
"""A box is too large by at most `GRAZE_M`, and no side shrinks below the share `LEAST_SIDE`; a
track that overlaps the ego in more than the share `MOMENT` of its samples is not a road user."""
ROOM_M, PASSING_S = 0.2, 0.02
"""The recorded driver keeps at least this from what stands, m.

It is looked at every `PASSING_S`, s.
"""
RANGE_M, RANGE_SIDE_M = 42.0, 20.0
EXTEND_S, EXTEND_STILL_MPS = 10.0, 0.2
"""Sight ends about 50 m ahead and 25 m to the side. A user who stands at the first (last) sight
beyond `RANGE_M` ahead or `RANGE_SIDE_M` aside is assumed to stand there before (after), for
`EXTEND_S` at most."""


def detections_of(tracks: Tracks) -> Detections:
    """Return the samples of tracks as detections without scores, so that any log can be
    repaired.
    """
    order = np.lexsort((tracks.owner, tracks.t))
    columns = {name: getattr(tracks, name)[order] for name in SAMPLE_COLUMNS}
    owners = tracks.owner[order]
    return Detections(
        frames=np.unique(tracks.t),
        ids=tuple(tracks.ids[i] for i in owners),
        codes=codes_of(tracks.kinds)[owners],
        length=tracks.length[owners],
        width=tracks.width[owners],
        score=np.full(len(owners), np.nan),
        **columns,
    )


def repair(
    detections: Detections, ego: Trajectory, vehicle: VehicleParameters
) -> tuple[Tracks, Repair]:
    """Make tracks from raw detections, and record all changes. Not causal: it uses the whole log.

    `ego` is the drive of the log (rear axle): far boxes have less weight, and objects in its way
    are removed. A track keeps the id of the log if exactly its detections have this id; else its id
    is a number in order of birth.
    """
    every, frames = detections.boxes, detections.frames
    twin_of = stronger_twins(every)
    boxes = every.taken(np.flatnonzero(twin_of < 0))
    names = np.concatenate(
        [np.empty(0, np.int64), *(names for _, _, names in Association().steps(boxes, frames))]
    )
    order = np.argsort(names, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(names[order])) + 1) if len(names) else []
    pieces = [fitted(rows, boxes, frames) for rows in parts]
    several = stitched([piece for piece in pieces if len(piece.rows) > 1], boxes, frames)
    users, removed = _road_users(
        [*several, *(piece for piece in pieces if len(piece.rows) == 1)], boxes, frames, ego
    )
    stay, notes = [], []
    for user in sorted(users, key=_birth):
        remaining, note = _beside_ego(user, ego, vehicle)
        if remaining is None:
            removed.append((user, note))
        else:
            stay.append(remaining)
            notes.append(note)
    removed.sort(key=lambda each: _birth(each[0]))
    users = [_extend_standing(user, stay, frames, ego, vehicle) for user in stay]

    def sources(user: User) -> tuple[str, ...]:
        named = (detections.ids[i] for i in boxes.source[user.piece.rows].tolist())
        return tuple(dict.fromkeys(name for name in named if name))

    everywhere = Counter(detections.ids[i] for i in boxes.source.tolist())
    numbers = (
        str(k) for k in range(1, len(users) + len(everywhere) + 1) if str(k) not in everywhere
    )
    weaker = np.bincount(every.source[twin_of[twin_of >= 0]], minlength=len(every))[boxes.source]
    ids, changes = list[str](), list[TrackChange]()
    for user, note in zip(users, notes, strict=True):
        rows, logged = user.piece.rows, sources(user)
        own = len(logged) == 1 and everywhere[logged[0]] == len(rows)
        ids.append(logged[0] if own else next(numbers))
        changes += _changes(user, ids[-1], note, int(weaker[rows].sum()), logged)
    gone = [f"removed {k + 1}" for k in range(len(removed))]
    for (user, why), name in zip(removed, gone, strict=True):
        span = float(user.t[0]), float(user.t[-1])
        changes.append(
            TrackChange("removed", name, *span, len(user.piece.rows), why, sources(user))
        )
    added = np.concatenate([np.empty(0, np.bool_), *(user.extended for user in users)])
    tracks = _tracks(users, ids)
    return tracks, Repair(
        detections, _tracks([user for user, _ in removed], gone), added, tuple(changes), tracks
    )


def _birth(user: User) -> tuple[float, int]:
    return float(user.t[0]), int(user.piece.rows[0])


def _road_users(
    pieces: Sequence[Piece], boxes: Boxes, frames: FloatArray, ego: Trajectory
) -> tuple[list[User], list[tuple[User, str]]]:
    """Return the road users of pieces with enough evidence, and the removed ones with reasons.

    A user in the place of a better one is removed; its detections before and after the better one's
    go to that one.
    """
    every = [user_of(piece, boxes, ego) for piece in pieces]
    reasons = [_trouble(user, boxes) for user in every]
    removed = [(user, why) for user, why in zip(every, reasons, strict=True) if why]
    users = [user for user, why in zip(every, reasons, strict=True) if not why]
    # better evidence: not a cluster, then the larger sum of weights
    group = np.array([user.piece.group for user in users])
    proof = np.array([boxes.weight[user.piece.rows].sum() for user in users]) + len(boxes) * (
        group != CLUSTER
    )
    reach = np.array([0.5 * np.hypot(user.length, user.width) for user in users])[:, None]
    low, high = (
        np.array([end(user.poses[:, :2], axis=0) for user in users]).reshape(-1, 2) + sign * reach
        for end, sign in ((np.min, -1.0), (np.max, 1.0))
    )
    better: dict[int, int] = {}
    for a in np.argsort(proof, kind="stable").tolist():
        near = ((low <= high[a]) & (high >= low[a])).all(axis=1) & (proof >= proof[a])
        near &= (group != PERSON) | (group[a] != PERSON)  # people walk close together
        for b in np.flatnonzero(near).tolist():
            part = OTHER_PART if PERSON in (group[a], group[b]) else SAME_PART
            if b == a or b in better:
                continue
            if (
                shares(users[a].t, users[a].poses, users[b].t, users[b].poses, part).mean()
                > SAME_SHARE
            ):
                better[a] = b
                break
    gained: dict[int, list[IntArray]] = {}
    for a in sorted(better):
        b = better[a]
        while b in better:
            b = better[b]
        lesser_piece, better_piece = users[a].piece, users[b].piece
        t = boxes.t[lesser_piece.rows]
        same_group = lesser_piece.group == better_piece.group
        outside = ((t < better_piece.t[0]) | (t > better_piece.t[-1])) & same_group
        gained.setdefault(b, []).append(lesser_piece.rows[outside])
        if not outside.all():
            inside = (
                user_of(fitted(lesser_piece.rows[~outside], boxes, frames), boxes, ego)
                if outside.any()
                else users[a]
            )
            removed.append(
                (inside, f"In the place of another {users[b].kind.value} that is seen better.")
            )
    for b, more in gained.items():
        rows = np.concatenate([users[b].piece.rows, *more])
        rows = rows[np.unique(boxes.frame[rows], return_index=True)[1]]
        users[b] = user_of(fitted(rows, boxes, frames), boxes, ego)
    return [user for i, user in enumerate(users) if i not in better], removed


def _changes(
    user: User, name: str, note: str, twins: int, sources: tuple[str, ...]
) -> list[TrackChange]:
    t, count = user.piece.t, len(user.piece.rows)
    changes = []

    def add(what: str, samples: int, why: str, times: FloatArray = t) -> None:
        changes.append(
            TrackChange(what, name, float(times[0]), float(times[-1]), samples, why, sources)
        )

    if sources != (name,) or len(t) > count:
        under = f"under {len(sources)} ids" if sources else "without ids"
        gap = np.diff(t[user.piece.seen]).max(initial=0.0)
        add("joined", count, f"{count} detections {under}, the longest gap {gap:.1f} s.")
    if twins:
        add("removed", twins, f"{twins} boxes overlap better ones of the same object.")
    if user.turned:
        add(
            "turned",
            user.turned,
            f"{user.turned} of {count} detections have front and back exchanged.",
        )
    if user.kind is not user.label:
        add("relabelled", count, f"Detected as a {user.label.value}, moves as a {user.kind.value}.")
    if note:
        add("shrunk", count, note)
    for part, side in ((user.t < t[0], "before"), (user.t > t[-1], "after")):
        times = user.t[part & user.extended]
        if len(times):
            why = f"Stood at the edge of sight: it is assumed there {np.ptp(times):.1f} s {side}."
            add("extended", len(times), why, times)
    return changes


def _tracks(users: Sequence[User], ids: Sequence[str]) -> Tracks:
    length, width = np.array([(user.length, user.width) for user in users]).reshape(-1, 2).T
    offsets = np.r_[0, np.cumsum([len(user.t) for user in users], dtype=np.int64)]
    columns = np.hstack([np.empty((6, 0)), *(user.way for user in users)])
    kinds = tuple(user.kind for user in users)
    return Tracks(
        tuple(ids), kinds, length, width, np.zeros(len(users), np.bool_), offsets, *columns
    )


def _trouble(user: User, boxes: Boxes) -> str | None:
    """Return why a piece has too little evidence of a road user, or moves unlike a vehicle; None if
    it is one.
    """
    piece, score = user.piece, boxes.score[user.piece.rows]
    group, count, span = piece.group, len(piece.rows), piece.t[-1] - piece.t[0]
    row = group
    if group != CLUSTER and count >= LEAST_COUNT[STEADY]:
        # steady: its detections lie on a line through time, as far as their noise allows
        t, xy = piece.t[piece.seen], piece.z[piece.seen]
        velocity, start = np.polyfit(t - t[0], xy, 1)
        off = xy - start - np.outer(t - t[0], velocity)
        deviation = np.sqrt((off**2).sum() / (off.size - velocity.size - start.size))
        row = STEADY if np.hypot(*velocity) > STEADY_MPS and deviation < NOISE[group] else group
    sure = LEAST_SCORE[row] > 0.0 and np.nansum(score) >= SURE_SCORE * LEAST_SCORE[row]
    if count < LEAST_COUNT[row] or (span < LEAST_TIME[row] - 1e-6 and not sure):
        return f"Seen {count} times within {span:.1f} s: too little for a road user."
    if np.isfinite(score).all() and score.sum() < LEAST_SCORE[row]:
        return (
            f"The scores of its {count} detections sum up to {score.sum():.1f}: too little for "
            "a road user."
        )
    seen = count / len(piece.t)
    if not piece.still and seen < LEAST_SEEN[row]:
        return f"Moves, and was seen in {seen:.0%} of the frames only."
    vx, vy = user.way[4:, piece.seen]
    fast = np.hypot(vx, vy) > SIDEWAYS_MPS
    if group != VEHICLE or fast.sum() < SIDEWAYS_COUNT:
        return None
    askew = np.arctan2(vy, vx)[fast] - boxes.yaw[piece.rows][fast]
    median = float(np.median(np.abs(askew - np.pi * np.round(askew / np.pi))))
    if median <= SIDEWAYS_RAD:
        return None
    return (
        f"A {user.kind.value} that moves {np.degrees(median):.0f} degrees off its axis: parts "
        "of several objects."
    )


def _depths(
    t: FloatArray, boxes: FloatArray, ego: Trajectory, vehicle: VehicleParameters, room: float = 0.0
) -> FloatArray:
    """Return how deep boxes `(k, 5)` overlap the ego's, larger by `room` on all sides, at t `(k,)`,
    m.

    It is 0 if they are apart, or if the log has no ego then.
    """
    x, y, yaw = (np.interp(t, ego.t, column) for column in (ego.x, ego.y, ego.yaw))
    x, y = x + vehicle.axle_to_center * np.cos(yaw), y + vehicle.axle_to_center * np.sin(yaw)
    long, wide = vehicle.length + 2.0 * room, vehicle.width + 2.0 * room
    reach = 0.5 * (np.hypot(long, wide) + np.hypot(boxes[:, 3], boxes[:, 4]))
    near = (
        (t >= ego.t[0]) & (t <= ego.t[-1]) & (np.hypot(x - boxes[:, 0], y - boxes[:, 1]) <= reach)
    )
    depths = np.zeros(len(t))
    for i in np.flatnonzero(near).tolist():
        depths[i] = max(0.0, -clearance(x[i], y[i], yaw[i], long, wide, *boxes[i]))
    return depths


def _beside_ego(user: User, ego: Trajectory, vehicle: VehicleParameters) -> tuple[User | None, str]:
    """Check a road user against the ego's drive: return it, shrunk or cut, or None, and the
    reason.
    """
    t, boxes = user.t, user.poses
    if user.piece.still:
        t = np.arange(max(t[0] - BEFORE_S, ego.t[0]), min(t[-1] + BEFORE_S, ego.t[-1]), PASSING_S)
        boxes = np.repeat(boxes[:1], len(t), axis=0)
    depth = _depths(t, boxes, ego, vehicle)
    deepest = float(depth.max(initial=0.0))
    short = (
        float(_depths(t, boxes, ego, vehicle, ROOM_M).max(initial=0.0))
        if user.piece.still
        else deepest
    )
    if short == 0.0:
        return user, ""
    most = 0.5 * (1.0 - LEAST_SIDE) * min(user.length, user.width)
    if deepest <= min(GRAZE_M, most):
        by = min(short, most)
        near = (
            f"reached {deepest:.2f} m into the ego's"
            if deepest > 0.0
            else f"came within {ROOM_M:g} m of the ego's"
        )
        return replace(
            user, length=user.length - 2.0 * by, width=user.width - 2.0 * by
        ), f"Its box {near}."
    share = float((depth > 0.0).mean())
    if user.piece.still or share > MOMENT:
        return None, f"The ego drove through it: their boxes overlap by {deepest:.2f} m."
    ends = np.flatnonzero(np.diff(np.r_[False, depth == 0.0, False]))
    first, last = max(
        zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True), key=lambda run: run[1] - run[0]
    )
    longest = replace(user, way=user.way[:, first:last], extended=user.extended[first:last])
    return longest, f"Its box was {deepest:.2f} m within the ego's for {share:.0%} of its time."


def _extend_standing(
    user: User,
    users: Sequence[User],
    frames: FloatArray,
    ego: Trajectory,
    vehicle: VehicleParameters,
) -> User:
    """Extend a user who stands at the edge of sight to times before the first (after the last)
    detection.

    The extension ends where the ego, or another one of `users`, is in that place.
    """
    if user.piece.group == PERSON or user.piece.t[-1] - user.piece.t[0] < 0.5:
        return user
    for end_row, side in ((0, -1), (-1, 1)):
        end, near = user.way[:, end_row], np.abs(user.t - user.t[end_row]) <= 1.0
        x, y, yaw = (float(np.interp(end[0], ego.t, column)) for column in (ego.x, ego.y, ego.yaw))
        dx, dy = end[1] - x, end[2] - y
        ahead, aside = (
            abs(dx * np.cos(yaw) + dy * np.sin(yaw)),
            abs(dy * np.cos(yaw) - dx * np.sin(yaw)),
        )
        since = side * (frames - end[0])
        times = frames[(since > 1e-6) & (since <= EXTEND_S)]
        moves = np.hypot(*user.way[4:, near]).max() > EXTEND_STILL_MPS
        if moves or not len(times) or (ahead < RANGE_M and aside < RANGE_SIDE_M):
            continue
        boxes = np.repeat(user.poses[[end_row]], len(times), axis=0)
        taken = _depths(times, boxes, ego, vehicle) > 0.0
        for other in users:
            if other.piece is not user.piece:
                taken |= shares(times, boxes, other.t, other.poses, 0.0)
        times = times[~np.logical_or.accumulate(taken[::side])[::side]]
        _, end_x, end_y, end_yaw, *_ = end
        more = np.outer([0.0, end_x, end_y, end_yaw, 0.0, 0.0], np.ones(len(times)))
        more[0] = times
        columns, marks = [more, user.way], [np.ones(len(times), np.bool_), user.extended]
        user = replace(user, way=np.hstack(columns[::-side]), extended=np.hstack(marks[::-side]))
    return user
