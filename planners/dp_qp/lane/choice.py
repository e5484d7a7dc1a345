"""Cross-lane choice: keep the lane or change, by cost with hysteresis and a safety protocol (paper, section II-F).

The neighbours are looked at where the route asks for a change, a slow agent is ahead, the plan in the lane fails, or a
change is under way (so that it can be aborted). A neighbour is taken where it is cheaper by `hysteresis_s` and no agent
on it is endangered:

(1) gap behind >= MIN_GAP_M + REACTION_S max(0, v_a - v) + max(0, v_a - v)^2 / (2 YIELD_MPS2)      for each follower
(2) no agent beside the ego, from MIN_GAP_M behind its rear to MIN_GAP_M before its front
(3) those ahead are met in the lane's own S-T graph; the plan must not need hard braking

The plan past who is slower (`passing`) is a candidate like a neighbour: it must be comfortable and cheaper by
`hysteresis_s`, once it is under way not dearer by more than that, and (1) and (2) hold for the lane that it borrows.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Artefact, CostTerms, LaneOption
from planners.dp_qp.config import LaneConfig
from planners.dp_qp.lane.plan import LanePlan
from planners.frenet.scene import Scene
from planners.rules.rulebook import YIELD_MPS2

MIN_GAP_M = 2.0
"""Least gap to who follows (1) or is beside (2), m."""
REACTION_S = 1.0
"""Of who follows, before they brake with `YIELD_MPS2` (1), s."""
INSIDE_M = 1.0
"""An ego nearer than this to a lane's reference line drives in that lane, m."""
SLOWEST_CHANGE_MPS = 1.0
"""A slower ego does not begin to change, m/s: it would stand across the marking."""


def worth_looking(keep: LanePlan, config: LaneConfig, *, since_change: float) -> bool:
    """Whether the neighbours are planned, given the plan in the lane and the time (s) since the last change."""
    under_way = abs(keep.scene.l) > INSIDE_M
    if under_way:
        return not keep.is_comfortable
    slow = keep.time_lost > config.look_s and since_change > config.dwell_s
    return keep.lane.changes != 0 or slow or not keep.is_comfortable


def hopeless(name: str, scene: Scene, least: CostTerms, keep: LanePlan, hysteresis_s: float) -> LaneOption | None:
    """Why a neighbour need not be planned, given what it costs at least; None where it may be taken."""
    cost = sum(value for _, value in least.terms)
    against = ""
    if not cost < keep.cost - hysteresis_s:
        against = f"costs at least {cost:.1f} s, {keep.name} {keep.cost:.1f} s: not {hysteresis_s:.1f} s better"
    elif abs(scene.l) > INSIDE_M:
        against = _unsafe(scene)
    return LaneOption(name, least.terms, against) if against else None


def choose(keep: LanePlan, others: list[LanePlan], hysteresis_s: float) -> tuple[LanePlan, tuple[Artefact, ...]]:
    """The cheapest lane that may be taken, and what was considered."""
    best, rejected = keep, dict[str, str]()
    for other in others:
        against = "" if other.is_comfortable else other.trouble
        if not against and abs(other.scene.l) > INSIDE_M:
            against = _unsafe(other.scene)
        needed = hysteresis_s if best is keep else 0.0
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


def _unsafe(scene: Scene) -> str:
    """Why a change into the scene's lane may not be begun now; empty where it may."""
    return "too slow to change" if scene.frame.ego.v < SLOWEST_CHANGE_MPS else endangered(scene)


def worth_passing(keep: LanePlan, past: LanePlan, hysteresis_s: float, *, under_way: bool) -> str:
    """Why the driven lane is not driven past who is slower; empty where it is."""
    if not past.is_comfortable and (keep.is_comfortable or not under_way):
        return past.trouble
    needed = -hysteresis_s if under_way else hysteresis_s
    if not past.cost < keep.cost - needed:
        return f"costs {past.cost:.1f} s, keep {keep.cost:.1f} s" + (" and it is not begun" if not under_way else "")
    return ""


def borrowing_endangers(scene: Scene, *, left: bool) -> str:
    """Which agent an ego that borrows the road beside its lane would endanger (1), (2), and how; empty where none."""
    lane = scene.reference
    return _endangered(scene, *((lane.lane_left, lane.road_left) if left else (lane.road_right, lane.lane_right)))


def endangered(scene: Scene) -> str:
    """Which agent a change into the scene's lane would endanger (1), (2), and how; empty where none."""
    return _endangered(scene, scene.reference.lane_right, scene.reference.lane_left)


def _endangered(scene: Scene, right_edge: FloatArray, left_edge: FloatArray) -> str:
    """As `endangered`, between two edges `(n,)`."""
    agents, along, stations = scene.frame.agents, scene.agents, scene.reference.line.s
    left, right = (np.interp(along.s, stations, edge) for edge in (left_edge, right_edge))
    inside = (along.l - 0.5 * agents.width < left) & (along.l + 0.5 * agents.width > right)
    for i in np.flatnonzero(inside).tolist():
        head, tail = along.s[i] + 0.5 * agents.length[i], along.s[i] - 0.5 * agents.length[i]
        if tail > scene.front + MIN_GAP_M:
            continue
        if head > scene.rear - MIN_GAP_M:
            return f"{scene.name(i)} is beside"  # (2)
        closing = max(0.0, float(along.v_s[i]) - scene.frame.ego.v)
        needed = MIN_GAP_M + REACTION_S * closing + closing**2 / (2.0 * YIELD_MPS2)  # (1)
        gap = scene.rear - head
        if gap < needed:
            return f"{scene.name(i)} is {gap:.1f} m behind and {closing:.1f} m/s faster: needs {needed:.1f} m"
    return ""
