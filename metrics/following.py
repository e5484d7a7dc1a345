"""The path ahead of the ego, the lead in it, gap and time to the lead, and the effort required to
avoid it.

All metrics use this definition of the lead, in closed loop. The path leads from the rear axle along
the circle of the ego's curvature at that step, for at most `LOOK_M` and a quarter of a turn; s in m
along it, l in m to its left. It needs neither lanes nor later steps of the drive. For a point at
(x, y) ahead and to the left of the rear axle:

(1) s = atan2(kappa x, 1 - kappa y) / kappa,  x where kappa = 0
    l = (2 y - kappa (x^2 + y^2)) / (1 + hypot(1 - kappa y, kappa x))

Band: |l| <= half of the ego's width, the area that its box sweeps. Lead: of all agents whose boxes
reach into the band, the one whose part in it begins nearest ahead of the middle of the ego's box.
Agents that approach the ego at more than `COMING_MPS` are no leads (TTC and RSS cover them);
crossing agents are leads while in the band. An ego in reverse has no lead. Each edge of a box is
divided into `PIECES` pieces: exact to 0.1 m for a truck on the tightest curve.

With gap (m) from bumper to bumper along the path, the ego's speed v, the lead's speed u along the
path, and its deceleration b_o >= 0:

(2) THW = gap / v: time until the ego's front is where the lead's rear is now, at constant speed;
        none while it stands
(3) DRAC = (v - u)^2 / (2 gap) where v > u, else 0: the lead holds its speed
(4) a_req, the least constant deceleration that avoids a lead that keeps braking
        with b_o until it stands:
    b_o + (v - u)^2 / (2 gap)
        where v > u and the speeds meet first, i.e. 2 gap / (v - u) <= u / b_o;  else
    v^2 / (2 (gap + u^2 / (2 b_o)))  where the lead comes to rest first;  0 where v <= u and b_o = 0
(5) BTN = a_req / (the ego's greatest deceleration);  above 1, braking alone does not suffice
(6) a_lat,req = 2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 with T = gap / (v - u),
        h half of the ego's width and the lead from l_low to l_high moving sideways with w: the
        least constant lateral acceleration that passes it; 0 if the lead has left the band by then,
        or if the gap opens
(7) STN = a_lat,req / 8.0 m/s2
(8) following gap: required = max(v t_front(v), 2 m), t_front from `R157_S`, interpolated linearly,
        constant beyond the table; measured while the lead is a vehicle that heads along the path
        (within 45 degrees) and drives, or while both stand

At a contact (gap 0) only (2) and the gap have values: the required accelerations are unbounded.
Sources: commonroad-crime 0.4.5 and the criticality metrics catalogue (Westhofen et al. 2023) for
(2) to (7); (4) adds that a braking lead does not reverse; UN R157, 5.2.3.3 for (8), whose table
ends at 60 km/h.

Responsibility-sensitive safety (RSS), closed loop: the margin to a dangerous situation, and the
proper response.

Measured along and across the same path, every 0.1 s, for every agent within `LOOK_M` that is not
wholly behind the ego (agents behind must keep their own distance). v is the ego's speed, u the
other's along the path, w the other's across it towards the ego's side, d_lon and d_lat are the gaps
of the boxes (negative where they overlap), and stopping(v) = v RHO + A_MAX RHO^2 / 2 + (v + RHO
A_MAX)^2 / (2 B_MIN).

(9) d_lon,min = max(stopping(v) - u^2 / (2 B_MAX), 0) if both drive in the same direction;
        stopping(v) + stopping(|u|) if the other approaches (u < -0.05 m/s)
(10) d_lat,min = MU + max(aside(0) + aside(w), 0),
         aside(c) = (c + c') RHO / 2 + c' |c'| / (2 B_LAT),
    c' = c + RHO A_LAT: the ego keeps to its path (c = 0); signed, so that moving away reduces it;
        aside(w) is 0 if the other stands or is an object, which cannot swerve (an addition of
        replan)
(11) dangerous: d_lon < d_lon,min and d_lat < d_lat,min;
         margin = the greater of both differences, m; negative: dangerous
(12) proper response, from RHO after the danger to this agent began until it ends or the ego stands:
    if d_lat became unsafe last, the ego's speed towards the other, across the path that it was on
    when the danger began, is at most its value at RHO less B_LAT times the time since then, or 0;
    otherwise the ego brakes with at least B_MIN. At all times, also before RHO, it accelerates with
    at most A_MAX.

A standing ego has given its response and has no margin. The parameters are those of JRC-FSM (commit
01b05c29), since RSS leaves them to its user. With these, a car that follows at 15 m/s is in danger
within 18.1 m, 1.2 s. Source: Shalev-Shwartz, Shammah, Shashua, arXiv 1708.06374, definitions 1 to
10.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import atan2, cos, hypot, pi, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.trace import Mode, Trace
from replan.metrics.boxes import (
    GRID_S,
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    each,
    grid_of,
    labels_of,
    name_of,
    nearest,
)
from replan.metrics.metric import (
    MAX,
    MIN,
    Measured,
    Metric,
    Series,
    Unavailable,
    share_while,
    time_below,
    time_outside,
)
from replan.metrics.safety import CATALOGUE

LOOK_M = 150.0
COMING_MPS = 0.5
PIECES = 4
SHORT_THW_S = 0.9  # Germany fines shorter headways (criticality metrics catalogue: DE 0.9 s)
EMERGENCY_MPS2 = 5.0  # UN R157: a manoeuvre that requires more is an emergency manoeuvre
STEER_MPS2 = 8.0  # Available lateral acceleration: a_lat,max of commonroad-crime
R157_MPS = np.array([7.2, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]) / 3.6
R157_S = np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6])
R157_LEAST_M = 2.0
_ALONG = np.cos(np.pi / 4.0)
_ALONE = f"no other road user in the ego's path within {LOOK_M:g} m"


@dataclass(frozen=True, eq=False, slots=True)
class EgoAndLead:
    """The ego and its lead over k steps; NaN without a lead."""

    t: FloatArray  # s since the scenario's start
    v: FloatArray  # The ego's speed, m/s; `a` its acceleration, m/s2
    a: FloatArray
    agent: IntArray  # Index of the lead's track, -1: none
    # Along the path from the ego's front bumper to the lead's nearest part in the band, m; 0 where
    # they touch
    gap: FloatArray
    u: FloatArray  # The lead's speed along the path, m/s; `w` across it, positive to the left
    w: FloatArray
    decel: FloatArray  # The lead's deceleration along the path, m/s2; 0 if it does not brake
    low: FloatArray  # The lead's rightmost l, m; `high` its leftmost
    high: FloatArray
    facing: FloatArray  # Cosine of the angle between the lead's heading and the path


@once
def ahead_of(trace: Trace, scenario: Scenario) -> EgoAndLead:
    """Return the lead at each step of `grid_of(trace)`."""
    ego, car = grid_of(trace), car_of(scenario)
    states = np.stack([ego.x, ego.y, ego.yaw, ego.v, ego.kappa])
    rows, agent = nearest(
        trace.agents, ego.t, lambda k, seen, others: _leads(states[:, k], car, others)
    )
    return EgoAndLead(ego.t, ego.v, ego.a, agent, *rows)


@inner_kernel
def arc_point(kappa: float, x: float, y: float) -> tuple[float, float]:
    """Return s and l (1) of a point in the frame of the rear axle."""
    side, up = 1.0 - kappa * y, kappa * x
    s = atan2(up, side) / kappa if kappa != 0.0 else x
    return s, (2.0 * y - kappa * (x * x + y * y)) / (1.0 + hypot(side, up))


@inner_kernel
def _least_s_within(s0: float, l0: float, s1: float, l1: float, half: float) -> float:
    """Return the least s of the part of a segment within |l| <= half; inf if no part is."""
    if max(l0, l1) < -half or min(l0, l1) > half:
        return np.inf
    least = np.inf
    if abs(l0) <= half:
        least = s0
    if abs(l1) <= half:
        least = min(least, s1)
    if l0 != l1:
        for edge in (-half, half):
            u = (edge - l0) / (l1 - l0)
            if 0.0 <= u <= 1.0:
                least = min(least, s0 + u * (s1 - s0))
    return least


@inner_kernel
def extent(
    x: float, y: float, yaw: float, kappa: float, half: float, outline: FloatArray
) -> tuple[float, float, float, float, float]:
    """Return for a box with corners `outline` `(4, 2)`: least s in the band (inf: none), ranges of
    s and l (1).
    """
    c, s = cos(yaw), sin(yaw)
    near, s_low, s_high, l_low, l_high = np.inf, np.inf, -np.inf, np.inf, -np.inf
    before = np.zeros(2)
    for i in range(4 * PIECES + 1):
        at, u = (i // PIECES) % 4, (i % PIECES) / PIECES
        dx = (1.0 - u) * outline[at, 0] + u * outline[(at + 1) % 4, 0] - x
        dy = (1.0 - u) * outline[at, 1] + u * outline[(at + 1) % 4, 1] - y
        along, left = arc_point(kappa, c * dx + s * dy, c * dy - s * dx)
        s_low, s_high = min(s_low, along), max(s_high, along)
        l_low, l_high = min(l_low, left), max(l_high, left)
        if i > 0 and abs(kappa * (along - before[0])) < pi:
            near = min(near, _least_s_within(before[0], before[1], along, left, half))
        before[0], before[1] = along, left
    return near, s_low, s_high, l_low, l_high


@inner_kernel
def within_look(
    x: float, y: float, yaw: float, kappa: float, other_x: float, other_y: float, reach: float
) -> bool:
    """Return whether a box of half diagonal `reach` may lie along the path: near, and not past the
    circle's centre.
    """
    dx, dy = other_x - x, other_y - y
    return hypot(dx, dy) <= LOOK_M + reach and kappa * (dy * cos(yaw) - dx * sin(yaw)) < 1.0


@kernel
def _leads(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> tuple[FloatArray, IntArray]:
    """Return rows gap to facing of `EgoAndLead` `(7, k)`, agent `(k,)`; `ego`: x, y, yaw, v, kappa
    of the rear axle.
    """
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    half, front = 0.5 * car.width, car.axle + 0.5 * car.length
    rows, agent = np.full((7, steps), np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw, kappa, best = ego[0, k], ego[1, k], ego[2, k], ego[4, k], np.inf
        if ego[3, k] < -STANDING_MPS:
            continue
        for i in range(len(size)):
            reach = 0.5 * hypot(size[i, 0], size[i, 1])
            if not others.there[i, k] or not within_look(
                x, y, yaw, kappa, pose[0, i, k], pose[1, i, k], reach
            ):
                continue
            dx, dy = pose[0, i, k] - x, pose[1, i, k] - y
            ahead, left = dx * cos(yaw) + dy * sin(yaw), dy * cos(yaw) - dx * sin(yaw)
            if abs(arc_point(kappa, ahead, left)[1]) > half + reach:
                continue
            outline = corners(pose[0, i, k], pose[1, i, k], pose[2, i, k], size[i, 0], size[i, 1])
            near, _, _, low, high = extent(x, y, yaw, kappa, half, outline)
            if not car.axle < near < min(best, front + LOOK_M) or abs(kappa * near) > 0.5 * pi:
                continue
            path, vx, vy = yaw + kappa * near, pose[3, i, k], pose[4, i, k]
            u, w, speed = (
                vx * cos(path) + vy * sin(path),
                vy * cos(path) - vx * sin(path),
                hypot(vx, vy),
            )
            if u < -COMING_MPS:
                continue
            best, agent[k] = near, i
            rows[0, k], rows[1, k], rows[2, k] = max(near - front, 0.0), u, w
            accel = others.accel[i, k] if np.isfinite(others.accel[i, k]) else 0.0
            rows[3, k] = max(-accel * u / speed, 0.0) if speed > STANDING_MPS else 0.0
            rows[4, k], rows[5, k], rows[6, k] = low, high, cos(pose[2, i, k] - path)
    return rows, agent


def required_decel(gap: FloatArray, v: FloatArray, u: FloatArray, decel: FloatArray) -> FloatArray:
    """Return (4) `(n,)`, m/s2, positive; NaN where the gap is 0 or unknown."""
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
    """Return (6) `(n,)`, m/s2; NaN where the gap is 0 or unknown."""
    # Tiny closing speed: infinite time, 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        time = ahead.gap / np.maximum(ahead.v - ahead.u, 0.0)
        left, right = ahead.high + ahead.w * time + half, half - ahead.low - ahead.w * time
        needed = 2.0 * np.maximum(np.minimum(left, right), 0.0) / time**2
    return np.where(ahead.gap > 0.0, np.where(ahead.v > ahead.u, needed, 0.0), np.nan)


def required_gap(v: FloatArray) -> FloatArray:
    """Return the required gap (8) `(n,)`, m."""
    return np.maximum(v * np.interp(v, R157_MPS, R157_S), R157_LEAST_M)


def _quotient(above: FloatArray, below: FloatArray, known: BoolArray) -> FloatArray:
    return np.divide(above, below, out=np.full(len(above), np.nan), where=known)


def _required_decel(ahead: EgoAndLead, scenario: Scenario) -> FloatArray:
    return required_decel(ahead.gap, ahead.v, ahead.u, ahead.decel)


def _following_margin(ahead: EgoAndLead, scenario: Scenario) -> FloatArray:
    both_stand = (ahead.v <= COMING_MPS) & (np.abs(ahead.u) <= COMING_MPS)
    follows = (ahead.facing >= _ALONG) & ((ahead.u > COMING_MPS) | both_stand)
    return np.where(follows, ahead.gap - required_gap(ahead.v), np.nan)


def _of_lead(
    trace: Trace,
    scenario: Scenario,
    *,
    value: Callable[[EgoAndLead, Scenario], FloatArray],
    missing: str = _ALONE,
    vehicles: bool = False,
) -> Measured:
    ahead = ahead_of(trace, scenario)
    found = value(ahead, scenario)
    if vehicles:
        no_vehicle = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
        vehicle = np.array(
            [*(kind not in no_vehicle for kind in trace.agents.kinds), False], np.bool_
        )
        found = np.where(vehicle[ahead.agent], found, np.nan)
    return Series(ahead.t, found, labels_of(trace, ahead.agent), missing)


_PATH = (
    f"path: the arc of the ego's curvature, {LOOK_M:g} m ahead, at most a quarter turn",
    f"every {GRID_S:g} s",
)
_LEAD = "a lead in the ego's path"
FOLLOWING = (
    Metric(
        "headway",
        "m",
        "higher",
        (Mode.CLOSED,),
        partial(_of_lead, value=lambda ahead, scenario: ahead.gap),
        (MIN,),
        "Gap along the ego's path from its front bumper to the lead.",
        CATALOGUE,
        formula="s_lead - s_front",
        parameters=_PATH,
        needs=_LEAD,
    ),
    Metric(
        "thw",
        "s",
        "higher",
        (Mode.CLOSED,),
        partial(
            _of_lead,
            value=lambda ahead, scenario: _quotient(ahead.gap, ahead.v, ahead.v > STANDING_MPS),
            missing=f"{_ALONE} while it drove",
        ),
        (MIN, time_below(SHORT_THW_S, "time_below_900ms")),
        "Time headway: until the ego's front is where the lead's rear is now, at constant speed.",
        CATALOGUE,
        formula="gap / v",
        parameters=(f"bound {SHORT_THW_S:g} s (fined in Germany)", *_PATH),
        needs="a lead in the path of an ego that drives",
    ),
    Metric(
        "drac",
        "m/s2",
        "lower",
        (Mode.CLOSED,),
        partial(
            _of_lead,
            value=lambda ahead, scenario: _quotient(
                np.maximum(ahead.v - ahead.u, 0.0) ** 2, 2.0 * ahead.gap, ahead.gap > 0.0
            ),
        ),
        (MAX,),
        "Deceleration rate to avoid a crash with a lead that holds its speed.",
        CATALOGUE,
        formula="(v - u)^2 / (2 gap) where v > u, else 0",
        parameters=_PATH,
        needs=_LEAD,
    ),
    Metric(
        "required_decel",
        "m/s2",
        "lower",
        (Mode.CLOSED,),
        partial(_of_lead, value=_required_decel),
        (MAX, time_outside(-np.inf, EMERGENCY_MPS2, "time_in_emergency")),
        "Least constant deceleration that avoids a lead that goes on braking as it does until it "
        "stands.",
        f"{CATALOGUE}; emergency: UN R157",
        formula="b_o + (v - u)^2 / (2 gap) where the speeds meet before the lead stands, else"
        " v^2 / (2 (gap + u^2 / (2 b_o)))",
        parameters=(f"emergency above {EMERGENCY_MPS2:g} m/s2", *_PATH),
        needs=_LEAD,
    ),
    Metric(
        "btn",
        "1",
        "lower",
        (Mode.CLOSED,),
        partial(
            _of_lead,
            value=lambda ahead, scenario: (
                _required_decel(ahead, scenario) / scenario.vehicle.max_decel
            ),
        ),
        (MAX, time_outside(-np.inf, 1.0, "time_above_1")),
        "Brake threat number: required over greatest deceleration; above 1 braking alone does not "
        "suffice.",
        CATALOGUE,
        formula="a_req / a_max",
        parameters=("a_max: the vehicle's max_decel", *_PATH),
        needs=_LEAD,
    ),
    Metric(
        "stn",
        "1",
        "lower",
        (Mode.CLOSED,),
        partial(
            _of_lead,
            value=lambda ahead, scenario: (
                required_lateral(ahead, 0.5 * scenario.vehicle.width) / STEER_MPS2
            ),
        ),
        (MAX, time_outside(-np.inf, 1.0, "time_above_1")),
        "Steer threat number: lateral acceleration that is required to pass the lead, over what is "
        "available.",
        "commonroad-crime 0.4.5",
        formula=(
            "2 max(min(l_high + w T + h, h - l_low - w T), 0) / T^2 / a_lat,max, T = gap / (v - u)"
        ),
        parameters=(f"a_lat,max {STEER_MPS2:g} m/s2", *_PATH),
        needs=_LEAD,
    ),
    Metric(
        "following_gap",
        "m",
        "higher",
        (Mode.CLOSED,),
        partial(
            _of_lead, value=_following_margin, missing="the ego followed no vehicle", vehicles=True
        ),
        (MIN, time_below(0.0, "time_too_near")),
        "Gap to the vehicle that the ego follows, less the minimum following gap of UN R157.",
        "UN R157, 5.2.3.3",
        formula="gap - max(v t_front(v), 2 m)",
        parameters=(
            "t_front 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6 s at 7.2, 10, 20, 30, 40, 50, 60 km/h, "
            "linear between, 1.6 s"
            " beyond",
            *_PATH,
        ),
        needs="a vehicle that drives on in the ego's path, or stands where the ego stands",
    ),
)


RHO_S = 0.75
A_MAX_MPS2, B_MIN_MPS2, B_MAX_MPS2 = 3.0, 6.0, 6.0
A_LAT_MPS2, B_LAT_MPS2 = 1.0, 1.0
MU_M = 0.3
_EPS = 1e-6  # Rounding tolerance when accelerations and times are compared


@kernel
def _stopping(v: float) -> float:
    faster = v + RHO_S * A_MAX_MPS2
    return v * RHO_S + 0.5 * A_MAX_MPS2 * RHO_S**2 + faster * faster / (2.0 * B_MIN_MPS2)


@kernel
def longitudinal_distance(v: float, u: float) -> float:
    """Return the minimum longitudinal distance (9), m."""
    if u < -STANDING_MPS:
        return _stopping(v) + _stopping(-u)
    return max(_stopping(v) - u * u / (2.0 * B_MAX_MPS2), 0.0)


@inner_kernel
def _lateral_way(c: float) -> float:
    then = c + RHO_S * A_LAT_MPS2
    return 0.5 * (c + then) * RHO_S + then * abs(then) / (2.0 * B_LAT_MPS2)


@kernel
def lateral_distance(w: float, swerves: bool) -> float:
    """Return the minimum lateral distance (10), m; `w` m/s towards the ego's path."""
    return MU_M + max(_lateral_way(0.0) + (_lateral_way(w) if swerves else 0.0), 0.0)


