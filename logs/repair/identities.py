"""Names of road users: checks whether a log's ids are identities, and matches causal tracks with repaired ones.

(1) a causal track belongs to the repaired track whose box was nearest to its own, within `NEAR_M`, in most frames up to
    now; a causal track that was near no repaired track is not a road user
(2) a repaired track gets the name of the causal track that belonged to it in most frames; other causal tracks of the
    same road user, after a loss, keep their own names. A repaired track without a causal track gets a new name; a
    static road user keeps its name, with a suffix if a causal track has it
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from logs.agents import Agents
from logs.arrays import FloatArray
from logs.repair.detections import Detections, Repair

STEP_S, FASTEST_MPS, JUMPS = 0.5, 60.0, 0.02
"""Ids are not identities if more than `JUMPS` of the steps of equal ids within `STEP_S` are faster than `FASTEST_MPS`,
or if more than this share of the boxes has the same id as another box of the frame."""
SHORT_S, FLICKER, LEAST_IDS = 1.0, 0.5, 10
"""Road users flicker if more than half of at least ten ids are seen for less than a second."""
NEAR_M = 2.5
"""Half of a car's length, m: covers the drift of detected centres and the error of extrapolating lost agents."""
UNTRACKED = "untracked"


def needs_repair(detections: Detections) -> str | None:
    """Return why the detections must be repaired, in a sentence; None if they are tracks already."""
    if not any(detections.ids):
        return "The log gives its detections no ids." if len(detections) else None
    why = no_identities(detections.ids, detections.t, detections.x, detections.y)
    if why or np.ptp(detections.frames) < 2.0 * SHORT_S:
        return why
    codes = np.unique(np.array(detections.ids), return_inverse=True)[1]
    begin, end = np.full(codes.max() + 1, np.inf), np.full(codes.max() + 1, -np.inf)
    np.minimum.at(begin, codes, detections.t)
    np.maximum.at(end, codes, detections.t)
    short = int((end - begin < SHORT_S).sum())
    if len(begin) >= LEAST_IDS and short > FLICKER * len(begin):
        return f"Road users flicker: {short} of {len(begin)} ids are seen for less than {SHORT_S:g} s."
    return None


def no_identities(ids: Sequence[str], t: FloatArray, x: FloatArray, y: FloatArray) -> str | None:
    """Return why the ids of boxes `(m,)` at the frame times t `(m,)`, s, are not identities; None if they are."""
    codes = np.unique(np.array(ids), return_inverse=True)[1]
    order = np.lexsort((t, codes))
    same, dt = np.diff(codes[order]) == 0, np.diff(t[order])
    twice = int((same & (dt == 0.0)).sum())
    if twice > JUMPS * len(ids):
        return f"Ids of detections are no identities: {twice / len(ids):.0%} stand twice in a frame."
    near = same & (dt > 0.0) & (dt <= STEP_S)
    step = np.hypot(np.diff(x[order]), np.diff(y[order]))
    jumps = int((near & (step > FASTEST_MPS * np.maximum(dt, 0.02))).sum())
    if jumps > JUMPS * max(int(near.sum()), 1):
        return f"Ids of detections are no identities: {jumps} of {int(near.sum())} steps are jumps."
    return None


class Owners:
    """Assigns causal tracks to the tracks of a log (1), frame by frame."""

    def __init__(self) -> None:
        self.votes: dict[str, Counter[str]] = defaultdict(Counter)

    def of(self, known: Agents, log: Agents) -> list[str]:
        """Return the log's name of each known agent, "" if it has none; both arguments are states at the same time."""
        away = np.hypot(known.x[:, None] - log.x, known.y[:, None] - log.y)
        for name, row in zip(known.ids, away if len(log) else (), strict=bool(len(log))):
            nearest = int(np.argmin(row))
            if row[nearest] <= NEAR_M:
                self.votes[name][log.ids[nearest]] += 1
        return [self.owner(name) for name in known.ids]

    def owner(self, name: str) -> str:
        """Return the log's track that owns a causal track; the first of several with equal votes."""
        votes = self.votes[name]
        return max(votes, key=votes.__getitem__, default="")


def named_as_tracked(made: Repair) -> Repair:
    """Rename the tracks of a repair by (2); removed tracks keep their names."""
    known, owners = made.detections.tracked, Owners()
    for t in known.frames:
        owners.of(known.at(t), made.tracks.perceived(t))
    longest: dict[str, tuple[int, str]] = {}
    for name in list(owners.votes):
        if owner := owners.owner(name):
            count = owners.votes[name][owner]
            longest[owner] = max(longest.get(owner, (0, "")), (count, name), key=lambda one: one[0])
    names, number = {}, 0
    for name, still in zip(made.tracks.ids, made.tracks.static.tolist(), strict=True):
        if still:
            names[name] = f"{name}~static" if name in owners.votes else name
        elif name in longest:
            names[name] = longest[name][1]
        else:
            number += 1
            names[name] = f"{UNTRACKED} {number}"
    tracks = replace(made.tracks, ids=tuple(names[name] for name in made.tracks.ids))
    changes = tuple(replace(each, agent=names.get(each.agent, each.agent)) for each in made.changes)
    return replace(made, tracks=tracks, changes=changes)
