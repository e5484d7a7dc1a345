"""Event kinds, and a log prepared for finding them: on a time grid, in the frame of the ego's path.

An `EventKind` finds `Event`s in a `DrivenLog`: one function (log) -> events, and one row of
`replan.mine.kinds`. A kind of your own is an `EventKind` in a module, named as "module:NAME"
(`replan mine --kind module:NAME`) or by an entry point of the group `replan.events`.

The path is the way that the recorded rear axle took, as a reference line (straight on before its
begin and beyond its end). It contains the log's future, because mining looks at a whole log; no
planner sees it. With a road user's box centre at (s, l) on that path and its heading turned by d
against it:

(1) half_s = (|cos d| length + |sin d| width) / 2     half_l = (|sin d| length + |cos d| width) / 2
(2) rear, front = s -+ half_s     low, high = l -+ half_l
(3) the band: |l| <= half of the ego's width; a box reaches into it where low < half
        and high > -half

A road user is examined at the steps of the grid at which the log has it within `NEAR_M` of the ego.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind
from replan.logs.polylines import thinned
from replan.logs.reference_line import ReferenceLine, line_frame, line_project
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory, wrap
from replan.metrics.boxes import GRID_S, car_of, ego_boxes, in_spans, phantoms, without_phantoms
from replan.metrics.metric import Unavailable, rate_of_change

NEAR_M = 80.0
SEARCH_M, FOLLOW_M = 120.0, 15.0
"""The first foot is searched within SEARCH_M of the ego's station, each later one within FOLLOW_M
of the last.
"""
OWN_M = 10.0
"""The ego's foot is searched within this of the one before."""
SHORT_M = 2.0
"""An ego that moves less than this stands: its path is straight along its heading."""
FELT_S = 0.5
"""The ego's acceleration is the change of its speed over this time."""
TYRES_MPS2 = 11.0
"""No car accelerates harder on dry asphalt: a coefficient of friction of 1.1."""
MOTOR_MPS2 = 6.0
"""Few cars speed up more: 100 km/h in 4.6 s."""
JUMPS = "its motion changes by more than tyres and motors can do"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened in a log.

    Attributes:
        begin: s since the log's start; `end` likewise, not before it.
        value: The number that the kind measures, in its unit; NaN if it measures none.
        agents: Ids of the road users that took part, the main one first; empty if only the ego did.
        what: More in words ("left", "crosswalk 7"); may be empty.
        doubt: Why it may not have happened; empty if nothing speaks against it.
    """

    begin: float
    end: float
    value: float
    agents: tuple[str, ...] = ()
    what: str = ""
    doubt: str = ""


UNCLASSIFIED = "the log does not say what the road user is"
"""The doubt about each event of a road user of the kind OBJECT."""


@dataclass(frozen=True, slots=True)
class EventKind:
    """A kind of event.

    Attributes:
        name: One word, as in the column `kind` of events.parquet.
        find: The events of a log in any order; raises Unavailable if the log lacks the required
            data.
        meaning: Its definition, begin and end, with its thresholds.
        measures: The meaning of `Event.value`; empty if that is NaN.
        unit: Unit of the value: "m", "s", "m/s", "m/s2", "1".
        source: Source of the definition; empty for a definition of replan.
        doubted: When an event of the kind is in doubt, beside `UNCLASSIFIED`.

    Raises:
        ValueError: A field is invalid.
    """

    name: str
    find: Callable[[DrivenLog], Iterable[Event] | Unavailable]
    meaning: str
    measures: str = ""
    unit: str = ""
    source: str = ""
    doubted: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or self.name.split() != [self.name]:
            raise ValueError(f"event kind {self.name!r}: its name has to be one word")
        if not callable(self.find):
            raise ValueError(f"event kind {self.name!r}: find has to be a function (log) -> events")


@dataclass(frozen=True, eq=False, slots=True)
class Neighbour:
    """One road user at the m steps of the grid at which it is near the ego.

    Attributes:
        k: `(m,)` the steps, increasing.
        pose: `(5, m)` x, y (box centre, m), yaw (rad), vx, vy (m/s), world.
        accel: `(m,)` rate of its speed, m/s2; `turn` of its velocity's direction, rad/s.
        size: Length and width, m.
        s: `(m,)` station of its box centre on the ego's path, m; `l` its offset, positive to the
            left.
        along: `(m,)` cosine of the angle between its heading and the path.
        half_s: `(m,)` (1), m; `half_l` likewise.
    """

    index: int
    id: str
    kind: AgentKind
    k: IntArray
    pose: FloatArray
    accel: FloatArray
    turn: FloatArray
    size: tuple[float, float]
    s: FloatArray
    l: FloatArray
    along: FloatArray
    half_s: FloatArray
    half_l: FloatArray

    @property
    def speed(self) -> FloatArray:
        """`(m,)` m/s."""
        return np.hypot(*self.pose[-2:])

    def reaches_into(self, half: float) -> BoolArray:
        """Whether it reaches into the band (3), `(m,)`."""
        return (self.l - self.half_l < half) & (self.l + self.half_l > -half)


class DrivenLog:
    """A log on a grid of `replan.metrics.boxes.GRID_S`.

    Args:
        scenario: The scenario as it was read; phantoms (`replan.metrics.boxes.phantoms`) are left
            out.

    Attributes:
        t: `(n,)` s since the scenario's start.
        boxes: `(5, n)` the ego's box centre, heading and velocity vector
            (`replan.metrics.boxes.ego_boxes`).
        half: Half of the ego's width, m.
        path: The way of the rear axle.
        station: `(n,)` of the rear axle on it, m.
        front: `(n,)` station of the front bumper, m; `back` of the rear bumper.
        neighbours: The road users that come near, in the order of their tracks.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        first, last = float(scenario.ego.t[0]), float(scenario.ego.t[-1])
        self.t = first + GRID_S * np.arange(int((last - first) / GRID_S + 1e-6) + 1)
        self.ego: Trajectory = scenario.ego.resampled(self.t)
        self.boxes, self.car = ego_boxes(self.ego, scenario), car_of(scenario)
        self.half = 0.5 * self.car.width
        arc = arc_lengths(self.ego.x, self.ego.y)
        points = thinned(np.column_stack([self.ego.x, self.ego.y]), 1.0)
        if arc[-1] < SHORT_M or len(points) < 2:
            ahead = SHORT_M * np.array([np.cos(self.ego.yaw[0]), np.sin(self.ego.yaw[0])])
            points = np.vstack([points[0], points[0] + ahead])
        self.path = ReferenceLine.through(points)
        self.station = _own_stations(self.path.s, self.path.coef, self.ego.x, self.ego.y)
        self.front = self.station + self.car.front
        self.back = self.front - self.car.length
        neighbours: list[Neighbour] = []
        tracks = without_phantoms(scenario.tracks, phantoms(scenario))
        for i, span, others in in_spans(tracks, self.t):
            x, y = others.pose[:2, 0]
            near = np.hypot(x - self.boxes[0, span], y - self.boxes[1, span]) <= NEAR_M
            near &= others.there[0]
            if not near.any():
                continue
            k, pose = (
                np.flatnonzero(near) + span.start,
                np.ascontiguousarray(others.pose[:, 0, near]),
            )
            frame = _on_path(self.path.s, self.path.coef, k, self.station[k], pose)
            along, aside = np.cos(frame[2]), np.abs(np.sin(frame[2]))
            length, width = others.size[0].tolist()
            half_s, half_l = (
                np.abs(along) * length + aside * width,
                aside * length + np.abs(along) * width,
            )
            neighbours.append(
                Neighbour(
                    i,
                    tracks.ids[i],
                    tracks.kinds[i],
                    k,
                    pose,
                    others.accel[0, near],
                    others.turn[0, near],
                    (length, width),
                    frame[0],
                    frame[1],
                    along,
                    0.5 * half_s,
                    0.5 * half_l,
                )
            )
        self.neighbours = tuple(neighbours)

    @cached_property
    def accel(self) -> FloatArray:
        """Change of the ego's speed over `FELT_S` `(n,)`, m/s2; NaN in the first `FELT_S`."""
        return rate_of_change(self.t, self.ego.v, FELT_S)

    @cached_property
    def jumps(self) -> BoolArray:
        """Steps within `FELT_S` of a change of the ego's velocity beyond `TYRES_MPS2` or
        `MOTOR_MPS2`, `(n,)`.
        """
        east, north = self.ego.v * np.cos(self.ego.yaw), self.ego.v * np.sin(self.ego.yaw)
        beyond = np.hypot(np.diff(east), np.diff(north)) > TYRES_MPS2 * GRID_S
        beyond |= np.diff(np.abs(self.ego.v)) > MOTOR_MPS2 * GRID_S
        near = steps(FELT_S)
        return np.convolve(np.r_[False, beyond], np.ones(2 * near + 1), "same") > 0.5

    @cached_property
    def lead(self) -> tuple[IntArray, FloatArray]:
        """Per step, the index in `neighbours` of the nearest one ahead in the band (-1: none), and
        the gap, m (or NaN).

        A road user that comes towards the ego is not a lead.
        """
        leads, gaps = np.full(len(self.t), -1, np.int64), np.full(len(self.t), np.inf)
        for index, user in enumerate(self.neighbours):
            gap = self.gap_to(user)
            closer = (
                user.reaches_into(self.half) & (user.along > 0.0) & (gap > -0.5 * self.car.length)
            )
            closer &= gap < gaps[user.k]
            leads[user.k[closer]], gaps[user.k[closer]] = index, gap[closer]
        return leads, np.where(leads >= 0, np.maximum(gaps, 0.0), np.nan)

    def event(
        self,
        user: Neighbour,
        first: int,
        last: int,
        value: float,
        what: str = "",
        *,
        doubt: str = "",
    ) -> Event:
        """An event of a road user between two of its places."""
        return self.event_at(user, int(user.k[first]), int(user.k[last]), value, what, doubt=doubt)

    def event_at(
        self, user: Neighbour, i: int, j: int, value: float, what: str = "", *, doubt: str = ""
    ) -> Event:
        """An event of a road user between two steps of the grid."""
        if user.kind is AgentKind.OBJECT:
            doubt = "; ".join(filter(None, (doubt, UNCLASSIFIED)))
        return Event(float(self.t[i]), float(self.t[j]), float(value), (user.id,), what, doubt)

    def gap_to(self, user: Neighbour) -> FloatArray:
        """`(m,)` way along the path from the ego's front bumper to a road user's nearest part
        ahead, m.
        """
        return user.s - user.half_s - self.front[user.k]

    def reached(self, s: FloatArray) -> FloatArray:
        """Times at which the ego's front bumper reaches stations `(m,)`, s; NaN if it starts beyond
        or never does.
        """
        front = np.maximum.accumulate(self.front)
        step = np.searchsorted(front, s)
        inside = (step > 0) & (step < len(front))
        return np.where(inside, self.t[np.minimum(step, len(self.t) - 1)], np.nan)