@kernel
def _margins(
    ego: FloatArray, car: EgoOutline, others: OtherBoxes, i: int, movable: bool
) -> FloatArray:
    """Return d_lon - d_lon,min, d_lat - d_lat,min, side (1 left, -1 right) of agent i, `(3, k)`;
    NaN: not judged.
    """
    there, pose, size = others.there[i], others.pose[:, i], others.size[i]
    steps, half = len(there), 0.5 * car.width
    front, rear = car.axle + 0.5 * car.length, car.axle - 0.5 * car.length
    out = np.full((3, steps), np.nan)
    reach = 0.5 * hypot(size[0], size[1])
    for k in range(steps):
        x, y, yaw, v, kappa = ego[0, k], ego[1, k], ego[2, k], ego[3, k], ego[4, k]
        if (
            not there[k]
            or v <= STANDING_MPS
            or not within_look(x, y, yaw, kappa, pose[0, k], pose[1, k], reach)
        ):
            continue
        outline = corners(pose[0, k], pose[1, k], pose[2, k], size[0], size[1])
        _, s_low, s_high, l_low, l_high = extent(x, y, yaw, kappa, half, outline)
        if s_high < rear or abs(kappa * s_low) > 0.5 * pi:
            continue
        path, vx, vy = yaw + kappa * 0.5 * (s_low + s_high), pose[3, k], pose[4, k]
        u, left = vx * cos(path) + vy * sin(path), vy * cos(path) - vx * sin(path)
        side = 1.0 if l_low + l_high >= 0.0 else -1.0
        aside = l_low - half if side > 0.0 else -half - l_high
        out[0, k] = s_low - front - longitudinal_distance(v, u)
        out[1, k] = aside - lateral_distance(-side * left, movable and hypot(vx, vy) > STANDING_MPS)
        out[2, k] = side
    return out


