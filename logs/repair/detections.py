"""Raw detections, whether their ids are identities, the changes of a repair that makes tracks of
them, and their names.

Names. A repair makes its tracks with the whole log; the tracker's tracks are causal:

(1) a causal track belongs to the repaired track whose box was nearest to its own, within `NEAR_M`,
    in most frames up to now; a causal track that was near no repaired track is not a road user
(2) a repaired track gets the name of the causal track that belonged to it in most frames; other
    causal tracks of the same road user, after a loss, keep their own names. A repaired track
    without a causal track gets a new name; a static road user keeps its name, with a suffix if a
    causal track has it
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.logs.agents import AgentKind, Agents
from replan.logs.repair.detected_boxes import Boxes
from replan.logs.repair.tracker import Tracked, tracked
from replan.logs.tracks import Tracks


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes of all frames, flat, in order of time: `(m,)` each, world frame, m, rad, m/s. Equal
    times are one frame.

    Attributes:
        t: s since the scenario's start, not decreasing; each is one of `frames`.
        frames: `(k,)` times of all frames, frames without boxes included, strictly increasing.
        ids: The log's names, which need not identify one object over time; "" where the log has
            none.
        codes: Kinds as numbers (`codes_of`).
        x: Box centre; `y` likewise; `yaw` of the box.
        length: Length of the box, NaN where unknown; `width` likewise.
        vx: Velocity in the world, NaN where the log has none; `vy` likewise.
        score: The detector's confidence, 0 to 1; NaN where unknown.

    Raises:
        ValueError: Shapes disagree, times decrease, a box belongs to no frame, or a pose is not
            finite.
    """

    t: FloatArray
    frames: FloatArray
    ids: tuple[str, ...]
    codes: IntArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    vx: FloatArray
    vy: FloatArray
    score: FloatArray

    def __post_init__(self) -> None:
        for name in ("frames", *_BOXES):
            object.__setattr__(
                self, name, frozen(getattr(self, name), np.int64 if name == "codes" else np.float64)
            )
        if {getattr(self, name).shape for name in _BOXES} != {(len(self.ids),)}:
            raise ValueError("detections: columns differ in length")
        if (np.diff(self.t) < 0.0).any() or (np.diff(self.frames) <= 0.0).any():
            raise ValueError("detections: times decrease")
        if not np.isin(self.t, self.frames).all():
            raise ValueError("detections: a box belongs to no frame")
        if not np.isfinite(np.array([self.t, self.x, self.y, self.yaw])).all():
            raise ValueError("detections: a pose is not finite")

    def __len__(self) -> int:
        return len(self.ids)

    def taken(self, keep: BoolArray) -> Detections:
        """Return the detections that `keep` `(m,)` marks, with the same frames."""
        columns = {name: getattr(self, name)[keep] for name in _BOXES}
        return replace(self, ids=tuple(np.array(self.ids, object)[keep]), **columns)

    def between(self, first: float, last: float) -> Detections:
        """Return the detections and frames from `first` to `last`, s."""
        frames = self.frames[(self.frames >= first) & (self.frames <= last)]
        return replace(self.taken((self.t >= first) & (self.t <= last)), frames=frames)

    def shifted(self, seconds: float) -> Detections:
        """The same boxes and frames, `seconds` later."""
        return replace(self, t=self.t + seconds, frames=self.frames + seconds)

    @cached_property
    def tracked(self) -> Tracked:
        """The tracks that were known at each time, computed on first use."""
        return tracked(self.boxes, self.frames)

    @property
    def boxes(self) -> Boxes:
        """The boxes in a defined order, with missing values filled in."""
        columns = self.x, self.y, self.yaw, self.length, self.width, self.score
        return Boxes.of(self.frames, self.t, self.codes, *columns)

    @property
    def kinds(self) -> tuple[AgentKind, ...]:
        """The kinds of the boxes."""
        every = tuple(AgentKind)
        return tuple(every[code] for code in self.codes)


_BOXES = tuple(each.name for each in fields(Detections) if each.name not in ("ids", "frames"))


