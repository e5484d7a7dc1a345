"""What a recording shows of a lattice plan: both graphs, decisions, costs."""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Artefact, Corridor, CostTerms, Decision, DecisionKind, GraphObstacle, SlGraph, StGraph
from planners.frenet.path import Path
from planners.frenet.profiles import STEP_S
from planners.frenet.scene import Scene
from planners.frenet.st_boundaries import StGraphConfig, decide_speed, outlines, st_boundaries
from planners.lattice.candidates import COST_PARTS, Pairs
from planners.lattice.config import LatticeConfig
from planners.lattice.futures import Ego, Futures

EVERY = 4
"""Samples of the plan per point of the S-L graph."""


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