@kernel
def _improper_response(
    t: FloatArray, ego: FloatArray, accel: FloatArray, margins: FloatArray
) -> BoolArray:
    """Return at which steps `(k,)` the response to one agent is not proper (12)."""
    out = np.zeros(len(t), np.bool_)
    start, lateral, allowed = -1, False, np.nan
    for k in range(len(t)):
        if not (margins[0, k] < 0.0 and margins[1, k] < 0.0):
            start = -1
            continue
        if start < 0:
            start, lateral, allowed = (
                k,
                k > 0 and margins[0, k - 1] < 0.0 and margins[1, k - 1] >= 0.0,
                np.nan,
            )
        waited = t[k] - t[start] - RHO_S
        if accel[k] > A_MAX_MPS2 + _EPS:
            out[k] = True
        elif waited >= -_EPS and lateral:
            c, s, kappa = cos(ego[2, start]), sin(ego[2, start]), ego[4, start]
            dx, dy = ego[0, k] - ego[0, start], ego[1, k] - ego[1, start]
            along, _ = arc_point(kappa, c * dx + s * dy, c * dy - s * dx)
            towards = ego[3, k] * sin(ego[2, k] - ego[2, start] - kappa * along) * margins[2, start]
            if not np.isfinite(allowed):
                allowed = max(towards, 0.0)
            out[k] = towards > max(allowed - B_LAT_MPS2 * waited, 0.0) + STANDING_MPS
        elif waited >= -_EPS:
            out[k] = accel[k] > -B_MIN_MPS2 + _EPS
    return out


