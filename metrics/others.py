"""The other road users on a time grid, as they moved: ground truth for the safety metrics.

As `Tracks.truth` at each time of the grid, in one kernel: logged positions, estimated velocities and accelerations
(`logs.motion`), and no agent is there in a gap of its track. Arrays over (agent, time) grow with the square of a long
drive, so metrics walk in pieces of time with those who are there (`pieces`), or over one agent after another (`each`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.scenario import Tracks
from logs.trace import Trace
from metrics.once import last

GRID_S = 0.1  # How often metrics look at a drive that do not look at each of its steps
MOST_CELLS = 1_000_000  # Agents by times that are in memory at once: 49 bytes each
PIECE_STEPS = 4096  # Of a piece of a longer drive, where no more than `MOST_CELLS` come of it


class Others(NamedTuple):
    """Road users over a grid of k times.

    Attributes:
        there: `(n, k)` whether the agent is in the scene.
        pose: `(5, n, k)`: x, y (box centre, m), yaw (rad), vx, vy (m/s); NaN where not there.
        accel: `(n, k)` rate of the speed, m/s2; NaN where not there.
        size: `(n, 2)` length and width, m.
    """

    there: BoolArray
    pose: FloatArray
    accel: FloatArray
    size: FloatArray


def others_at(tracks: Tracks, t: FloatArray) -> Others:
    """The agents at the increasing times `t` `(k,)`, interpolated as `Tracks.truth` does."""
    return _at(tracks, np.asarray(t, np.float64).tobytes())


@last(2)  # most ask at the steps of the drive, some every 0.1 s
def _at(tracks: Tracks, times: bytes) -> Others:
    return some_at(tracks, np.arange(len(tracks)), np.frombuffer(times))


def some_at(tracks: Tracks, agents: IntArray, t: FloatArray) -> Others:
    """`others_at` of the tracks `agents` `(n,)` alone."""
    lengths, moved = np.diff(tracks.offsets)[agents], tracks.motion
    offsets = np.r_[0, np.cumsum(lengths)]
    at = np.repeat(tracks.offsets[agents] - offsets[:-1], lengths) + np.arange(offsets[-1])
    columns = np.stack([some[at] for some in (tracks.x, tracks.y, tracks.yaw, moved.vx, moved.vy, moved.accel)])
    there, found = _on_grid(offsets, tracks.static[agents], tracks.t[at], tracks.gap_after[at], columns, t)
    return Others(there, found[:5], found[5], np.column_stack([tracks.length, tracks.width])[agents])


def pieces(tracks: Tracks, t: FloatArray) -> Iterator[tuple[slice, IntArray, Others]]:
    """Steps of the increasing times `t` `(k,)`, the tracks who are there then in their order, and `some_at` of both."""
    if len(tracks) * len(t) <= MOST_CELLS:
        yield slice(0, len(t)), np.arange(len(tracks)), others_at(tracks, t)
        return
    begin = 0
    while begin < len(t):
        end = min(begin + PIECE_STEPS, len(t))
        agents = there_between(tracks, t[begin], t[end - 1])
        while len(agents) * (end - begin) > MOST_CELLS and end - begin > 1:
            end = begin + (end - begin) // 2
            agents = there_between(tracks, t[begin], t[end - 1])
        yield slice(begin, end), agents, some_at(tracks, agents, t[begin:end])
        begin = end


def each(tracks: Tracks, t: FloatArray) -> Iterator[tuple[int, Others, int]]:
    """All tracks in their order, each with some at the increasing times `t` `(k,)` and its row among them."""
    count = max(MOST_CELLS // len(t), 1)
    for begin in range(0, len(tracks), count):
        agents = np.arange(begin, min(begin + count, len(tracks)))
        others = others_at(tracks, t) if len(agents) == len(tracks) else some_at(tracks, agents, t)
        yield from ((begin + row, others, row) for row in range(len(agents)))


def in_spans(tracks: Tracks, t: FloatArray) -> Iterator[tuple[int, slice, Others]]:
    """Each track that has a sample among the increasing times `t` `(k,)`: its steps from first to last, and it there.

    A static one is there at all of them.
    """
    begins, ends = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]
    low, high = np.searchsorted(t, begins - 1e-9), np.searchsorted(t, ends + 1e-9, side="right")
    low, high = np.where(tracks.static, 0, low), np.where(tracks.static, len(t), high)
    for i in np.flatnonzero(low < high).tolist():
        yield i, slice(low[i], high[i]), some_at(tracks, np.array([i]), t[low[i] : high[i]])


def nearest(
    tracks: Tracks, t: FloatArray, ask: Callable[[slice, Others], tuple[FloatArray, IntArray]]
) -> tuple[FloatArray, IntArray]:
    """What a kernel finds in each of the `pieces`: values `(..., k)`, and tracks `(k,)`, -1 where it names no row."""
    found = [(seen, *ask(steps, others)) for steps, seen, others in pieces(tracks, t)]
    agents = [named(seen, rows) for seen, _, rows in found]
    return np.concatenate([values for _, values, _ in found], axis=-1), np.concatenate(agents)


def named(agents: IntArray, rows: IntArray) -> IntArray:
    """The tracks of rows `(k,)` of a piece, -1 of row -1."""
    return np.append(agents, -1)[rows]


def there_between(tracks: Tracks, first: float, last: float) -> IntArray:
    """The tracks that have a sample before `last` and one after `first`, s, or are static, in their order."""
    spans = (tracks.t[tracks.offsets[:-1]] <= last + 1e-9) & (tracks.t[tracks.offsets[1:] - 1] >= first - 1e-9)
    return np.flatnonzero(spans | tracks.static)


def name_of(tracks: Tracks, index: int) -> str:
    """Kind and id of a track: "car 12"."""
    return f"{tracks.kinds[index].value} {tracks.ids[index]}"


def labels_of(trace: Trace, agents: IntArray) -> tuple[str, ...]:
    """The agents' names at each step `(k,)`, "" for -1."""
    names = (*(name_of(trace.agents, i) for i in range(len(trace.agents))), "")
    return tuple(names[i] for i in agents.tolist())


@kernel
def _on_grid(
    offsets: IntArray, static: BoolArray, t: FloatArray, gap_after: BoolArray, columns: FloatArray, times: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Who is there `(n, k)`, and the interpolated `columns` `(6, m)` as `(6, n, k)`, NaN where not."""
    n, k = len(offsets) - 1, len(times)
    there, out = np.zeros((n, k), np.bool_), np.full((len(columns), n, k), np.nan)
    for i in range(n):
        first, last = offsets[i], offsets[i + 1] - 1
        at = first
        for j in range(k):
            if not static[i]:
                if t[first] > times[j] + 1e-9 or t[last] < times[j] - 1e-9:
                    continue
                while at < last and t[at + 1] <= times[j] + 1e-9:
                    at += 1
                if gap_after[at] and times[j] > t[at] + 1e-9:
                    continue
            there[i, j] = True
            u = 0.0
            if at < last and not static[i]:
                u = min(max((times[j] - t[at]) / (t[at + 1] - t[at]), 0.0), 1.0)
            after = at + 1 if u > 0.0 else at
            for c in range(len(columns)):
                out[c, i, j] = columns[c, at] + u * (columns[c, after] - columns[c, at])
    return there, out
