"""Raw detections to tracks with the whole log at hand: what the judge, traffic and drawing get. Not causal.

1. twins     of boxes of a frame that show one object the best stays (`overlap`)
2. join      detections to tracks, frame by frame (`association`)
3. stitch    tracks whose ends meet across a gap (`pieces`)
4. smooth    forward and backward, outliers weighted down; who stands has no speed (`pieces`, `kalman`)
5. vote      kind, size, front (`users`)
6. remove    what is no road user (`evidence`)
7. extend    who stands where sight ends (`evidence`)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.agents import codes_of
from logs.detections import Change, Detections, Repair
from logs.kernel import FloatArray, IntArray
from logs.repair import evidence
from logs.repair.association import joined
from logs.repair.groups import Boxes
from logs.repair.overlap import stronger_twins
from logs.repair.pieces import Piece, fitted, stitched
from logs.repair.users import User, user_of
from logs.scenario import Tracks
from logs.states import Trajectory
from logs.vehicle import VehicleParameters


def detections_of(tracks: Tracks) -> Detections:
    """The samples of tracks as detections without scores, by which any log can be repaired."""
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    order = np.lexsort((owner, tracks.t))
    columns = {name: getattr(tracks, name)[order] for name in ("t", "x", "y", "yaw", "vx", "vy")}
    who = owner[order]
    return Detections(
        frames=np.unique(tracks.t), ids=tuple(tracks.ids[i] for i in who), codes=codes_of(tracks.kinds)[who],
        length=tracks.length[who], width=tracks.width[who], score=np.full(len(who), np.nan), **columns,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Removed:
    user: User
    why: str


def repair(detections: Detections, ego: Trajectory, vehicle: VehicleParameters) -> tuple[Tracks, Repair]:
    """The road users that raw detections show, and what was done to find them. Not causal: uses the whole log.

    `ego` is the drive of the log (rear axle): far boxes count less, and nothing stands where it drove. A track keeps
    the id of the log where all of its detections, and no others, have it; else its id is a number in order of birth.
    """
    every = Boxes.of(detections)
    if not len(every):
        return Tracks.empty(), Repair(detections, Tracks.empty(), np.empty(0, np.bool_), (), Tracks.empty())
    twin_of = stronger_twins(every)
    boxes = every.taken(np.flatnonzero(twin_of < 0))
    names = joined(boxes, detections.frames)
    order = np.argsort(names, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(names[order])) + 1)
    pieces = [fitted(rows, boxes, detections.frames) for rows in parts]
    several = stitched([piece for piece in pieces if len(piece.rows) > 1], boxes, detections.frames)
    alone = [piece for piece in pieces if len(piece.rows) == 1]
    users, removed, notes = _judged(several + alone, boxes, detections.frames, ego, vehicle)
    users = [evidence.extended(user, users, detections.frames, ego, vehicle) for user in users]
    return _reported(users, removed, notes, detections, boxes, every, twin_of)


def _judged(
    pieces: Sequence[Piece], boxes: Boxes, frames: FloatArray, ego: Trajectory, vehicle: VehicleParameters
) -> tuple[list[User], list[_Removed], list[str]]:
    """Who was there, in order of birth; what was not; and per user what the ego's drive changed."""
    found, removed = [], []
    for piece in pieces:
        user = user_of(piece, boxes, ego)
        why = evidence.too_little(piece, boxes) or evidence.sideways(user, boxes)
        if why:
            removed.append(_Removed(user, why))
        else:
            found.append(user)
    found, doubles = _without_doubles(found, boxes, frames, ego)
    users, notes = [], []
    for user in sorted(found, key=lambda user: (user.t[0], user.piece.rows[0])):
        kept, note = evidence.beside_ego(user, ego, vehicle)
        if kept is None:
            removed.append(_Removed(user, note))
        else:
            users.append(kept)
            notes.append(note)
    removed = sorted(removed + doubles, key=lambda each: (each.user.t[0], each.user.piece.rows[0]))
    return users, removed, notes


def _without_doubles(
    users: Sequence[User], boxes: Boxes, frames: FloatArray, ego: Trajectory
) -> tuple[list[User], list[_Removed]]:
    """The users but for those in the place of a better one, which gets what they show of it before and after."""
    better = evidence.in_anothers_place(users, boxes)
    gained: dict[int, list[IntArray]] = {}
    removed = []
    for a in sorted(better):
        b = better[a]
        while b in better:
            b = better[b]
        one, two = users[a].piece, users[b].piece
        t = boxes.t[one.rows]
        outside = ((t < two.t[0]) | (t > two.t[-1])) & (one.group == two.group)
        gained.setdefault(b, []).append(one.rows[outside])
        if not outside.all():
            inside = user_of(fitted(one.rows[~outside], boxes, frames), boxes, ego) if outside.any() else users[a]
            removed.append(_Removed(inside, f"In the place of another {users[b].kind.value} that is seen better."))
    out = []
    for i, user in enumerate(users):
        if i in gained:
            rows = np.concatenate([user.piece.rows, *gained[i]])
            rows = rows[np.unique(boxes.frame[rows], return_index=True)[1]]
            user = user_of(fitted(rows, boxes, frames), boxes, ego)
        if i not in better:
            out.append(user)
    return out, removed


