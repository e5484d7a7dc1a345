"""The planner's one screen: start, scene, pairs, the first of them in order of cost that passes; or the fallback.

And what a recording shows of a plan: both graphs, decisions, costs.
"""

from __future__ import annotations

import numpy as np

from logs.frame import Frame, PlannerContext
from logs.kernel import FloatArray
from logs.states import Trajectory
from logs.trace import (
    Artefact,
    Candidates,
    Corridor,
    CostTerms,
    Decision,
    DecisionKind,
    GraphObstacle,
    Internals,
    Plan,
    SlGraph,
    StGraph,
)
from planners.frenet.fallback import fall_back
from planners.frenet.occupancy import on_reference
from planners.frenet.path import Path
from planners.frenet.profiles import HORIZON_STEPS, STEP_S
from planners.frenet.scene import RouteTracker, Scene
from planners.frenet.st_boundaries import StGraphConfig, decide_speed, outlines, st_boundaries
from planners.lattice.candidates import COST_PARTS, LatticeConfig, Sampler, ego_frenet, futures_of
from planners.lattice.checks import (
    REASONS,
    REST_MPS,
    Body,
    Ego,
    Futures,
    Pairs,
    Room,
    first_feasible,
    lateral_polynomial,
    sampled,
    states,
)
from planners.rules import Rulebook, RuleMemory

EVERY = 4
"""Samples of the plan per point of the S-L graph."""


class Lattice:
    """Chooses among pairs of polynomials; its memory is the last station and what the rules remember.

    Where no pair can be driven, the ladder of `planners.frenet.fallback` answers: the rest of the previous plan, else a
    comfortable stop, else a hard one. Who follows behind is not looked at while the ego keeps its track.
    """

    def __init__(self, context: PlannerContext, config: LatticeConfig | None = None) -> None:
        self._config = config or LatticeConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        self._rules = Rulebook(context.road, self._tracker.reference, context.vehicle)
        self._memory = RuleMemory()
        passes_left = context.road.drives_on_right
        self._sampler = Sampler(self._tracker.reference, self._vehicle, self._config, passes_left=passes_left)

    def plan(self, frame: Frame) -> Plan:
        """The cheapest pair that can be driven, ties to the first; else the fallback, and why."""
        scene, start_kind = self._tracker.scene(frame)
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, scene.start, start_kind, None, scene.trouble, (), self._vehicle)
        ego = ego_frenet(scene)
        futures = futures_of(scene, ego, self._config)
        self._lap("scene")
        demanded, self._memory = self._rules.stops(scene, self._memory)
        stops = on_reference(demanded, scene.s, self._vehicle)
        pairs = self._sampler.pairs(ego, futures, stops)
        self._lap("candidates")
        car, line = self._vehicle, self._tracker.reference.line
        order = np.argsort(np.round(pairs.costs.sum(axis=0), 9), kind="stable")
        room = Room(line.s, line.coef, self._sampler.left, self._sampler.right)
        body = Body(car.axle_to_center, car.length, car.width, car.max_kappa, self._config.lat_accel_mps2)
        chosen, faults = first_feasible(pairs, order, ego, room, futures, body)
        dearer = len(pairs.row) - int(faults.sum()) - 1 if chosen >= 0 else 0
        counts = [(why, int((pairs.faults + faults)[fault])) for fault, why in REASONS.items()]
        counts = [count for count in (*counts, ("dearer than the chosen one", dearer)) if count[1]]
        counted = Candidates("lattice", len(pairs.row) + int(pairs.faults.sum()), tuple(counts))
        self._lap("choice")
        if chosen < 0:
            reason = "no candidate can be driven: " + ", ".join(f"{n} {why}" for why, n in counted.rejected)
            return fall_back(frame, scene.start, start_kind, None, reason, (counted,), self._vehicle)
        row, line = int(pairs.row[chosen]), scene.reference.line
        motion = sampled(pairs.lon.coef[row, None], pairs.lon.T[row, None], HORIZON_STEPS)[0]
        lateral = lateral_polynomial(np.array(ego.lateral), pairs.l1[chosen], pairs.length[chosen])
        at = states(line.s, line.coef, scene.s, lateral, pairs.length[chosen], motion)

        def internals() -> tuple[Artefact, ...]:
            shown = artefacts(scene, ego, futures, pairs, chosen, at, motion, self._config)
            return (*shown, *(stop.decision for stop in stops), counted)

        return Plan(trajectory(frame.t, at), start=start_kind, internals=Internals((), internals))


def trajectory(t: float, at: FloatArray) -> Trajectory:
    """The trajectory from time `t` of `states` `(9, k)`; a rest is a rest."""
    x, y, yaw, v, a, kappa = at[:6]
    rest = v < 1e-3
    times = t + STEP_S * np.arange(at.shape[1])
    return Trajectory(times, x, y, yaw, np.where(rest, 0.0, v), np.where(rest & (np.abs(a) < REST_MPS), 0.0, a), kappa)


