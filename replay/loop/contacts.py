"""Contacts of the ego's box with the boxes of other road users, at the rows of a trace."""

from __future__ import annotations

from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.shapes import overlap
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.metrics.boxes import Phantom
from replan.replay.vehicle.state_records import STEP, Records, write_ego
from replan.replay.world import ROUNDING_M, World


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
    absent = [
        (place[phantom.agent], phantom.t_from, phantom.t_to)
        for phantom in left_out
        if phantom.agent in place
    ]
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
    rows = np.zeros(1, STEP)
    write_ego(rows, 0, world.ego)
    return touched(rows, 0, 1, ego_box(vehicle), agent_boxes(world.tracks, left_out))[1]


@kernel
def touched(
    rows: Records, first: int, end: int, car: EgoBox, agents: AgentBoxes
) -> tuple[int, int]:
    """Return the first row of a trace from `first` to before `end` with a touch of an agent, and
    its index.

    Returns row `end` and agent -1 if there is no touch; of several agents at one row, the first.
    """
    own, first_agent = hypot(car.length, car.width), -1
    egos, beyond = rows[first:end]["ego"], abs(car.ahead) + ROUNDING_M
    for i in range(len(agents.offsets) - 1):
        near = 0.5 * (own + hypot(agents.length[i], agents.width[i])) + ROUNDING_M
        if first < end and not _comes_near(egos, agents, i, near + beyond):
            continue
        for r in range(first, end):
            ego = rows[r].ego
            is_present, x, y, yaw = agent_at(agents, i, ego.t)
            if not is_present:
                continue
            ex, ey = ego.x + car.ahead * cos(ego.yaw), ego.y + car.ahead * sin(ego.yaw)
            if (x - ex) ** 2 + (y - ey) ** 2 <= near * near and overlap(
                ex,
                ey,
                ego.yaw,
                car.length,
                car.width,
                x,
                y,
                yaw,
                agents.length[i],
                agents.width[i],
            ):
                end, first_agent = r, i
                break
    return end, first_agent


@inner_kernel
def _comes_near(egos: Records, agents: AgentBoxes, i: int, reach: float) -> bool:
    """Return whether agent i comes within `reach` m of the ego's places, in x and in y, around
    their times.
    """
    t, first, end = agents.t, agents.offsets[i], agents.offsets[i + 1]
    k, last = first, first
    if not agents.static[i]:
        k = max(first + np.searchsorted(t[first:end], egos[0].t + 1e-9, side="right") - 1, first)
        last = k
        while last < end - 1 and t[last] < egos[-1].t + 1e-9:
            last += 1
    x, y = agents.x[k : last + 1], agents.y[k : last + 1]
    own_x, own_y = egos["x"], egos["y"]
    aside = own_x.min() > x.max() + reach or own_x.max() < x.min() - reach
    return not (aside or own_y.min() > y.max() + reach or own_y.max() < y.min() - reach)


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
