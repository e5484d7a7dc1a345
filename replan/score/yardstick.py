"""The score of a plan in a window of NAVSIM, beside PDM-Closed and the log's driver (`navsim` has
the parts).

PDM-Closed as NAVSIM runs it beside each plan: fifteen IDM drivers on three lines, the best by
NAVSIM's own parts. On the centre line and 1 m to both sides of it, five drivers with 0.2 to 1 times
the limit of the first lane (15 m/s without one), from the projection of the rear axle and with the
ego's speed: `replan.planners.pdm.idm_drivers` (1), Euler steps of 0.1 s, no bound on the speed
below. They know road users within 100 m at constant speed, and lanes behind red lights as standing.
Every other step looks for the leader: of those that touch the corridor of the car's width and are
ahead, the nearest to the car's box; without one, the end of the line. The first step has a leader
at a gap of 1 m that stands: the original's array is still empty.

Each is driven by `navsim.simulated` and judged by `navsim.judged` among the predictions; the score
leaves out EC, and HC is 1 in v2. `replan.planners.pdm` is a planner after the same paper: it obeys
signs and crosswalks, and reacts at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import cos, nan, sin, sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.shapes import distance
from replan.logs.states import wrapped
from replan.metrics.boxes import EgoOutline, car_of
from replan.planners.pdm.planner import PdmConfig
from replan.score.navsim import (
    POSE_S,
    STEPS,
    ScoredWindow,
    Version,
    driven,
    extended_comfort,
    history_comfort,
    human_poses,
    judged,
    multiplied,
    progress,
)
from replan.score.navsim_tracker import STEP_S, V, X, Y, simulated
from replan.score.window import (
    Polyline,
    WindowAgents,
    box_on_polygon,
    centroid,
    in_corridor,
    logged_others,
    predicted_others,
)

CONFIG = PdmConfig()
FREE_MPS = 15.0
KNOTS = STEPS + 10  # States of a proposal: 5 s
OFFSETS_M = (0.0, -1.0, 1.0)


def plan_of(window: ScoredWindow, version: Version) -> FloatArray:
    """Return the poses x, y, yaw `(41, 3)` of the best proposal in a window.

    Of equals the first.
    """
    car, own = window.scenario.vehicle, car_of(window.scenario)
    x, y, *_ = window.box
    others = predicted_others(window.scenario, window.t, x, y, KNOTS + 2).apart(window.box)
    lines = [window.ground.center.beside(offset) for offset in OFFSETS_M]
    proposals = np.concatenate([_proposals(window, line, own, others) for line in lines])
    driven = [simulated(poses[:STEPS], window.start, car.wheelbase) for poses in proposals]
    ground = replace(window.ground, red=window.ground.red[:1])
    judgements = [judged(states, others, ground, version) for states in driven]
    products = np.array([multiplied(parts, version) for parts, _ in judgements])
    best = float((products * [progressed for _, progressed in judgements]).max())
    weights = {name: weight for name, weight in version.weights.items() if name != "EC"}
    totals = []
    rows = zip(driven, judgements, products.tolist(), strict=True)
    for states, (parts, progressed), product in rows:
        parts["EP"] = progress(progressed, best, multiplier=product, masks=version.masks)
        parts["HC"] = 1.0 if version.past else history_comfort(window, states, version)
        totals.append(product * sum(weight * parts[name] for name, weight in weights.items()))
    return np.asarray(proposals[int(np.argmax(totals)), :STEPS])


def _proposals(
    window: ScoredWindow, path: Polyline, car: EgoOutline, others: WindowAgents
) -> FloatArray:
    """Return the poses `(5, KNOTS, 3)` of the drivers on one line."""
    c, ground = CONFIG, window.ground
    limit = window.scenario.road.stated_limit(ground.lanes.lanes[ground.first].id)
    wanted_mps = (limit if np.isfinite(limit) else FREE_MPS) * np.array(c.speed_shares)
    begin = path.station(window.start[X], window.start[Y])
    end = min(begin + wanted_mps.max() * STEP_S * (KNOTS - 1), path.s[-1])
    corridor = path.points[(begin <= path.s) & (path.s <= end)]
    corridor = corridor if len(corridor) > 1 else path.at(np.array([begin, end]))[:, :2]
    red = _in_the_way(window, corridor, car)
    lights = [(path.station(*centroid(outline)), outline) for outline in red]
    s = np.full((len(wanted_mps), KNOTS), begin)
    v = np.full_like(s, window.start[V])
    poses: FloatArray = np.empty((*s.shape, 3))
    lead: FloatArray = np.zeros((len(wanted_mps), 3))
    poses[:, 0] = path.at(s[:, 0])
    for k in range(1, KNOTS):
        if k % 2 == 0:
            near = _near(path, corridor, car, others, k)
            lead = _leaders(
                s[:, k - 1], poses[:, k - 1], near, lights, others, k, car, float(path.s[-1])
            )
        speed = v[:, k - 1]
        gap = np.maximum(lead[:, 0] - s[:, k - 1] - lead[:, 2], c.min_gap_m)
        ideal = c.min_gap_m + speed * c.headway_s
        ideal = ideal + speed * (speed - lead[:, 1]) / (2.0 * sqrt(c.accel_mps2 * c.decel_mps2))
        accel = c.accel_mps2 * (1.0 - (speed / wanted_mps) ** c.exponent - (ideal / gap) ** 2)
        s[:, k] = s[:, k - 1] + STEP_S * speed
        v[:, k] = speed + STEP_S * np.clip(accel, -c.decel_mps2, c.accel_mps2)
        poses[:, k] = path.at(s[:, k])
    return poses


def _in_the_way(window: ScoredWindow, corridor: FloatArray, car: EgoOutline) -> list[FloatArray]:
    """Return the outlines of lanes with a red light that touch the corridor, without one that holds
    the ego's box.
    """
    outlines = [window.ground.lanes.lanes[i].polygon for i in sorted(window.ground.red[0])]
    touching = []
    for outline in outlines:
        ends = np.hstack([np.roll(outline, 1, axis=0), outline])
        crosses = any(
            in_corridor(
                corridor,
                0.5 * car.width,
                0.5 * (a + c),
                0.5 * (b + d),
                float(np.arctan2(d - b, c - a)),
                float(np.hypot(c - a, d - b)),
                0.0,
            )
            for a, b, c, d in ends.tolist()
        )
        holds = box_on_polygon(*window.box, outline) == 0.0
        touching += [outline] if crosses and not holds else []
    return touching


def _near(
    path: Polyline, corridor: FloatArray, car: EgoOutline, others: WindowAgents, k: int
) -> dict[int, float]:
    """Return the agents that touch the corridor at step k, and their stations."""
    present = np.flatnonzero(others.there[:, k]).tolist()
    half = 0.5 * car.width
    touching = (
        i for i in present if in_corridor(corridor, half, *others.pose[:, i, k], *others.size[i])
    )
    return {i: path.station(*others.pose[:2, i, k]) for i in touching}


def _leaders(
    s: FloatArray,
    poses: FloatArray,
    near: dict[int, float],
    lights: list[tuple[float, FloatArray]],
    others: WindowAgents,
    k: int,
    car: EgoOutline,
    end: float,
) -> FloatArray:
    """Return station, speed and length to the rear of each driver's leader `(5, 3)`.

    As in the original, a field that a driver does not set is that of the driver before.
    """
    lead, row = np.zeros((len(s), 3)), np.zeros(3)
    for n, (x, y, yaw) in enumerate(poses.tolist()):
        x, y = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
        ahead: list[tuple[float, float | None]] = []
        for i, station in near.items():
            if station > s[n]:
                away = distance(
                    x, y, yaw, car.length, car.width, *others.pose[:, i, k], *others.size[i]
                )
                ahead.append(
                    (away, others.speed[i] * cos(float(wrapped(others.pose[2, i, 0] - yaw))))
                )
        ahead += [
            (box_on_polygon(x, y, yaw, car.length, car.width, outline), None)
            for station, outline in lights
            if station > s[n]
        ]
        if ahead:
            away, speed = min(ahead, key=lambda leader: leader[0])
            row[0], row[1] = s[n] + away, row[1] if speed is None else speed
        else:
            row[0], row[2] = end, 0.5 * car.length
        lead[n] = row
    return lead


def total(parts: Mapping[str, float], version: Version) -> float:
    """Return the score of parts; a part that is NaN leaves with its weight."""
    known = {name: weight for name, weight in version.weights.items() if not np.isnan(parts[name])}
    mean = sum(weight * parts[name] for name, weight in known.items()) / sum(known.values())
    return multiplied(parts, version) * mean


@dataclass(frozen=True, eq=False)
class ScoredPlan:
    """The parts of a plan, its tracked states, which the next plan's EC needs, and its score."""

    parts: Mapping[str, float]  # After the human filter; `own` before it
    own: Mapping[str, float]
    states: FloatArray  # The tracked states `(41, 9)`
    version: Version  # The version by which it is scored

    @property
    def score(self) -> float:
        """The score of the parts, by the version."""
        return total(self.parts if self.version.scores_filtered else self.own, self.version)

    def with_comfort(self, extended: float) -> ScoredPlan:
        """Return the plan with another EC."""
        return replace(self, parts={**self.parts, "EC": extended}, own={**self.own, "EC": extended})


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What the plans of a window are compared with."""

    others: WindowAgents  # The road users as logged
    best: float  # PDM-Closed's way along its centre line times its multipliers, m
    human: Mapping[str, float]  # The parts of the log's driver; empty without the human filter


def yardstick(window: ScoredWindow, version: Version) -> Yardstick:
    """Return what all plans of a window are compared with."""
    car = window.scenario.vehicle
    others = logged_others(window.scenario, window.t, version.seen_s)
    others = others.apart(window.box) if version.drops else others
    states = simulated(plan_of(window, version), window.start, car.wheelbase)
    rival, progressed = judged(states, others, window.ground, version)
    human: dict[str, float] = {}
    if version.filters:
        logged = driven(window, human_poses(window))
        human, _ = judged(logged, others, window.ground, version)
    return Yardstick(others, multiplied(rival, version) * progressed, human)


def scored(
    window: ScoredWindow,
    poses: FloatArray,
    version: Version,
    before: ScoredPlan | None = None,
    beside: Yardstick | None = None,
) -> ScoredPlan:
    """Score a plan: eight poses x, y, yaw of the rear axle `(8, 3)`, every 0.5 s from the window's
    begin.

    `before` is the plan of 0.5 s earlier; `beside` is `yardstick(at, version)`, if it is known.
    """
    beside = beside or yardstick(window, version)
    states = driven(window, poses)
    parts, progressed = judged(states, beside.others, window.ground, version)
    product = multiplied(parts, version)
    best = max(product * progressed, beside.best)
    parts["EP"] = progress(progressed, best, multiplier=product, masks=version.masks)
    parts["HC"] = history_comfort(window, states, version)
    parts["EC"] = (
        nan if before is None else extended_comfort(states, before.states, round(POSE_S / STEP_S))
    )
    filtered = parts | {name: 1.0 for name, value in beside.human.items() if value == 0.0}
    return ScoredPlan(filtered, parts, states, version)
