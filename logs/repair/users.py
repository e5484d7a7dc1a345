"""What a piece of motion is: kind, size and front by votes; a road user's boxes over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from logs.agents import AgentKind
from logs.kernel import BoolArray, FloatArray
from logs.repair.boxes import FAST, PERSON, VEHICLE, Boxes
from logs.repair.pieces import Piece, centre
from logs.states import Trajectory

FAR_M = 20.0
"""A vote from there counts half as much as one from close by."""
RIDES_MPS, RIDES_M = 3.3, 8.0
"""A "pedestrian" with a faster median speed over more than this is a rider: joggers run 2.5 to 3 m/s."""
REVERSE_MPS, HEADINGS_AGREE = 4.0, 0.9
"""No vehicle drives backwards faster. Where fewer of a slow one's headings agree, its front is where it goes."""
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
        way: Rows t, s, x, y, yaw of the box, vx, vy `(6, k)`.
        turned: How many detections had their front at the other end.
        extended: Whether a sample is before the first or after the last detection `(k,)`.
    """

    piece: Piece
    kind: AgentKind
    label: AgentKind
    length: float
    width: float
    way: FloatArray
    turned: int
    extended: BoolArray

    @property
    def t(self) -> FloatArray:
        """Times, s."""
        return self.way[0]

    @cached_property
    def poses(self) -> FloatArray:
        """Boxes `(k, 5)`: x, y, yaw, length, width."""
        return np.column_stack([*self.way[1:4], *np.outer([self.length, self.width], np.ones(len(self.t)))])


def user_of(piece: Piece, boxes: Boxes, ego: Trajectory) -> User:
    """The road user that a piece of motion shows; votes count by score and by distance from the ego."""
    rows = piece.rows
    t, x, y, codes = boxes.t[rows], boxes.x[rows], boxes.y[rows], boxes.codes[rows]
    far = np.hypot(x - np.interp(t, ego.t, ego.x), y - np.interp(t, ego.t, ego.y))
    weight = boxes.weight[rows] / (1.0 + (far / FAR_M) ** 2)
    code = int(np.bincount(codes, np.where(boxes.group[rows] == piece.group, weight, 0.0)).argmax())
    sides = []
    for values in (boxes.length[rows], boxes.width[rows]):  # the weighted medians of those of this kind
        order, same = np.argsort(values), np.where(codes == code, weight, 0.0)
        sides.append(float(values[order[np.searchsorted(np.cumsum(same[order]), 0.5 * same.sum())]]))
    path = piece.standing()
    if piece.still:
        path = np.zeros_like(path)
        path[:, :2] = centre(piece.z[piece.seen], weight)
    yaw, turned = _headings(piece, path, boxes.yaw[rows], weight)
    label, speed = _KINDS[code], np.median(np.hypot(path[:, 2], path[:, 3]))
    rides = label is AgentKind.PEDESTRIAN and piece.net > RIDES_M and speed > RIDES_MPS
    way = np.array([piece.t, path[:, 0], path[:, 1], yaw, path[:, 2], path[:, 3]])
    kind = AgentKind.BICYCLE if rides else label
    return User(piece, kind, label, sides[0], sides[1], way, turned, np.zeros(len(piece.t), np.bool_))


def _headings(piece: Piece, path: FloatArray, yaw: FloatArray, weight: FloatArray) -> tuple[FloatArray, int]:
    """The heading at each time `(k,)`, and how many of the detected ones `yaw` have front and back exchanged.

    The axis is that of the boxes, the front where it goes, or, of what never goes anywhere, where most headings are.
    A person's heading is where they go, as their boxes say little (16 to 33 degrees).
    """
    speed = np.hypot(path[:, 2], path[:, 3])
    fast = np.flatnonzero(speed > FAST[piece.group])
    middle = 0.5 * np.angle(np.sum(weight * np.exp(2j * yaw)))
    if not len(fast):
        front = middle if np.sum(weight * np.cos(yaw - middle)) >= 0.0 else middle + np.pi
        return np.full(len(path), front), int((np.cos(yaw - front) < 0.0).sum())
    nearest = np.abs(np.arange(len(path))[:, None] - fast).argmin(axis=1)
    goes = np.unwrap(np.arctan2(path[fast, 3], path[fast, 2]))[nearest]
    if piece.group == PERSON:
        return goes, 0
    # one end of the box throughout, though it may go back and forth
    axis = np.unwrap(goes, period=np.pi) if piece.group == VEHICLE else np.full(len(path), middle)
    ahead = np.cos(axis[fast] - goes[fast]).sum() >= 0.0
    agree = float(np.average(np.cos(yaw - axis[piece.seen]) >= 0.0, weights=weight))
    if speed.max() < REVERSE_MPS and max(agree, 1.0 - agree) >= HEADINGS_AGREE:
        ahead = agree >= 0.5
    if not ahead:
        axis = axis + np.pi
    off = yaw - axis[piece.seen]
    turned = int((np.cos(off) < 0.0).sum())
    off -= np.pi * np.round(off / np.pi)
    counts = weight * (np.abs(off) < YAW_OFF) if piece.group == VEHICLE else weight
    near = np.exp(-0.5 * ((piece.t[:, None] - piece.t[piece.seen]) / YAW_S) ** 2) * counts
    share = near.sum(axis=1)
    # the offsets from the axis are averaged about the detections' own axis, as both turn in a curve
    measured = axis[piece.seen] + off - axis[:, None]
    mean = np.divide((near * measured).sum(axis=1), share, out=np.zeros(len(path)), where=share > 1e-9)
    return axis + mean, turned
