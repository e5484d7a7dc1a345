"""Who is who from frame to frame: joining by position where a topic's ids are no identities.

Perception that numbers the entries of each list anew gives no tracks (`logs.repair.names`). Then every frame's objects
are assigned to those known so far, by the least sum of distances to where these should be by now, from the samples
before only. Outlines of clusters split and merge: one whose size is another than that with which an object began is
another object, as a box has one size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from logs.agents import AgentKind, codes_of
from logs.kernel import BoolArray, FloatArray, IntArray

REACH_M = {AgentKind.PEDESTRIAN: 1.0, AgentKind.OBJECT: 1.5}
REACH_OTHERS_M = 2.0
"""How far from where it should be an object is still the same: noise of its centre and its acceleration."""
UNKNOWN_MPS = {AgentKind.PEDESTRIAN: 2.5, AgentKind.OBJECT: 5.0}
UNKNOWN_OTHERS_MPS = 20.0
"""And more, per second, after a first sample, whose velocity is not known."""
OTHER_KIND_M = 1.0
"""An object of another kind counts as so much farther away: labels flicker."""
LOST_S = 1.0
"""Who was not seen for longer is not waited for."""
OTHER_SIZE_M, OTHER_SIZE = 0.5, 0.25
"""An outline is another object's if its size differs by more than both, m and as a share of the larger one."""
MEMORY = 5
"""Samples over which the velocity is taken."""
_FAR = 1e6


@dataclass
class _Known:
    """Objects so far: name, kind, and their last samples."""

    name: list[int] = field(default_factory=list)
    kind: list[AgentKind] = field(default_factory=list)
    past: list[list[tuple[float, float, float]]] = field(default_factory=list)
    size: list[FloatArray] = field(default_factory=list)


def joined(
    frame: IntArray, t: FloatArray, x: FloatArray, y: FloatArray, kinds: Sequence[AgentKind], sizes: FloatArray
) -> IntArray:
    """Names `(m,)`, numbered by first appearance, of samples in frames `(m,)`, rising, at times `t` `(m,)`, s.

    `sizes` `(m, 2)`: length and width of outlines, NaN of what has a box.
    """
    names = np.empty(len(frame), np.int64)
    known, count = _Known(), 0
    for part in np.split(np.arange(len(frame)), np.flatnonzero(np.diff(frame)) + 1):
        if not len(part):
            continue
        now = float(t[part[0]])
        known = _kept(known, now)
        found = _assigned(known, now, x[part], y[part], [kinds[i] for i in part], sizes[part])
        for i, k in zip(part, found, strict=True):
            if k < 0:
                k, count = len(known.name), count + 1
                known.name.append(count)
                known.kind.append(kinds[i])
                known.past.append([])
                known.size.append(sizes[i])
            names[i] = known.name[k]
            known.kind[k] = kinds[i]
            known.past[k] = [*known.past[k][1 - MEMORY :], (now, float(x[i]), float(y[i]))]
    return names


def _kept(known: _Known, now: float) -> _Known:
    stay = [k for k, past in enumerate(known.past) if now - past[-1][0] <= LOST_S]
    return _Known(
        [known.name[k] for k in stay],
        [known.kind[k] for k in stay],
        [known.past[k] for k in stay],
        [known.size[k] for k in stay],
    )


def _assigned(
    known: _Known, now: float, x: FloatArray, y: FloatArray, kinds: list[AgentKind], sizes: FloatArray
) -> list[int]:
    """Which known object each of a frame's is; -1: none."""
    out = [-1] * len(x)
    if not known.name:
        return out
    where = np.array([_expected(past, now) for past in known.past])
    reach = np.array(
        [
            REACH_M.get(kind, REACH_OTHERS_M)
            + (0.0 if len(past) > 1 else UNKNOWN_MPS.get(kind, UNKNOWN_OTHERS_MPS) * (now - past[-1][0]))
            for kind, past in zip(known.kind, known.past, strict=True)
        ]
    )
    away = np.hypot(where[:, 0, None] - x, where[:, 1, None] - y)
    near = np.nonzero(away <= reach[:, None])
    other = codes_of(tuple(known.kind))[near[0]] != codes_of(tuple(kinds))[near[1]]
    alike = _alike(np.sort(np.array(known.size))[near[0]], np.sort(sizes)[near[1]])
    cost = np.full(away.shape, _FAR)
    cost[near] = np.where(alike, away[near] + OTHER_KIND_M * other, _FAR)
    for k, i in zip(*linear_sum_assignment(cost), strict=True):
        if cost[k, i] < _FAR:
            out[i] = int(k)
    return out


def _alike(a: FloatArray, b: FloatArray) -> BoolArray:
    """Whether sizes `(..., 2)` may be those of one object; unknown ones may."""
    apart = np.abs(a - b)
    return np.asarray(~((apart > OTHER_SIZE_M) & (apart > OTHER_SIZE * np.maximum(a, b))).any(axis=-1), np.bool_)


def _expected(past: list[tuple[float, float, float]], now: float) -> tuple[float, float]:
    """Where an object should be: its last place, carried on with the velocity over its last samples."""
    (t0, x0, y0), (t1, x1, y1) = past[0], past[-1]
    if t1 <= t0:
        return x1, y1
    ahead = (now - t1) / (t1 - t0)
    return x1 + ahead * (x1 - x0), y1 + ahead * (y1 - y0)
