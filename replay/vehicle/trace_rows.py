"""The rows of a trace, one per control step, as kernels and recorder share them.

A row's columns are the ego's motion and the actuation at its time, what is commanded from then on, and the errors
against the plan that is driven then.
"""

from __future__ import annotations

from math import nan

from logs.kernel import FloatArray, inner_kernel, kernel
from logs.states import Command, EgoState
from replay.vehicle.base import Motion, motion_of
from replay.vehicle.plan_path import Deviation, deviation

MOTION, COMMAND, ACTUATION, ERRORS = slice(0, 10), slice(10, 13), slice(13, 16), slice(16, 20)
"""Columns of a row: `Motion`; steer, throttle, brake twice; lateral, heading, speed, station (`Deviation`)."""
COLUMNS = 20


@inner_kernel
def motion_at(rows: FloatArray, k: int) -> Motion:
    """The ego's motion at row k."""
    row = rows[k]
    return Motion(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9])


@inner_kernel
def arrived(row: FloatArray, now: Motion, steer: float, throttle: float, brake: float) -> None:
    """Write motion and actuation."""
    row[0], row[1], row[2], row[3], row[4] = now.t, now.x, now.y, now.yaw, now.v
    row[5], row[6], row[7], row[8], row[9] = now.a, now.kappa, now.steer, now.yaw_rate, now.v_lat
    row[13], row[14], row[15] = steer, throttle, brake


@inner_kernel
def commanded(row: FloatArray, steer: float, throttle: float, brake: float, off: Deviation) -> None:
    """Write command and errors."""
    row[10], row[11], row[12] = steer, throttle, brake
    row[16], row[17], row[18], row[19] = off.lateral, off.heading, off.speed, off.station


@kernel
def compared(times: FloatArray, knots: FloatArray, rows: FloatArray, k: int) -> None:
    """Write the errors of row k against a plan (`PlanPath`)."""
    row = rows[k]
    off = deviation(times, knots, row[0], row[1], row[2], row[3], row[4])
    row[16], row[17], row[18], row[19] = off.lateral, off.heading, off.speed, off.station


def write_state(rows: FloatArray, k: int, state: EgoState, actuation: Command) -> None:
    """Write motion and actuation of row k; what is commanded there is not known yet."""
    does = actuation.steer, actuation.throttle, actuation.brake
    rows[k] = (*motion_of(state), nan, nan, nan, *does, nan, nan, nan, nan)


def state_at(rows: FloatArray, k: int) -> EgoState:
    """The ego at row k."""
    return EgoState(*rows[k, MOTION].tolist())
