"""Judges each plan over its horizon, as NAVSIM judges a proposal: for 4 s, among the others as they
moved.

The plan of the frame at t_i is sampled at t_i + 0, 0.1, ..., 4 s (t_ik), as far as it reaches and
evidence exists: in closed loop until the drive ends, in open loop until the log ends. The others do
not react to the plan, and a plan may have to change when a road user does something unexpected.
Gates therefore bound shares of the drive's time.

(1) plan_collision = least t_ik - t_i with a contact at fault: first touch of each agent,
        fault in the order of `safety`
(2) plan_off_road = max over k of off_k - off_0,
        off_k the greatest distance of the four corners to the drivable lanes
(3) plan_ttc = min over k of the time to contact (`shapes.time_to_contact`), 0 where (1) is known
(4) plan_comfort = max over k and q of q / bound(q), the six signals of `comfort.NUPLAN_BOUNDS`,
        differenced over 0.1 s
(5) plan_progress = s / max(s, d); 1 where max(s, d) <= 5 m.
        s is the planned distance and d the distance that was then driven (in open loop: by the
        log's driver), until the last k that both have
(6) plan_kept = max over k of |p_ik - p(t_ik)|, closed loop:
        distance from the ego's later positions; plan_kept_lateral: of its component across the
        ego's heading. Measured at frames with max(s, d) > 5 m after which the drive lasts 3 s, the
        length of the shortest complete plan
(7) plan_score = contact x drivable x (5 ttc + 5 progress + 2 comfort + 2 extended_comfort) / 14
    contact is 0 with (1), 1/2 for an object; drivable: (2) <= 0.3 m; ttc: (3) > 0.95 s; comfort:
        (4) <= 1;
    extended_comfort: that of `plans` <= 1. A part without a value is left out with its weight.

(7) is made after the EPDMS of NAVSIM 0a380a90, and is not comparable with it: a plan is judged by
its own columns, and its progress by what was driven. `replan score` computes EPDMS.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import cos, hypot, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.frame import PLAN_HORIZON_S
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import (
    NO_TTC_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    contact_time,
    distance_bound,
    indices_of,
    is_behind,
    labels_of,
    present_between,
    some_at,
    touches,
)
from replan.metrics.collisions import ACTIVE_FRONT, LATERAL, STOPPED_TRACK, contact_kind
from replan.metrics.comfort import NUPLAN_BOUNDS
from replan.metrics.lanes import keeps_lane
from replan.metrics.metric import BOTH_LOOPS, Measured, Series, Unavailable, metric
from replan.metrics.off_road import OFF_ROAD_M, box_off_lanes, known_lanes
from replan.metrics.plans import (
    NO_PLANS,
    SHORT_M,
    STEP_S,
    extended_comfort,
    frame_times,
    plan_columns,
    plan_way,
    times_after,
)
from replan.metrics.reductions import HAVING, MAX, MEAN, MIN, P95, share_beyond, share_while
from replan.metrics.time_to_collision import CLOSE_S

HORIZON_S, TTC_HORIZON_S = 4.0, 3.0
STEPS = round(HORIZON_S / STEP_S)
PIECE = 500  # Plans that are sampled at a time: 1 MB per column
PLAN_COLUMNS = ("x", "y", "yaw", "v", "a", "kappa")
Rows = Mapping[str, NDArray[Any]]


@once
def _measure_plans(trace: Trace, scenario: Scenario) -> Rows:
    """Return `judged` of the plans, and the values for (6), `(f,)` each."""
    drive = followed_drive(trace, scenario)
    by_piece, all_times = [], times_after(trace, 0, STEPS)
    for frames in np.split(np.arange(len(all_times)), range(PIECE, len(all_times), PIECE)):
        times = all_times[frames]
        plan = plan_columns(trace, times, PLAN_COLUMNS, frames)
        by_piece.append(
            {**judged(times, plan, trace, scenario), **_distances_kept(times, plan, drive)}
        )
    return {name: np.concatenate([piece[name] for piece in by_piece]) for name in by_piece[0]}


def followed_drive(trace: Trace, scenario: Scenario) -> Trajectory:
    """Return the drive that follows the plans: in open loop that of the log, if it has one."""
    return trace.ego if trace.mode is Mode.CLOSED or len(scenario.ego) < 2 else scenario.ego


def judged(times: FloatArray, plan: FloatArray, trace: Trace, scenario: Scenario) -> Rows:
    """Return the values for (1) to (5) of trajectories, `(r,)` each; NaN where one has none, -1 for
    no agent.

    Args:
        times: `(r, k)` s, at multiples of `STEP_S` from each trajectory's frame on.
        plan: `PLAN_COLUMNS` of the trajectories at these times, `(6, r, k)`; NaN beyond their ends.
        trace: The drive.
        scenario: What was driven in.
    """
    drive, lanes = followed_drive(trace, scenario), known_lanes(scenario)
    witnessed = np.where(times <= drive.t[-1] + 1e-6, plan, np.nan)
    off = np.full(times.shape, np.nan if isinstance(lanes, Unavailable) else 0.0)  # (2)
    if not isinstance(lanes, Unavailable):
        covered = np.isfinite(witnessed[0])
        x, y, yaw = witnessed[:3, covered]
        ahead = scenario.vehicle.axle_to_center
        box = np.stack([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw])
        off[covered] = box_off_lanes(lanes, box, scenario.vehicle, np.inf)
    planned, driven = _ways(times, witnessed, drive)
    best = np.maximum(planned, driven)
    return {
        "off": off.max(axis=1) - off[:, 0],
        **_comfort_signals(plan),
        "progress": np.where(best > SHORT_M, planned / np.maximum(best, SHORT_M), 1.0),
        **_contacts_and_ttc(times, witnessed, trace.agents, scenario),
    }


def _ways(times: FloatArray, plan: FloatArray, drive: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return the distances planned and driven, `(r,)` each, m, until the last time that both
    have.
    """
    x, y = (np.interp(times, drive.t, column) for column in (drive.x, drive.y))
    dx = plan[0] - x
    planned, driven = (
        np.fmax.reduce(length + 0.0 * dx, axis=1)
        for length in (plan_way(plan[0], plan[1]), plan_way(x, y))
    )
    return planned, driven


