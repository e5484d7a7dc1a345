"""The boxes of the ego and of the other road users on a time grid, as they moved: ground truth for
all metrics.

One kernel computes the others as `Tracks.truth` does at each time of the grid: logged positions,
estimated velocities and accelerations (`replan.logs.motion`). An agent is absent during a gap of
its track. The size of arrays over (agent, time) grows with the square of the length of a drive.
Metrics therefore process pieces of time with the agents present in each (`pieces`), or one agent
after another (`each`).

Phantoms are boxes that overlap the recorded ego: they cannot have been real. A box that reaches
`DEEP_M` into the box of the recorded ego is no evidence of a contact. It is removed from the last
sample of its track at least `AROUND_S` before the overlap to the first sample at least `AROUND_S`
after it; a static box is removed from the whole log. Only recorded logs have phantoms.
`without_phantoms` returns tracks with gaps at these times (`replan.logs.observed`), for metrics and
for the contact that ends a drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, hypot, inf, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import last, once
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap, time_to_contact_turning
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks

GRID_S = 0.1  # Time step of metrics that do not use every step of the drive, s
MOST_CELLS = 1_000_000  # Most (agent, time) pairs in memory at once: 57 bytes each
PIECE_STEPS = 4096  # Steps of a piece of a longer drive, unless that exceeds `MOST_CELLS`
BEHIND = cos(150.0 / 180.0 * np.pi)
STANDING_MPS = 0.05  # nuPlan devkit e9241677: a road user at this speed or below stands
NO_TTC_MPS = 0.005  # Likewise: an ego at this speed or below has no time to collision
# Time for which turning road users go on turning: they end their turns, and 1.5 s is a critical TTC
TURN_S = 1.5
# Margin before and after a phantom: above `replan.logs.observed.MAX_GAP_S`, so that every track
# gets a gap
AROUND_S = 1.0
FINE_S = 0.05  # Time step of the search for phantoms, s
# Depth that a phantom reaches into the ego's box on each side; a box that only grazes it is no
# phantom
DEEP_M = 0.3


class OtherBoxes(NamedTuple):
    """Road users over a grid of k times."""

    there: BoolArray  # `(n, k)` whether the agent is present
    pose: FloatArray  # `(5, n, k)`: x, y (box centre, m), yaw (rad), vx, vy (m/s); NaN while absent
    accel: FloatArray  # `(n, k)` rate of the speed, m/s2; NaN while absent
    turn: FloatArray  # `(n, k)` rate of the velocity's direction, rad/s; NaN while absent
    size: FloatArray  # `(n, 2)` length and width, m


@once
def grid_of(trace: Trace) -> Trajectory:
    """Resample the ego's drive every `GRID_S` from its start, and at its last step."""
    first, last = float(trace.ego.t[0]), float(trace.ego.t[-1])
    steps = first + GRID_S * np.arange(int((last - first) / GRID_S - 1e-6) + 1)
    return trace.ego.resampled(np.r_[steps, last] if last > steps[-1] else steps)


def others_at(tracks: Tracks, t: FloatArray) -> OtherBoxes:
    """Return the agents at the increasing times `t` `(k,)`, interpolated as by `Tracks.truth`."""
    return _others_at(tracks, np.asarray(t, np.float64).tobytes())


@last(2)  # most metrics use the steps of the drive, some use the 0.1 s grid
def _others_at(tracks: Tracks, times: bytes) -> OtherBoxes:
    return some_at(tracks, np.arange(len(tracks)), np.frombuffer(times))


