"""Records: one declaration of a state for Python, for compiled kernels and for the rows of a trace.

A record is an element of a NumPy array whose fields have names (`numpy.record`). Python and
kernels read a field as `record.v` and write it in place, and arrays of records go into kernels and
come out at no cost. Its type follows from the annotations of a class, so that a kernel that reads
an `EgoState` takes the data class's fields, whether they come from a vehicle or from a trace.

A trace has one row per control step, which kernels and recorder share: the ego's motion and the
actuation at its time, what is commanded from then on, and the deviation from the plan that is
driven then.
"""

from __future__ import annotations

from math import nan
from operator import attrgetter
from typing import Any, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray

from replan.core.kernel import inner_kernel
from replan.logs.states import TRAJECTORY_COLUMNS, Command, EgoState, Trajectory
from replan.replay.vehicle.plan_path import Deviation

T = TypeVar("T")
Records = NDArray[Any]
"""`(n,)` records of one type."""
Plain = tuple[Any, ...]
"""Named tuples as plain ones: a named one costs a microsecond each time that it goes into a kernel
or comes out.
"""
Motion = tuple[float, float, float, float, float, float, float, float, float, float]
"""The fields of `EgoState`, in their order."""


def plain(named: Any) -> Any:
    """Named tuples, also nested ones, as plain tuples; any other value as it is."""
    return tuple(plain(item) for item in named) if isinstance(named, tuple) else named


def record_type(kind: type) -> np.dtype[Any]:
    """The annotated fields of a class as a type of records: numbers, and classes of such fields."""
    fields = [
        (name, hint if hint in (float, int, bool) else record_type(hint))
        for name, hint in get_type_hints(kind).items()
    ]
    return np.dtype((np.record, fields))


def initial_values(kind: type) -> tuple[Any, ...]:
    """The values that a class gives to its fields, as a tuple for a record."""
    return tuple(
        getattr(kind, name) if hasattr(kind, name) else initial_values(hint)
        for name, hint in get_type_hints(kind).items()
    )


def new_records(kind: type) -> Records:
    """`(1,)`: a record with the values that a class gives to its fields."""
    return np.array([initial_values(kind)], record_type(kind))


def new_record(kind: type[T]) -> T:
    """The record of `new_records`."""
    record: T = new_records(kind)[0]
    return record


class Step:
    """A row of a trace, as a record."""

    ego: EgoState
    command: Command
    actuation: Command
    deviation: Deviation


EGO, STEP = record_type(EgoState), record_type(Step)
_ego_values = attrgetter(*EGO.names or ())
_command_values = attrgetter(*STEP["command"].names or ())


def ego_record(state: EgoState) -> EgoState:
    """A state as a record, which kernels take."""
    record: EgoState = np.array([_ego_values(state)], EGO)[0]
    return record


def write_ego(rows: Records, k: int, state: EgoState) -> None:
    """Write the motion of row k."""
    rows["ego"][k] = _ego_values(state)


def write_state(rows: Records, k: int, state: EgoState, actuation: Command) -> None:
    """Write motion and actuation of row k; command and deviation there are not known yet: NaN."""
    rows[k] = (_ego_values(state), (nan,) * 3, _command_values(actuation), (nan,) * 5)


def state_at(rows: Records, k: int) -> EgoState:
    """The ego at row k."""
    return EgoState(*rows["ego"].item(k))


def trajectory_of(egos: Records) -> Trajectory:
    """The trajectory of records of the ego."""
    return Trajectory(*(egos[name] for name in TRAJECTORY_COLUMNS))


@inner_kernel
def write_motion(row: Any, motion: Motion, steer: float, throttle: float, brake: float) -> None:
    """Write motion and actuation of a row."""
    ego, actuation = row.ego, row.actuation
    ego.t, ego.x, ego.y, ego.yaw, ego.v, ego.a, ego.kappa, ego.steer, ego.yaw_rate, ego.v_lat = (
        motion
    )
    actuation.steer, actuation.throttle, actuation.brake = steer, throttle, brake


@inner_kernel
def write_command(
    row: Any, steer: float, throttle: float, brake: float, deviation: Deviation
) -> None:
    """Write command and deviation of a row."""
    command, off = row.command, row.deviation
    command.steer, command.throttle, command.brake = steer, throttle, brake
    off.lateral, off.heading, off.speed, off.station, off.foot = deviation
