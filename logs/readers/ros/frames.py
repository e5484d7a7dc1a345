"""The tree of coordinate frames of a bag, and the clock of its messages.

Frames. `/tf` and `/tf_static` are the edges. With q the rotation (`replan.logs.readers.recorded`)
and p the translation of a child in its parent, a chain of two edges is

(1) p = p1 + q1 p2 q1*,   q = q1 q2

The pose of a frame at a time is that of the edges' samples: `held` is the last one not later;
`between` is the straight line (and the normalised mean of the quaternions) between the two around
that time, to place what a moving sensor saw.

Clock. A message has the log time of its record, and may have a stamp of its sender in the header. A
stamp is the time of the measurement. Log times are later by the time of computation, and jitter:
differences of positions by log time are useless if several messages are written at once. So stamps
are used if all messages of a topic have one. A topic whose stamps are from another clock than the
ego's is read by log time.

A sender's clock restarts where stamps go back while log times go on, and do not come back to where
they were: a simulator that began anew, or a bag that was played in a loop. Stale messages go back
too, but newer ones follow.

(2) t_stamp(log) = the ego's stamp, interpolated over the ego's log time:
        for messages without a stamp
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.core.names import listed
from replan.logs.readers.recorded import heading, product, rotated, unit_or_identity

HELD, BETWEEN = "held", "between"


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a frame in another: times `(n,)` ns, rising.

    Positions `(n, 3)` m; quaternions `(n, 4)` x, y, z, w.
    """

    t: IntArray
    p: FloatArray
    q: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    @property
    def yaw(self) -> FloatArray:
        """Heading of the x axis `(n,)`, rad."""
        return heading(self.q)


def composed(a: Poses, b: Poses) -> Poses:
    """Chain two edges (1), sample by sample."""
    return Poses(a.t, a.p + rotated(a.q, b.p), product(a.q, b.q))


def inverse(a: Poses) -> Poses:
    """Return the poses of the parent in the child."""
    q = a.q * np.array([-1.0, -1.0, -1.0, 1.0])
    return Poses(a.t, -rotated(q, a.p), q)


def sampled(poses: Poses, t: IntArray, how: str) -> Poses:
    """Sample poses at other times `(m,)` ns.

    The first (last) pose applies before the first (after the last) sample.
    """
    before = np.clip(np.searchsorted(poses.t, t, side="right") - 1, 0, len(poses) - 1)
    if how == HELD:
        return Poses(t, poses.p[before], poses.q[before])
    after = np.minimum(before + 1, len(poses) - 1)
    span = (poses.t[after] - poses.t[before]).astype(np.float64)
    u = np.clip(
        np.divide(t - poses.t[before], span, out=np.zeros(len(t)), where=span > 0.0), 0.0, 1.0
    )[:, None]
    p = poses.p[before] + u * (poses.p[after] - poses.p[before])
    near = np.where(
        np.sum(poses.q[before] * poses.q[after], axis=1, keepdims=True) < 0.0, -1.0, 1.0
    )
    return Poses(t, p, unit_or_identity((1.0 - u) * poses.q[before] + u * near * poses.q[after]))


