"""A causal tracker: makes road users for planners from raw detections, without later frames (a filter, no smoother).

Detections are joined frame by frame with the same association and filter as in the offline repair (`association`);
the state at t depends only on the frames up to t.

(1) a track is reported once it has the evidence that its group requires (`BIRTH_TIME`, `BIRTH_COUNT`, `BIRTH_SCORE`),
    until it was not seen for `KEEP_STILL_S` (standing), `KEEP_S` (moving), or `KEEP_YOUNG_S` (moving, with at most
    `FEW` detections)
(2) it stands if a line fitted to its detections of the last `WINDOW_S` has a speed below `SLOW`, and the filter's speed
    is below `FILTER_SLOW` times that: over shorter times, the drift of boxes looks like motion
(3) kind, length and width: votes of its detections, by score; axis of the box: averaged with `YAW_MEMORY`; front: the
    direction of motion, or of most headings
(4) between frames, and while it is not seen, it is extrapolated with its velocity, whose deviation grows
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from logs.agents import NUMBERS, OLDEST_S, AgentKind, Agents
from logs.arrays import FloatArray, frozen
from logs.repair.association import ACROSS, ALONG, VX, VY, Association, X, Y
from logs.repair.detected_boxes import CLUSTER, DENSITY, FAST, NOISE, PERSON, SLIDES, SLOW, Boxes, stronger_twins

BIRTH_TIME, BIRTH_COUNT, BIRTH_SCORE = frozen([0.15, 0.15, 0.8]), frozen([3, 3, 6]), frozen([1.2, 1.2, 0.0])
"""Evidence (1) by group: time s, detections, sum of scores; later births give
fewer ghosts (tests/support/track_score.py)."""
KEEP_STILL_S, KEEP_S, KEEP_YOUNG_S, FEW = 2.0, 0.8, 0.35, 10
WINDOW_S, WINDOW_LEAST_S, FILTER_SLOW = 1.5, 0.8, 2.5
YAW_MEMORY = 0.8
"""Share of the old heading that remains with each new detection."""
_KINDS = tuple(AgentKind)


@dataclass
class _Track:
    """Data of one track besides its filter; `late`: it was first seen after the first frame."""

    first: float
    late: bool
    yaw: float
    fronts: float = 0.0
    score: float = 0.0
    count: int = 0
    votes: FloatArray = field(default_factory=lambda: np.zeros(len(_KINDS)))
    size: FloatArray = field(default_factory=lambda: np.zeros((len(_KINDS), 2)))
    window: deque[tuple[float, float, float]] = field(default_factory=deque)

    def see(self, boxes: Boxes, i: int) -> None:  # (3)
        weight, code, t = float(boxes.weight[i]), int(boxes.codes[i]), float(boxes.t[i])
        self.count += 1
        self.score += weight
        self.votes[code] += weight
        self.size[code] += weight * np.array([boxes.length[i], boxes.width[i]])
        off = float(boxes.yaw[i]) - self.yaw
        half = np.pi * round(off / np.pi)
        self.fronts += weight * np.cos(half)
        self.yaw += (1.0 - YAW_MEMORY) * (off - half)
        self.window.append((t, float(boxes.x[i]), float(boxes.y[i])))
        while t - self.window[0][0] > WINDOW_S + 1e-9:
            self.window.popleft()

    def front(self, group: int, vx: float, vy: float) -> float:  # (3)
        ahead = self.fronts
        if np.hypot(vx, vy) > FAST[group]:
            if group == PERSON:
                return float(np.arctan2(vy, vx))
            ahead = np.cos(self.yaw) * vx + np.sin(self.yaw) * vy
            self.fronts += ahead
        return self.yaw if ahead >= 0.0 else self.yaw + np.pi

    def stands(self, group: int, speed: float, length: float) -> bool:  # (2)
        slow = max(SLOW[group], SLIDES * length / WINDOW_S) if group == CLUSTER else SLOW[group]
        t, x, y = np.array(self.window).T
        if t[-1] - t[0] < WINDOW_LEAST_S or speed > FILTER_SLOW * slow:
            return False
        t = t - t.mean()
        return bool(np.hypot(t @ x, t @ y) < slow * (t @ t))


@dataclass(frozen=True, eq=False)
class Tracked:
    """The road users known after each frame: `agents[k]` at `frames[k]` s, not extrapolated.

    `growth[k]` `(n,)`: growth rate of the variance of their velocities, m2/s3; `patience[k]` `(n,)`: time for which
    they are reported without a detection, s.
    """

    frames: tuple[float, ...]
    agents: tuple[Agents, ...]
    growth: tuple[FloatArray, ...]
    patience: tuple[FloatArray, ...]

    def at(self, t: float) -> Agents:
        """Return the road users as known at t, s: those of the last frame not later than t, extrapolated (4)."""
        k = bisect_right(self.frames, t + 1e-9) - 1
        if k < 0:
            return _agents([], [], [])
        known, since = self.agents[k], max(t - self.frames[k], 0.0)
        carried = replace(
            known, x=known.x + since * known.vx, y=known.y + since * known.vy, unseen=known.unseen + since,
            age=np.minimum(known.age + since, OLDEST_S),
            velocity_sigma=np.sqrt(known.velocity_sigma**2 + since * self.growth[k]),
        )  # fmt: skip
        return carried.some(np.flatnonzero(carried.unseen <= self.patience[k] + 1e-9))


def tracked(every: Boxes, frames: FloatArray) -> Tracked:
    """Track detected boxes: return the road users known after each of the `frames`, s, without later frames."""
    boxes = every.taken(np.flatnonzero(stronger_twins(every) < 0))
    joining, tracks, out = Association(), dict[int, _Track](), []
    for t, rows, names in joining.steps(boxes, frames):
        for name, i in zip(names.tolist(), range(rows.start, rows.stop), strict=True):
            if name not in tracks:
                tracks[name] = _Track(t, t > frames[0], float(boxes.yaw[i]))
            tracks[name].see(boxes, i)
        tracks = {name: tracks[name] for name in joining.tracks["name"].tolist()}
        ids, codes, columns, growth, patience = [], [], [], [], []  # of the tracks reported at t (1)
        for (name, track), row in zip(tracks.items(), joining.tracks, strict=True):
            state, group = row["state"], int(row["group"])
            early = t - track.first < BIRTH_TIME[group] - 1e-9
            if early or track.count < BIRTH_COUNT[group] or track.score < BIRTH_SCORE[group]:
                continue
            code = int(track.votes.argmax())
            length, width = (track.size[code] / track.votes[code]).tolist()
            vx, vy = float(state[VX]), float(state[VY])
            sigma, most = float(np.sqrt(0.5 * (state[ALONG + 2] + state[ACROSS + 2]))), KEEP_S
            if track.stands(group, float(np.hypot(vx, vy)), length):
                vx, vy, sigma, most = 0.0, 0.0, float(NOISE[group]) / WINDOW_S, KEEP_STILL_S
            elif track.count <= FEW:
                most = KEEP_YOUNG_S
            unseen = t - float(row["last"])
            if unseen > most + 1e-9:
                continue
            age = min(t - track.first, OLDEST_S) if track.late else np.nan
            pose = state[X], state[Y], track.front(group, vx, vy)
            ids.append(str(name + 1))
            codes.append(code)
            columns.append((length, width, *pose, vx, vy, 0.0, 0.0, age, unseen, sigma))
            growth.append(float(DENSITY[group]))
            patience.append(most)
        out.append((_agents(ids, codes, columns), np.array(growth), np.array(patience)))
    agents, growths, patiences = zip(*out, strict=True) if out else ((), (), ())
    return Tracked(tuple(frames.tolist()), agents, growths, patiences)


def _agents(ids: Sequence[str], codes: Sequence[int], columns: Sequence[tuple[float, ...]]) -> Agents:
    numbers = np.array(columns).reshape(-1, len(NUMBERS)).T
    return Agents.of_rows(tuple(ids), tuple(_KINDS[code] for code in codes), numbers, frozen(codes, np.int64))