def _distances_kept(times: FloatArray, plan: FloatArray, drive: Trajectory) -> Rows:
    """Return the values for (6), `(f,)` each."""
    witnessed = np.where(times <= drive.t[-1] + 1e-6, plan, np.nan)
    x, y, yaw = (np.interp(times, drive.t, column) for column in (drive.x, drive.y, drive.yaw))
    dx, dy = witnessed[0] - x, witnessed[1] - y
    best = np.maximum(*_ways(times, witnessed, drive))
    aside = np.abs(dy * np.cos(yaw) - dx * np.sin(yaw))
    lasting = (best > SHORT_M) & (times[:, 0] + PLAN_HORIZON_S <= drive.t[-1] + 1e-6)
    deviation, lateral = (
        np.where(lasting, np.fmax.reduce(d, axis=1), np.nan) for d in (np.hypot(dx, dy), aside)
    )
    return {"kept": deviation, "kept_lateral": lateral}


def _comfort_signals(plan: FloatArray) -> Rows:
    """Return the largest absolute planned accelerations and jerk, and (4) with the index of its
    signal, `(f,)` each.
    """
    _, _, yaw, v, a, kappa = plan
    aside, c, s = v**2 * kappa, np.cos(yaw), np.sin(yaw)
    jerk = np.hypot(np.diff(a * c - aside * s), np.diff(a * s + aside * c))
    yaw_rate = np.diff(yaw) / STEP_S
    signals = (a, aside, np.diff(a) / STEP_S, jerk / STEP_S, yaw_rate, np.diff(yaw_rate) / STEP_S)
    ratio = []
    for signal, (_, low, high) in zip(signals, NUPLAN_BOUNDS.values(), strict=True):
        ratio.append(np.fmax.reduce(np.where(signal < 0.0, signal / low, signal / high), axis=1))
    largest = [np.fmax.reduce(np.abs(signal), axis=1) for signal in signals[:3]]
    return {
        "lon_accel": largest[0],
        "lat_accel": largest[1],
        "lon_jerk": largest[2],
        "comfort": np.fmax.reduce(ratio),
        "signal": np.argmax(np.nan_to_num(ratio), axis=0),
    }


