"""Cuts a part of a scenario by time, and rounds times to whole nanoseconds.

The begin of a part becomes t = 0, and data outside are left out. The ego's first and last state are
interpolated at the begin and end; its states from `HISTORY_S` before the begin on are its past.
Tracks keep the samples from `HISTORY_S` before the begin, which show who is present and how they
move, to the first after the end, if that is at most `HISTORY_S` later. Lights keep their colour at
that time, and its changes since then. Detections are kept from `DETECTED_S` before the begin, which
is longer than the memory of a tracker. A lane along the driven path is made anew from the states of
the part.

Native MCAP holds whole nanoseconds. Every scenario has such times, so that a log and its conversion
are the same bit for bit:

(1) t -> rint(1e9 t) / 1e9,   t in s since the scenario's start; at most half a nanosecond away
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import inf
from typing import TypeVar

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import LogError
from replan.logs.complete import ONE_LANE, REVERSES, road_along
from replan.logs.observed import clipped
from replan.logs.repair.detections import Detections, Repair
from replan.logs.road import Goal, RoadSource
from replan.logs.rules import TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks

HISTORY_S = 2.2
"""Time that is kept before a part, s: longer than any sample is valid
(`replan.logs.observed.MAX_GAP_S`), and than the past of a planner (`replan.logs.past.PAST_S`).
"""
DETECTED_S = 10.0
"""Detections keep this time before a part, s: a repair joins across gaps up to 8 s, a tracker up to
2 s.
"""
CLOSE_S = 1e-9
"""A sample this close to the begin or end is at it, s: logs hold whole nanoseconds."""


def cut(scenario: Scenario, begin: float, end: float = inf) -> Scenario:
    """Cut the part from `begin` to `end`, s after the scenario's start; LogError if the ego's log
    has nothing in it.
    """
    ego = scenario.ego
    if begin <= 0.0 and end >= scenario.duration:
        return scenario
    first, last = max(begin, float(ego.t[0])), min(end, float(ego.t[-1]))
    if not first < last:
        if len(ego) == 1:
            raise LogError(
                "the log has one ego state, its start: there is no part to choose",
                remedy="drive all of it",
            )
        part = f"after {begin:g} s" if end == inf else f"between {begin:g} s and {end:g} s"
        raise LogError(
            f"no ego states {part}: they are from {ego.t[0]:g} s to {ego.t[-1]:g} s",
            remedy="choose begin and end within the log",
        )
    t = np.r_[first, ego.t[(ego.t > first + CLOSE_S) & (ego.t < last - CLOSE_S)], last]
    moved = ego.resampled(t)
    columns = (getattr(moved, name) for name in ("x", "y", "yaw", "v", "a", "kappa"))
    earlier = scenario.whole_ego
    history = (earlier.t >= begin - HISTORY_S) & (earlier.t < first - CLOSE_S)
    before = None
    if history.any():
        before = earlier.taken(history)
        before = replace(before, t=before.t - begin)
    samples = _samples_within(scenario.tracks, begin, end)
    tracks = scenario.tracks.taken(samples).shifted(-begin)
    goal = scenario.goal
    if goal is not None:
        goal = goal.changed(partial(_earlier_goal, seconds=begin))
        past = ego.between(-inf, first)
        goal = goal.after(float(np.hypot(np.diff(past.x), np.diff(past.y)).sum()))
    controls = scenario.controls
    if controls is not None:
        keep = (controls.t >= begin) & (controls.t <= end)
        pedals = controls.throttle[keep], controls.brake[keep]
        shifted = Controls(controls.t[keep] - begin, controls.steer[keep], *pedals)
        controls = shifted if keep.any() else None
    driving = scenario.driving and scenario.driving.between(begin - HISTORY_S, end)
    # The newest plan at the begin
    newest = max(sum(plan.known <= begin for plan in scenario.onboard) - 1, 0)
    onboard = []
    for plan in scenario.onboard[newest:]:
        if plan.known <= end:
            moved_plan = plan.changed(partial(_begun_later, seconds=begin))
            onboard.append(replace(moved_plan, known=plan.known - begin))
    # From the last change before the history on; lights first observed after the end are left out
    lights = []
    for light in scenario.lights:
        known = max(int(np.searchsorted(light.t, begin - HISTORY_S, side="right")) - 1, 0)
        shown = np.flatnonzero(light.t <= end)
        shown = shown[shown >= known]
        if len(shown):
            lights.append(
                TrafficLight(
                    light.id, light.t[shown] - begin, tuple(light.colours[i] for i in shown)
                )
            )
    driven, notes, road = Trajectory(t - begin, *columns), list(scenario.notes), scenario.road
    # A lane of the part alone, as wide as that of the log
    if road.source is RoadSource.DRIVEN_PATH:
        notes = [note for note in notes if not note.startswith((ONE_LANE, REVERSES))]
        lane = next(iter(road.lanes.values()))
        road = road_along(driven, notes, round(float(np.hypot(*(lane.left[0] - lane.right[0]))), 6))
    return replace(
        scenario,
        name=f"{scenario.name}@{begin:g}",
        ego=driven,
        before=before,
        driving=driving and driving.shifted(-begin),
        road=road,
        tracks=tracks,
        duration=min(end, scenario.duration) - begin,
        goal=goal,
        controls=controls,
        start_ns=scenario.start_ns + round(1e9 * begin),
        notes=(
            *notes,
            f"This is the part from {begin:g} s to {min(end, scenario.duration):g} s of the log.",
        ),
        onboard=tuple(onboard),
        lights=tuple(lights),
        traffic=clipped(scenario.traffic_spans, begin, min(end, scenario.duration)),
        detections=None
        if scenario.detections is None
        else _detections(scenario.detections, begin, end),
        repair=None
        if scenario.repair is None
        else _repair(scenario.repair, scenario, begin, end, tracks),
    )


def _samples_within(tracks: Tracks, begin: float, end: float) -> BoolArray:
    before = np.r_[-inf, tracks.t[:-1]]
    before[tracks.offsets[:-1]] = -inf
    after = (before < end) & np.isfinite(before) & (tracks.t <= end + HISTORY_S)
    keep = (tracks.t >= begin - HISTORY_S) & ((tracks.t <= end) | after)
    keep |= tracks.static[tracks.owner]
    return np.asarray(keep)


def _earlier_goal(goal: Goal, seconds: float) -> Goal:
    return replace(goal, t=goal.t and (goal.t[0] - seconds, goal.t[1] - seconds))


def _begun_later(trajectory: Trajectory, seconds: float) -> Trajectory:
    return replace(trajectory, t=trajectory.t - seconds)


def _detections(detections: Detections, begin: float, end: float) -> Detections:
    return detections.between(begin - DETECTED_S, end + HISTORY_S).shifted(-begin)


def _repair(repair: Repair, scenario: Scenario, begin: float, end: float, part: Tracks) -> Repair:
    """Cut the repair of a scenario to the part, whose tracks are `part`."""
    samples = _samples_within(repair.tracks, begin, end)
    own = repair.tracks is not scenario.tracks
    changes = [
        replace(change, begin=change.begin - begin, end=change.end - begin)
        for change in repair.changes
        if change.end - begin >= -DETECTED_S and change.begin - begin <= end - begin + HISTORY_S
    ]
    return Repair(
        _detections(repair.detections, begin, end),
        repair.removed.taken(_samples_within(repair.removed, begin, end)).shifted(-begin),
        repair.extended[samples],
        tuple(changes),
        repair.tracks.taken(samples).shifted(-begin) if own else part,
    )


Timed = TypeVar("Timed", Trajectory, Tracks, Controls, TrafficLight)


def in_nanoseconds(scenario: Scenario) -> Scenario:
    """Round the times of all samples to whole nanoseconds (1); LogError if two samples of one thing
    become one.
    """
    repair, controls, detections = scenario.repair, scenario.controls, scenario.detections
    try:
        tracks = _columns_over_time(scenario.tracks)
        return replace(
            scenario,
            ego=_columns_over_time(scenario.ego),
            before=scenario.before and _columns_over_time(scenario.before),
            tracks=tracks,
            controls=None if controls is None else _columns_over_time(controls),
            lights=tuple(map(_columns_over_time, scenario.lights)),
            onboard=tuple(
                replace(plan, known=_round_time(plan.known)) for plan in scenario.onboard
            ),
            detections=None if detections is None else framed(detections),
            repair=None if repair is None else _rounded_repair(repair, scenario, tracks),
        )
    except ValueError as error:
        raise LogError(f"in whole nanoseconds: {error}", remedy="keep one of the samples") from None


def _rounded_repair(repair: Repair, scenario: Scenario, tracks: Tracks) -> Repair:
    changes = (
        replace(change, begin=_round_time(change.begin), end=_round_time(change.end))
        for change in repair.changes
    )
    own = repair.tracks is not scenario.tracks
    return Repair(
        framed(repair.detections),
        _columns_over_time(repair.removed),
        repair.extended,
        tuple(changes),
        _columns_over_time(repair.tracks) if own else tracks,
    )


def _round_time(seconds: float) -> float:
    return float(_round_times(np.array(seconds)))


def _round_times(t: FloatArray) -> FloatArray:
    return np.asarray(np.rint(1e9 * t) / 1e9)  # (1)


def _columns_over_time(table: Timed) -> Timed:
    t = _round_times(table.t)
    return table if np.array_equal(t, table.t) else replace(table, t=t)


def framed(detections: Detections) -> Detections:
    """Round the frames of detections to whole nanoseconds (1).

    Frames at the same nanosecond become one.
    """
    t, frames = _round_times(detections.t), np.unique(_round_times(detections.frames))
    same = np.array_equal(t, detections.t) and np.array_equal(frames, detections.frames)
    return detections if same else replace(detections, t=t, frames=frames)
