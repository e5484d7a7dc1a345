"""Times as native MCAP holds them, so that a log and its conversion are the same scenario, bit for bit.

(1) t -> rint(1e9 t) / 1e9,   t in s since the scenario's start; at most half a nanosecond away
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from logs.detections import Detections, Repair
from logs.errors import LogError
from logs.kernel import FloatArray
from logs.rules import TrafficLight
from logs.scenario import Scenario, Tracks
from logs.states import Controls, OnboardPlan, Trajectory

Timed = TypeVar("Timed", Trajectory, Tracks, Controls, TrafficLight)


def in_nanoseconds(scenario: Scenario) -> Scenario:
    """The scenario with its samples at whole nanoseconds (1).

    Raises:
        LogError: Two samples of the ego, of a road user or of a light fall on one nanosecond.
    """
    try:
        tracks = _timed(scenario.tracks)
        return replace(
            scenario,
            ego=_timed(scenario.ego),
            tracks=tracks,
            controls=None if scenario.controls is None else _timed(scenario.controls),
            lights=tuple(map(_timed, scenario.lights)),
            onboard=tuple(map(_known, scenario.onboard)),
            detections=None if scenario.detections is None else framed(scenario.detections),
            repair=None if scenario.repair is None else _repaired(scenario.repair, scenario.tracks, tracks),
        )
    except ValueError as error:
        raise LogError(f"in whole nanoseconds: {error}", remedy="keep one of the samples") from None


def _rounded(t: FloatArray) -> FloatArray:
    return np.asarray(np.rint(1e9 * t) / 1e9)  # (1)


def _timed(table: Timed) -> Timed:
    t = _rounded(table.t)
    return table if np.array_equal(t, table.t) else replace(table, t=t)


def framed(found: Detections) -> Detections:
    """Detections whose frames are at whole nanoseconds (1); those of one nanosecond become one frame."""
    t, frames = _rounded(found.t), np.unique(_rounded(found.frames))
    same = np.array_equal(t, found.t) and np.array_equal(frames, found.frames)
    return found if same else replace(found, t=t, frames=frames)


def _repaired(made: Repair, was: Tracks, now: Tracks) -> Repair:
    changes = tuple(
        replace(each, begin=float(_rounded(np.array(each.begin))), end=float(_rounded(np.array(each.end))))
        for each in made.changes
    )
    tracks = now if made.tracks is was else _timed(made.tracks)
    return Repair(framed(made.detections), _timed(made.removed), made.extended, changes, tracks)


def _known(plan: OnboardPlan) -> OnboardPlan:
    known = float(_rounded(np.array(plan.known)))
    return plan if known == plan.known else replace(plan, known=known)