def _contacts_and_ttc(
    times: FloatArray, plan: FloatArray, agents: Tracks, scenario: Scenario
) -> Rows:
    """Return (1) and (3), each with its agent."""
    grid_ns, column = np.unique(np.rint(times * 1e9).astype(np.int64), return_inverse=True)
    seen = present_between(agents, grid_ns[0] / 1e9, grid_ns[-1] / 1e9)
    others, car = some_at(agents, seen, grid_ns / 1e9), car_of(scenario)
    objects = np.array([agents.kinds[i] is AgentKind.OBJECT for i in seen.tolist()], np.bool_)
    step, hit, ttc, near = _meet_agents(plan, column.reshape(times.shape), car, others, objects)
    for f in np.flatnonzero((step[1] >= 0) & ((step[0] < 0) | (step[1] < step[0]))).tolist():
        x, y, yaw = plan[:3, f, step[1, f]]
        x, y = x + car.axle * np.cos(yaw), y + car.axle * np.sin(yaw)
        if not keeps_lane(
            scenario.road, float(x), float(y), corners(x, y, yaw, car.length, car.width)
        ):
            step[0, f], hit[0, f] = step[1, f], hit[1, f]
    at_fault = step[0] >= 0
    return {
        "contact": np.where(at_fault, STEP_S * step[0], np.nan),
        "contact_agent": indices_of(seen, hit[0]),
        "ttc": np.where(at_fault, 0.0, ttc),
        "ttc_agent": indices_of(seen, np.where(at_fault, hit[0], near)),
    }


@kernel
def _meet_agents(
    plan: FloatArray, column: IntArray, car: EgoOutline, others: OtherBoxes, objects: BoolArray
) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """Return per plan the first contact at fault (row 0) and the first with the side (row 1): step,
    agent `(2, f)`.

    And the least time to contact below `TTC_HORIZON_S` and its agent; -1 and NaN where there is
    none. `column` `(f, k)` is the step of the others at the plans' steps.
    """
    frames, present, pose = column.shape[0], others.there, others.pose
    step, hit = np.full((2, frames), -1), np.full((2, frames), -1)
    ttc, near = np.full(frames, np.nan), np.full(frames, -1)
    for f in range(frames):
        best = TTC_HORIZON_S
        for i in range(len(present)):
            for j in range(column.shape[1]):
                k, yaw, v = column[f, j], plan[2, f, j], plan[3, f, j]
                rear_x, rear_y = plan[0, f, j], plan[1, f, j]
                if not np.isfinite(rear_x):
                    break
                if not present[i, k]:
                    continue
                c, s, turn = cos(yaw), sin(yaw), car.axle * plan[5, f, j] * v
                x, y = rear_x + car.axle * c, rear_y + car.axle * s
                vx, vy = v * c - turn * s, v * s + turn * c
                gap = distance_bound(x, y, car, others, i, k)
                closing = hypot(pose[3, i, k] - vx, pose[4, i, k] - vy)
                if gap > closing * best:
                    continue
                if gap <= 0.0 and touches(x, y, yaw, car, others, i, k):
                    before = column[f, max(j - 1, 0)]
                    if j > 0 and present[i, before]:
                        previous, size = pose[:, i, before], others.size[i]
                        kind = contact_kind(
                            plan[:4, f, j], car, previous, pose[:, i, k], size, objects[i]
                        )
                        row = 0 if kind in (STOPPED_TRACK, ACTIVE_FRONT) else 1
                        if (row == 0 or kind == LATERAL) and (step[row, f] < 0 or j < step[row, f]):
                            step[row, f], hit[row, f] = j, i
                    break
                if abs(v) <= NO_TTC_MPS or is_behind(
                    rear_x, rear_y, yaw, pose[0, i, k], pose[1, i, k]
                ):
                    continue
                contact_s = contact_time((x, y, yaw, vx, vy), 0.0, car, others, i, k, 0.0)
                if contact_s < best:
                    best, ttc[f], near[f] = contact_s, contact_s, i
    return step, hit, ttc, near