def _reported(
    users: Sequence[User], removed: Sequence[_Removed], notes: Sequence[str], detections: Detections, boxes: Boxes,
    every: Boxes, twin_of: IntArray,
) -> tuple[Tracks, Repair]:  # fmt: skip
    """The users as tracks, and a list of all that was done."""
    ids = _ids(users, detections, boxes)
    gone = tuple(f"removed {k + 1}" for k in range(len(removed)))
    weaker = np.bincount(every.source[twin_of[twin_of >= 0]], minlength=len(every))
    changes: list[Change] = []
    for user, name, note in zip(users, ids, notes, strict=True):
        twins = int(weaker[boxes.source[user.piece.rows]].sum())
        changes += _changes(user, name, note, twins, _sources(user, detections, boxes))
    for each, name in zip(removed, gone, strict=True):
        user = each.user
        whole = float(user.t[0]), float(user.t[-1]), len(user.piece.rows)
        changes.append(Change("removed", name, *whole, each.why, _sources(user, detections, boxes)))
    added = np.concatenate([user.extended for user in users]) if users else np.empty(0, np.bool_)
    tracks, taken = _tracks(users, ids), _tracks([each.user for each in removed], gone)
    return tracks, Repair(detections, taken, added, tuple(changes), tracks)


def _changes(user: User, name: str, note: str, twins: int, sources: tuple[str, ...]) -> list[Change]:
    """What was done to one road user who stays."""
    t, count = user.piece.t, len(user.piece.rows)
    out = []

    def add(what: str, samples: int, why: str, begin: float = float(t[0]), end: float = float(t[-1])) -> None:
        out.append(Change(what, name, begin, end, samples, why, sources))

    steps = np.diff(t[user.piece.seen])
    if sources != (name,) or len(t) > count:
        under = f"under {len(sources)} ids" if sources else "without ids"
        add("joined", count, f"{count} detections {under}, the longest gap {steps.max(initial=0.0):.1f} s.")
    if twins:
        add("removed", twins, f"{twins} boxes overlap better ones of the same object.")
    if user.turned:
        add("turned", user.turned, f"{user.turned} of {count} detections have front and back exchanged.")
    if user.kind is not user.label:
        add("relabelled", count, f"Detected as a {user.label.value}, moves as a {user.kind.value}.")
    if note:
        add("shrunk", count, note)
    for part, side in ((user.t < t[0], "before"), (user.t > t[-1], "after")):
        times = user.t[part & user.extended]
        if len(times):
            why = f"Stood at the edge of sight: it is assumed there {np.ptp(times):.1f} s {side}."
            add("extended", len(times), why, float(times[0]), float(times[-1]))
    return out


def _sources(user: User, detections: Detections, boxes: Boxes) -> tuple[str, ...]:
    """The ids that the log gave to a user's detections, in order of time."""
    named = (detections.ids[i] for i in boxes.source[user.piece.rows].tolist())
    return tuple(dict.fromkeys(name for name in named if name))


def _ids(users: Sequence[User], detections: Detections, boxes: Boxes) -> tuple[str, ...]:
    """The log's id where it is this user's alone and the only one, else a number that no id of the log is."""
    everywhere = Counter(detections.ids[i] for i in boxes.source.tolist())
    numbers = (str(k) for k in range(1, len(users) + len(everywhere) + 1) if str(k) not in everywhere)
    out = []
    for user in users:
        sources = _sources(user, detections, boxes)
        own = len(sources) == 1 and everywhere[sources[0]] == len(user.piece.rows)
        out.append(sources[0] if own else next(numbers))
    return tuple(out)


def _tracks(users: Sequence[User], ids: tuple[str, ...]) -> Tracks:
    if not users:
        return Tracks.empty()

    def column(name: str) -> FloatArray:
        return np.concatenate([getattr(user, name) for user in users])

    return Tracks(
        ids, tuple(user.kind for user in users), np.array([user.length for user in users]),
        np.array([user.width for user in users]), np.zeros(len(users), np.bool_),
        np.r_[0, np.cumsum([len(user.t) for user in users])], *map(column, ("t", "x", "y", "yaw", "vx", "vy")),
    )  # fmt: skip