def some_at(tracks: Tracks, agents: IntArray, t: FloatArray) -> OtherBoxes:
    """Return `others_at` for the tracks `agents` `(n,)` only."""
    lengths, moved = np.diff(tracks.offsets)[agents], tracks.motion
    offsets = np.r_[0, np.cumsum(lengths)]
    rows = np.repeat(tracks.offsets[agents] - offsets[:-1], lengths) + np.arange(offsets[-1])
    moves = (moved.vx, moved.vy, moved.accel, moved.turn)
    columns = np.stack([column[rows] for column in (tracks.x, tracks.y, tracks.yaw, *moves)])
    present, values = _on_grid(
        offsets, tracks.static[agents], tracks.t[rows], tracks.gap_after[rows], columns, frozen(t)
    )
    *pose, accel, turn = values
    size = np.column_stack([tracks.length, tracks.width])[agents]
    return OtherBoxes(present, values[: len(pose)], accel, turn, size)


def pieces(tracks: Tracks, t: FloatArray) -> Iterator[tuple[slice, IntArray, OtherBoxes]]:
    """Yield pieces of the increasing times `t` `(k,)`: their steps, the tracks present in order,
    `some_at` of both.
    """
    if len(tracks) * len(t) <= MOST_CELLS:
        yield slice(0, len(t)), np.arange(len(tracks)), others_at(tracks, t)
        return
    begin = 0
    while begin < len(t):
        end = min(begin + PIECE_STEPS, len(t))
        agents = present_between(tracks, t[begin], t[end - 1])
        while len(agents) * (end - begin) > MOST_CELLS and end - begin > 1:
            end = begin + (end - begin) // 2
            agents = present_between(tracks, t[begin], t[end - 1])
        yield slice(begin, end), agents, some_at(tracks, agents, t[begin:end])
        begin = end


def each(tracks: Tracks, t: FloatArray) -> Iterator[tuple[int, OtherBoxes, int]]:
    """Yield all tracks in order: index, the boxes of a batch of tracks at the increasing times `t`
    `(k,)`, its row.
    """
    count = max(MOST_CELLS // len(t), 1)
    for begin in range(0, len(tracks), count):
        agents = np.arange(begin, min(begin + count, len(tracks)))
        others = others_at(tracks, t) if len(agents) == len(tracks) else some_at(tracks, agents, t)
        yield from ((begin + row, others, row) for row in range(len(agents)))


def in_spans(tracks: Tracks, t: FloatArray) -> Iterator[tuple[int, slice, OtherBoxes]]:
    """Yield each track whose time span contains some of the increasing times `t` `(k,)`: index,
    those steps, its boxes.

    A static track is present at all times.
    """
    begins, ends = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]
    low, high = np.searchsorted(t, begins - 1e-9), np.searchsorted(t, ends + 1e-9, side="right")
    low, high = np.where(tracks.static, 0, low), np.where(tracks.static, len(t), high)
    for i in np.flatnonzero(low < high).tolist():
        yield i, slice(low[i], high[i]), some_at(tracks, np.array([i]), t[low[i] : high[i]])


def nearest(
    tracks: Tracks,
    t: FloatArray,
    measure: Callable[[slice, IntArray, OtherBoxes], tuple[FloatArray, IntArray]],
) -> tuple[FloatArray, IntArray]:
    """Join the results of a kernel over all `pieces`: values `(..., k)` and tracks `(k,)`, -1 where
    there is no row.
    """
    results = [
        (agents_of_piece, *measure(steps, agents_of_piece, others))
        for steps, agents_of_piece, others in pieces(tracks, t)
    ]
    agents = [indices_of(agents_of_piece, rows) for agents_of_piece, _, rows in results]
    return np.concatenate([values for _, values, _ in results], axis=-1), np.concatenate(agents)


def indices_of(agents: IntArray, rows: IntArray) -> IntArray:
    """Return the tracks of the rows `(k,)` of a piece; -1 for row -1."""
    return np.append(agents, -1)[rows]


def present_between(tracks: Tracks, first: float, last: float) -> IntArray:
    """Return the tracks whose samples reach into `first` to `last`, s, and the static ones, in
    order.
    """
    spans = (tracks.t[tracks.offsets[:-1]] <= last + 1e-9) & (
        tracks.t[tracks.offsets[1:] - 1] >= first - 1e-9
    )
    return np.flatnonzero(spans | tracks.static)


