"""The state of the world: the ego, and the tracks of the other road users."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan, cos, hypot, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.shapes import overlap
from replan.logs.states import EgoState, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.metrics.boxes import Phantom
from replan.planners.constant_speed import arc

ROUNDING_M = 1e-6
"""Boxes whose centres are farther apart than half of their diagonals and this cannot touch."""


@dataclass(frozen=True, slots=True)
class World:
    """Ego and others at the instant `ego.t`; `tracks` may reach beyond it (`Traffic.step`)."""

    ego: EgoState
    tracks: Tracks


def box_center(ego: EgoState, vehicle: VehicleParameters) -> tuple[float, float]:
    """Centre of the ego's box, world, m."""
    return ego.ahead(vehicle.axle_to_center)


def logged_ego(log: Trajectory, vehicle: VehicleParameters, t: float) -> EgoState:
    """Return the ego as known at `t`: the log's last sample up to `t`, extrapolated at its speed
    and curvature.

    Later samples are not used. Steering and yaw rate follow from the curvature, as for a kinematic
    bicycle.
    """
    index = max(int(np.searchsorted(log.t, t + 1e-6, side="right")) - 1, 0)
    state = log.state(index)
    if abs(t - state.t) > 1e-6:
        state = replace(arc(state, np.array([t])).state(0), a=state.a)
    return replace(
        state, t=t, steer=atan(vehicle.wheelbase * state.kappa), yaw_rate=state.v * state.kappa
    )


class EgoBox(NamedTuple):
    """The ego's box: its centre `ahead` of the rear axle, length, width, m."""

    ahead: float
    length: float
    width: float


def ego_box(vehicle: VehicleParameters) -> EgoBox:
    """The box of a vehicle."""
    return EgoBox(float(vehicle.axle_to_center), float(vehicle.length), float(vehicle.width))


class AgentBoxes(NamedTuple):
    """`Tracks` for kernels, with the same ragged layout, and the times at which agents are absent.

    Attributes:
        offsets: As in `Tracks`, like all attributes but the last.
        static: Likewise.
        t: Likewise.
        gap_after: Likewise.
        x: Likewise.
        y: Likewise.
        yaw: Likewise.
        length: Likewise.
        width: Likewise.
        absent: `(k, 3)`: track, start and end of an absence, s.
    """

    offsets: IntArray
    static: BoolArray
    t: FloatArray
    gap_after: BoolArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    absent: FloatArray


def agent_boxes(tracks: Tracks, left_out: tuple[Phantom, ...] = ()) -> AgentBoxes:
    """Return the boxes of the tracks; the phantoms `left_out` are absent."""
    place = {agent: i for i, agent in enumerate(tracks.ids)} if left_out else {}
    absent = [(place[one.agent], one.t_from, one.t_to) for one in left_out if one.agent in place]
    return AgentBoxes(
        tracks.offsets,
        tracks.static,
        tracks.t,
        tracks.gap_after,
        tracks.x,
        tracks.y,
        tracks.yaw,
        tracks.length,
        tracks.width,
        np.array(absent, float).reshape(-1, 3),
    )


def contact(world: World, vehicle: VehicleParameters, left_out: tuple[Phantom, ...] = ()) -> int:
    """Return the index of the first agent whose true box touches the ego's; -1: none.

    The phantoms `left_out` are ignored during their times.
    """
    ego = world.ego
    row = np.array([[ego.t, ego.x, ego.y, ego.yaw]])
    return touched(row, 0, 1, ego_box(vehicle), agent_boxes(world.tracks, left_out))[1]


@kernel
def touched(
    rows: FloatArray, first: int, end: int, car: EgoBox, agents: AgentBoxes
) -> tuple[int, int]:
    """Return the first row (t, x, y, yaw) from `first` to before `end` with a touch of an agent,
    and its index.

    Returns row `end` and agent -1 if there is no touch; of several agents at one row, the first.
    """
    own, who = hypot(car.length, car.width), -1
    ahead, at = rows[first:end], abs(car.ahead) + ROUNDING_M
    for i in range(len(agents.offsets) - 1):
        near = 0.5 * (own + hypot(agents.length[i], agents.width[i])) + ROUNDING_M
        if first < end and not _comes_near(ahead, agents, i, near + at):
            continue
        for r in range(first, end):
            there, x, y, yaw = agent_at(agents, i, rows[r, 0])
            if not there:
                continue
            ex, ey = (
                rows[r, 1] + car.ahead * cos(rows[r, 3]),
                rows[r, 2] + car.ahead * sin(rows[r, 3]),
            )
            if (x - ex) ** 2 + (y - ey) ** 2 <= near * near and overlap(
                ex,
                ey,
                rows[r, 3],
                car.length,
                car.width,
                x,
                y,
                yaw,
                agents.length[i],
                agents.width[i],
            ):
                end, who = r, i
                break
    return end, who


@inner_kernel
def _comes_near(rows: FloatArray, agents: AgentBoxes, i: int, reach: float) -> bool:
    """Return whether agent i comes within `reach` m of the rows, in x and in y, around the rows'
    times.
    """
    t, first, end = agents.t, agents.offsets[i], agents.offsets[i + 1]
    k, last = first, first
    if not agents.static[i]:
        k = max(first + np.searchsorted(t[first:end], rows[0, 0] + 1e-9, side="right") - 1, first)
        last = k
        while last < end - 1 and t[last] < rows[-1, 0] + 1e-9:
            last += 1
    x, y = agents.x[k : last + 1], agents.y[k : last + 1]
    aside = rows[:, 1].min() > x.max() + reach or rows[:, 1].max() < x.min() - reach
    return not (aside or rows[:, 2].min() > y.max() + reach or rows[:, 2].max() < y.min() - reach)


@inner_kernel
def agent_at(agents: AgentBoxes, i: int, now: float) -> tuple[bool, float, float, float]:
    """Return whether agent i is present at `now`, s, and x, y, yaw of its box, as `Tracks.truth`
    does.
    """
    t, first, end = agents.t, agents.offsets[i], agents.offsets[i + 1]
    k, u = first, 0.0
    if not agents.static[i]:
        k = first + np.searchsorted(t[first:end], now + 1e-9, side="right") - 1
        if k < first or t[end - 1] < now - 1e-9 or (agents.gap_after[k] and now > t[k] + 1e-9):
            return False, 0.0, 0.0, 0.0
        if k + 1 < end:
            u = min(max((now - t[k]) / (t[k + 1] - t[k]), 0.0), 1.0)
    for c in range(len(agents.absent)):
        if agents.absent[c, 0] == i and agents.absent[c, 1] < now < agents.absent[c, 2]:
            return False, 0.0, 0.0, 0.0
    j = min(k + 1, end - 1) if u > 0.0 else k
    x, y, yaw = agents.x, agents.y, agents.yaw
    return True, x[k] + u * (x[j] - x[k]), y[k] + u * (y[j] - y[k]), yaw[k] + u * (yaw[j] - yaw[k])
