"""What a plan of the lattice shows: both graphs, decisions, and the costs of the chosen pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.logs.plan import (
    Artefact,
    Corridor,
    CostTerms,
    Decision,
    DecisionKind,
    GraphObstacle,
    SlGraph,
    StGraph,
)
from replan.planners.frenet.path import Path, path_through
from replan.planners.frenet.profiles import STEP_S
from replan.planners.frenet.scene import Scene
from replan.planners.frenet.st_boundaries import (
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
)
from replan.planners.lattice.candidates import (
    COST_PARTS,
    KAPPA,
    OFFSET,
    YAW,
    FrenetStart,
    NearFutures,
    Pairs,
    X,
    Y,
)

EVERY = 4  # Samples of the plan per point of the S-L graph
DRAWN_M = 10.0  # Standing agents farther beside the line than this are not drawn, m


@dataclass(frozen=True, eq=False, slots=True)
class ChosenPair:
    """The chosen pair of a scene: its `states` `(9, k)`, and its s, s_dot, s_ddot `(3, k)`."""

    scene: Scene
    ego: FrenetStart
    futures: NearFutures
    pairs: Pairs
    pair: int
    states: FloatArray
    motion: FloatArray


def make_artefacts(chosen: ChosenPair, margins: StGraphConfig) -> tuple[Artefact, ...]:
    """Graphs, decisions and costs of the chosen pair.

    Each agent that stands in the middle of the road and that the ego passes has a decision with the
    side.
    """
    costs = chosen.pairs.costs[:, chosen.pair].tolist()
    passed = _passed_agents(chosen, margins.margin_m)
    return (
        _graph_across(chosen, passed),
        *_graph_along(chosen, margins),
        *passed.values(),
        CostTerms("lattice", tuple(zip(COST_PARTS, costs, strict=True))),
    )


def _passed_agents(chosen: ChosenPair, margin_m: float) -> dict[str, Decision]:
    """The decision by id of each agent that stands in the middle of the road and is passed."""
    scene, ego, (driven, _, _) = chosen.scene, chosen.ego, chosen.motion
    half, l1 = 0.5 * scene.vehicle.width, float(chosen.pairs.l1[chosen.pair])
    passed = dict[str, Decision]()
    for j, i in enumerate(chosen.futures.agent):
        s, l, half_s, half_l = chosen.futures.frenet[:, j, 0]
        is_reached = ego.s < s and s + half_s < ego.s + driven[-1]
        if scene.standing[i] and is_reached and abs(l) < half_l + half + margin_m:
            beside = float(np.interp(s - ego.s, driven, chosen.states[OFFSET]))
            kind = DecisionKind.NUDGE_LEFT if beside > l else DecisionKind.NUDGE_RIGHT
            gap = abs(beside - l) - half_l - half
            reason = (
                f"stands in the middle of the lane: passed with {gap:.2f} m at the end offset "
                f"{l1:.1f} m"
            )
            name = scene.frame.agents.ids[i]
            passed[name] = Decision(name, kind, "path", reason)
    return passed


def _graph_across(chosen: ChosenPair, passed: dict[str, Decision]) -> SlGraph:
    """The S-L graph: the road's edges, the path, and the standing agents near it."""
    scene, ego, (driven, _, _) = chosen.scene, chosen.ego, chosen.motion
    lane, half = scene.reference, 0.5 * scene.vehicle.width
    path = np.column_stack([ego.s + driven[::EVERY], chosen.states[OFFSET, ::EVERY]])
    path = path[np.r_[True, np.diff(path[:, 0]) > 1e-3]]
    grid = ego.s + np.arange(0.0, max(float(driven[-1]), 10.0), 4.0)
    right = np.interp(grid, lane.line.s, lane.road_right + half)
    left = np.interp(grid, lane.line.s, lane.road_left - half)
    boxes = []
    for j, i in enumerate(chosen.futures.agent):
        s, l, half_s, half_l = chosen.futures.frenet[:, j, 0]
        if scene.standing[i] and abs(l) < DRAWN_M:
            name = scene.frame.agents.ids[i]
            kind = passed[name].kind if name in passed else DecisionKind.IGNORE
            rear, front = s - half_s, s + half_s
            low, high = l - half_l, l + half_l
            outline = np.array([(rear, low), (front, low), (front, high), (rear, high)])
            boxes.append(GraphObstacle(name, outline, kind))
    return SlGraph(None, Corridor(grid, right, left), np.empty((0, 2)), path, tuple(boxes))


def _graph_along(chosen: ChosenPair, margins: StGraphConfig) -> tuple[Artefact, ...]:
    """The S-T graph along the planned path, and the decisions to follow, yield to or overtake
    agents.
    """
    scene, futures, drive = chosen.scene, chosen.futures, chosen.states
    planned = path_through(drive[X], drive[Y], drive[YAW], drive[KAPPA])
    beyond, yaw = np.arange(1.0, 30.0), planned.yaw[-1]  # straight on, to show its leader
    sigma = np.r_[planned.sigma, planned.sigma[-1] + beyond]
    path = Path(
        sigma,
        np.r_[planned.x, planned.x[-1] + beyond * np.cos(yaw)],
        np.r_[planned.y, planned.y[-1] + beyond * np.sin(yaw)],
        np.r_[planned.yaw, np.full(len(beyond), yaw)],
        np.r_[planned.kappa, np.zeros(len(beyond))],
        chosen.ego.s + sigma,
    )
    skip = np.ones(len(scene.frame.agents), np.bool_)
    skip[futures.agent[~futures.behind[int(chosen.pairs.changes[chosen.pair])]]] = False
    blocks = st_boundaries(scene, path, skip, frozenset(), margins)
    t = STEP_S * np.arange(drive.shape[1])
    driven = arc_lengths(drive[X], drive[Y])
    decisions = decide_speed(blocks, scene, np.interp(blocks.t, t, driven))
    profile = np.column_stack([t, driven])
    graph = StGraph(None, None, np.empty((0, 2)), profile, outlines(blocks, decisions))
    return (graph, *({decision.agent: decision for decision in decisions}.values()))
