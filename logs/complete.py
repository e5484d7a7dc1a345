"""Fills in what a log leaves out; each assumption is a sentence in the scenario's notes.

(1) a_k = (v_k - v_(k-1)) / (t_k - t_(k-1))
        a_0 = 0: a derived value never uses a later sample
(2) kappa_k = (yaw_k - yaw_(k-1)) / d,  d = +-|p_k - p_(k-1)|
        negative in reverse; below `MIN_STEP` the value before
(3) no road: one lane along the driven path, from 10 m behind the start. It follows the part that is
    driven forward (`replan.logs.forward`). A drive of less than `MIN_PATH` that stays within as
    much has no direction: the heading gives it
(4) no speed limit on lanes: the speed at the start rounded up to 10 km/h, at least
    `Road.default_speed_limit`. Later speeds are not used: otherwise the planner would know how fast
    the log's driver will be
(5) no lanes: `MARGIN` x the speed below which `SHARE` of the way was driven, rounded up to
    `STEP_MPS`; at least the speed at the start and `LEAST_MPS`; (4) for a drive of less than
    `MIN_PATH`. Real limits are set by the 85th percentile of the driven speeds, so the drive is an
    estimate where nothing else is known. One number reveals little of its course
(6) no lanes, but agents drive beside the driven path: the next lane's middle is one lane's width
    away. The lane's width is the median of their distances, within `WIDTHS_M`, if they are at least
    `LEAST_USERS`; else 3.5 m (`Road.along`). Used are vehicles, and clusters as wide as one, that
    are at `BESIDE_M` in `LEAST_SAMPLES` samples, faster than `DRIVES_MPS` and within `ALONG_RAD` of
    the path's direction
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from replan.core.arrays import TIE, FloatArray
from replan.core.errors import LogError
from replan.logs.ego_columns import speed_along, with_agreed_columns
from replan.logs.forward import described, forward_part, reversals
from replan.logs.polylines import thinned
from replan.logs.road import Road
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

MIN_STEP = 0.05
MIN_PATH = 5.0
LIMIT_STEP = 10.0 / 3.6
SHARE, MARGIN = 0.85, 1.1
STEP_MPS, LEAST_MPS = 5.0 / 3.6, 20.0 / 3.6
"""Constants of (5)."""
WIDTHS_M, BESIDE_M = (3.0, 4.0), (2.25, 5.5)
LEAST_USERS, LEAST_SAMPLES = 3, 5
DRIVES_MPS, ALONG_RAD, VEHICLE_M = 2.0, np.radians(20.0), 1.2
"""Constants of (6); a vehicle is at least `VEHICLE_M` wide."""
BEHIND = 10.0
ASSUMED = "as fast as at the start, at least 50 km/h"
NO_LANES = "The log has no lanes"
ONE_LANE, REVERSES = f"{NO_LANES}: one lane", f"{NO_LANES}, and reverses"
"""Begins of the notes on a lane (3)."""


def derived_speed(
    t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, notes: list[str]
) -> FloatArray:
    """Backward differences of the position along the heading `(n,)`, m/s, with a note.

    The first is the second.
    """
    notes.append(
        "The log has no ego speed: it is derived from the positions by backward differences."
    )
    return speed_along(t, x, y, yaw)


def derived_acceleration(t: FloatArray, v: FloatArray) -> FloatArray:
    """Backward differences (1) of the speed `(n,)`, m/s2."""
    return np.r_[0.0, np.diff(v) / np.diff(t)]


def derived_curvature(x: FloatArray, y: FloatArray, yaw: FloatArray, v: FloatArray) -> FloatArray:
    """Backward differences (2) of the heading over the way `(n,)`, 1/m."""
    steps_m = np.hypot(np.diff(x), np.diff(y)) * np.where(v[1:] < 0.0, -1.0, 1.0)
    turn = np.diff(np.unwrap(yaw))
    moved = np.abs(steps_m) >= MIN_STEP
    kappa = np.r_[0.0, np.divide(turn, steps_m, out=np.zeros(len(steps_m)), where=moved)]
    last_moved = np.maximum.accumulate(np.where(np.r_[True, moved], np.arange(len(x)), 0))
    return np.asarray(kappa[last_moved])


def completed(columns: dict[str, FloatArray], notes: list[str]) -> Trajectory:
    """The trajectory of columns t, x, y, yaw, v, a, kappa, as they agree
    (`replan.logs.ego_columns`); NaN in a and kappa is derived, with a note.
    """
    columns = with_agreed_columns(columns, notes)
    t, x, y, yaw, v = (columns[name] for name in ("t", "x", "y", "yaw", "v"))
    if np.isnan(v).all():
        v = derived_speed(t, x, y, yaw, notes)
    derived = {"a": derived_acceleration(t, v), "kappa": derived_curvature(x, y, yaw, v)}
    for name, word in (("a", "acceleration"), ("kappa", "curvature")):
        missing = np.isnan(columns[name])
        if missing.any():
            part = "" if missing.all() else f" at {missing.sum()} of {len(missing)} samples"
            notes.append(f"The log has no ego {word}{part}: it is derived by backward differences.")
        derived[name] = np.where(missing, derived[name], columns[name])
    return Trajectory(t, x, y, yaw, v, derived["a"], derived["kappa"])


def assumed_limit(ego: Trajectory) -> float:
    """The speed limit (4) of a log that has none, m/s."""
    steps = ceil(abs(float(ego.v[0])) / LIMIT_STEP - TIE)
    return max(Road.default_speed_limit, steps * LIMIT_STEP)


def with_limit(road: Road, ego: Trajectory, lanes: str, notes: list[str]) -> Road:
    """Return the road with the speed limit (4) for its `lanes` without one, which the note
    describes.
    """
    limit = assumed_limit(ego)
    notes.append(f"{lanes}: {limit:.1f} m/s is assumed ({ASSUMED}).")
    return replace(road, default_speed_limit=limit)


def driven_limit(ego: Trajectory) -> tuple[float, str]:
    """The speed limit (5) of a road that is known by one drive only, m/s, and the rule that sets
    it.
    """
    v = np.abs(ego.v)
    pace = 0.5 * (v[1:] + v[:-1])
    steps_m = pace * np.diff(ego.t)
    if steps_m.sum() < MIN_PATH:
        return assumed_limit(ego), f"{ASSUMED}, for less than {MIN_PATH:g} m of way"
    order = np.argsort(pace, kind="stable")
    row = np.searchsorted(np.cumsum(steps_m[order]), SHARE * steps_m.sum())
    usual = MARGIN * float(pace[order][row])
    limit = ceil(max(usual, float(v[0])) / STEP_MPS - TIE) * STEP_MPS
    if limit < LEAST_MPS:
        return (
            LEAST_MPS,
            f"the least that is assumed, as {SHARE:.0%} of the way was driven at "
            f"{usual / MARGIN:.1f} m/s",
        )
    rule = f"{MARGIN - 1.0:.0%} above what {SHARE:.0%} of the way was driven at"
    return limit, rule if usual >= v[0] else "the speed at the start"


def road_along(ego: Trajectory, notes: list[str], width: float = 3.5) -> Road:
    """The road of a log without lanes (3), `width` m wide, with its notes; LogError if no lane
    follows the path.
    """
    backward = reversals(ego)
    first, last = forward_part(ego, backward) or (0, 0)
    part = ego.taken(slice(first, last + 1)) if backward else ego
    path = np.column_stack([part.x, part.y])
    ahead = np.array([np.cos(part.yaw[0]), np.sin(part.yaw[0])])
    stands = bool(np.hypot(*(path - path[0]).T).max() < MIN_PATH) and way_driven(part) < MIN_PATH
    if stands:
        path = path[0] + np.array([[0.0], [MIN_PATH]]) * ahead
    path = np.vstack([path[0] - np.arange(BEHIND, 0.0, -2.0)[:, None] * ahead, path])
    limit, rule = driven_limit(part)
    course = "its heading, as it hardly moves" if stands else "the driven path"
    if backward and not last:
        course = "its heading, as it does not drive forward"
    notes.append(f"{ONE_LANE} along {course}. Its speed limit is assumed: {limit:.1f} m/s, {rule}.")
    if backward:
        unsigned = (
            " (at a speed that is not negative)"
            if min(ego.v[a:b].mean() for a, b in backward) > 0.0
            else ""
        )
        driven = (
            f"only the part from {part.t[0]:.1f} to {part.t[-1]:.1f} s has a lane and"
            if last
            else "no part"
        )
        notes.append(
            f"{REVERSES} from {described(ego, backward)}{unsigned}. Planners drive forward only: "
            f"{driven} is driven."
        )
    try:
        with np.errstate(all="ignore"):
            road = Road.along(path, width=width, speed_limit=limit)
            return replace(road, assumed_limits=frozenset(road.lanes))
    except ValueError as error:
        remedy = "give the log a road"
        raise LogError(
            f"no road can be made along the driven path: {error}", topic="/ego", remedy=remedy
        ) from None


def way_driven(ego: Trajectory) -> float:
    """The way that positions and speeds agree on, m: noise at rest adds steps to neither."""
    points = thinned(np.column_stack([ego.x, ego.y]), 1.0)
    speeds = 0.5 * (np.abs(ego.v[1:]) + np.abs(ego.v[:-1])) * np.diff(ego.t)
    return min(float(np.hypot(*np.diff(points, axis=0).T).sum()), float(speeds.sum()))


def passed_width(road: Road, tracks: Tracks, notes: list[str]) -> Road:
    """The road (3) with the width (6) of its lane, and its note.

    The same road if too few agents drive beside it.
    """
    from scipy.spatial import cKDTree  # here: reading a log with lanes starts without SciPy

    (lane,) = road.lanes.values()
    middle, across = 0.5 * (lane.left + lane.right), lane.left - lane.right
    across /= np.hypot(*across.T)[:, None]
    place, velocity = np.column_stack([tracks.x, tracks.y]), np.column_stack([tracks.vx, tracks.vy])
    to_middle, nearest = cKDTree(middle).query(place, distance_upper_bound=BESIDE_M[1] + 1.0)
    near = np.flatnonzero(np.isfinite(to_middle))
    stations = np.asarray(nearest)[near]
    normal, pace = across[stations], np.hypot(*velocity[near].T)
    offset = ((place[near] - middle[stations]) * normal).sum(axis=1)
    along = np.abs((velocity[near] * normal).sum(axis=1)) < np.sin(ALONG_RAD) * pace
    vehicle = (tracks.width >= VEHICLE_M) & ~np.array(
        [kind.is_vulnerable for kind in tracks.kinds], np.bool_
    )
    owners = tracks.owner[near]
    drives = along & (pace > DRIVES_MPS) & vehicle[owners]
    distances = [
        abs(np.median(offset[drives & (owners == i)]))
        for i in np.unique(owners[drives])
        if np.count_nonzero(drives & (owners == i)) >= LEAST_SAMPLES
    ]
    beside = [distance for distance in distances if BESIDE_M[0] < distance < BESIDE_M[1]]
    if len(beside) < LEAST_USERS:
        return road
    width = float(np.clip(np.median(beside), *WIDTHS_M))
    notes.append(
        f"{NO_LANES}: the one lane's width is assumed: {width:.2f} m, as {len(beside)} road users "
        f"drive beside it at {np.median(beside):.2f} m (median)."
    )
    lane = replace(lane, left=middle + 0.5 * width * across, right=middle - 0.5 * width * across)
    return replace(road, lanes={lane.id: lane})
