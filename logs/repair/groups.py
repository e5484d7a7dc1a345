"""What is known of detected road users by group: how exact their boxes are, how they move, how long they must be seen.

Measured on 13 city drives at 10 Hz (SFA and cluster detectors of Autoware Mini) where no other source is named.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind, among
from logs.detections import Detections
from logs.kernel import FloatArray, IntArray, frozen


@dataclass(frozen=True)
class Group:
    """Constants of a group of road users.

    Attributes:
        noise: Standard deviation of a box centre, m, of which most drifts slowly: rms 0.22 to 0.30 m of standing cars.
        accel: Standard deviation of the acceleration over `STEP_S`, m/s2; Autoware's tracker has 0.35 g along
            and 0.15 g across cars, 0.3 g for pedestrians.
        first_along: Standard deviation of the speed at the first detection along the box, m/s; `first_across` likewise:
            29 % of the vehicle tracks joined without it began with a step above 2.5 m, 18 % sideways.
        reach: A detection farther from where a track should be is another object, m; Autoware's gates are 2 m.
        least_time: Less is no evidence of a road user, s; `least_count` detections and `least_score`, their sum,
            likewise: clutter lives for 0.1 to 0.5 s.
        birth_time: A causal track is reported after it was seen for so long, s, `birth_count` times and with a sum of
            scores of `birth_score`: fewer ghosts for who is seen later (tests/support/track_score.py).
        still: A track that moves less between its first and last third stands, m.
        slow: Who is slower for `STAND_S` stands meanwhile, m/s.
        fast: Above this the direction of motion is known, m/s.
        meet: Two tracks that meet within this in the middle of the gap between them are one, m; `meet_growth` more per
            second of gap.
        turn: And whose velocities differ by less, m/s; `turn_growth` more per second of gap.
    """

    noise: float
    accel: float
    first_along: float
    first_across: float
    reach: float
    least_time: float
    least_count: int
    least_score: float
    birth_time: float
    birth_count: int
    birth_score: float
    still: float
    slow: float
    fast: float
    meet: float
    meet_growth: float
    turn: float
    turn_growth: float


VEHICLE, PERSON, CLUSTER = 0, 1, 2
GROUPS = (
    Group(noise=0.30, accel=3.0, first_along=10.0, first_across=1.5, reach=4.0,
          least_time=0.7, least_count=5, least_score=2.5, birth_time=0.15, birth_count=3, birth_score=1.2,
          still=1.2, slow=0.6, fast=1.5,
          meet=1.0, meet_growth=0.8, turn=3.0, turn_growth=2.0),
    Group(noise=0.20, accel=1.5, first_along=2.5, first_across=2.5, reach=1.5,
          least_time=0.7, least_count=5, least_score=2.0, birth_time=0.15, birth_count=3, birth_score=1.2,
          still=0.6, slow=0.3, fast=0.5,
          meet=0.7, meet_growth=0.5, turn=1.5, turn_growth=1.0),
    Group(noise=0.35, accel=1.5, first_along=3.0, first_across=3.0, reach=1.5,
          least_time=1.5, least_count=10, least_score=0.0, birth_time=0.8, birth_count=6, birth_score=0.0,
          still=2.0, slow=0.6, fast=1.0,
          meet=0.7, meet_growth=0.3, turn=1.5, turn_growth=0.5),
)  # fmt: skip
"""Vehicles; persons, on foot or riding; clusters, whose kind is not known and whose parts split and merge."""
STEP_S = 0.1
"""The period over which `Group.accel` is constant."""
STAND_S = 1.0
"""Standing is decided over this: the drift of a box looks like motion for shorter."""
SLIDES = 0.75
"""A cluster stands unless it gets farther than this share of its length: another part of what stands is seen."""
SURE = 0.4
"""Above this score a box is as exact as `Group.noise` says; below, 1.5 times less."""
UNSURE_NOISE = 1.5
LEAST_SIZE_M = 0.1
NOISE, ACCEL, FIRST_ALONG, FIRST_ACROSS, REACH = (
    frozen([getattr(group, name) for group in GROUPS])
    for name in ("noise", "accel", "first_along", "first_across", "reach")
)
DENSITY = frozen(ACCEL**2 * STEP_S)
"""Spectral density of the acceleration by group, m2/s3."""
SMOOTH_DENSITY = frozen(0.45 * DENSITY)
"""Where the whole track is known: the speed of who drives is off by a fifth less (tests/support/track_score.py)."""
_PERSONS, _CLUSTERS = among(*(kind for kind in AgentKind if kind.is_vulnerable)), among(AgentKind.OBJECT)
_GROUP = frozen(np.where(_CLUSTERS, CLUSTER, np.where(_PERSONS, PERSON, VEHICLE)), np.int64)
_USUAL = frozen([USUAL_SIZE_M[kind] for kind in AgentKind])


@dataclass(frozen=True, eq=False)
class Boxes:
    """Detections in a stated order within each frame, `(m,)` each, with what is missing filled in.

    Attributes:
        source: Places in the detections.
        frame: Places in `Detections.frames`.
        t: s; `x`, `y` m, `yaw` rad, `length`, `width` m: of clusters the longer side is the length.
        score: NaN where it is not known (detectors write 0 for that).
        codes: Kinds as numbers; `group` places in `GROUPS`.
        noise: Standard deviation of the centre, m.
    """

    source: IntArray
    frame: IntArray
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    score: FloatArray
    codes: IntArray
    group: IntArray
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    def taken(self, rows: IntArray) -> Boxes:
        """Some of them, in the order of `rows`."""
        return Boxes(**{each.name: getattr(self, each.name)[rows] for each in fields(Boxes)})

    @cached_property
    def weight(self) -> FloatArray:
        """How much each counts in votes `(m,)`: its score, 0.5 where that is not known."""
        return np.where(np.isfinite(self.score), np.maximum(self.score, 0.05), 0.5)

    @classmethod
    def of(cls, found: Detections) -> Boxes:
        """The boxes of detections: the order in which a frame lists them changes nothing."""
        order = np.lexsort((found.length, found.yaw, found.y, found.x, found.codes, found.t))
        codes, group = found.codes[order], _GROUP[found.codes[order]]
        sizes = np.column_stack([found.length, found.width])[order]
        sizes = np.maximum(np.where(np.isfinite(sizes), sizes, _USUAL[codes]), LEAST_SIZE_M)
        lying = (group == CLUSTER) & (sizes[:, 0] < sizes[:, 1])
        score = np.where(found.score > 0.0, found.score, np.nan)[order]
        return cls(
            source=order, frame=np.searchsorted(found.frames, found.t[order]), t=found.t[order], x=found.x[order],
            y=found.y[order], yaw=found.yaw[order] + np.where(lying, 0.5 * np.pi, 0.0),
            length=np.where(lying, sizes[:, 1], sizes[:, 0]), width=np.where(lying, sizes[:, 0], sizes[:, 1]),
            score=score, codes=codes, group=group,
            noise=NOISE[group] * np.where(score < SURE, UNSURE_NOISE, 1.0),
        )  # fmt: skip