@once
def _rss(trace: Trace, scenario: Scenario) -> tuple[Series, Series]:
    """Return the least margin (NaN: no agent is judged), and 1 where any response is improper."""
    ego, car = grid_of(trace), car_of(scenario)
    states = np.stack([ego.x, ego.y, ego.yaw, ego.v, ego.kappa])
    margin, improper = np.full(len(ego.t), np.nan), np.zeros(len(ego.t))
    labels, blamed = [""] * len(ego.t), [""] * len(ego.t)
    for i, others, row in each(trace.agents, ego.t):
        movable = trace.agents.kinds[i] is not AgentKind.OBJECT and not bool(trace.agents.static[i])
        found = _margins(states, car, others, row, movable)
        name, least = name_of(trace.agents, i), np.maximum(found[0], found[1])
        for k in np.flatnonzero(np.isfinite(least) & ~(margin <= least)):
            margin[k], labels[k] = least[k], name
        for k in np.flatnonzero(_improper_response(ego.t, states, ego.a, found)):
            improper[k], blamed[k] = 1.0, name
    nothing = f"no other road user ahead or beside within {LOOK_M:g} m while the ego drove"
    return Series(ego.t, margin, tuple(labels), nothing), Series(ego.t, improper, tuple(blamed))


def _response(trace: Trace, scenario: Scenario) -> Measured:
    margin, improper = _rss(trace, scenario)
    return (
        improper
        if (margin.value < 0.0).any()
        else Unavailable("no dangerous situation: no response was due")
    )


