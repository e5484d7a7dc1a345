"""Road users as a detector sees them: a model of raw detections with parameters measured on 13 city
drives.

Measured (SFA and cluster detectors of Autoware Mini at 10 Hz): range, share of detected frames by
distance, lengths of gaps, jitter and slow drift of centres, sizes, headings, reversed fronts,
flicker of kinds, twins, ids that are positions in a list. Clutter, lasting ghosts and scores are
assumed. Road users hidden behind a vehicle are missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.agents import USUAL_SIZE_M, AgentKind, among, codes_of
from replan.logs.repair.detections import Detections
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

STEP_S = 0.1
AHEAD_M, ASIDE_M = 50.0, 25.0
FAR_M, SEEN = (0.0, 10.0, 20.0, 30.0, 40.0, 90.0), (0.95, 0.93, 0.89, 0.82, 0.76, 0.69)
"""Distances, m, and the share of frames in which a road user is detected at each."""
SHORT_GAPS, SHORT_END, LONG_END = 0.75, 0.6, 0.12
"""Three of four gaps end with probability 0.6 per frame, the others with 0.12: half last one frame,
1 % over 26.
"""
DRIFT_KEPT = 0.95
"""Share of the drift that remains after a frame."""
FLIPS, FLICKER, TWINS = 0.18, 0.02, 0.05
"""Shares of boxes: vehicles with reversed fronts, vehicles of a wrong kind, second boxes of one
object.
"""
CLUTTER, CLUTTER_END = 1.0, 0.6
"""Mean number of false boxes that begin in a frame, and the probability that one ends with a
frame.
"""
GHOST_EVERY_S, GHOST_S, GHOST_SEEN = 10.0, (1.0, 3.0), 0.4
"""Lasting ghosts: mean interval and range of durations, s, and share of detected frames."""
LEAST_SCORE = 0.2
_CODES = {kind: int(code) for kind, code in zip(AgentKind, codes_of(tuple(AgentKind)), strict=True)}
_VEHICLES = among(AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS)
_CLUSTERS = among(AgentKind.OBJECT)
_FALSE = AgentKind.CAR, AgentKind.PEDESTRIAN


@dataclass(frozen=True, eq=False)
class Sight:
    """Road users within a detector's range, flat, `(m,)` each, in order of time: their true
    states.
    """

    frames: FloatArray  # `(k,)` s; `frame` is the index of a frame, `agent` that of a track
    frame: IntArray
    agent: IntArray
    x: FloatArray  # m; `y` likewise, `yaw` rad, `vx` and `vy` m/s
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    far: FloatArray  # distance from the ego's rear axle, m
    hidden: BoolArray  # whether a vehicle is between


def sight(tracks: Tracks, ego: Trajectory) -> Sight:
    """The road users within range of the ego, every `STEP_S` of its drive."""
    frames = np.round(np.arange(ego.t[0], ego.t[-1] + 1e-6, STEP_S), 6)
    row_of = {name: i for i, name in enumerate(tracks.ids)}
    parts = []
    for k, t in enumerate(frames.tolist()):
        own, agents = ego.at(t), tracks.truth(t)
        dx, dy = agents.x - own.x, agents.y - own.y
        ahead, aside = (
            dx * np.cos(own.yaw) + dy * np.sin(own.yaw),
            dy * np.cos(own.yaw) - dx * np.sin(own.yaw),
        )
        near = np.flatnonzero((np.abs(ahead) <= AHEAD_M) & (np.abs(aside) <= ASIDE_M))
        agent_rows = np.array([row_of[agents.ids[i]] for i in near], np.int64)
        boxes = np.column_stack([agents.x, agents.y, agents.yaw, agents.length, agents.width])[near]
        hidden = _hidden(own.x, own.y, boxes, _VEHICLES[agents.codes[near]])
        columns = (
            np.full(len(near), k),
            agent_rows,
            boxes[:, :3],
            agents.vx[near],
            agents.vy[near],
            np.hypot(dx, dy)[near],
        )
        parts.append(np.column_stack([*columns, hidden]))
    rows = np.vstack(parts)
    x, y, yaw, vx, vy, far = rows[:, 2:8].T
    frame, agent = rows[:, :2].T.astype(np.int64)
    return Sight(frames, frame, agent, x, y, yaw, vx, vy, far, rows[:, 8] > 0.5)


@kernel
def _hidden(x: float, y: float, boxes: FloatArray, opaque: BoolArray) -> BoolArray:
    """Whether an opaque box crosses the line from (x, y) to the centre of each of the boxes
    `(k, 5)`.
    """
    hidden = np.zeros(len(boxes), np.bool_)
    for i in range(len(boxes)):
        dx, dy = boxes[i, 0] - x, boxes[i, 1] - y
        far, angle = hypot(dx, dy), atan2(dy, dx)
        middle_x, middle_y = 0.5 * (boxes[i, 0] + x), 0.5 * (boxes[i, 1] + y)
        for j in range(len(boxes)):
            bx, by, yaw, length, width = boxes[j]
            if j != i and opaque[j] and hypot(bx - x, by - y) < far:
                crossed = overlap(middle_x, middle_y, angle, far, 0.1, bx, by, yaw, length, width)
                hidden[i] = hidden[i] or crossed
    return hidden


def detected(tracks: Tracks, ego: Trajectory, seed: int) -> Detections:
    """The detections of these road users by a detector on the ego.

    Another seed gives another drive.
    """
    rng = np.random.default_rng(seed)
    visible = sight(tracks, ego)
    boxes = np.vstack(
        [np.empty((0, _WIDTH)), *(_of_agent(tracks, i, visible, rng) for i in range(len(tracks)))]
    )
    # Second boxes of some objects, with lower scores
    twins = boxes[rng.random(len(boxes)) < TWINS].copy()
    twins[:, 2:4] += rng.normal(0.0, 0.5, (len(twins), 2))
    twins[:, 7] = np.minimum(twins[:, 7], 0.25)
    false, count = [], len(visible.frames)
    # For a frame or a few
    for first in rng.integers(0, count, rng.poisson(CLUTTER * count)).tolist():
        last = min(first + int(rng.geometric(CLUTTER_END)), count)
        false.append(_nothing(np.arange(first, last), visible.frames, ego, 0.4, rng))
    # ghosts, for seconds
    for first in rng.integers(0, count, rng.poisson(STEP_S * count / GHOST_EVERY_S)).tolist():
        last = min(first + round(rng.uniform(*GHOST_S) / STEP_S), count)
        frames = first + np.flatnonzero(rng.random(last - first) < GHOST_SEEN)
        false.append(_nothing(frames, visible.frames, ego, 0.35, rng))
    rows = rng.permutation(np.vstack([boxes, twins, *false]))
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    frame, codes = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
    places = np.arange(len(frame)) - np.searchsorted(frame, frame)
    nothing = np.full(len(frame), np.nan)
    return Detections(
        t=visible.frames[frame],
        frames=visible.frames,
        ids=tuple(map(str, places.tolist())),
        codes=codes,
        x=rows[:, 2],
        y=rows[:, 3],
        yaw=rows[:, 4],
        length=rows[:, 5],
        width=rows[:, 6],
        vx=nothing,
        vy=nothing,
        score=rows[:, 7],
    )


_WIDTH = 8
"""Columns of boxes: frame, code, x, y, yaw, length, width, score."""


def _of_agent(tracks: Tracks, i: int, visible: Sight, rng: np.random.Generator) -> FloatArray:
    """The boxes `(k, _WIDTH)` of one road user."""
    rows = np.flatnonzero(visible.agent == i)
    n, code = len(rows), int(tracks.codes[i])
    vehicle, cluster = bool(_VEHICLES[code]), bool(_CLUSTERS[code])
    along, across = (0.09, 0.06) if vehicle else (0.06, 0.06)
    drift = rng.normal(0.0, 0.22 if vehicle else 0.1, (n, 2))  # slow errors, m
    for k in range(1, n):
        drift[k] = DRIFT_KEPT * drift[k - 1] + np.sqrt(1.0 - DRIFT_KEPT**2) * drift[k]
    u, v = drift[:, 0] + rng.normal(0.0, along, n), 0.5 * drift[:, 1] + rng.normal(0.0, across, n)
    c, s = np.cos(visible.yaw[rows]), np.sin(visible.yaw[rows])
    yaw = visible.yaw[rows] + rng.normal(0.0, np.radians(3.5 if vehicle else 25.0), n)
    yaw += np.pi * (rng.random(n) < FLIPS)
    length = np.abs(tracks.length[i] + rng.normal(0.0, min(0.13, 0.1 * tracks.length[i]), n))
    width = np.abs(tracks.width[i] + rng.normal(0.0, 0.04, n))
    codes = np.full(n, code)
    flicker = vehicle & (rng.random(n) < FLICKER)
    codes[flicker] = rng.choice(
        [_CODES[AgentKind.TRUCK], _CODES[AgentKind.BUS]], int(flicker.sum())
    )
    score = np.clip(
        0.75 - 0.008 * visible.far[rows] - 0.1 * (not vehicle) + rng.normal(0.0, 0.12, n),
        LEAST_SCORE,
        0.9,
    )
    share = np.interp(visible.far[rows], FAR_M, SEEN)
    mean = SHORT_GAPS / SHORT_END + (1.0 - SHORT_GAPS) / LONG_END
    begins = (1.0 - share) / share / mean
    shown, end = np.ones(n, np.bool_), 0.0  # the gaps have the measured lengths
    for k in range(n):
        if end > 0.0 and rng.random() < end:
            end = 0.0
        elif end == 0.0 and rng.random() < begins[k]:
            end = SHORT_END if rng.random() < SHORT_GAPS else LONG_END
        shown[k] = end == 0.0
    boxes = np.column_stack(
        [
            visible.frame[rows],
            codes,
            visible.x[rows] + c * u - s * v,
            visible.y[rows] + s * u + c * v,
            yaw,
            length,
            width,
            np.full(n, np.nan) if cluster else score,
        ]
    )
    return boxes[shown & ~visible.hidden[rows]]


def _nothing(
    rows: IntArray, frames: FloatArray, ego: Trajectory, most: float, rng: np.random.Generator
) -> FloatArray:
    """Boxes `(k, _WIDTH)` of one false object at a random position in range in the first frame; 0.3
    m rms.
    """
    kind = _FALSE[rng.integers(len(_FALSE))]
    own = ego.at(float(frames[rows[0]])) if len(rows) else ego.state(0)
    ahead, aside, yaw = (
        rng.uniform(-10.0, AHEAD_M),
        rng.uniform(-ASIDE_M, ASIDE_M),
        rng.uniform(-np.pi, np.pi),
    )
    n, jitter = len(rows), rng.normal(0.0, 0.3, (len(rows), 2))
    x = own.x + ahead * np.cos(own.yaw) - aside * np.sin(own.yaw) + jitter[:, 0]
    y = own.y + ahead * np.sin(own.yaw) + aside * np.cos(own.yaw) + jitter[:, 1]
    length, width = USUAL_SIZE_M[kind]
    return np.column_stack(
        [
            rows,
            np.full(n, _CODES[kind]),
            x,
            y,
            yaw + rng.normal(0.0, 0.1, n),
            np.full(n, length),
            np.full(n, width),
            rng.uniform(LEAST_SCORE, most, n),
        ]
    )