@dataclass(frozen=True)
class TrackChange:
    """One change that a repair made."""

    # "joined" (detections became a track), "removed" (a track, or boxes that overlap a track),
    # "extended" (a track beyond its detections), "relabelled" (its kind), "turned" (reversed
    # fronts) or "shrunk" (its box)
    what: str
    agent: str  # id in the repaired tracks or in `Repair.removed`
    begin: float  # first time of the change, s; `end` is the last
    end: float
    samples: int  # number of changed detections; for "extended": number of added samples
    why: str  # the reason, one sentence with numbers
    # Ids of these detections in the log, each once; empty if the log has none
    sources: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Repair:
    """The input of a repair, and what it removed, added and changed.

    Raises:
        ValueError: `extended` has not one entry per sample of the tracks.
    """

    detections: Detections  # the detections as read
    removed: Tracks  # removed tracks, under ids that no repaired track has; for drawing
    # Whether a sample of the repaired tracks `(m,)` lies before the first or after the last
    # detection of its track. Samples that fill a gap between two detections are not marked.
    extended: BoolArray
    # Changes in the order of the repaired tracks, then of the removed ones
    changes: tuple[TrackChange, ...]
    # The repaired tracks. A scenario has the same object unless traffic or a variation replaced it.
    tracks: Tracks

    def __post_init__(self) -> None:
        object.__setattr__(self, "extended", frozen(self.extended, np.bool_))
        if self.extended.shape != self.tracks.t.shape:
            raise ValueError("repair: `extended` needs one entry for each sample of the tracks")

    def summary(self) -> tuple[str, ...]:
        """A sentence for each kind of change, with counts."""
        tracks, samples = Counter[str](), Counter[str]()
        for change in self.changes:
            tracks[change.what] += 1
            samples[change.what] += change.samples
        return tuple(
            f"Repair {change} {samples[change]} {unit} {of} {tracks[change]} tracks."
            for change, (unit, of) in _SENTENCES.items()
            if tracks[change]
        )


_SENTENCES = {
    "joined": ("detections", "to"),
    "removed": ("detections", "with"),
    "extended": ("samples beyond sight", "of"),
    "relabelled": ("detections", "of"),
    "turned": ("reversed fronts", "of"),
    "shrunk": ("boxes", "of"),
}


# Identities and names

STEP_S, FASTEST_MPS, JUMPS = 0.5, 60.0, 0.02
"""Ids are not identities if more than `JUMPS` of the steps of equal ids within `STEP_S` are faster
than `FASTEST_MPS`, or if more than this share of the boxes has the same id as another box of the
frame."""
SHORT_S, FLICKER, LEAST_IDS = 1.0, 0.5, 10
"""Road users flicker if more than half of at least ten ids are seen for less than a second."""
NEAR_M = 2.5
"""Half of a car's length, m: covers the drift of detected centres and the error of extrapolating
lost agents.
"""
UNTRACKED = "untracked"


def needs_repair(detections: Detections) -> str | None:
    """Return why the detections must be repaired, in a sentence; None if they are tracks
    already.
    """
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
        return (
            f"Road users flicker: {short} of {len(begin)} ids are seen for less than {SHORT_S:g} s."
        )
    return None


def no_identities(ids: Sequence[str], t: FloatArray, x: FloatArray, y: FloatArray) -> str | None:
    """Return why the ids of boxes `(m,)` at the frame times t `(m,)`, s, are not identities; None
    if they are.
    """
    codes = np.unique(np.array(ids), return_inverse=True)[1]
    order = np.lexsort((t, codes))
    same, dt = np.diff(codes[order]) == 0, np.diff(t[order])
    twice = int((same & (dt == 0.0)).sum())
    if twice > JUMPS * len(ids):
        return (
            f"Ids of detections are no identities: {twice / len(ids):.0%} stand twice in a frame."
        )
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
        """Return the log's name of each known agent, "" if it has none.

        Both arguments are states at the same time.
        """
        away = np.hypot(known.x[:, None] - log.x, known.y[:, None] - log.y)
        for name, row in zip(known.ids, away if len(log) else (), strict=bool(len(log))):
            nearest = int(np.argmin(row))
            if row[nearest] <= NEAR_M:
                self.votes[name][log.ids[nearest]] += 1
        return [self.owner(name) for name in known.ids]

    def owner(self, name: str) -> str:
        """Return the log's track that owns a causal track.

        The first of several with equal votes.
        """
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
    changes = tuple(
        replace(change, agent=names.get(change.agent, change.agent)) for change in made.changes
    )
    return replace(made, tracks=tracks, changes=changes)