_SOURCE = "Shalev-Shwartz et al., arXiv 1708.06374; parameters: JRC-FSM 01b05c29"
_PARAMETERS = (
    f"rho {RHO_S:g} s",
    f"a_max {A_MAX_MPS2:g} m/s2",
    f"b_min {B_MIN_MPS2:g} m/s2",
    f"b_max {B_MAX_MPS2:g} m/s2",
    f"a_lat {A_LAT_MPS2:g} m/s2",
    f"b_lat {B_LAT_MPS2:g} m/s2",
    f"mu {MU_M:g} m",
    f"along the arc of the ego's curvature, {LOOK_M:g} m ahead",
    f"every {GRID_S:g} s",
)
RSS_MARGIN = Metric(
    "rss_margin",
    "m",
    "higher",
    (Mode.CLOSED,),
    lambda trace, scenario: _rss(trace, scenario)[0],
    (
        MIN,
        time_below(0.0, "time_dangerous"),
        share_while(lambda value: value < 0.0, "share_dangerous"),
    ),
    "Distance from a dangerous situation of RSS: the greater of the longitudinal and the lateral "
    "surplus, the least of "
    "all agents ahead or beside; negative: dangerous.",
    _SOURCE,
    formula="min over agents of max(d_lon - d_lon,min, d_lat - d_lat,min)",
    parameters=_PARAMETERS,
    needs="another ahead or beside, and an ego that drives",
)
RSS_IMPROPER = Metric(
    "rss_improper",
    "1",
    "lower",
    (Mode.CLOSED,),
    _response,
    (time_outside(-np.inf, 0.5, "time"), share_while(lambda value: value > 0.5, "share")),
    "Where the ego does not give the proper response of RSS: rho after the danger began it brakes "
    "with less than "
    "b_min, or goes on nearing sideways, or it accelerates with more than a_max.",
    _SOURCE,
    formula=(
        "dangerous, and after rho a > -b_min (lateral danger last: v_lat > max(v_lat(rho) - "
        "b_lat t, 0))"
    ),
    parameters=_PARAMETERS,
    needs="a dangerous situation",
)
