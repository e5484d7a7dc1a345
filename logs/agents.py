"""Road users at one instant, raw detections, and the changes of a repair that makes tracks from detections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from logs.arrays import BoolArray, FloatArray, IntArray, frozen

if TYPE_CHECKING:
    from logs.repair.tracker import Tracked
    from logs.scenario import Tracks

OLDEST_S = 10.0
"""The greatest age, s; older agents get this age."""
_UNKNOWN = frozen(np.empty(0))
_UNCODED = frozen(np.empty(0), np.int64)


class AgentKind(Enum):
    """What a road user is."""

    CAR = "car"
    TRUCK = "truck"
    BUS = "bus"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    PEDESTRIAN = "pedestrian"
    OBJECT = "object"

    @property
    def is_vulnerable(self) -> bool:
        """Whether it is a pedestrian or a rider."""
        return self in (AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.MOTORCYCLE)


USUAL_SIZE_M = {
    AgentKind.CAR: (4.5, 1.8), AgentKind.TRUCK: (8.0, 2.5), AgentKind.BUS: (12.0, 2.5),
    AgentKind.MOTORCYCLE: (2.2, 0.8), AgentKind.BICYCLE: (1.8, 0.7), AgentKind.PEDESTRIAN: (0.5, 0.5),
    AgentKind.OBJECT: (1.0, 1.0),
}  # fmt: skip
"""Length and width of agents whose log states none, m."""
_CODE = {kind: code for code, kind in enumerate(AgentKind)}


def codes_of(kinds: tuple[AgentKind, ...]) -> IntArray:
    """Return the codes of the kinds, `(n,)`: their positions in `AgentKind`. They index the result of `among`."""
    return frozen([_CODE[kind] for kind in kinds], np.int64)


def among(*kinds: AgentKind) -> BoolArray:
    """Return a mask over all codes that marks the kinds: `among(AgentKind.CAR)[agents.codes]` marks the cars."""
    return frozen([kind in kinds for kind in AgentKind], np.bool_)


@dataclass(frozen=True, eq=False, slots=True)
class Agents:
    """Road users at one instant: `(n,)` each, world frame, box centres, m, rad, m/s.

    Attributes:
        ids: Names of the agents.
        kinds: Kinds of the agents.
        length: Length of the box; `width` likewise.
        x: Centre of the box; `y` likewise; `yaw` is the heading of the box, counter-clockwise from x.
        vx: Velocity along the world's x axis; `vy` likewise.
        yaw_rate: rad/s; 0 if unknown, and for pedestrians, who turn on the spot. Default: all 0.
        accel: Rate of the speed, m/s2; 0 if unknown. Default: all 0.
        age: s since the agent was first seen, at most `OLDEST_S`; NaN where unknown: for agents that never move, and
            in the first `OLDEST_S` for agents that were present when the scenario began. Default: all NaN, like the
            next two columns.
        unseen: s since the agent's last sample, 0 at a sample; NaN for agents that never move.
        velocity_sigma: Standard deviation of vx and of vy, m/s; NaN if perception does not state it.
        codes: `kinds` as numbers; default: `codes_of(kinds)`.
    """

    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: FloatArray
    width: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    yaw_rate: FloatArray = field(default_factory=lambda: _UNKNOWN)
    accel: FloatArray = field(default_factory=lambda: _UNKNOWN)
    age: FloatArray = field(default_factory=lambda: _UNKNOWN)
    unseen: FloatArray = field(default_factory=lambda: _UNKNOWN)
    velocity_sigma: FloatArray = field(default_factory=lambda: _UNKNOWN)
    codes: IntArray = field(default_factory=lambda: _UNCODED)

    def __post_init__(self) -> None:
        for name in NUMBERS[NUMBERS.index("yaw_rate") :]:
            if not len(getattr(self, name)):
                unknown = np.nan if name in OPTIONAL else 0.0
                object.__setattr__(self, name, np.full(len(self.ids), unknown))
        if self.codes is _UNCODED:
            object.__setattr__(self, "codes", codes_of(self.kinds))
        for name in NUMBERS:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of_rows(cls, ids: tuple[str, ...], kinds: tuple[AgentKind, ...], rows: FloatArray, codes: IntArray) -> Agents:
        """Make agents whose columns `NUMBERS` are the rows `(12, n)`, which are copied once."""
        made = object.__new__(cls)
        for name, value in zip(_COLUMNS, (ids, kinds, *frozen(rows), codes), strict=True):
            object.__setattr__(made, name, value)
        return made

    def __len__(self) -> int:
        return len(self.ids)

    def some(self, rows: IntArray) -> Agents:
        """The agents `rows` `(k,)`, in that order."""
        ids, kinds = tuple(self.ids[i] for i in rows), tuple(self.kinds[i] for i in rows)
        columns = np.stack([getattr(self, name)[rows] for name in NUMBERS])
        return Agents.of_rows(ids, kinds, columns, frozen(self.codes[rows], np.int64))

    @property
    def speed(self) -> FloatArray:
        """Length of the velocity vector `(n,)`, m/s."""
        return np.hypot(self.vx, self.vy)


_COLUMNS = tuple(each.name for each in fields(Agents))
NUMBERS = _COLUMNS[2:-1]
"""Names of the float columns, in order."""
OPTIONAL = ("age", "unseen", "velocity_sigma")
"""The optional columns whose default is NaN; `yaw_rate` and `accel` default to 0."""


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
        from logs.repair.tracker import tracked

        return tracked(self)

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