def artefacts(
    scene: Scene, ego: Ego, futures: Futures, pairs: Pairs, chosen: int, at: FloatArray, motion: FloatArray,
    config: LatticeConfig,
) -> tuple[Artefact, ...]:  # fmt: skip
    """Graphs, decisions and costs of the pair `chosen` with `states` `at` `(9, k)` and `motion` `(3, k)`."""
    passed = _passed(scene, ego, futures, float(pairs.l1[chosen]), at, motion, config)
    costs = CostTerms("lattice", tuple(zip(COST_PARTS, pairs.costs[:, chosen].tolist(), strict=True)))
    graph = _sl_graph(scene, ego, futures, passed, at, motion)
    return (graph, *_along(scene, ego, futures, pairs.changes[chosen], at, config), *passed, costs)


def _along(
    scene: Scene, ego: Ego, futures: Futures, changes: bool, at: FloatArray, config: LatticeConfig
) -> tuple[Artefact, ...]:  # fmt: skip
    """The S-T graph along the planned path, and who is followed, let go first or driven ahead of."""
    step = np.hypot(np.diff(at[0]), np.diff(at[1]))
    keep = np.r_[True, step > 1e-3]
    x, y, yaw, kappa = at[0, keep], at[1, keep], at[2, keep], at[5, keep]
    sigma = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
    d = np.arange(1.0, 30.0)  # straight on beyond the end, so that the one it stops for is seen
    sigma, kappa = np.r_[sigma, sigma[-1] + d], np.r_[kappa, np.zeros(len(d))]
    x, y = np.r_[x, x[-1] + d * np.cos(yaw[-1])], np.r_[y, y[-1] + d * np.sin(yaw[-1])]
    path = Path(sigma, x, y, np.r_[yaw, np.full(len(d), yaw[-1])], kappa, ego.s + sigma)
    skip = np.ones(len(scene.frame.agents), np.bool_)
    skip[futures.agent[~futures.behind[int(changes)]]] = False
    exact = StGraphConfig(config.margin_m, config.vulnerable_margin_m, early_s=0.0, late_s=0.0)
    blocks = st_boundaries(scene, path, skip, frozenset(), exact)
    t = STEP_S * np.arange(at.shape[1])
    driven = np.r_[0.0, np.cumsum(step)]
    decisions = decide_speed(blocks, scene, np.interp(blocks.t, t, driven))
    profile = np.column_stack([t, driven])
    graph = StGraph(None, None, np.empty((0, 2)), profile, outlines(blocks, decisions))
    return (graph, *({decision.agent: decision for decision in decisions}.values()))


def _passed(
    scene: Scene, ego: Ego, futures: Futures, l1: float, at: FloatArray, motion: FloatArray, config: LatticeConfig
) -> tuple[Decision, ...]:  # fmt: skip
    """The standing agents in the middle of the road that the pair drives past, and on which side."""
    found = {}
    for j, i in enumerate(futures.agent):
        s, l, half_s, half_l = futures.frenet[:, j, 0]  # noqa: E741
        reached = ego.s < s and s + half_s < ego.s + motion[0, -1]
        in_the_way = abs(l) < half_l + 0.5 * scene.vehicle.width + config.margin_m
        if scene.standing[i] and reached and in_the_way:
            beside = float(np.interp(s - ego.s, motion[0], at[6]))
            kind = DecisionKind.NUDGE_LEFT if beside > l else DecisionKind.NUDGE_RIGHT
            gap = abs(beside - l) - half_l - 0.5 * scene.vehicle.width
            reason = f"stands in the middle of the lane: passed with {gap:.2f} m at the end offset {l1:.1f} m"
            found[scene.frame.agents.ids[i]] = Decision(scene.frame.agents.ids[i], kind, "path", reason)
    return tuple(found.values())


def _sl_graph(
    scene: Scene, ego: Ego, futures: Futures, passed: tuple[Decision, ...], at: FloatArray, motion: FloatArray
) -> SlGraph:  # fmt: skip
    """The chosen offsets over the stations, the road's edges, and who stands near."""
    lane, s = scene.reference, ego.s + motion[0, ::EVERY]
    line = np.column_stack([s, at[6, ::EVERY]])[np.r_[True, np.diff(s) > 1e-3]]
    grid = ego.s + np.arange(0.0, max(float(motion[0, -1]), 10.0), 4.0)
    side = 0.5 * scene.vehicle.width
    edges = [np.interp(grid, lane.line.s, edge) for edge in (lane.road_right + side, lane.road_left - side)]
    kinds = {decision.agent: decision.kind for decision in passed}
    boxes = []
    for j, i in enumerate(futures.agent):
        s_mid, l, half_s, half_l = futures.frenet[:, j, 0]  # noqa: E741
        if scene.standing[i] and abs(l) < 10.0:
            name = scene.frame.agents.ids[i]
            outline = np.array([(s_mid + a * half_s, l + b * half_l) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
            boxes.append(GraphObstacle(name, outline, kinds.get(name, DecisionKind.IGNORE)))
    return SlGraph(None, Corridor(grid, *edges), np.empty((0, 2)), line, tuple(boxes))
