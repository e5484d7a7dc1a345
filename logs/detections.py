"""Raw detections: the boxes that a perception reported frame by frame, before anything was joined into tracks."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from logs.agents import AgentKind, codes_of
from logs.kernel import BoolArray, FloatArray, IntArray, frozen
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

    @classmethod
    def of_tracks(cls, tracks: Tracks) -> Detections:
        """The samples of tracks, by which any log can be repaired; without scores."""
        owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
        order = np.lexsort((owner, tracks.t))
        columns = {name: getattr(tracks, name)[order] for name in ("t", "x", "y", "yaw", "vx", "vy")}
        who = owner[order]
        return cls(
            frames=np.unique(tracks.t), ids=tuple(tracks.ids[i] for i in who), codes=codes_of(tracks.kinds)[who],
            length=tracks.length[who], width=tracks.width[who], score=np.full(len(who), np.nan), **columns,
        )  # fmt: skip

    def taken(self, keep: BoolArray) -> Detections:
        """Those that `keep` `(m,)` marks, among the same frames."""
        columns = {name: getattr(self, name)[keep] for name in _COLUMNS}
        return replace(self, ids=tuple(np.array(self.ids, object)[keep]), **columns)

    @property
    def kinds(self) -> tuple[AgentKind, ...]:
        """What they are."""
        every = tuple(AgentKind)
        return tuple(every[code] for code in self.codes)


_COLUMNS = tuple(each.name for each in fields(Detections) if each.name not in ("ids", "frames"))
