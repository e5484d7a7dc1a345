"""Finds the identities of objects over time, and makes tracks with one box, kind and front each.

Identities. Where perception numbers the entries of each list anew
(`replan.logs.repair.detections`), ids are no identities. Then the objects of a frame are assigned
to those known so far, by the least sum of distances to the positions expected from earlier samples.
Outlines of clusters split and merge: an outline whose size differs from that with which an object
began is another object, since a box has one size.

Tracks. A log has a box in each frame, a Scenario one for each agent: the median of its sizes, and
the kind that it had most often. Where the log has no velocities, they are derived.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from replan.core.arrays import BoolArray, Columns, FloatArray, IntArray
from replan.logs.agents import USUAL_SIZE_M, AgentKind, codes_of
from replan.logs.readers.ros.fits import rates, spread
from replan.logs.repair.detections import Detections, no_identities
from replan.logs.tracks import Tracks

AGENT_WINDOW_S, OBJECT_WINDOW_S = 0.5, 1.0
"""Windows for boxes of road users and of objects at 10 Hz, s: outlines of clusters jump by
decimetres.
"""
NOISE_M = {
    AgentKind.PEDESTRIAN: 0.07,
    AgentKind.BICYCLE: 0.07,
    AgentKind.MOTORCYCLE: 0.17,
    AgentKind.TRUCK: 0.17,
    AgentKind.BUS: 0.17,
}
NOISE_OTHERS_M, NOISES = 0.1, 2.0
"""Noise of box centres (root mean square in the 13 drives of Tartu); a derived velocity counts from
`NOISES` times the standard deviation that follows on: an object that was seen twice 0.1 s apart is
not yet known to move."""
MOVES_MPS = 1.0
"""Only faster objects show their front, m/s."""


@dataclass(frozen=True, eq=False)
class Samples(Columns):
    """Objects of all frames, `(m,)` each: message, id, kind, pose in the map, velocity, size (NaN:
    not known).

    `ids` are those of the log, "" where it gives none; `score` is 0 to 1, NaN where it is not
    known; `names` are identities, None until they are asked for (`identified`).
    """

    message: IntArray
    ids: list[str]
    kinds: list[AgentKind]
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    length: FloatArray
    width: FloatArray
    turned: BoolArray
    score: FloatArray
    names: list[str] | None = None

    def __len__(self) -> int:
        return len(self.ids)

    def detections(self, t: FloatArray) -> Detections:
        """All of them as they were reported; t `(k,)` s are the times of the messages."""
        columns = (self.x, self.y, self.yaw, self.length, self.width, self.vx, self.vy, self.score)
        return Detections(
            t[self.message], t, tuple(self.ids), codes_of(tuple(self.kinds)), *columns
        )


def identified(samples: Samples, t: IntArray, notes: list[str]) -> Samples:
    """The samples with names that are identities, each once a frame.

    T `(k,)` ns are the times of the messages.
    """
    if samples.names is not None:
        return samples
    seconds, with_ids = (t[samples.message] - t[:1]) / 1e9, any(samples.ids)
    if with_ids and no_identities(samples.ids, seconds, samples.x, samples.y) is None:
        return replace(samples, names=samples.ids)
    sizes = np.where(
        samples.turned[:, None], np.column_stack([samples.length, samples.width]), np.nan
    )
    names = joined(samples.message, seconds, samples.x, samples.y, samples.kinds, sizes)
    why = "are no identities (they jump)" if with_ids else "are not there"
    count = int(names.max(initial=0))
    notes.append(
        f"Ids of objects {why}: objects are joined from frame to frame by position, to {count} "
        "tracks."
    )
    return replace(samples, names=[str(name) for name in names])


def firsts(codes: IntArray) -> IntArray:
    """Of sorted codes `(m,)`, the index of the first equal one."""
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    return np.repeat(starts, np.diff(np.append(starts, len(codes))))


def tracks_of(samples: Samples, t: FloatArray, notes: list[str]) -> Tracks:
    """Make tracks from the samples; t `(k,)` s are the times of their messages."""
    if not len(samples):
        return Tracks.empty()
    names = np.array(samples.names, dtype=object).astype(str)
    _, first_seen, codes = np.unique(names, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first_seen, kind="stable"), kind="stable")
    codes = rank[codes]
    order = np.lexsort((samples.message, codes))
    twice = np.r_[False, (np.diff(codes[order]) == 0) & (np.diff(samples.message[order]) == 0)]
    if twice.any():
        notes.append(f"{int(twice.sum())} samples repeat an id within a frame: the first counts.")
    order = order[~twice]
    in_order, codes = samples.taken(order), codes[order]
    first = firsts(codes)
    offsets = np.append(np.unique(first), len(codes))
    seconds = t[in_order.message]
    parts = [slice(*ends) for ends in pairwise(offsets)]
    kinds = tuple(Counter(in_order.kinds[part]).most_common(1)[0][0] for part in parts)
    # rectangles around outlines may lie on any of four sides: each as the one before
    yaw, length, width = in_order.yaw.copy(), in_order.length.copy(), in_order.width.copy()
    for part in parts:
        for i in range(part.start + 1, part.stop):
            if in_order.turned[i] and in_order.turned[i - 1]:
                turns = round((yaw[i - 1] - yaw[i]) / (0.5 * np.pi))
                yaw[i] += 0.5 * np.pi * turns
                if turns % 2:
                    length[i], width[i] = width[i], length[i]
    yaw = _one_front(yaw, in_order, seconds, parts, kinds, notes)
    sizes, assumed, varied = np.empty((2, len(parts))), False, False
    for k, part in enumerate(parts):
        for row, column in enumerate((length, width)):
            values = column[part][np.isfinite(column[part])]
            sizes[row, k] = np.median(values) if len(values) else USUAL_SIZE_M[kinds[k]][row]
            assumed = assumed or not len(values)
            varied = varied or bool(len(values) and np.ptp(values) > 0.01)
    if assumed:
        notes.append("Some objects have no size: that of their kind is assumed.")
    if varied:
        notes.append(
            "An agent's box is the median of its sizes, its kind the one that it had most often."
        )
    vx, vy = _fill_velocities(in_order, seconds, first, kinds, np.diff(offsets), notes)
    return Tracks(
        tuple(names[order[offsets[:-1]]].tolist()),
        kinds,
        sizes[0],
        sizes[1],
        np.zeros(len(parts), np.bool_),
        offsets,
        seconds,
        in_order.x,
        in_order.y,
        yaw,
        vx,
        vy,
    )


def _one_front(
    yaw: FloatArray,
    samples: Samples,
    t: FloatArray,
    parts: list[slice],
    kinds: tuple[AgentKind, ...],
    notes: list[str],
) -> FloatArray:
    """Headings of boxes whose front and back change places, so that none turns round from one
    sample to the next.

    The front is the direction of motion of most samples; for a standing agent, the direction of
    most headings.
    """
    one_front, turned = yaw.copy(), 0
    for part, kind in zip(parts, kinds, strict=True):
        if kind is AgentKind.PEDESTRIAN or part.stop - part.start < 2:
            continue
        # by how many half turns each differs from the one before, summed up
        steps = np.round(np.diff(yaw[part]) / np.pi)
        half = np.r_[0.0, np.cumsum(steps)]
        if not (half % 2).any():
            continue
        own = yaw[part] - np.pi * half
        along = np.diff(samples.x[part]) * np.cos(own[1:]) + np.diff(samples.y[part]) * np.sin(
            own[1:]
        )
        speed = along / np.diff(t[part])
        moves = np.abs(speed) > MOVES_MPS
        backward = (
            np.sum(np.sign(speed[moves])) < 0 if moves.mean() > 0.5 else (half % 2).mean() > 0.5
        )
        one_front[part] = own + (np.pi if backward else 0.0)
        turned += int(min((half % 2).sum(), len(half) - (half % 2).sum()))
    if turned:
        notes.append(
            f"{turned} samples of objects have front and back exchanged and are turned round."
        )
    return one_front


def _fill_velocities(
    samples: Samples,
    t: FloatArray,
    first: IntArray,
    kinds: tuple[AgentKind, ...],
    counts: IntArray,
    notes: list[str],
) -> tuple[FloatArray, FloatArray]:
    """The logged velocities, and where there are none the motion over a backward window.

    A first sample has none.
    """
    missing = ~(np.isfinite(samples.vx) & np.isfinite(samples.vy))
    if not missing.any():
        return samples.vx, samples.vy
    windows = np.array(
        [OBJECT_WINDOW_S if kind is AgentKind.OBJECT else AGENT_WINDOW_S for kind in kinds]
    )
    values = np.array([samples.x, samples.y])
    velocity = rates(t, values, first, np.repeat(windows, counts), parabola=False)[0]
    noise = np.repeat([NOISE_M.get(kind, NOISE_OTHERS_M) for kind in kinds], counts)
    explained = NOISES * noise >= np.hypot(*velocity) * spread(t, first, np.repeat(windows, counts))
    velocity = np.where(explained, 0.0, velocity)
    notes.append(
        f"Velocities of objects ({missing.mean():.0%} of the samples) are derived from their "
        f"positions in the last {AGENT_WINDOW_S} s (for objects that are not road users: the last "
        f"{OBJECT_WINDOW_S:g} s). Motion within the noise of positions counts as standing."
    )
    return np.where(missing, velocity[0], samples.vx), np.where(missing, velocity[1], samples.vy)


REACH_M = {AgentKind.PEDESTRIAN: 1.0, AgentKind.OBJECT: 1.5}
REACH_OTHERS_M = 2.0
"""Largest distance of an object from its expected place, m: noise of its centre and
acceleration.
"""
UNKNOWN_MPS = {AgentKind.PEDESTRIAN: 2.5, AgentKind.OBJECT: 5.0}
UNKNOWN_OTHERS_MPS = 20.0
"""Additional distance per second after a first sample, whose velocity is unknown, m/s."""
OTHER_KIND_M = 1.0
"""Added distance of an object of another kind, m: labels flicker."""
LOST_S = 1.0
"""A road user not seen for longer is no longer expected."""
OTHER_SIZE_M, OTHER_SIZE = 0.5, 0.25
"""An outline is another object's if its size differs by more than both, m and as a share of the
larger one.
"""
MEMORY = 5
"""Number of last samples from which the velocity is computed."""
_FAR = 1e6


@dataclass
class _Known:
    """A known object: its name and kind, the size with which it began, and its last samples (t, x,
    y).
    """

    name: int
    kind: AgentKind
    size: FloatArray
    past: list[tuple[float, float, float]] = field(default_factory=list)

    def expected(self, now: float) -> tuple[float, float]:
        """Return its expected place: the last one, extrapolated with the velocity over its last
        samples.
        """
        (t0, x0, y0), (t1, x1, y1) = self.past[0], self.past[-1]
        if t1 <= t0:
            return x1, y1
        ahead = (now - t1) / (t1 - t0)
        return x1 + ahead * (x1 - x0), y1 + ahead * (y1 - y0)


def joined(
    frame: IntArray,
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    kinds: Sequence[AgentKind],
    sizes: FloatArray,
) -> IntArray:
    """Names `(m,)`, numbered by first appearance, of samples in frames `(m,)`, rising, at times `t`
    `(m,)`, s.

    `sizes` `(m, 2)`: length and width of outlines, NaN for samples with a box.
    """
    names = np.empty(len(frame), np.int64)
    known: list[_Known] = []
    count = 0
    for part in np.split(np.arange(len(frame)), np.flatnonzero(np.diff(frame)) + 1):
        if not len(part):
            continue
        now = float(t[part[0]])
        known = [track for track in known if now - track.past[-1][0] <= LOST_S]
        object_of_detection = [-1] * len(part)  # which known object each one is; -1: none
        if known:
            expected_x, expected_y = np.array([track.expected(now) for track in known]).T
            reach = np.empty(len(known))
            for k, track in enumerate(known):
                reach[k] = REACH_M.get(track.kind, REACH_OTHERS_M)
                if len(track.past) == 1:
                    lost_s = now - track.past[-1][0]
                    reach[k] += UNKNOWN_MPS.get(track.kind, UNKNOWN_OTHERS_MPS) * lost_s
            away = np.hypot(expected_x[:, None] - x[part], expected_y[:, None] - y[part])
            near = np.nonzero(away <= reach[:, None])
            codes = codes_of(tuple(kinds[i] for i in part))
            other = codes_of(tuple(track.kind for track in known))[near[0]] != codes[near[1]]
            a, b = (
                np.sort(np.array([track.size for track in known]))[near[0]],
                np.sort(sizes[part])[near[1]],
            )
            apart = np.abs(a - b)  # NaN, a size that is not known, may be that of any object
            alike = ~((apart > OTHER_SIZE_M) & (apart > OTHER_SIZE * np.maximum(a, b))).any(axis=-1)
            cost = np.full(away.shape, _FAR)
            cost[near] = np.where(alike, away[near] + OTHER_KIND_M * other, _FAR)
            for row, column in zip(*linear_sum_assignment(cost), strict=True):
                if cost[row, column] < _FAR:
                    object_of_detection[column] = int(row)
        for i, k in zip(part, object_of_detection, strict=True):
            if k < 0:
                k, count = len(known), count + 1
                known.append(_Known(count, kinds[i], sizes[i]))
            track = known[k]
            names[i], track.kind = track.name, kinds[i]
            track.past = [*track.past[1 - MEMORY :], (now, float(x[i]), float(y[i]))]
    return names