def name_of(tracks: Tracks, index: int) -> str:
    """Return kind and id of a track: "car 12"."""
    return f"{tracks.kinds[index].value} {tracks.ids[index]}"


def labels_of(trace: Trace, agents: IntArray) -> tuple[str, ...]:
    """Return the agents' names at each step `(k,)`; "" for -1."""
    names = (*(name_of(trace.agents, i) for i in range(len(trace.agents))), "")
    return tuple(names[i] for i in agents.tolist())


@kernel
def _on_grid(
    offsets: IntArray,
    static: BoolArray,
    t: FloatArray,
    gap_after: BoolArray,
    columns: FloatArray,
    times: FloatArray,
) -> tuple[BoolArray, FloatArray]:
    """Return which agents are present `(n, k)`, and the `columns` `(7, m)` interpolated to
    `(7, n, k)`, else NaN.
    """
    n, k = len(offsets) - 1, len(times)
    present, values = np.zeros((n, k), np.bool_), np.full((len(columns), n, k), np.nan)
    for i in range(n):
        first, last = offsets[i], offsets[i + 1] - 1
        row = first
        for j in range(k):
            if not static[i]:
                if t[first] > times[j] + 1e-9 or t[last] < times[j] - 1e-9:
                    continue
                while row < last and t[row + 1] <= times[j] + 1e-9:
                    row += 1
                if gap_after[row] and times[j] > t[row] + 1e-9:
                    continue
            present[i, j] = True
            u = 0.0
            if row < last and not static[i]:
                u = min(max((times[j] - t[row]) / (t[row + 1] - t[row]), 0.0), 1.0)
            after = row + 1 if u > 0.0 else row
            for c in range(len(columns)):
                values[c, i, j] = columns[c, row] + u * (columns[c, after] - columns[c, row])
    return present, values


class EgoOutline(NamedTuple):
    """The ego's box, m: rear axle to centre, length, width, and rear axle to front bumper."""

    axle: float
    length: float
    width: float
    front: float


def car_of(scenario: Scenario) -> EgoOutline:
    """The ego's box."""
    car = scenario.vehicle
    return EgoOutline(
        float(car.axle_to_center), float(car.length), float(car.width), float(car.axle_to_front)
    )


def ego_boxes(ego: Trajectory, scenario: Scenario) -> FloatArray:
    """The ego's box centre and its velocity vector `(5, k)`: x, y, yaw, vx, vy.

    The centre is l = `axle_to_center` ahead of the rear axle and turns with the body: it moves
    sideways at l kappa v.
    """
    ahead = scenario.vehicle.axle_to_center
    c, s, aside = np.cos(ego.yaw), np.sin(ego.yaw), ahead * ego.kappa * ego.v
    return np.stack(
        [
            ego.x + ahead * c,
            ego.y + ahead * s,
            ego.yaw,
            ego.v * c - aside * s,
            ego.v * s + aside * c,
        ]
    )


@inner_kernel
def distance_bound(
    x: float, y: float, car: EgoOutline, others: OtherBoxes, i: int, k: int
) -> float:
    """Return a lower bound of the distance between box i at step k and the ego's box with the
    centre (x, y), m.
    """
    size, reach = others.size, 0.5 * hypot(car.length, car.width)
    return (
        hypot(others.pose[0, i, k] - x, others.pose[1, i, k] - y)
        - reach
        - 0.5 * hypot(size[i, 0], size[i, 1])
    )


@inner_kernel
def touches(
    x: float, y: float, yaw: float, car: EgoOutline, others: OtherBoxes, i: int, k: int
) -> bool:
    """Whether box i at step k and the ego's box with this centre and heading touch."""
    pose, size = others.pose, others.size
    return overlap(
        x,
        y,
        yaw,
        car.length,
        car.width,
        pose[0, i, k],
        pose[1, i, k],
        pose[2, i, k],
        size[i, 0],
        size[i, 1],
    )


