"""Raw detections: the boxes that a perception reported frame by frame, and what was done to make tracks of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from logs.agents import AgentKind
from logs.kernel import BoolArray, FloatArray, IntArray, frozen

if TYPE_CHECKING:
    from logs.repair.tracker import Tracked
    from logs.scenario import Tracks


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes of all frames, flat, in order of time: `(m,)` each, world frame, m, rad, m/s. Equal times are one frame.

    Attributes:
        t: Seconds since the scenario's start, never falling.
        frames: `(k,)` times of all frames, strictly rising, those without boxes too: `t` holds only such times.
        ids: The names that the log gives, which need not be identities; "" where it gives none.
        codes: What they are (`logs.agents.codes_of`).
        x: Box centre; `y` likewise; `yaw` of the box.
        length: NaN where it is not known; `width` likewise.
        vx: Velocity in the world, NaN where the log has none; `vy` likewise.
        score: The detector's confidence, 0 to 1; NaN where it is not known.

    Raises:
        ValueError: Shapes disagree, times fall, or a pose is not finite.
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
        for each in fields(self):
            if each.name != "ids":
                dtype = np.int64 if each.name == "codes" else np.float64
                object.__setattr__(self, each.name, frozen(getattr(self, each.name), dtype))
        shapes = {getattr(self, each.name).shape for each in fields(self) if each.name not in ("ids", "frames")}
        if shapes != {(len(self.ids),)}:
            raise ValueError("detections: columns differ in length")
        if (np.diff(self.t) < 0.0).any() or (np.diff(self.frames) <= 0.0).any():
            raise ValueError("detections: times fall")
        if not np.isin(self.t, self.frames).all():
            raise ValueError("detections: a box belongs to no frame")
        if not np.isfinite(np.array([self.t, self.x, self.y, self.yaw])).all():
            raise ValueError("detections: a pose is not finite")

    def __len__(self) -> int:
        return len(self.ids)

    def taken(self, keep: BoolArray) -> Detections:
        """Those that `keep` `(m,)` marks, among the same frames."""
        columns = {name: getattr(self, name)[keep] for name in _COLUMNS}
        return replace(self, ids=tuple(np.array(self.ids, object)[keep]), **columns)

    def between(self, first: float, last: float) -> Detections:
        """Those of the frames from `first` to `last`, s."""
        frames = self.frames[(self.frames >= first) & (self.frames <= last)]
        return replace(self.taken((self.t >= first) & (self.t <= last)), frames=frames)

    def shifted(self, seconds: float) -> Detections:
        """Those, so much later."""
        return replace(self, t=self.t + seconds, frames=self.frames + seconds)

    @cached_property
    def tracked(self) -> Tracked:
        """The road users as they could be known at each time; made when it is first asked for."""
        from logs.repair.tracker import tracked

        return tracked(self)

    @property
    def kinds(self) -> tuple[AgentKind, ...]:
        """What they are."""
        every = tuple(AgentKind)
        return tuple(every[code] for code in self.codes)


_COLUMNS = tuple(each.name for each in fields(Detections) if each.name not in ("ids", "frames"))


@dataclass(frozen=True)
class Change:
    """One thing that a repair did.

    Attributes:
        what: "joined" (detections became a track), "removed" (a track, or boxes that overlap one), "extended" (beyond
            sight), "relabelled" (its kind), "turned" (reversed fronts) or "shrunk" (its box).
        agent: Id in the repaired tracks, or among `Repair.removed`.
        begin: First time that it concerns, s; `end` the last one.
        samples: How many detections it concerns; of "extended": how many samples it added.
        why: One sentence with numbers.
        sources: Ids that the log gave to these detections, each once; empty where it gives none.
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
    """What a repair read, removed, added and changed.

    Attributes:
        detections: As read.
        removed: Tracks that were taken away, under ids that no repaired track has; for drawing.
        extended: Per sample of the repaired tracks `(m,)`: before the first or after the last detection of its track.
            Gaps between two detections are filled and not marked.
        changes: In order of the repaired tracks, then of the removed ones.
        tracks: What they became; those of a scenario are these, unless traffic or a variation changed them since.

    Raises:
        ValueError: `extended` is not of these tracks.
    """

    detections: Detections
    removed: Tracks
    extended: BoolArray
    changes: tuple[Change, ...]
    tracks: Tracks

    def __post_init__(self) -> None:
        object.__setattr__(self, "extended", frozen(self.extended, np.bool_))
        if self.extended.shape != self.tracks.t.shape:
            raise ValueError("repair: one mark of what is extended for each sample of the tracks")

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
