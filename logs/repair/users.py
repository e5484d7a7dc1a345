"""What a piece of motion is: kind, size and front by votes; a road user's boxes over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from logs.agents import AgentKind
from logs.kernel import BoolArray, FloatArray, IntArray
from logs.repair.groups import GROUPS, PERSON, VEHICLE, Boxes
from logs.repair.pieces import Piece, centre
from logs.states import Trajectory

FAR_M = 20.0
"""A vote from there counts half as much as one from close by."""
RIDES_MPS, RIDES_M = 3.3, 8.0
"""A "pedestrian" with a faster median speed over more than this is a rider: joggers run 2.5 to 3 m/s."""
REVERSE_MPS = 4.0
"""No vehicle drives backwards faster."""
HEADINGS_AGREE = 0.9
"""Fewer of a slow vehicle's headings leave open which of its ends is the front: it is where it goes."""
YAW_S, YAW_OFF = 0.4, 0.6
"""Headings are averaged over this; one farther from where the vehicle goes does not count, rad."""
_KINDS = tuple(AgentKind)


@dataclass(frozen=True, eq=False)
class User:
    """A road user over the frames `(k,)` in which it is there.

    Attributes:
        piece: Its detections and motion as smoothed.
        kind: What it is; `label` what most detections call it.
        length: m; `width` likewise.
        t: s; x, y, yaw of the box, vx, vy.
        turned: How many detections had their front at the other end.
        extended: Whether a sample is before the first or after the last detection `(k,)`.
    """

    piece: Piece
    kind: AgentKind
    label: AgentKind
    length: float
    width: float
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    turned: int
    extended: BoolArray

    @cached_property
    def poses(self) -> FloatArray:
        """Boxes `(k, 5)`: x, y, yaw, length, width."""
        n = len(self.t)
        return np.column_stack([self.x, self.y, self.yaw, np.full(n, self.length), np.full(n, self.width)])

    def at(self, rows: IntArray) -> User:
        """The same at some of its samples; one may stand several times: but for its time it is the same there."""
        columns = {name: getattr(self, name)[rows] for name in ("t", "x", "y", "yaw", "vx", "vy", "extended")}
        return replace(self, **columns)


def user_of(piece: Piece, boxes: Boxes, ego: Trajectory) -> User:
    """The road user that a piece of motion shows; votes count by score and by distance from the ego."""
    rows = piece.rows
    far = np.hypot(
        boxes.x[rows] - np.interp(boxes.t[rows], ego.t, ego.x), boxes.y[rows] - np.interp(boxes.t[rows], ego.t, ego.y)
    )
    weight = boxes.weight[rows] / (1.0 + (far / FAR_M) ** 2)
    own = np.where(boxes.group[rows] == piece.group, weight, 0.0)
    code = int(np.bincount(boxes.codes[rows], own).argmax())
    same = np.where(boxes.codes[rows] == code, weight, 0.0)
    length, width = (_middle(values[rows], same) for values in (boxes.length, boxes.width))
    path = piece.standing()
    if piece.still:
        path = np.zeros_like(path)
        path[:, :2] = centre(piece.z[piece.seen], weight)
    yaw, turned = _headings(piece, path, boxes.yaw[rows], weight)
    label = _KINDS[code]
    speed = np.median(np.hypot(path[:, 2], path[:, 3]))
    rides = label is AgentKind.PEDESTRIAN and piece.net > RIDES_M and speed > RIDES_MPS
    return User(
        piece, AgentKind.BICYCLE if rides else label, label, length, width, piece.t, path[:, 0], path[:, 1], yaw,
        path[:, 2], path[:, 3], turned, np.zeros(len(piece.t), np.bool_),
    )  # fmt: skip


def _middle(values: FloatArray, weight: FloatArray) -> float:
    """The weighted median."""
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(values[order[half]])


def _headings(piece: Piece, path: FloatArray, yaw: FloatArray, weight: FloatArray) -> tuple[FloatArray, int]:
    """The heading at each time `(k,)`, and how many of the detected ones `yaw` have front and back exchanged.

    The axis is that of the boxes, the front where it goes, or, of what never goes anywhere, where most headings are.
    A person's heading is where they go, as their boxes say little (16 to 33 degrees).
    """
    speed = np.hypot(path[:, 2], path[:, 3])
    fast = np.flatnonzero(speed > GROUPS[piece.group].fast)
    middle = 0.5 * np.angle(np.sum(weight * np.exp(2j * yaw)))
    if not len(fast):
        front = middle if np.sum(weight * np.cos(yaw - middle)) >= 0.0 else middle + np.pi
        return np.full(len(path), front), int((np.cos(yaw - front) < 0.0).sum())
    course = np.arctan2(path[fast, 3], path[fast, 2])
    nearest = np.abs(np.arange(len(path))[:, None] - fast).argmin(axis=1)
    goes = np.unwrap(course)[nearest]
    if piece.group == PERSON:
        return goes, 0
    axis = np.unwrap(goes, period=np.pi)  # one end of the box throughout, though it may go back and forth
    if piece.group != VEHICLE:
        axis = np.full(len(path), middle)
    ahead = np.cos(axis[fast] - goes[fast]).sum() >= 0.0
    agree = float(np.average(np.cos(yaw - axis[piece.seen]) >= 0.0, weights=weight))
    if speed.max() < REVERSE_MPS and max(agree, 1.0 - agree) >= HEADINGS_AGREE:
        ahead = agree >= 0.5
    if not ahead:
        axis = axis + np.pi
    turned = int((np.cos(yaw - axis[piece.seen]) < 0.0).sum())
    off = yaw - axis[piece.seen]
    off -= np.pi * np.round(off / np.pi)
    counts = weight * (np.abs(off) < YAW_OFF) if piece.group == VEHICLE else weight
    near = np.exp(-0.5 * ((piece.t[:, None] - piece.t[piece.seen]) / YAW_S) ** 2) * counts
    share = near.sum(axis=1)
    # the offsets from the axis are averaged about the detections' own axis, as both turn in a curve
    measured = axis[piece.seen] + off - axis[:, None]
    mean = np.divide((near * measured).sum(axis=1), share, out=np.zeros(len(path)), where=share > 1e-9)
    return axis + mean, turned