_plan_metric = partial(
    metric,
    modes=BOTH_LOOPS,
    parameters=(f"horizon {HORIZON_S:g} s", f"step {STEP_S:g} s"),
    needs="plans",
    source="after NAVSIM 0a380a90, pdm_scorer",
)


def _series(
    name: str,
    trace: Trace,
    scenario: Scenario,
    *,
    about: str = "",
    missing: str = "no plan has a second state",
    followed: bool = True,
) -> Measured:
    """Return a row of `_measure_plans` as a series; `followed`: it needs the drive after the
    frames.
    """
    if followed and trace.mode is Mode.OPEN and len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to plan along")
    if not trace.frames:
        return NO_PLANS
    rows = _measure_plans(trace, scenario)
    labels = labels_of(trace, rows[about]) if about else ()
    return Series(frame_times(trace), rows[name], labels, missing)


@_plan_metric(unit="s", better="higher", reductions=(HAVING, MIN), version=2)
def plan_collision(trace: Trace, scenario: Scenario) -> Measured:
    """Time until a plan has a contact at fault with a road user as it then moved; fault as in
    collision_at_fault.

    Formula: least t - t_i with a contact at fault
    """
    missing = f"no plan has a contact at fault within {HORIZON_S:g} s"
    return _series("contact", trace, scenario, about="contact_agent", missing=missing)


@_plan_metric(
    unit="m",
    better="lower",
    reductions=(MAX, share_beyond(OFF_ROAD_M, "share_beyond_30cm")),
    needs="plans, lanes in the log",
)
def plan_off_road(trace: Trace, scenario: Scenario) -> Measured:
    """How much farther off the drivable lanes than at its start a plan leads.

    Formula: max over t of off(t) - off(t_i), off the greatest distance of a corner to the lanes
    """
    lanes = known_lanes(scenario)
    if isinstance(lanes, Unavailable):
        return lanes
    return _series("off", trace, scenario, followed=False)


def _is_close(ttc: FloatArray) -> BoolArray:
    return ttc <= CLOSE_S


@_plan_metric(
    unit="s", better="higher", reductions=(MIN, share_while(_is_close, "share_below_950ms"))
)
def plan_ttc(trace: Trace, scenario: Scenario) -> Measured:
    """Least time to contact along a plan, straight on; 0 where the plan has a contact at fault.

    Formula: min over t of the time to contact at constant velocity vectors
    """
    missing = "no plan is on a course to touch anyone"
    return _series("ttc", trace, scenario, about="ttc_agent", missing=missing)


@_plan_metric(unit="1", better="lower", reductions=(MEAN, P95, share_beyond(1.0, "share_above_1")))
def plan_comfort(trace: Trace, scenario: Scenario) -> Measured:
    """The worst of nuPlan's six comfort signals of a plan, over its bound.

    Formula: max over t and q of q / bound(q)
    """
    if not trace.frames:
        return NO_PLANS
    rows, names = _measure_plans(trace, scenario), tuple(NUPLAN_BOUNDS)
    labels = tuple(names[signal] for signal in rows["signal"].tolist())
    return Series(frame_times(trace), rows["comfort"], labels)


@_plan_metric(unit="1", better="higher", reductions=(MEAN, MIN))
def plan_progress(trace: Trace, scenario: Scenario) -> Measured:
    """Planned distance over the greater of planned and then driven distance.

    Formula: s / max(s, d); 1 up to 5 m
    """
    return _series("progress", trace, scenario)


