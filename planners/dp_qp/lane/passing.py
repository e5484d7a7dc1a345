"""The driven lane planned past those who are slower: path and speed found in turns (paper, section II-F, "nudge").

The plan that keeps the lane follows them. A second plan of the same lane passes them where `scene.moving_obstacles`
says; it is taken where it is worth it and safe (`choice`). Its first turn counts on the speed of a road
without them, the next on the speed that the turn before found, at most `TURNS` in one frame; later frames go on from
the last one's plan. It is a plan only if, by its own speed, it gets past the nearest of them within the predictions.

The lane beside may be borrowed on the passing side; whoever follows there must not have to brake (`choice`, (1) and
(2)), until the ego is over the marking and is seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Artefact, Candidates
from planners.dp_qp.config import DpQpConfig
from planners.dp_qp.lane.choice import borrowing_endangers, worth_passing
from planners.dp_qp.lane.plan import FORGET_S, LaneMemory, LanePlan, LanePlanner, PassWay
from planners.dp_qp.path.bounds import CorridorConfig
from planners.dp_qp.scene.moving_obstacles import along_lane, gone_on, pass_targets, to_pass
from planners.frenet.profiles import STEP_S
from planners.frenet.scene import Scene

TURNS = 3
"""Turns of path and speed in one frame."""
SETTLED_M = 1.0
"""Boxes that a further turn moves by less than this are settled, m."""


@dataclass(frozen=True, eq=False, slots=True)
class PassMemory:
    """What is remembered of passing those who are slower, in one lane.

    Attributes:
        t: When it was thought of last, s.
        passed: Those that the ego is passing.
        given_up: Who was not passed in the end, when, s.
        stations: Of the last plan that passes, at the times of the predictions since `t` `(k,)`, m; None: none.
        lane: Of the plans that pass, apart from those that keep the lane.
    """

    t: float = -inf
    passed: frozenset[str] = frozenset()
    given_up: Mapping[str, float] = field(default_factory=dict)
    stations: FloatArray | None = None
    lane: LaneMemory = field(default_factory=LaneMemory)


def passing(
    keep: LanePlan, planner: LanePlanner, memory: PassMemory, config: DpQpConfig, *, passes_left: bool
) -> tuple[LanePlan, tuple[Artefact, ...], PassMemory]:
    """The plan in the lane, past who is slower where that is worth it, else `keep`; what was considered; the memory."""
    scene, t, lane = keep.scene, keep.scene.frame.t, config.lane
    if not 0.0 <= t - memory.t <= FORGET_S:
        memory = PassMemory()
    if not memory.passed and keep.time_lost + keep.braking < lane.hysteresis_s:
        return keep, (), memory
    who, ids = along_lane(scene, memory.passed), scene.frame.agents.ids
    if not who and not memory.passed:
        return keep, (), PassMemory(t, given_up=memory.given_up, lane=memory.lane)
    past, names, after = _plan(keep, planner, memory, who, config.path.corridor, passes_left=passes_left)
    under_way = bool(names & memory.passed)
    against = worth_passing(keep, past, lane.hysteresis_s, under_way=under_way) if past is not None else "no plan"
    if not under_way and any(t - memory.given_up.get(name, -inf) < lane.dwell_s for name in names):
        against = "abandoned a moment ago"
    going = frozenset() if against else names
    given_up = {**memory.given_up, **{ids[i]: t for i in who if ids[i] in memory.passed - going}}
    memory = replace(after, t=t, passed=going, given_up=given_up)
    if past is None:
        return keep, (), memory
    rejected = f"pass: {against}" if against else f"keep: costs {keep.cost:.1f} s, pass {past.cost:.1f} s"
    considered = (keep.costs, past.costs, Candidates("passing", 2, ((rejected, 1),)))
    return keep if against else past, considered, memory


def _plan(
    keep: LanePlan, planner: LanePlanner, memory: PassMemory, who: list[int], config: CorridorConfig, *,
    passes_left: bool,
) -> tuple[LanePlan | None, frozenset[str], PassMemory]:  # fmt: skip
    """The plan past the nearest, all that it passes, and the memory; None where there is no such plan."""
    scene, t, lane = keep.scene, keep.scene.frame.predictions.t, memory.lane
    if not who:
        return None, frozenset(), replace(memory, stations=None)
    sides, stations = _sides(scene, passes_left=passes_left), memory.stations
    if stations is None or len(stations) != len(t):
        stations = gone_on(t, scene.s, scene.start.v, scene.limit)
    else:
        stations = _carried_on(t - t[0], stations, t - memory.t)
    found = pass_targets(scene, who, stations, memory.passed)
    for turn in range(TURNS):
        way = to_pass(scene, found, stations, sides, config, planner.places, memory.passed)
        if not way.obstacles:
            return None, frozenset(), replace(memory, stations=None, lane=lane)
        plan, lane = planner.plan("pass", scene, lane, PassWay(found, way))
        path, speed = plan.path.path, plan.speed
        if path is None or speed is None or speed.profile is None:
            return None, frozenset(), replace(memory, stations=None, lane=lane)
        sigma = speed.profile[0]
        reached = np.interp(sigma, path.sigma, path.s)  # on the reference line
        stations = _carried_on(STEP_S * np.arange(len(sigma)), reached, t - t[0])
        before, found = found, pass_targets(scene, who, stations, memory.passed)
        moved = [
            abs(a.box.s_from - b.box.s_from) + abs(a.box.s_to - b.box.s_to) for a, b in zip(before, found, strict=False)
        ]
        same = [one.agent for one in before] == [one.agent for one in found]
        if turn + 1 == TURNS or (same and max(moved, default=inf) < SETTLED_M):
            break
    names = frozenset(plan.path.passed) & {box.agent for box in way.obstacles} & {one.box.agent for one in found}
    if way.obstacles[0].agent not in names:
        return None, frozenset(), replace(memory, stations=None, lane=lane)
    return plan, names, replace(memory, stations=stations, lane=lane)


def _sides(scene: Scene, *, passes_left: bool) -> tuple[bool, bool]:
    """Whether the road left and right of the lane may be borrowed: on the passing side, without danger."""
    lane, stations = scene.reference, scene.reference.line.s
    left, right = (float(np.interp(scene.s, stations, edge)) for edge in (lane.lane_left, lane.lane_right))
    aside, edge = (scene.l, left) if passes_left else (-scene.l, -right)
    seen = aside + 0.5 * scene.vehicle.width > edge
    free = seen or not borrowing_endangers(scene, left=passes_left)
    return free and passes_left, free and not passes_left


def _carried_on(known: FloatArray, stations: FloatArray, t: FloatArray) -> FloatArray:
    """Stations `(n,)` of `known` times at other times `(k,)`; after the last with the last speed."""
    speed = (stations[-1] - stations[-2]) / (known[-1] - known[-2])
    return np.asarray(np.interp(t, known, stations) + speed * np.maximum(t - known[-1], 0.0))
