"""Raw detections, and the changes of a repair that makes tracks from them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from logs.agents import AgentKind
from logs.arrays import BoolArray, FloatArray, IntArray, frozen
from logs.repair.detected_boxes import Boxes
from logs.repair.tracker import Tracked, tracked
from logs.tracks import Tracks


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes of all frames, flat, in order of time: `(m,)` each, world frame, m, rad, m/s. Equal times are one frame.

    Attributes:
        t: s since the scenario's start, not decreasing; each is one of `frames`.
        frames: `(k,)` times of all frames, frames without boxes included, strictly increasing.
        ids: The log's names, which need not identify one object over time; "" where the log has none.
        codes: Kinds as numbers (`codes_of`).
        x: Box centre; `y` likewise; `yaw` of the box.
        length: Length of the box, NaN where unknown; `width` likewise.
        vx: Velocity in the world, NaN where the log has none; `vy` likewise.
        score: The detector's confidence, 0 to 1; NaN where unknown.

    Raises:
        ValueError: Shapes disagree, times decrease, a box belongs to no frame, or a pose is not finite.
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
            object.__setattr__(self, name, frozen(getattr(self, name), np.int64 if name == "codes" else np.float64))
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
    """One change that a repair made.

    Attributes:
        what: "joined" (detections became a track), "removed" (a track, or boxes that overlap a track), "extended" (a
            track beyond its detections), "relabelled" (its kind), "turned" (reversed fronts) or "shrunk" (its box).
        agent: Id in the repaired tracks or in `Repair.removed`.
        begin: First time of the change, s; `end` is the last.
        samples: Number of changed detections; for "extended": number of added samples.
        why: The reason, one sentence with numbers.
        sources: Ids of these detections in the log, each once; empty if the log has none.
    """

    what: str
    agent: str
    begin: float
    end: float
    samples: int
    why: str
    sources: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Repair:
    """The input of a repair, and what it removed, added and changed.

    Attributes:
        detections: The detections as read.
        removed: Removed tracks, under ids that no repaired track has; for drawing.
        extended: Whether a sample of the repaired tracks `(m,)` lies before the first or after the last detection of
            its track. Samples that fill a gap between two detections are not marked.
        changes: Changes in the order of the repaired tracks, then of the removed ones.
        tracks: The repaired tracks. A scenario has the same object unless traffic or a variation replaced it.

    Raises:
        ValueError: `extended` has not one entry per sample of the tracks.
    """

    detections: Detections
    removed: Tracks
    extended: BoolArray
    changes: tuple[TrackChange, ...]
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
            f"Repair {what} {samples[what]} {unit} {of} {tracks[what]} tracks."
            for what, (unit, of) in _SENTENCES.items()
            if tracks[what]
        )


_SENTENCES = {
    "joined": ("detections", "to"), "removed": ("detections", "with"), "extended": ("samples beyond sight", "of"),
    "relabelled": ("detections", "of"), "turned": ("reversed fronts", "of"), "shrunk": ("boxes", "of"),
}  # fmt: skip
