"""Raw detections to tracks with the whole log at hand: what the judge, traffic and drawing get. Not causal.

1. twins     of boxes of a frame that show one object the best stays (`boxes`)
2. join      detections to tracks, frame by frame (`association`)
3. stitch    tracks whose ends meet across a gap (`users`)
4. smooth    forward and backward, outliers weighted down; who stands has no speed (`users`, `kalman`)
5. vote      kind, size, front (`users`)
6. remove    what is no road user (`evidence`)
7. extend    who stands where sight ends (`evidence`)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from logs.agents import codes_of
from logs.detections import Change, Detections, Repair
from logs.kernel import FloatArray, IntArray
from logs.repair import evidence
from logs.repair.association import Association
from logs.repair.boxes import Boxes, stronger_twins
from logs.repair.users import Piece, User, fitted, stitched, user_of
from logs.scenario import Tracks
from logs.states import Trajectory
from logs.vehicle import VehicleParameters

_Removed = tuple[User, str]
"""What was no road user, and why."""


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


def repair(detections: Detections, ego: Trajectory, vehicle: VehicleParameters) -> tuple[Tracks, Repair]:
    """The road users that raw detections show, and what was done to find them. Not causal: uses the whole log.

    `ego` is the drive of the log (rear axle): far boxes count less, and nothing stands where it drove. A track keeps
    the id of the log where all of its detections, and no others, have it; else its id is a number in order of birth.
    """
    every, frames = Boxes.of(detections), detections.frames
    twin_of = stronger_twins(every)
    boxes = every.taken(np.flatnonzero(twin_of < 0))
    names = np.concatenate([np.empty(0, np.int64), *(found for _, _, found in Association().steps(boxes, frames))])
    order = np.argsort(names, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(names[order])) + 1) if len(names) else []
    pieces = [fitted(rows, boxes, frames) for rows in parts]
    several = stitched([piece for piece in pieces if len(piece.rows) > 1], boxes, frames)
    users, removed = _road_users([*several, *(piece for piece in pieces if len(piece.rows) == 1)], boxes, frames, ego)
    stay, notes = [], []
    for user in sorted(users, key=_birth):
        kept, note = evidence.beside_ego(user, ego, vehicle)
        if kept is None:
            removed.append((user, note))
        else:
            stay.append(kept)
            notes.append(note)
    removed.sort(key=lambda each: _birth(each[0]))
    users = [evidence.extended(user, stay, frames, ego, vehicle) for user in stay]

    def sources(user: User) -> tuple[str, ...]:
        """The ids that the log gave to a user's detections, in order of time."""
        named = (detections.ids[i] for i in boxes.source[user.piece.rows].tolist())
        return tuple(dict.fromkeys(name for name in named if name))

    everywhere = Counter(detections.ids[i] for i in boxes.source.tolist())
    numbers = (str(k) for k in range(1, len(users) + len(everywhere) + 1) if str(k) not in everywhere)
    weaker = np.bincount(every.source[twin_of[twin_of >= 0]], minlength=len(every))[boxes.source]
    ids, changes = list[str](), list[Change]()
    for user, note in zip(users, notes, strict=True):
        rows, logged = user.piece.rows, sources(user)
        own = len(logged) == 1 and everywhere[logged[0]] == len(rows)
        ids.append(logged[0] if own else next(numbers))
        changes += _changes(user, ids[-1], note, int(weaker[rows].sum()), logged)
    gone = [f"removed {k + 1}" for k in range(len(removed))]
    for (user, why), name in zip(removed, gone, strict=True):
        span = float(user.t[0]), float(user.t[-1])
        changes.append(Change("removed", name, *span, len(user.piece.rows), why, sources(user)))
    added = np.concatenate([np.empty(0, np.bool_), *(user.extended for user in users)])
    tracks = _tracks(users, ids)
    return tracks, Repair(detections, _tracks([user for user, _ in removed], gone), added, tuple(changes), tracks)


def _birth(user: User) -> tuple[float, int]:
    return float(user.t[0]), int(user.piece.rows[0])


def _road_users(
    pieces: Sequence[Piece], boxes: Boxes, frames: FloatArray, ego: Trajectory
) -> tuple[list[User], list[_Removed]]:
    """The users that pieces of motion are evidence of, and what is none or in the place of a better one.

    The better one gets what the other shows of it before and after.
    """
    every = [user_of(piece, boxes, ego) for piece in pieces]
    reasons = [evidence.trouble(user, boxes) for user in every]
    removed = [(user, why) for user, why in zip(every, reasons, strict=True) if why]
    users = [user for user, why in zip(every, reasons, strict=True) if not why]
    better = evidence.in_anothers_place(users, boxes)
    gained: dict[int, list[IntArray]] = {}
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
            removed.append((inside, f"In the place of another {users[b].kind.value} that is seen better."))
    for b, more in gained.items():
        rows = np.concatenate([users[b].piece.rows, *more])
        rows = rows[np.unique(boxes.frame[rows], return_index=True)[1]]
        users[b] = user_of(fitted(rows, boxes, frames), boxes, ego)
    return [user for i, user in enumerate(users) if i not in better], removed


def _changes(user: User, name: str, note: str, twins: int, sources: tuple[str, ...]) -> list[Change]:
    """What was done to one road user who stays."""
    t, count = user.piece.t, len(user.piece.rows)
    out = []

    def add(what: str, samples: int, why: str, times: FloatArray = t) -> None:
        out.append(Change(what, name, float(times[0]), float(times[-1]), samples, why, sources))

    if sources != (name,) or len(t) > count:
        under = f"under {len(sources)} ids" if sources else "without ids"
        gap = np.diff(t[user.piece.seen]).max(initial=0.0)
        add("joined", count, f"{count} detections {under}, the longest gap {gap:.1f} s.")
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
            add("extended", len(times), why, times)
    return out


def _tracks(users: Sequence[User], ids: Sequence[str]) -> Tracks:
    length, width = np.array([(user.length, user.width) for user in users]).reshape(-1, 2).T
    offsets = np.r_[0, np.cumsum([len(user.t) for user in users], dtype=np.int64)]
    columns = np.hstack([np.empty((6, 0)), *(user.way for user in users)])
    kinds = tuple(user.kind for user in users)
    return Tracks(tuple(ids), kinds, length, width, np.zeros(len(users), np.bool_), offsets, *columns)
