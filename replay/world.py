"""The world as it is now: the ego, and the others with where they have been."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan, cos, sin

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.scenario import Tracks
from logs.shapes import overlap
from logs.states import EgoState, Trajectory
from logs.vehicle import VehicleParameters
from metrics.phantoms import Phantom
from planners.constant_speed import arc


@dataclass(frozen=True, slots=True)
class World:
    """Ego and others at the instant `ego.t`; `tracks` may reach beyond it (`Traffic.step`)."""

    ego: EgoState
    tracks: Tracks


def box_center(ego: EgoState, vehicle: VehicleParameters) -> tuple[float, float]:
    """Centre of the ego's box, world, m."""
    ahead = vehicle.axle_to_center
    return ego.x + ahead * cos(ego.yaw), ego.y + ahead * sin(ego.yaw)


def logged_ego(log: Trajectory, vehicle: VehicleParameters, t: float) -> EgoState:
    """The ego as known at `t`: the log's last sample not later, carried on at its speed and curvature.

    Later samples do not go in. Steering and yaw rate follow from the curvature, as a kinematic bicycle has them.
    """
    index = max(int(np.searchsorted(log.t, t + 1e-6, side="right")) - 1, 0)
    state = log.state(index)
    if abs(t - state.t) > 1e-6:
        state = replace(arc(state, np.array([t])).state(0), a=state.a)
    return replace(state, t=t, steer=atan(vehicle.wheelbase * state.kappa), yaw_rate=state.v * state.kappa)


def contact(world: World, vehicle: VehicleParameters, left_out: tuple[Phantom, ...] = ()) -> int:
    """Index into `world.tracks` of the first agent whose box touches the ego's, as they truly are; -1: none.

    Who is one of the phantoms `left_out` at that time does not count.
    """
    tracks, ego = world.tracks, world.ego
    if not len(tracks):
        return -1
    counts = np.ones(len(tracks), np.bool_)
    for phantom in left_out:
        if phantom.agent in tracks.ids:
            counts[tracks.ids.index(phantom.agent)] &= not phantom.t_from < ego.t < phantom.t_to
    x, y = box_center(ego, vehicle)
    return _first_contact(
        counts, tracks.offsets, tracks.static, tracks.t, tracks.gap_after, tracks.x, tracks.y, tracks.yaw,
        tracks.length, tracks.width, ego.t, x, y, ego.yaw, vehicle.length, vehicle.width,
    )  # fmt: skip


@kernel
def _first_contact(
    counts: BoolArray, offsets: IntArray, static: BoolArray, t: FloatArray, gap_after: BoolArray, xs: FloatArray,
    ys: FloatArray, yaws: FloatArray, lengths: FloatArray, widths: FloatArray,
    now: float, x: float, y: float, yaw: float, length: float, width: float,
) -> int:  # fmt: skip
    """The first track that counts whose box, where `Tracks.truth(now)` has it, overlaps the given one."""
    for i in range(len(offsets) - 1):
        first, end = offsets[i], offsets[i + 1]
        k, u = first, 0.0
        if not counts[i]:
            continue
        if not static[i]:
            k = first + np.searchsorted(t[first:end], now + 1e-9, side="right") - 1
            if k < first or t[end - 1] < now - 1e-9:
                continue
            if gap_after[k] and now > t[k] + 1e-9:
                continue
            if k + 1 < end:
                u = min(max((now - t[k]) / (t[k + 1] - t[k]), 0.0), 1.0)
        j = min(k + 1, end - 1) if u > 0.0 else k
        ax, ay = xs[k] + u * (xs[j] - xs[k]), ys[k] + u * (ys[j] - ys[k])
        if overlap(x, y, yaw, length, width, ax, ay, yaws[k] + u * (yaws[j] - yaws[k]), lengths[i], widths[i]):
            return i
    return -1
