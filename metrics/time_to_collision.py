"""Time to collision, closed loop: how long until the ego's box touches another's.

TTC is the greater of two times until the boxes touch, so neither a course that a turn leaves nor
one that a turn enters is a danger yet. TTC is never less than the straight time, which the scores
of nuPlan and NAVSIM use:

    straight   both go on with their velocity vectors and headings (`shapes.time_to_contact`)
    turning    both turn as they do now, at constant speed and yaw rate, for `TURN_S`, then go
               straight on (`shapes.time_to_contact_turning`): the ego at v kappa, the others as
               estimated (`replan.logs.motion`)

Both up to 10 s; agents behind (as in `collisions`), agents from their first contact on, and a
standing ego (<= 0.005 m/s) have none. At a collision at fault TTC is 0, also with agents behind.
Each step, including the last, has a duration w_k (`reductions.durations`):

(1) TET = sum of w_k [TTC_k < tau],  time exposed, s;
        TIT = sum of w_k (tau - TTC_k) [TTC_k <= tau],  time integrated,
    s2: the published variant; another variant integrates 1 / TTC - 1 / tau and is infinite at a
    contact
"""

from __future__ import annotations

from functools import partial
from math import cos, hypot, sin

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    NO_TTC_MPS,
    TURN_S,
    EgoOutline,
    OtherBoxes,
    car_of,
    contact_time,
    distance_bound,
    ego_boxes,
    is_behind,
    labels_of,
    nearest,
)
from replan.metrics.collisions import contacts
from replan.metrics.gaps import judged_agents, no_agents
from replan.metrics.metric import Measured, Reduction, Series, metric
from replan.metrics.reductions import MIN, durations, first_of, time_below

TTC_HORIZON_S, CLOSE_S = 10.0, 0.95  # Horizon of the time to collision, and nuPlan's bound on it
TAU_S = 1.5  # Critical TTC (criticality metrics catalogue, Westhofen et al. 2023)


@kernel
def _contact_times(
    ego: FloatArray,
    turn: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    until: IntArray,
    horizon: float,
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least TTC and straight time `(2, k)` within the horizon (NaN), and
    whose TTC (-1).

    `turn` are the ego's yaw rates `(k,)`, rad/s; agent i counts at the steps before `until[i]`.
    """
    pose, steps = others.pose, others.there.shape[1]
    least, nearest = np.full((2, steps), np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        vx, vy = ego[3, k], ego[4, k]
        rear_x, rear_y = x - car.axle * cos(yaw), y - car.axle * sin(yaw)
        best, straight = horizon, horizon
        if hypot(vx, vy) <= NO_TTC_MPS:
            continue
        for i in range(len(until)):
            if (
                k >= until[i]
                or not others.there[i, k]
                or is_behind(rear_x, rear_y, yaw, pose[0, i, k], pose[1, i, k])
            ):
                continue
            closing = hypot(pose[3, i, k] - vx, pose[4, i, k] - vy)
            if distance_bound(x, y, car, others, i, k) > closing * best:
                continue
            contact_s = contact_time((x, y, yaw, vx, vy), turn[k], car, others, i, k, 0.0)
            if contact_s < straight:
                straight, least[1, k] = contact_s, contact_s
            if contact_s < best:
                contact_s = max(
                    contact_s, contact_time((x, y, yaw, vx, vy), turn[k], car, others, i, k, TURN_S)
                )
            if contact_s < best:
                best, least[0, k], nearest[k] = contact_s, contact_s, i
    return least, nearest


@once
def least_contact_times(
    trace: Trace, scenario: Scenario, vulnerable_only: bool
) -> tuple[FloatArray, IntArray]:
    """Return at each step the least TTC and straight time `(2, k)`, s (NaN: none), and the agent of
    the first (-1).
    """
    drive, ego, car = trace.ego, ego_boxes(trace.ego, scenario), car_of(scenario)
    until = np.where(judged_agents(trace, vulnerable_only), len(drive), 0)
    collisions = [contact for contact in contacts(trace, scenario) if until[contact.agent]]
    until[[contact.agent for contact in collisions]] = [contact.step for contact in collisions]
    turn = drive.v * drive.kappa

    def contact_times(
        steps: slice, present: IntArray, others: OtherBoxes
    ) -> tuple[FloatArray, IntArray]:
        last = until[present] - steps.start
        return _contact_times(ego[:, steps], turn[steps], car, others, last, TTC_HORIZON_S)

    least, agents = nearest(trace.agents, drive.t, contact_times)
    for contact in collisions:
        if contact.at_fault:
            least[0, contact.step], agents[contact.step] = 0.0, contact.agent
    return least, agents


def _integral(series: Series) -> tuple[float, int]:
    """Return TIT (1), s2, and the first step that contributes."""
    flags = series.known & (series.value <= TAU_S)
    return float(np.sum((durations(series.t) * (TAU_S - series.value))[flags])), first_of(flags)


_ttc = partial(
    metric,
    unit="s",
    better="higher",
    reductions=(
        MIN,
        time_below(CLOSE_S, "time_below_950ms"),
        time_below(TAU_S, "time_below_1500ms"),
        Reduction("integrated_1500ms", _integral, "s2", "lower", 0.0),
    ),
    parameters=(
        f"horizon {TTC_HORIZON_S:g} s",
        "bounds 0.95 s and 1.5 s (tau of TET and TIT)",
        f"turns last {TURN_S} s",
        "not to who is more than 150 degrees off the heading, nor from their first contact on",
        "0 at a collision at fault",
    ),
    source="bound 0.95 s: nuPlan devkit e9241677, time_to_collision_within_bound; TET and TIT: "
    "Minderhoud, Bovy, Accid. Anal. Prev. 33 (2001) 89",
)


@_ttc(version=3, needs="another on a course to touch an ego that drives")
def ttc(trace: Trace, scenario: Scenario) -> Measured:
    """Least time until boxes touch at constant velocity vectors, or at constant speeds and yaw
    rates if that is later, within 10 s; not to those behind.

    Formula: max over straight, turning of the least t >= 0 at which the boxes touch; TET = sum w
    [TTC < tau], TIT = sum w (tau - TTC) [TTC <= tau]
    """
    return _least_ttc(trace, scenario, vulnerable_only=False)


@_ttc(version=2, needs="a pedestrian or rider on a course to touch an ego that drives")
def ttc_vulnerable(trace: Trace, scenario: Scenario) -> Measured:
    """Least time until the ego's box touches a pedestrian or rider, as ttc.

    Formula: max over straight, turning of the least t >= 0 at which the boxes touch; TET = sum w
    [TTC < tau], TIT = sum w (tau - TTC) [TTC <= tau]
    """
    return _least_ttc(trace, scenario, vulnerable_only=True)


def _least_ttc(trace: Trace, scenario: Scenario, *, vulnerable_only: bool) -> Measured:
    if not judged_agents(trace, vulnerable_only).any():
        return no_agents(vulnerable_only)
    (least, _), agents = least_contact_times(trace, scenario, vulnerable_only)
    never = f"never on a course to touch within {TTC_HORIZON_S:g} s"
    return Series(trace.ego.t, least, labels_of(trace, agents), never)