class FrameTree:
    """The tree of frames, of edges (parent, child, poses of the child in the parent), each pair
    once.
    """

    def __init__(self, edges: Iterable[tuple[str, str, Poses]]) -> None:
        self.edges = {(parent, child): poses for parent, child, poses in edges if len(poses)}
        self.parents: dict[str, str] = {}
        for parent, child in sorted(self.edges, key=lambda edge: (-len(self.edges[edge]), edge)):
            self.parents.setdefault(child, parent)

    @property
    def names(self) -> tuple[str, ...]:
        """All frames, sorted."""
        return tuple(sorted({name for edge in self.edges for name in edge}))

    def path(self, name: str) -> list[str]:
        """Return the frame, its parent, and so on up to the root; a cycle ends the path."""
        names = [name]
        while names[-1] in self.parents and self.parents[names[-1]] not in names:
            names.append(self.parents[names[-1]])
        return names

    def connects(self, one: str, other: str) -> bool:
        """Return whether transforms lead from a frame to another, or both are the same."""
        return bool(set(self.path(one)) & set(self.path(other)))

    def chain(self, above: str, below: str) -> list[tuple[str, str, bool]]:
        """Return the edges between frames: (parent, child, whether it goes down); LogError if there
        are none.
        """
        up, down = self.path(above), self.path(below)
        meet = next((name for name in up if name in down), None)
        if meet is None:
            problem = (
                f"no transform leads from frame {above!r} to {below!r}; there are "
                f"{', '.join(self.names) or 'none'}"
            )
            raise LogError(
                problem, topic="/tf", remedy="name the log's own under frames (map, base)"
            )
        climbed = [(self.parents[name], name, False) for name in up[: up.index(meet)]]
        return climbed + [
            (self.parents[name], name, True) for name in reversed(down[: down.index(meet)])
        ]

    def poses(self, above: str, below: str, t: IntArray, how: str) -> Poses:
        """The pose of frame `below` in `above` at times `(m,)` ns."""
        n = len(t)
        poses = Poses(t, np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))
        for parent, child, down in self.chain(above, below):
            step = sampled(self.edges[parent, child], t, how)
            poses = composed(poses, step if down else inverse(step))
        return poses

    def times(self, above: str, below: str) -> IntArray:
        """Return the times of the chain's edge with most samples, ns, from when all moving edges
        are known.
        """
        edges = [self.edges[parent, child] for parent, child, _ in self.chain(above, below)]
        moving = [edge for edge in edges if len(edge) > 1]
        if not moving:
            return np.empty(0, np.int64)
        t = max(moving, key=len).t
        return t[t >= max(edge.t[0] for edge in moving)]


OTHER_CLOCK_S = 1.0
"""Topics with a larger median offset from the ego's clock are stamped by another clock; messages
that differ by more from their topic's median are stale, s."""
LASTS_S = 0.2
"""A restarted clock goes on for this time at least, s; fewer messages at a log's end are stale."""
RETURNS_S = 10.0
"""Stamps that come back to the newest one within this time were stale and not restarted, s."""
REPORTED_S = 0.1
"""Larger offsets are reported, s."""
DROPOUT_S, DROPOUT_INTERVALS = 0.3, 5.0
"""A gap is a drop-out if it exceeds both this time (s) and this multiple of the usual interval."""
_DROPOUTS_SHOWN = 3


@dataclass(frozen=True, eq=False)
class Clock:
    """Converts log times to the scenario's clock, ns, by increasing samples (2) of both.

    Empty: both are the same.
    """

    log: IntArray
    stamp: IntArray

    def __call__(self, log: IntArray) -> IntArray:
        """Convert log times `(n,)` to the scenario's clock."""
        if not len(self.log):
            return log
        since = np.interp(log - self.log[0], self.log - self.log[0], self.stamp - self.stamp[0])
        # integers: floats cannot hold times since an epoch
        inner = self.stamp[0] + np.rint(since).astype(np.int64)
        times = np.where(log < self.log[0], log - self.log[0] + self.stamp[0], inner)
        return np.where(log > self.log[-1], log - self.log[-1] + self.stamp[-1], times)


LOG_CLOCK = Clock(np.empty(0, np.int64), np.empty(0, np.int64))


def stamped(stamps: IntArray) -> bool:
    """Return whether all messages of a topic have a stamp."""
    return bool(len(stamps) and (stamps > 0).all())


