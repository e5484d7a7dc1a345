"""The state of the world: the ego, and the tracks of the other road users."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan

import numpy as np

from replan.logs.states import EgoState, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
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
