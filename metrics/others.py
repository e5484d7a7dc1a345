"""The other road users on a time grid, as they moved: ground truth for the safety metrics.

The same as `Tracks.truth` at each time of the grid, in one kernel. The ego's and the others' boxes are arrays over
(agent, time); an agent that is not in the scene at a time has `there` False and NaN columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.scenario import Scenario, Tracks
from logs.states import Trajectory


@dataclass(frozen=True, eq=False, slots=True)
class Others:
    """Road users over a grid of k times.

    Attributes:
        there: `(n, k)` whether the agent is in the scene.
        pose: `(5, n, k)`: x, y (box centre, m), yaw (rad), vx, vy (m/s); NaN where not there.
        size: `(n, 2)` length and width, m.
    """

    there: BoolArray
    pose: FloatArray
    size: FloatArray


def others_at(tracks: Tracks, t: FloatArray) -> Others:
    """The agents at the increasing times `t` `(k,)`, interpolated as `Tracks.truth` does."""
    columns = np.stack([tracks.x, tracks.y, tracks.yaw, tracks.vx, tracks.vy])
    there, pose = _on_grid(tracks.offsets, tracks.static, tracks.t, columns, t)
    return Others(there, pose, np.column_stack([tracks.length, tracks.width]))


def name_of(tracks: Tracks, index: int) -> str:
    """Kind and id of a track: "car 12"."""
    return f"{tracks.kinds[index].value} {tracks.ids[index]}"


def ego_boxes(ego: Trajectory, scenario: Scenario) -> FloatArray:
    """The ego's box centre and velocity vector `(5, k)`: x, y, yaw, vx, vy; rear axle moved to the centre."""
    ahead = scenario.vehicle.axle_to_center
    c, s = np.cos(ego.yaw), np.sin(ego.yaw)
    return np.stack([ego.x + ahead * c, ego.y + ahead * s, ego.yaw, ego.v * c, ego.v * s])


@kernel
def _velocity(t: FloatArray, x: FloatArray, v: FloatArray, first: int, at: int) -> float:
    """Logged, else the backward difference, else 0."""
    if np.isfinite(v[at]):
        return float(v[at])
    return (x[at] - x[at - 1]) / (t[at] - t[at - 1]) if at > first else 0.0


@kernel
def _on_grid(
    offsets: IntArray, static: BoolArray, t: FloatArray, columns: FloatArray, times: FloatArray
) -> tuple[BoolArray, FloatArray]:
    n, k = len(offsets) - 1, len(times)
    there, out = np.zeros((n, k), np.bool_), np.full((5, n, k), np.nan)
    for i in range(n):
        first, last = offsets[i], offsets[i + 1] - 1
        at = first
        for j in range(k):
            if static[i]:
                there[i, j] = True
                for c in range(3):
                    out[c, i, j] = columns[c, first]
                out[3, i, j], out[4, i, j] = 0.0, 0.0
                continue
            if t[first] > times[j] + 1e-9 or t[last] < times[j] - 1e-9:
                continue
            while at < last and t[at + 1] <= times[j] + 1e-9:
                at += 1
            there[i, j] = True
            span = t[at + 1] - t[at] if at < last else 0.0
            u = min(max((times[j] - t[at]) / span, 0.0), 1.0) if span > 0.0 else 0.0
            for c in range(3):
                step = columns[c, at + 1] - columns[c, at] if span > 0.0 else 0.0
                out[c, i, j] = columns[c, at] + u * step
                if c < 2:
                    out[3 + c, i, j] = (
                        step / span if span > 0.0 else _velocity(t, columns[c], columns[3 + c], first, at)
                    )
    return there, out
