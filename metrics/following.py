"""Distance and time to the lead, and what it would take to avoid them: closed loop, `path_ahead` says who is the lead.

gap (m) from bumper to bumper along the path, v the ego's speed, u the lead's along the path, b_o >= 0 its deceleration.

(1) THW = gap / v: when the ego's front is where the lead's rear is now, at constant speed; an ego that stands has none
(2) DRAC = (v - u)^2 / (2 gap) where v > u, else 0: the lead holds its speed
(3) a_req, the least constant deceleration that does not touch a lead that goes on braking with b_o until it stands:
    b_o + (v - u)^2 / (2 gap)  where v > u and the speeds meet first, i.e. 2 gap / (v - u) <= u / b_o;  else
    v^2 / (2 (gap + u^2 / (2 b_o)))  where the lead comes to rest first;  0 where v <= u and b_o = 0
(4) BTN = a_req / (the ego's greatest deceleration);  above 1 braking alone does not suffice
(5) a_lat,req = 2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 with T = gap / (v - u), h half of the ego's width
    and the lead from l_low to l_high moving sideways with w: the least constant lateral acceleration that passes it;
    0 where it is out of the band by then, or the gap opens
(6) STN = a_lat,req / 8.0 m/s2
(7) following gap: required = max(v t_front(v), 2 m), t_front by `R157_S`, linear between, the last beyond the table;
    asked while the lead is a vehicle that heads along the path (within 45 degrees) and drives on, or both stand

At a contact (gap 0) only (1) and the gap have a value: what is required then is without bound.
Sources: commonroad-crime 0.4.5 and the criticality metrics catalogue (Westhofen et al. 2023) for (1) to (6), where (3)
adds that a lead does not brake into reverse; UN R157, 5.2.3.3 for (7), whose table ends at 60 km/h.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from logs.kernel import BoolArray, FloatArray
from logs.scenario import AgentKind, Scenario
from logs.trace import Mode, Trace
from metrics.boxes import STANDING_MPS
from metrics.metric import MAX, MIN, Direction, Measured, Metric, Reduction, Series, time_below, time_outside
from metrics.others import labels_of
from metrics.path_ahead import COMING_MPS, GRID_S, LOOK_M, Ahead, ahead_of
from metrics.safety import CATALOGUE

SHORT_THW_S = 0.9  # Below it Germany fines (criticality metrics catalogue: DE 0.9 s)
EMERGENCY_MPS2 = 5.0  # UN R157: a greater demand is an emergency manoeuvre
STEER_MPS2 = 8.0  # Lateral acceleration that is available: commonroad-crime's a_lat,max
R157_MPS = np.array([7.2, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]) / 3.6
R157_S = np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6])
R157_LEAST_M = 2.0
_ALONG = np.cos(np.pi / 4.0)
_ALONE = f"no other road user in the ego's path within {LOOK_M:g} m"


def required_decel(gap: FloatArray, v: FloatArray, u: FloatArray, decel: FloatArray) -> FloatArray:
    """(3) `(n,)`, m/s2, positive; NaN where the gap is 0 or not known."""
    u = np.maximum(u, 0.0)
    closing = np.maximum(v - u, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = np.where(decel > 0.0, u**2 / (2.0 * decel), np.where(u > 0.0, np.inf, 0.0))
        meet_first = (closing > 0.0) & (2.0 * gap * decel <= u * closing)
        required = np.where(meet_first, decel + closing**2 / (2.0 * gap), v**2 / (2.0 * (gap + rest)))
    return np.where(gap > 0.0, required, np.nan)


def required_lateral(ahead: Ahead, half: float) -> FloatArray:
    """(5) `(n,)`, m/s2; NaN where the gap is 0 or not known."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # hardly closing: never, 0
        time = ahead.gap / np.maximum(ahead.v - ahead.u, 0.0)
        left, right = ahead.high + ahead.w * time + half, half - ahead.low - ahead.w * time
        needed = 2.0 * np.maximum(np.minimum(left, right), 0.0) / time**2
    return np.where(ahead.gap > 0.0, np.where(ahead.v > ahead.u, needed, 0.0), np.nan)


def required_gap(v: FloatArray) -> FloatArray:
    """(7) `(n,)`, m."""
    return np.maximum(v * np.interp(v, R157_MPS, R157_S), R157_LEAST_M)


def _quotient(above: FloatArray, below: FloatArray, known: BoolArray) -> FloatArray:
    return np.divide(above, below, out=np.full(len(above), np.nan), where=known)


def _required(ahead: Ahead, scenario: Scenario) -> FloatArray:
    return required_decel(ahead.gap, ahead.v, ahead.u, ahead.decel)


