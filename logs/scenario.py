"""A log as it was driven: the ego, the other road users as ragged tracks, the road, the goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, frozen, kernel
from logs.road import Goal, Road
from logs.rules import TrafficLight
from logs.states import Controls, Trajectory
from logs.vehicle import VehicleParameters

MAX_AGE_S = 0.5
"""An agent that was not seen for longer than this is no longer assumed to be there."""
TREND_S = 1.0
"""Yaw rate and acceleration are backward differences over at most this; one sample back where samples are rarer."""
_UNKNOWN = frozen(np.empty(0))
_Motion = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


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
        """Pedestrians and riders."""
        return self in (AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.MOTORCYCLE)


@dataclass(frozen=True, eq=False, slots=True)
class Agents:
    """Road users at one instant: `(n,)` each, world frame, box centres, m, rad, m/s.

    Attributes:
        yaw_rate: rad/s; 0 where it is not known, and of pedestrians, who turn on the spot. `accel` likewise: rate of
            the speed, m/s2. Left out: all 0.
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

    def __post_init__(self) -> None:
        for name in ("yaw_rate", "accel"):
            if getattr(self, name) is _UNKNOWN:
                object.__setattr__(self, name, np.zeros(len(self.ids)))
        for name in ("length", "width", "x", "y", "yaw", "vx", "vy", "yaw_rate", "accel"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def speed(self) -> FloatArray:
        """Length of the velocity vector `(n,)`, m/s."""
        return np.hypot(self.vx, self.vy)


@kernel
def _last_samples(offsets: IntArray, t: FloatArray, time: float) -> IntArray:
    """Per track, the index of its last sample not later than `time`; -1 where there is none."""
    out = np.empty(len(offsets) - 1, np.int64)
    for i in range(len(out)):
        k = np.searchsorted(t[offsets[i] : offsets[i + 1]], time + 1e-9, side="right")
        out[i] = offsets[i] + k - 1 if k > 0 else -1
    return out


@kernel
def _trends(
    seen: IntArray, at: IntArray, offsets: IntArray, t: FloatArray, yaw: FloatArray, x: FloatArray, y: FloatArray,
    vx: FloatArray, vy: FloatArray, speed: FloatArray,
) -> FloatArray:  # fmt: skip
    """Yaw rate and acceleration `(2, n)` of tracks `seen` at samples `at`, over the last `TREND_S`; 0: not known.

    `speed` `(n,)` is the speed at those samples; the earlier one is the logged, else a backward difference.
    """
    out = np.zeros((2, len(seen)))
    for i in range(len(seen)):
        first, last = offsets[seen[i]], at[i]
        k = last
        while k > first and t[last] - t[k - 1] <= TREND_S + 1e-9:
            k -= 1
        if k == last and k > first and t[last] - t[k - 1] <= 2.0 * TREND_S:
            k -= 1
        if k == last:
            continue
        span = t[last] - t[k]
        out[0, i] = (yaw[last] - yaw[k]) / span
        was_x, was_y = vx[k], vy[k]
        if not np.isfinite(was_x + was_y) and k > first:
            was_x, was_y = (x[k] - x[k - 1]) / (t[k] - t[k - 1]), (y[k] - y[k - 1]) / (t[k] - t[k - 1])
        if np.isfinite(was_x + was_y):
            out[1, i] = (speed[i] - np.hypot(was_x, was_y)) / span
    return out


def _continuous(yaw: FloatArray, offsets: IntArray) -> FloatArray:
    """The headings without jumps of 2 pi within a track; the first of each track stays."""
    turns = np.round(np.diff(yaw) / (2.0 * np.pi))
    turns[offsets[1:-1] - 1] = 0.0
    if not turns.any():
        return yaw
    sums = np.r_[0.0, np.cumsum(turns)]
    return np.asarray(yaw - 2.0 * np.pi * (sums - np.repeat(sums[offsets[:-1]], np.diff(offsets))))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Road users over time, ragged: track i owns the samples `offsets[i] : offsets[i + 1]`.

    Attributes:
        ids: `n` unique names.
        kinds: `n`.
        length: `(n,)` m; `width` likewise.
        static: `(n,)` bool: an obstacle that never moves, present at all times (one sample is enough).
        offsets: `(n + 1,)` int.
        t: `(m,)` s since the scenario's start, increasing strictly within a track.
        x: `(m,)` box centre, world, m; `y` likewise; `yaw` rad, continuous within a track (unwrapped here).
        vx: `(m,)` velocity, world, m/s; `vy` likewise; NaN where the log has none.

    Raises:
        ValueError: Shapes disagree, a pose is not finite, a velocity is infinite, times do not increase or are not
            finite, a size is not positive.
    """

    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: FloatArray
    width: FloatArray
    static: BoolArray
    offsets: IntArray
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray

    def __post_init__(self) -> None:
        for name in ("length", "width", "t", "x", "y", "yaw", "vx", "vy"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "static", frozen(self.static, np.bool_))
        object.__setattr__(self, "offsets", frozen(self.offsets, np.int64))
        n, m = len(self.ids), len(self.t)
        shapes = {len(self.kinds), len(self.length), len(self.width), len(self.static), len(self.offsets) - 1}
        if shapes != {n} or self.offsets[0] != 0 or self.offsets[-1] != m or (np.diff(self.offsets) < 1).any():
            raise ValueError("tracks: per-agent columns or offsets disagree")
        if len(set(self.ids)) != n:
            raise ValueError("tracks: two agents have the same id")
        for name in ("t", "x", "y", "yaw"):
            if getattr(self, name).shape != (m,) or not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"tracks: {name} has a wrong length or is not finite")
        for name in ("vx", "vy"):
            if getattr(self, name).shape != (m,) or np.isinf(getattr(self, name)).any():
                raise ValueError(f"tracks: {name} has a wrong length or is infinite")
        if n and not (np.isfinite(self.length) & (self.length > 0) & np.isfinite(self.width) & (self.width > 0)).all():
            raise ValueError("tracks: length and width must be positive")
        rising = np.diff(self.t) > 0.0
        rising[self.offsets[1:-1] - 1] = True
        if not rising.all():
            raise ValueError("tracks: time does not increase")
        object.__setattr__(self, "yaw", frozen(_continuous(self.yaw, self.offsets)))

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def empty(cls) -> Tracks:
        """No road users."""
        none = np.empty(0)
        return cls(
            (),
            (),
            none,
            none,
            np.empty(0, np.bool_),
            np.zeros(1, np.int64),
            none,
            none,
            none,
            none,
            none,
            none,
        )

    def samples(self, index: int) -> slice:
        """The samples of track `index`."""
        return slice(int(self.offsets[index]), int(self.offsets[index + 1]))

    def perceived(self, time: float) -> Agents:
        """The agents as known at `time`: never from a sample later than it.

        The last sample not older than `MAX_AGE_S` is carried on with its velocity: the logged one, or, where the
        log has none, the backward difference to the sample before (0 for a first sample).
        """
        index = _last_samples(self.offsets, self.t, time)
        age = time - self.t[np.maximum(index, 0)]
        index = np.where(self.static & (index < 0), self.offsets[:-1], index)
        seen = np.flatnonzero((index >= 0) & (self.static | (age <= MAX_AGE_S)))
        at = index[seen]
        vx, vy = self.velocity(seen, at)
        age = np.where(self.static[seen], 0.0, age[seen])
        x, y = self.x[at] + age * vx, self.y[at] + age * vy
        return self._agents(seen, at, (x, y, self.yaw[at], vx, vy))

    def truth(self, time: float) -> Agents:
        """The agents as they were at `time`, interpolated: for metrics and drawing, never for a planner."""
        before = _last_samples(self.offsets, self.t, time)
        last = self.offsets[1:] - 1
        there = self.static | ((before >= 0) & (self.t[last] >= time - 1e-9))
        seen = np.flatnonzero(there)
        at = np.where(self.static[seen], self.offsets[seen], before[seen])
        after = np.where(self.static[seen], at, np.minimum(at + 1, last[seen]))
        span = self.t[after] - self.t[at]
        u = np.clip(np.divide(time - self.t[at], span, out=np.zeros(len(at)), where=span > 0.0), 0.0, 1.0)
        x, y, yaw = (values[at] + u * (values[after] - values[at]) for values in (self.x, self.y, self.yaw))
        vx, vy = self.velocity(seen, at)
        moving = span > 0.0
        vx = np.where(moving, np.divide(self.x[after] - self.x[at], span, out=vx.copy(), where=moving), vx)
        vy = np.where(moving, np.divide(self.y[after] - self.y[at], span, out=vy.copy(), where=moving), vy)
        return self._agents(seen, at, (x, y, yaw, vx, vy))

    def velocity(self, seen: IntArray, at: IntArray) -> tuple[FloatArray, FloatArray]:
        """Vectors vx and vy `(k,)` of the tracks `seen` at their samples `at`: logged, else backward differences."""
        before = np.maximum(at - 1, self.offsets[seen])
        span = self.t[at] - self.t[before]
        differences = [
            np.divide(values[at] - values[before], span, out=np.zeros(len(at)), where=span > 0.0)
            for values in (self.x, self.y)
        ]
        moves = ~self.static[seen]
        return (
            np.where(np.isfinite(self.vx[at]), self.vx[at], differences[0]) * moves,
            np.where(np.isfinite(self.vy[at]), self.vy[at], differences[1]) * moves,
        )

    def _agents(self, seen: IntArray, at: IntArray, pose: _Motion) -> Agents:
        """The tracks `seen`, last sampled `at`, at x, y, yaw, vx, vy."""
        speed = np.hypot(pose[3], pose[4])
        trends = _trends(seen, at, self.offsets, self.t, self.yaw, self.x, self.y, self.vx, self.vy, speed)
        kinds = tuple(self.kinds[i] for i in seen)
        turns = np.array([kind is not AgentKind.PEDESTRIAN for kind in kinds], float) * ~self.static[seen]
        return Agents(
            tuple(self.ids[i] for i in seen),
            kinds,
            self.length[seen],
            self.width[seen],
            *pose,
            yaw_rate=turns * trends[0],
            accel=np.where(self.static[seen], 0.0, trends[1]),
        )


@dataclass(frozen=True, eq=False)
class Scenario:
    """One log: what was driven, where, among whom.

    Attributes:
        name: Short and unique within a run ("paper/free_road").
        ego: The driven states; one sample where only the start is known.
        tracks: The other road users.
        road: Always there; `road.source` says whether the log had lanes.
        duration: Seconds that the log lasts from t = 0; not less than the ego's last sample.
        goal: None where the log names none.
        vehicle: The ego's parameters.
        controls: Logged steering and pedals, or None.
        tags: Words by which gates and reports group ("pedestrian", "recorded").
        source: Where the log comes from; `licence` under which terms.
        origin: World offset `(x, y)` that was subtracted by the reader, m.
        start_ns: Log time of t = 0, nanoseconds.
        metadata: What else the log says of itself (generator, parameters, seed).
        notes: What was assumed in reading, one sentence each: shown to the user.
        lights: The traffic lights that the road's stop lines name, in order of their ids (ordered here). One that a
            stop line names and that is not among them was not observed.

    Raises:
        ValueError: The scenario is shorter than its ego log, or two lights have one id.
    """

    name: str
    ego: Trajectory
    tracks: Tracks
    road: Road
    duration: float
    goal: Goal | None = None
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    controls: Controls | None = None
    tags: tuple[str, ...] = ()
    source: str = ""
    licence: str = ""
    origin: tuple[float, float] = (0.0, 0.0)
    start_ns: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lights: tuple[TrafficLight, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        if self.duration < self.ego.t[-1] - 1e-9:
            raise ValueError(f"scenario lasts {self.duration} s, shorter than its ego log ({self.ego.t[-1]} s)")
        object.__setattr__(self, "lights", tuple(sorted(self.lights, key=lambda light: light.id)))
        if len({light.id for light in self.lights}) < len(self.lights):
            raise ValueError("two traffic lights have the same id")
