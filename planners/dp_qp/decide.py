"""Cross-lane choice: keep the lane or change, by cost with hysteresis and a safety protocol (paper, section II-F).

The neighbours are looked at where the route asks for a change, somebody slow is ahead, the plan in the lane fails, or a
change is under way (so that it can be aborted). A neighbour is taken where it is cheaper by HYSTERESIS_S and nobody on
it is endangered:

(1) gap behind >= MIN_GAP_M + REACTION_S max(0, v_a - v) + max(0, v_a - v)^2 / (2 YIELD_MPS2)      for each follower
(2) nobody beside the ego, from MIN_GAP_M behind its rear to MIN_GAP_M before its front
(3) those ahead are met in the lane's own S-T graph; the plan must not need hard braking

The plan past who is slower (`passing`) is a candidate like a neighbour: it must be comfortable and cheaper by
HYSTERESIS_S, once it is under way not dearer by more than that, and (1) and (2) hold for the lane that it borrows.
"""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.trace import Artefact, LaneOption
from logs.vehicle import VehicleParameters
from planners.dp_qp.lane_plan import LanePlan
from planners.dp_qp.reference_line import Course
from planners.dp_qp.st_graph import agents_frenet

HYSTERESIS_S = 0.5
LOOK_S = 1.0
"""Time lost to others from which the neighbours are looked at."""
MIN_GAP_M, REACTION_S, YIELD_MPS2 = 2.0, 1.0, 2.0
INSIDE_M = 1.0
"""An ego nearer than this to a lane's reference line drives in that lane."""
SLOWEST_CHANGE_MPS = 1.0
DWELL_S = 3.0
"""No change back within this time after a change, unless the lane fails."""


def worth_looking(keep: LanePlan, *, since_change: float) -> bool:
    """Whether the neighbours are planned, given the plan in the lane and the time (s) since the last change."""
    under_way = abs(keep.l) > INSIDE_M
    if under_way:
        return not keep.is_comfortable
    return keep.strip.changes != 0 or (keep.time_lost > LOOK_S and since_change > DWELL_S) or not keep.is_comfortable


def choose(
    keep: LanePlan, others: list[LanePlan], frame: Frame, vehicle: VehicleParameters
) -> tuple[LanePlan, tuple[Artefact, ...]]:
    """The cheapest lane that may be taken, and what was considered."""
    best, rejected = keep, dict[str, str]()
    for other in others:
        against = _against(other, frame, vehicle)
        needed = HYSTERESIS_S if best is keep else 0.0
        if not against and not other.cost < best.cost - needed:
            against = f"costs {other.cost:.1f} s, {best.name} {best.cost:.1f} s"
            against += f": not {needed:.1f} s better" if other.cost < best.cost else ""
        if against:
            rejected[other.name] = against
            continue
        if best is not keep:
            rejected[best.name] = f"costs {best.cost:.1f} s, {other.name} {other.cost:.1f} s"
        best = other
    if best is not keep:
        rejected[keep.name] = f"costs {keep.cost:.1f} s, {best.name} {best.cost:.1f} s"
    compared = (LaneOption(one.name, one.costs.terms, rejected.get(one.name, "")) for one in (keep, *others))
    return best, tuple(compared)


def _against(other: LanePlan, frame: Frame, vehicle: VehicleParameters) -> str:
    """Why a lane may not be taken; empty where it may."""
    if not other.is_comfortable:
        return other.path.reason or (other.speed.reason if other.speed else "") or "no plan"
    if abs(other.l) <= INSIDE_M:
        return ""
    if frame.ego.v < SLOWEST_CHANGE_MPS:
        return "too slow to change"
    return endangered(other.strip.course, frame, other.s, vehicle)


def worth_passing(keep: LanePlan, past: LanePlan, *, under_way: bool) -> str:
    """Why the driven lane is not driven past who is slower; empty where it is."""
    if not past.is_comfortable and (keep.is_comfortable or not under_way):
        return past.path.reason or (past.speed.reason if past.speed else "") or "no plan"
    needed = -HYSTERESIS_S if under_way else HYSTERESIS_S
    if not past.cost < keep.cost - needed:
        return f"costs {past.cost:.1f} s, keep {keep.cost:.1f} s" + (" and it is not begun" if not under_way else "")
    return ""


def borrowing_endangers(course: Course, frame: Frame, s_ego: float, vehicle: VehicleParameters, *, left: bool) -> str:
    """Whom an ego that borrows the road beside its lane would endanger (1), (2); empty where nobody."""
    edges = (course.lane_left, course.road_left) if left else (course.road_right, course.lane_right)
    return _endangered(course, frame, s_ego, vehicle, *edges)


def endangered(course: Course, frame: Frame, s_ego: float, vehicle: VehicleParameters) -> str:
    """Whom a change into the lane would endanger (1), (2); empty where nobody."""
    return _endangered(course, frame, s_ego, vehicle, course.lane_right, course.lane_left)


def _endangered(
    course: Course, frame: Frame, s_ego: float, vehicle: VehicleParameters, right_edge: FloatArray,
    left_edge: FloatArray,
) -> str:  # fmt: skip
    """As `endangered`, between two edges `(n,)`."""
    agents, line = frame.agents, course.line
    frenet = agents_frenet(line.s, line.coef, agents.x, agents.y, s_ego, 120.0)
    yaw = np.interp(frenet[:, 0], line.s, line.yaw)
    along = agents.vx * np.cos(yaw) + agents.vy * np.sin(yaw)
    left = np.interp(frenet[:, 0], line.s, left_edge)
    right = np.interp(frenet[:, 0], line.s, right_edge)
    inside = (frenet[:, 1] - 0.5 * agents.width < left) & (frenet[:, 1] + 0.5 * agents.width > right)
    rear, front = s_ego - vehicle.rear_overhang, s_ego + vehicle.axle_to_front
    for i in np.flatnonzero(inside):
        head, tail = frenet[i, 0] + 0.5 * agents.length[i], frenet[i, 0] - 0.5 * agents.length[i]
        if tail > front + MIN_GAP_M:
            continue
        name = f"{agents.kinds[i].value} {agents.ids[i]}"
        if head > rear - MIN_GAP_M:
            return f"{name} is beside"
        closing = max(0.0, float(along[i]) - frame.ego.v)
        needed = MIN_GAP_M + REACTION_S * closing + closing**2 / (2.0 * YIELD_MPS2)
        if rear - head < needed:
            return f"{name} is {rear - head:.1f} m behind and {closing:.1f} m/s faster: needs {needed:.1f} m"
    return ""
