"""Following, closed loop: gap and time to the lead, and the effort required to avoid it.

With the lead's gap (m) from bumper to bumper along the path (`lead`), the ego's speed v, the lead's
speed u along the path, and its deceleration b_o >= 0:

(1) THW = gap / v: time until the ego's front is where the lead's rear is now, at constant speed;
        none while it stands
(2) DRAC = (v - u)^2 / (2 gap) where v > u, else 0: the lead holds its speed
(3) a_req, the least constant deceleration that avoids a lead that keeps braking
        with b_o until it stands:
    b_o + (v - u)^2 / (2 gap)
        where v > u and the speeds meet first, i.e. 2 gap / (v - u) <= u / b_o;  else
    v^2 / (2 (gap + u^2 / (2 b_o)))  where the lead comes to rest first;  0 where v <= u and b_o = 0
(4) BTN = a_req / (the ego's greatest deceleration);  above 1, braking alone does not suffice
(5) a_lat,req = 2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 with T = gap / (v - u),
        h half of the ego's width and the lead from l_low to l_high moving sideways with w: the
        least constant lateral acceleration that passes it; 0 if the lead has left the band by then,
        or if the gap opens
(6) STN = a_lat,req / 8.0 m/s2
(7) following gap: required = max(v t_front(v), 2 m), t_front from `R157_S`, interpolated linearly,
        constant beyond the table; measured while the lead is a vehicle that heads along the path
        (within 45 degrees) and drives, or while both stand

At a contact (gap 0) only (1) and the gap have values: the required accelerations are unbounded.
Sources: commonroad-crime 0.4.5 and the criticality metrics catalogue (Westhofen et al. 2023) for
(1) to (6); (3) adds that a braking lead does not reverse; UN R157, 5.2.3.3 for (7), whose table
ends at 60 km/h.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import GRID_S, STANDING_MPS, labels_of
from replan.metrics.encounters import CATALOGUE
from replan.metrics.lead import COMING_MPS, LOOK_M, EgoAndLead, ahead_of
from replan.metrics.metric import Measured, Series, metric
from replan.metrics.reductions import MAX, MIN, time_below, time_outside

SHORT_THW_S = 0.9  # Germany fines shorter headways (criticality metrics catalogue: DE 0.9 s)
EMERGENCY_MPS2 = 5.0  # UN R157: a manoeuvre that requires more is an emergency manoeuvre
STEER_MPS2 = 8.0  # Available lateral acceleration: a_lat,max of commonroad-crime
R157_MPS = np.array([7.2, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]) / 3.6
R157_S = np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6])
R157_LEAST_M = 2.0
_ALONG = np.cos(np.pi / 4.0)
_ALONE = f"no other road user in the ego's path within {LOOK_M:g} m"
_PATH = (
    f"path: the arc of the ego's curvature, {LOOK_M:g} m ahead, at most a quarter turn",
    f"every {GRID_S:g} s",
)


def required_decel(gap: FloatArray, v: FloatArray, u: FloatArray, decel: FloatArray) -> FloatArray:
    """Return (3) `(n,)`, m/s2, positive; NaN where the gap is 0 or unknown."""
    u = np.maximum(u, 0.0)
    closing = np.maximum(v - u, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = np.where(decel > 0.0, u**2 / (2.0 * decel), np.where(u > 0.0, np.inf, 0.0))
        meet_first = (closing > 0.0) & (2.0 * gap * decel <= u * closing)
        required = np.where(
            meet_first, decel + closing**2 / (2.0 * gap), v**2 / (2.0 * (gap + rest))
        )
    return np.where(gap > 0.0, required, np.nan)


def required_lateral(ahead: EgoAndLead, half: float) -> FloatArray:
    """Return (5) `(n,)`, m/s2; NaN where the gap is 0 or unknown."""
    # Tiny closing speed: infinite time, 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        time = ahead.gap / np.maximum(ahead.v - ahead.u, 0.0)
        left, right = ahead.high + ahead.w * time + half, half - ahead.low - ahead.w * time
        needed = 2.0 * np.maximum(np.minimum(left, right), 0.0) / time**2
    return np.where(ahead.gap > 0.0, np.where(ahead.v > ahead.u, needed, 0.0), np.nan)


def required_gap(v: FloatArray) -> FloatArray:
    """Return the required gap (7) `(n,)`, m."""
    return np.maximum(v * np.interp(v, R157_MPS, R157_S), R157_LEAST_M)


def _quotient(above: FloatArray, below: FloatArray, known: BoolArray) -> FloatArray:
    return np.divide(above, below, out=np.full(len(above), np.nan), where=known)


def _series(trace: Trace, ahead: EgoAndLead, value: FloatArray, missing: str = _ALONE) -> Measured:
    return Series(ahead.t, value, labels_of(trace, ahead.agent), missing)


_lead_metric = partial(
    metric,
    parameters=_PATH,
    needs="a lead in the ego's path",
    source=CATALOGUE,
)


@_lead_metric(unit="m", better="higher", reductions=(MIN,))
def headway(trace: Trace, scenario: Scenario) -> Measured:
    """Gap along the ego's path from its front bumper to the lead.

    Formula: s_lead - s_front
    """
    ahead = ahead_of(trace, scenario)
    return _series(trace, ahead, ahead.gap)


@_lead_metric(
    unit="s",
    better="higher",
    reductions=(MIN, time_below(SHORT_THW_S, "time_below_900ms")),
    parameters=(f"bound {SHORT_THW_S:g} s (fined in Germany)", *_PATH),
    needs="a lead in the path of an ego that drives",
)
def thw(trace: Trace, scenario: Scenario) -> Measured:
    """Time headway: until the ego's front is where the lead's rear is now, at constant speed.

    Formula: gap / v
    """
    ahead = ahead_of(trace, scenario)
    headway_s = _quotient(ahead.gap, ahead.v, ahead.v > STANDING_MPS)
    return _series(trace, ahead, headway_s, f"{_ALONE} while it drove")


@_lead_metric(unit="m/s2", better="lower", reductions=(MAX,))
def drac(trace: Trace, scenario: Scenario) -> Measured:
    """Deceleration rate to avoid a crash with a lead that holds its speed.

    Formula: (v - u)^2 / (2 gap) where v > u, else 0
    """
    ahead = ahead_of(trace, scenario)
    closing = np.maximum(ahead.v - ahead.u, 0.0)
    return _series(trace, ahead, _quotient(closing**2, 2.0 * ahead.gap, ahead.gap > 0.0))


@_lead_metric(
    unit="m/s2",
    better="lower",
    reductions=(MAX, time_outside(-np.inf, EMERGENCY_MPS2, "time_in_emergency")),
    parameters=(f"emergency above {EMERGENCY_MPS2:g} m/s2", *_PATH),
    source=f"{CATALOGUE}; emergency: UN R157",
    name="required_decel",
)
def required_decel_of_lead(trace: Trace, scenario: Scenario) -> Measured:
    """Least constant deceleration that avoids a lead that goes on braking as it does until it
    stands.

    Formula: b_o + (v - u)^2 / (2 gap) where the speeds meet before the lead stands, else v^2 / (2
    (gap + u^2 / (2 b_o)))
    """
    ahead = ahead_of(trace, scenario)
    return _series(trace, ahead, required_decel(ahead.gap, ahead.v, ahead.u, ahead.decel))


@_lead_metric(
    unit="1",
    better="lower",
    reductions=(MAX, time_outside(-np.inf, 1.0, "time_above_1")),
    parameters=("a_max: the vehicle's max_decel", *_PATH),
)
def btn(trace: Trace, scenario: Scenario) -> Measured:
    """Brake threat number: required over greatest deceleration; above 1 braking alone does not
    suffice.

    Formula: a_req / a_max
    """
    ahead = ahead_of(trace, scenario)
    required = required_decel(ahead.gap, ahead.v, ahead.u, ahead.decel)
    return _series(trace, ahead, required / scenario.vehicle.max_decel)


@_lead_metric(
    unit="1",
    better="lower",
    reductions=(MAX, time_outside(-np.inf, 1.0, "time_above_1")),
    parameters=(f"a_lat,max {STEER_MPS2:g} m/s2", *_PATH),
    source="commonroad-crime 0.4.5",
)
def stn(trace: Trace, scenario: Scenario) -> Measured:
    """Steer threat number: lateral acceleration that is required to pass the lead, over what is
    available.

    Formula: 2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 / a_lat,max, T = gap / (v - u)
    """
    ahead = ahead_of(trace, scenario)
    required = required_lateral(ahead, 0.5 * scenario.vehicle.width)
    return _series(trace, ahead, required / STEER_MPS2)


@_lead_metric(
    unit="m",
    better="higher",
    reductions=(MIN, time_below(0.0, "time_too_near")),
    parameters=(
        "t_front 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6 s at 7.2, 10, 20, 30, 40, 50, 60 km/h, "
        "linear between, 1.6 s beyond",
        *_PATH,
    ),
    needs="a vehicle that drives on in the ego's path, or stands where the ego stands",
    source="UN R157, 5.2.3.3",
)
def following_gap(trace: Trace, scenario: Scenario) -> Measured:
    """Gap to the vehicle that the ego follows, less the minimum following gap of UN R157.

    Formula: gap - max(v t_front(v), 2 m)
    """
    ahead = ahead_of(trace, scenario)
    both_stand = (ahead.v <= COMING_MPS) & (np.abs(ahead.u) <= COMING_MPS)
    follows = (ahead.facing >= _ALONG) & ((ahead.u > COMING_MPS) | both_stand)
    no_vehicles = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
    is_vehicle = [kind not in no_vehicles for kind in trace.agents.kinds]
    # The last entry is that of no lead, -1
    follows &= np.array([*is_vehicle, False], np.bool_)[ahead.agent]
    margin = np.where(follows, ahead.gap - required_gap(ahead.v), np.nan)
    return _series(trace, ahead, margin, "the ego followed no vehicle")