def _margin(ahead: Ahead, scenario: Scenario) -> FloatArray:
    both_stand = (ahead.v <= COMING_MPS) & (np.abs(ahead.u) <= COMING_MPS)
    follows = (ahead.facing >= _ALONG) & ((ahead.u > COMING_MPS) | both_stand)
    return np.where(follows, ahead.gap - required_gap(ahead.v), np.nan)


def _measured(
    trace: Trace, scenario: Scenario, *, value: Callable[[Ahead, Scenario], FloatArray], missing: str, vehicles: bool
) -> Measured:
    ahead = ahead_of(trace, scenario)
    found = value(ahead, scenario)
    if vehicles:
        no_vehicle = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
        vehicle = np.array([*(kind not in no_vehicle for kind in trace.agents.kinds), False], np.bool_)
        found = np.where(vehicle[ahead.agent], found, np.nan)
    return Series(ahead.t, found, labels_of(trace, ahead.agent), missing)


def _metric(
    name: str, unit: str, direction: Direction, value: Callable[[Ahead, Scenario], FloatArray],
    reductions: tuple[Reduction, ...], meaning: str, formula: str, source: str, *parameters: str,
    needs: str = "a lead in the ego's path", missing: str = _ALONE, vehicles: bool = False,
) -> Metric:  # fmt: skip
    measure = partial(_measured, value=value, missing=missing, vehicles=vehicles)
    path = (f"path: the arc of the ego's curvature, {LOOK_M:g} m ahead, at most a quarter turn", f"every {GRID_S:g} s")
    return Metric(
        name, unit, direction, (Mode.CLOSED,), measure, reductions, meaning, source, formula=formula,
        parameters=(*parameters, *path), needs=needs,
    )  # fmt: skip


FOLLOWING = (
    _metric(
        "headway", "m", "higher", lambda ahead, scenario: ahead.gap, (MIN,),
        "Gap along the ego's path from its front bumper to the lead.", "s_lead - s_front", CATALOGUE,
    ),
    _metric(
        "thw", "s", "higher",
        lambda ahead, scenario: _quotient(ahead.gap, ahead.v, ahead.v > STANDING_MPS),
        (MIN, time_below(SHORT_THW_S, "time_below_900ms")),
        "Time headway: until the ego's front is where the lead's rear is now, at constant speed.", "gap / v",
        CATALOGUE, f"bound {SHORT_THW_S:g} s (fined in Germany)",
        needs="a lead in the path of an ego that drives", missing=f"{_ALONE} while it drove",
    ),
    _metric(
        "drac", "m/s2", "lower",
        lambda ahead, scenario: _quotient(np.maximum(ahead.v - ahead.u, 0.0) ** 2, 2.0 * ahead.gap, ahead.gap > 0.0),
        (MAX,), "Deceleration rate to avoid a crash with a lead that holds its speed.",
        "(v - u)^2 / (2 gap) where v > u, else 0", CATALOGUE,
    ),
    _metric(
        "required_decel", "m/s2", "lower", _required, (MAX, time_outside(-np.inf, EMERGENCY_MPS2, "time_in_emergency")),
        "Least constant deceleration that avoids a lead that goes on braking as it does until it stands.",
        "b_o + (v - u)^2 / (2 gap) where the speeds meet before the lead stands, else v^2 / (2 (gap + u^2 / (2 b_o)))",
        f"{CATALOGUE}; emergency: UN R157", f"emergency above {EMERGENCY_MPS2:g} m/s2",
    ),
    _metric(
        "btn", "1", "lower", lambda ahead, scenario: _required(ahead, scenario) / scenario.vehicle.max_decel,
        (MAX, time_outside(-np.inf, 1.0, "time_above_1")),
        "Brake threat number: required over greatest deceleration; above 1 braking alone does not suffice.",
        "a_req / a_max", CATALOGUE, "a_max: the vehicle's max_decel",
    ),
    _metric(
        "stn", "1", "lower",
        lambda ahead, scenario: required_lateral(ahead, 0.5 * scenario.vehicle.width) / STEER_MPS2,
        (MAX, time_outside(-np.inf, 1.0, "time_above_1")),
        "Steer threat number: lateral acceleration that is required to pass the lead, over what is available.",
        "2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 / a_lat,max, T = gap / (v - u)",
        "commonroad-crime 0.4.5", f"a_lat,max {STEER_MPS2:g} m/s2",
    ),
    _metric(
        "following_gap", "m", "higher", _margin, (MIN, time_below(0.0, "time_too_near")),
        "Gap to the vehicle that the ego follows, less the minimum following gap of UN R157.",
        "gap - max(v t_front(v), 2 m)", "UN R157, 5.2.3.3",
        "t_front 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6 s at 7.2, 10, 20, 30, 40, 50, 60 km/h, linear between, 1.6 s beyond",
        needs="a vehicle that drives on in the ego's path, or stands where the ego stands",
        missing="the ego followed no vehicle", vehicles=True,
    ),
)  # fmt: skip