@inner_kernel
def contact_time(
    ego: tuple[float, float, float, float, float],
    turn: float,
    car: EgoOutline,
    others: OtherBoxes,
    i: int,
    k: int,
    lasts: float,
) -> float:
    """`shapes.time_to_contact_turning` of box i at step k and the ego's box (x, y, yaw, vx, vy),
    yaw rate `turn`, s.
    """
    x, y, yaw, vx, vy = ego
    pose, size = others.pose, others.size
    return time_to_contact_turning(
        x,
        y,
        yaw,
        car.length,
        car.width,
        vx,
        vy,
        turn,
        pose[0, i, k],
        pose[1, i, k],
        pose[2, i, k],
        size[i, 0],
        size[i, 1],
        pose[3, i, k],
        pose[4, i, k],
        others.turn[i, k],
        lasts,
    )


@inner_kernel
def is_behind(x: float, y: float, yaw: float, other_x: float, other_y: float) -> bool:
    """Whether a point is more than 150 degrees off the heading, seen from the rear axle (x, y)."""
    dx, dy = other_x - x, other_y - y
    return dx * cos(yaw) + dy * sin(yaw) < BEHIND * hypot(dx, dy)


@dataclass(frozen=True, slots=True)
class Phantom:
    """A box that overlaps the recorded ego: id of its track, name with its kind, and the times, s,
    of its removal.

    The times may be -inf (from the start of the log) and inf (to its end).
    """

    agent: str
    name: str
    t_from: float
    t_to: float


@once
def phantoms(scenario: Scenario) -> tuple[Phantom, ...]:
    """Return the phantoms of a recorded log, in order of tracks and time; other logs have none."""
    if not scenario.is_recorded or not len(scenario.tracks):
        return ()
    ego, tracks = scenario.ego, scenario.tracks
    t = np.union1d(ego.t, np.arange(ego.t[0], ego.t[-1], FINE_S))
    boxes, car = ego_boxes(ego.resampled(t), scenario), scenario.vehicle
    result = []
    for i, steps, others in in_spans(tracks, t):
        size, pose, ego_box = others.size[0], others.pose[:3, 0], boxes[:3, steps]
        reach = 0.5 * (np.hypot(car.length, car.width) + np.hypot(*size))
        inside = others.there[0] & (np.hypot(pose[0] - ego_box[0], pose[1] - ego_box[1]) <= reach)
        for k in np.flatnonzero(inside):
            (x1, y1, yaw1), (x2, y2, yaw2) = ego_box[:, k], pose[:, k]
            inside[k] = overlap(
                x1,
                y1,
                yaw1,
                car.length - 2.0 * DEEP_M,
                car.width - 2.0 * DEEP_M,
                x2,
                y2,
                yaw2,
                *size,
            )
        if not inside.any():
            continue
        sampled = np.empty(0) if tracks.static[i] else tracks.t[tracks.samples(i)]
        seen = t[steps][inside]
        # Join runs if margins meet
        for run in np.split(seen, np.flatnonzero(np.diff(seen) > 2.0 * AROUND_S) + 1):
            before = sampled[sampled <= run[0] - AROUND_S]
            after = sampled[sampled >= run[-1] + AROUND_S]
            begin = float(before[-1]) if len(before) else -inf
            end = float(after[0]) if len(after) else inf
            result.append(Phantom(tracks.ids[i], name_of(tracks, i), begin, end))
    return tuple(dict.fromkeys(result))


def without_phantoms(tracks: Tracks, removed: tuple[Phantom, ...]) -> Tracks:
    """Return the tracks without the samples of phantoms (matched by id).

    Without phantoms, the same object.
    """
    if not removed:
        return tracks
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    keep = np.ones(len(tracks.t), np.bool_)
    for phantom in removed:
        if phantom.agent in tracks.ids:
            of_track = owner == tracks.ids.index(phantom.agent)
            keep &= ~(of_track & (phantom.t_from < tracks.t) & (tracks.t < phantom.t_to))
    return tracks.taken(keep)
