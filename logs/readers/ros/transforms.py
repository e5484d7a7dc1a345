"""Coordinate frames: the tree of `/tf` and `/tf_static`, and the pose of one frame in another over time.

With q the rotation (quaternion x, y, z, w) and p the translation of a child in its parent, a chain of two is

(1) p = p1 + q1 p2 q1*,   q = q1 q2

A frame's pose at a time is that of the edges' samples: `held` is the last one not later; `between` the straight line
(and the normalised mean of the quaternions) between the two around it, for placing what a moving sensor measured.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from logs.errors import LogError
from logs.kernel import FloatArray, IntArray

HELD, BETWEEN = "held", "between"


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a frame in another: times `(n,)` ns, rising; positions `(n, 3)` m; quaternions `(n, 4)` x, y, z, w."""

    t: IntArray
    p: FloatArray
    q: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    @property
    def yaw(self) -> FloatArray:
        """Heading of the x axis `(n,)`, rad."""
        return heading(self.q)


def heading(q: FloatArray) -> FloatArray:
    """Direction of the rotated x axis seen from above `(n,)`, rad."""
    x, y, z, w = q.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Quaternions a b, `(n, 4)` each."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=1,
    )


def rotated(q: FloatArray, p: FloatArray) -> FloatArray:
    """Vectors p `(n, 3)` turned by q `(n, 4)`."""
    u, w = q[:, :3], q[:, 3:]
    twice = 2.0 * np.cross(u, p)
    return np.asarray(p + w * twice + np.cross(u, twice))


def composed(a: Poses, b: Poses) -> Poses:
    """(1), sample by sample."""
    return Poses(a.t, a.p + rotated(a.q, b.p), product(a.q, b.q))


def inverse(a: Poses) -> Poses:
    """The parent in the child."""
    q = a.q * np.array([-1.0, -1.0, -1.0, 1.0])
    return Poses(a.t, -rotated(q, a.p), q)


def unit(q: FloatArray) -> FloatArray:
    """Quaternions of length 1; those that are 0 turn nothing, as senders who leave them out mean it."""
    size = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(size > 1e-9, q / np.where(size > 1e-9, size, 1.0), np.array([0.0, 0.0, 0.0, 1.0]))


def sampled(poses: Poses, t: IntArray, how: str) -> Poses:
    """The pose at other times `(m,)` ns; before the first sample it is the first, after the last the last."""
    before = np.clip(np.searchsorted(poses.t, t, side="right") - 1, 0, len(poses) - 1)
    if how == HELD:
        return Poses(t, poses.p[before], poses.q[before])
    after = np.minimum(before + 1, len(poses) - 1)
    span = (poses.t[after] - poses.t[before]).astype(np.float64)
    u = np.clip(np.divide(t - poses.t[before], span, out=np.zeros(len(t)), where=span > 0.0), 0.0, 1.0)[:, None]
    p = poses.p[before] + u * (poses.p[after] - poses.p[before])
    near = np.where(np.sum(poses.q[before] * poses.q[after], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return Poses(t, p, unit((1.0 - u) * poses.q[before] + u * near * poses.q[after]))


class Frames:
    """The tree of frames.

    Args:
        edges: (parent, child, poses of the child in the parent), each pair once.
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

    @property
    def roots(self) -> tuple[str, ...]:
        """Frames that have no parent, sorted."""
        return tuple(name for name in self.names if name not in self.parents)

    def path(self, name: str) -> list[str]:
        """The frame, its parent, and so on to its root; it ends where it would go round."""
        out = [name]
        while out[-1] in self.parents and self.parents[out[-1]] not in out:
            out.append(self.parents[out[-1]])
        return out

    def chain(self, above: str, below: str) -> list[tuple[str, str, bool]]:
        """Edges from a frame to another: (parent, child, whether it is gone down).

        Raises:
            LogError: No transforms connect them.
        """
        up, down = self.path(above), self.path(below)
        meet = next((name for name in up if name in down), None)
        if meet is None:
            what = f"no transform leads from frame {above!r} to {below!r}; there are {', '.join(self.names) or 'none'}"
            raise LogError(what, topic="/tf", remedy="name the log's own under frames (map, base)")
        climbed = [(self.parents[name], name, False) for name in up[: up.index(meet)]]
        return climbed + [(self.parents[name], name, True) for name in reversed(down[: down.index(meet)])]

    def poses(self, above: str, below: str, t: IntArray, how: str) -> Poses:
        """The pose of frame `below` in `above` at times `(m,)` ns."""
        n = len(t)
        out = Poses(t, np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))
        for parent, child, down in self.chain(above, below):
            step = sampled(self.edges[parent, child], t, how)
            out = composed(out, step if down else inverse(step))
        return out

    def times(self, above: str, below: str) -> IntArray:
        """When the chain moves: times of its edge with most samples, from when all of its edges are known; ns."""
        edges = [self.edges[parent, child] for parent, child, _ in self.chain(above, below)]
        moving = [edge for edge in edges if len(edge) > 1]
        if not moving:
            return np.empty(0, np.int64)
        t = max(moving, key=len).t
        return t[t >= max(edge.t[0] for edge in moving)]
