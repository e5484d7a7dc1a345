"""False braking, hard and without a cause, and missed braking: less of one costs more of the other, so both count.

(1) A hard episode: steps every `GRID_S` with a < -`HARD_MPS2`, less than `APART_S` apart.
(2) It had a cause if, within `WITHIN_S` of its begin, the box of any road user came within `NEAR_M` of the strip
    that the ego sweeps from where it then was on: along its drive, straight on where that ends, as far as it would
    have come with its speed.
(3) missed(t) = max((v - u)^2 / (2 gap) - b, 0) for the lead in the path ahead (`path_ahead`) with gap, u, v > u, of an
    ego that brakes with b: what a steady approach behind the lead asks beyond what is done.
"""

from __future__ import annotations

from math import cos, sin

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.trace import Mode, Trace
from metrics.boxes import Car, car_of, touches
from metrics.metric import COUNT, MAX, RATE, Measured, Metric, Series
from metrics.others import Others, labels_of, others_at
from metrics.path_ahead import GRID_S, ahead_of, grid_of

HARD_MPS2, APART_S, WITHIN_S, NEAR_M = 3.5, 0.5, 5.0, 0.3
SPACING_M = 0.5
"""Between two boxes of the ego whose union stands for the strip."""
TOUCHING_M = 0.5
"""Gaps are not taken as less than this: what is nearer is a contact's business."""


def hard_episodes(ego: Trajectory) -> list[int]:
    """The steps at which the episodes (1) begin."""
    hard = np.flatnonzero(ego.a < -HARD_MPS2)
    return [int(k) for i, k in enumerate(hard) if i == 0 or ego.t[k] - ego.t[hard[i - 1]] > APART_S + 1e-9]


def had_cause(trace: Trace, scenario: Scenario, begin: float) -> bool:
    """(2) of an episode that begins at a time, s."""
    car, t = car_of(scenario), begin + GRID_S * np.arange(round(WITHIN_S / GRID_S) + 1)
    wider = car._replace(width=car.width + 2.0 * NEAR_M)
    return bool(_comes(_way(trace.ego, begin), wider, others_at(trace.agents, t)))


def _way(ego: Trajectory, begin: float) -> FloatArray:
    """Rows x, y, yaw `(3, n)` of the rear axle along the strip of (2)."""
    drive = ego.resampled(np.r_[begin, ego.t[ego.t > begin]])
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(drive.x), np.diff(drive.y)))]
    at = np.arange(0.0, max(float(drive.v[0]), 0.0) * WITHIN_S + SPACING_M, SPACING_M)
    beyond = np.maximum(at - s[-1], 0.0)
    x, y, yaw = (np.interp(at, s, column) for column in (drive.x, drive.y, drive.yaw))
    return np.stack([x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw])


@kernel
def _comes(way: FloatArray, car: Car, others: Others) -> bool:
    """Whether any of the boxes `(n, k)` overlaps the ego's anywhere on the way."""
    for j in range(way.shape[1]):
        x, y, yaw = way[0, j] + car.axle * cos(way[2, j]), way[1, j] + car.axle * sin(way[2, j]), way[2, j]
        for i in range(others.there.shape[0]):
            for k in range(others.there.shape[1]):
                if others.there[i, k] and touches(x, y, yaw, car, others, i, k):
                    return True
    return False


def _false(trace: Trace, scenario: Scenario) -> Measured:
    ego = grid_of(trace)
    value = np.full(len(ego.t), np.nan)
    for k in hard_episodes(ego):
        value[k] = not had_cause(trace, scenario, float(ego.t[k]))
    return Series(ego.t, value, missing="the ego never brakes hard")


def _missed(trace: Trace, scenario: Scenario) -> Measured:
    found = ahead_of(trace, scenario)
    closing = np.maximum(found.v - found.u, 0.0)
    asked = closing**2 / (2.0 * np.maximum(found.gap, TOUCHING_M))
    value = np.maximum(asked - np.maximum(-found.a, 0.0), 0.0)
    return Series(found.t, value, labels_of(trace, found.agent), missing="the path ahead was free")


FALSE_BRAKING = Metric(
    "false_braking", "1", "lower", (Mode.CLOSED,), _false, (RATE, COUNT),
    "1 where a hard braking begins after which no road user comes near the ego's way, 0 where one does.",
    formula="[no road user within 0.3 m of the way ahead within 5 s]",
    parameters=(
        f"hard below -{HARD_MPS2:g} m/s2", f"apart {APART_S:g} s", f"near {NEAR_M:g} m", f"within {WITHIN_S:g} s",
    ),
    needs="a hard braking",
)  # fmt: skip
MISSED_BRAKING = Metric(
    "missed_braking", "m/s2", "lower", (Mode.CLOSED,), _missed, (MAX,),
    "Deceleration that a steady approach behind the one ahead in the path asks beyond the ego's.",
    formula="max((v - u)^2 / (2 gap) - b, 0)", parameters=(f"gap at least {TOUCHING_M:g} m",),
    needs="a road user ahead in the path",
)  # fmt: skip
