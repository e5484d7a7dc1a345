"""Which repaired track a road user is that was tracked causally, and the names that both then share.

(1) a causal track is the repaired one to whose box its own was nearest in most frames so far, within `NEAR_M`; one that
    was near none is no road user
(2) a repaired track has the name of the causal one that was it in most frames; others of the same road user, after it
    was lost for a while, keep their own names. A repaired track that was never tracked has a name of its own, and so
    has who never moves
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np

from logs.agents import Agents
from logs.detections import Repair

NEAR_M = 2.5
"""Half of a car's length: the drift of a detected centre, and what a lost agent was carried on wrongly."""
UNTRACKED = "untracked"


class Owners:
    """Finds whose each causal track is (1), frame by frame in order of time."""

    def __init__(self) -> None:
        self.votes: dict[str, Counter[str]] = defaultdict(Counter)

    def of(self, known: Agents, log: Agents) -> list[str]:
        """The name in the log of each agent that is known, "" of none; both are of one time."""
        away = np.hypot(known.x[:, None] - log.x, known.y[:, None] - log.y)
        for name, row in zip(known.ids, away if len(log) else (), strict=bool(len(log))):
            nearest = int(np.argmin(row))
            if row[nearest] <= NEAR_M:
                self.votes[name][log.ids[nearest]] += 1
        return [self.owner(name) for name in known.ids]

    def owner(self, name: str) -> str:
        """Of a causal track; of two that are equal the first."""
        votes = self.votes[name]
        return max(votes, key=votes.__getitem__, default="")


def named_as_tracked(made: Repair) -> Repair:
    """The repair with the names (2); those of what was removed stay."""
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