def runs(
    marked: BoolArray, k: IntArray | None = None, least: int = 1, hole: int = 0
) -> Iterator[tuple[int, int]]:
    """First and last place of each unbroken run of marked places, of at least `least` of them.

    Args:
        marked: `(m,)`.
        k: `(m,)` the steps of the places: a run ends where a step is missing. None: no step is
            missing.
        least: Least number of places of a run.
        hole: Up to this many consecutive unmarked places do not end a run.
    """
    flags = np.array(marked, np.bool_)
    broken = np.zeros(len(flags), np.bool_) if k is None else np.r_[False, np.diff(k) > 1]
    if hole:
        for first, last in list(runs(~flags, k)):
            whole = (
                first > 0 and last < len(flags) - 1 and not broken[first] and not broken[last + 1]
            )
            flags[first : last + 1] |= whole and last - first < hole
    begins = np.flatnonzero(flags & (~np.r_[False, flags[:-1]] | broken))
    ends = np.flatnonzero(flags & (~np.r_[flags[1:], False] | np.r_[broken[1:], True]))
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        if last - first + 1 >= least:
            yield first, last


def steps(seconds: float) -> int:
    """The number of steps of the grid in a time, s."""
    return round(seconds / GRID_S)


@kernel
def _own_stations(knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Stations `(n,)` of the rear axle, m."""
    stations, s = np.empty(len(x)), 0.0
    for i in range(len(x)):
        s, _ = line_project(knots, coef, x[i], y[i], s, OWN_M)
        stations[i] = s
    return stations


@kernel
def _on_path(
    knots: FloatArray, coef: FloatArray, k: IntArray, station: FloatArray, pose: FloatArray
) -> FloatArray:
    """Station, offset and heading against the path `(3, m)` of poses `(5, m)` at the steps `k`
    `(m,)`.
    """
    frame, s = np.empty((3, len(k))), 0.0
    for i in range(len(k)):
        fresh = i == 0 or k[i] > k[i - 1] + 1
        guess, window = (station[i], SEARCH_M) if fresh else (s, FOLLOW_M)
        s, l = line_project(knots, coef, pose[0, i], pose[1, i], guess, window)
        frame[0, i], frame[1, i] = s, l
        frame[2, i] = wrap(pose[2, i] - line_frame(knots, coef, s)[2])
    return frame
