"""Times as native MCAP holds them, so that a log and its conversion are the same scenario, bit for bit.

(1) t -> rint(1e9 t) / 1e9,   t in s since the scenario's start; at most half a nanosecond away
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

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
        return replace(
            scenario,
            ego=_timed(scenario.ego),
            tracks=_timed(scenario.tracks),
            controls=None if scenario.controls is None else _timed(scenario.controls),
            lights=tuple(map(_timed, scenario.lights)),
            onboard=tuple(map(_known, scenario.onboard)),
        )
    except ValueError as error:
        raise LogError(f"in whole nanoseconds: {error}", remedy="keep one of the samples") from None


def _rounded(t: FloatArray) -> FloatArray:
    return np.asarray(np.rint(1e9 * t) / 1e9)  # (1)


def _timed(table: Timed) -> Timed:
    t = _rounded(table.t)
    return table if np.array_equal(t, table.t) else replace(table, t=t)


def _known(plan: OnboardPlan) -> OnboardPlan:
    known = float(_rounded(np.array(plan.known)))
    return plan if known == plan.known else replace(plan, known=known)