_kept_metric = partial(
    _plan_metric,
    unit="m",
    better="lower",
    modes=(Mode.CLOSED,),
    needs=f"a plan that leads, or is followed by, more than {SHORT_M:g} m within {HORIZON_S:g} s, "
    f"and a drive that goes on for {PLAN_HORIZON_S:g} s after it",
)
_NOT_DRIVEN = f"no plan of more than {SHORT_M:g} m is followed by {PLAN_HORIZON_S:g} s of driving"


@_kept_metric(reductions=(MEAN, P95, MAX, share_beyond(5.0, "share_beyond_5m")))
def plan_kept(trace: Trace, scenario: Scenario) -> Measured:
    """Greatest distance of a plan's states from where the ego then was.

    Formula: max over t of |p_i(t) - p(t)|
    """
    return _series("kept", trace, scenario, missing=_NOT_DRIVEN)


@_kept_metric(reductions=(MEAN, P95, MAX, share_beyond(2.0, "share_beyond_2m")))
def plan_kept_lateral(trace: Trace, scenario: Scenario) -> Measured:
    """Greatest lateral distance of a plan's states from where the ego then was.

    Formula: max over t of |p_i(t) - p(t)| across the ego's heading
    """
    return _series("kept_lateral", trace, scenario, missing=_NOT_DRIVEN)


@_plan_metric(unit="1", better="higher", reductions=(MEAN, MIN))
def plan_score(trace: Trace, scenario: Scenario) -> Measured:
    """A score of each plan's own columns, made after NAVSIM's EPDMS; EPDMS itself: replan score.

    Formula: contact x drivable x (5 ttc + 5 progress + 2 comfort + 2 extended_comfort) / 14
    """
    lacking = _series("ttc", trace, scenario)
    if isinstance(lacking, Unavailable):
        return lacking
    rows, t = _measure_plans(trace, scenario), times_after(trace, 0, 0)[:, 0]
    steady = np.full(len(t), np.nan)
    extended = extended_comfort(trace, scenario)
    if isinstance(extended, Series):
        steady[np.isin(t, extended.t)] = np.where(extended.known, extended.value <= 1.0, np.nan)
    return Series(t, scored(rows, trace, steady))


def scored(rows: Rows, trace: Trace, steady: FloatArray) -> FloatArray:
    """Return (7) of trajectories `(r,)` by their values of `judged`; `steady` `(r,)`: 1 and 0 for
    extended comfort, NaN where there is none.
    """
    objects = np.array([kind is AgentKind.OBJECT for kind in trace.agents.kinds] + [False])
    contact = np.where(objects[rows["contact_agent"]], 0.5, 0.0)
    multiplier = np.where(np.isnan(rows["contact"]), 1.0, contact)
    multiplier = np.where(rows["off"] > OFF_ROAD_M, 0.0, multiplier)
    parts = np.array(
        [~(rows["ttc"] <= CLOSE_S), rows["progress"], rows["comfort"] <= 1.0, steady],
        np.float64,
    )
    weights = np.where(np.isfinite(parts), np.array([[5.0], [5.0], [2.0], [2.0]]), 0.0)
    mean = (weights * np.nan_to_num(parts)).sum(axis=0) / weights.sum(axis=0)
    return np.asarray(multiplier * mean)


_largest_metric = partial(_plan_metric, better="lower", reductions=(MEAN, P95, MAX), version=2)


@_largest_metric(unit="m/s2")
def plan_lon_accel(trace: Trace, scenario: Scenario) -> Measured:
    """Largest planned acceleration or braking.

    Formula: max |a|
    """
    return _series("lon_accel", trace, scenario, followed=False)


@_largest_metric(unit="m/s2")
def plan_lat_accel(trace: Trace, scenario: Scenario) -> Measured:
    """Largest planned lateral acceleration.

    Formula: max |v^2 kappa|
    """
    return _series("lat_accel", trace, scenario, followed=False)


@_largest_metric(unit="m/s3")
def plan_lon_jerk(trace: Trace, scenario: Scenario) -> Measured:
    """Largest planned longitudinal jerk, over 0.1 s.

    Formula: max |a(t) - a(t - W)| / W
    """
    return _series("lon_jerk", trace, scenario, followed=False)