def restarts(log: IntArray, stamps: IntArray) -> IntArray:
    """Return the log times, ns, rising, at which the clock of a topic's stamps begins anew; `log`
    is sorted.
    """
    begins, begin, much = list[int](), 0, round(1e9 * OTHER_CLOCK_S)
    if not stamped(stamps) or log[-1] - log[0] < 1e9 * LASTS_S:
        return np.empty(0, np.int64)
    for k in (np.flatnonzero(np.diff(stamps) < -much) + 1).tolist():
        newest, end = stamps[begin:k].max(), np.searchsorted(log, log[k] + round(1e9 * RETURNS_S))
        leaps = np.diff(stamps[k:end]) > np.diff(log[k:end]) + much
        returns = leaps & (stamps[k + 1 : end] > newest - much)
        if not returns.any() and log[-1] - log[k] >= 1e9 * LASTS_S:
            begins.append(int(log[k]))
            begin = k
    return np.array(begins, dtype=np.int64)


def clock_of(log: IntArray, stamps: IntArray, choice: str) -> Clock:
    """Return the scenario's clock: the stamps of the ego's messages, or the log times by choice or
    without stamps.
    """
    if choice == "log" or not stamped(stamps):
        return LOG_CLOCK
    rising = np.flatnonzero(np.diff(log, prepend=log[0] - 1) > 0)
    return Clock(log[rising], np.maximum.accumulate(stamps)[rising])


def times_of(
    topic: str, log: IntArray, stamps: IntArray, clock: Clock, notes: list[str]
) -> tuple[IntArray, IntArray]:
    """Return the times of a topic's messages `(k,)` ns, strictly increasing, and the indices of the
    messages `(k,)`.

    Stale messages (delays (2) more than `OTHER_CLOCK_S` off the topic's median) are left out; of
    several messages with the same time, the last recorded one is kept.
    """
    keep = np.arange(len(log))
    if not len(clock.log) or not stamped(stamps):
        times = clock(log)
    else:
        late = (clock(log) - stamps) / 1e9  # delay of the record after the stamp, s
        usual = float(np.median(late))
        near = np.flatnonzero(np.abs(late - usual) <= OTHER_CLOCK_S)
        again = restarts(log, stamps)
        if abs(usual) > OTHER_CLOCK_S or not len(near) or len(again):
            problem = f"The stamps of {topic} are of another clock than the ego's ({usual:+.1f} s)"
            if len(again):
                problem = (
                    f"The clock of {topic} restarts {(again[0] - clock.log[0]) / 1e9:.2f} s "
                    "after the first pose"
                )
            notes.append(f"{problem}: its log times count.")
            times = clock(log)
        else:
            keep = near
            if len(keep) < len(log):
                worst = float(np.abs(late - usual).max())
                notes.append(
                    f"{len(log) - len(keep)} of {len(log)} messages of {topic} are stale, by up to "
                    f"{worst:.1f} s, and left out."
                )
            times = stamps[keep]
    order = np.argsort(times, kind="stable")
    last = np.append(np.diff(times[order]) > 0, True)
    return times[order][last], keep[order][last]


def describe_timing(topic: str, log: IntArray, stamps: IntArray, start_ns: int) -> list[str]:
    """Describe a topic's delays and drop-outs in sentences, if there are any."""
    notes = []
    if stamped(stamps):
        late = (log - stamps) / 1e9
        usual, worst = float(np.median(late)), float(late[np.argmax(np.abs(late))])
        if max(abs(usual), abs(worst)) > REPORTED_S:
            notes.append(
                f"{topic} is recorded {usual:.3f} s after its stamps (median), at most {worst:.3f} "
                "s."
            )
    if len(log) > 2:
        apart = np.diff(log) / 1e9
        usual = float(np.median(apart))
        lost = np.flatnonzero(apart > max(DROPOUT_S, DROPOUT_INTERVALS * usual))
        if len(lost):
            places = [f"{apart[i]:.2f} s from {(log[i] - start_ns) / 1e9:.2f} s" for i in lost]
            notes.append(
                f"{topic} drops out: nothing for {listed(places, _DROPOUTS_SHOWN)} (usually every "
                f"{usual:.3f} s)."
            )
    return notes
