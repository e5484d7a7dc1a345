"""The score of a plan in a window of NAVSIM, beside PDM-Closed and the log's driver (`navsim` has the parts)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from logs.arrays import FloatArray
from replay.score.navsim import (
    POSE_S,
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
from replay.score.navsim_tracker import STEP_S, simulated
from replay.score.pdm_closed import plan_of
from replay.score.window import WindowAgents, logged_others


def total(parts: Mapping[str, float], version: Version) -> float:
    """Return the score of parts; a part that is NaN leaves with its weight."""
    known = {name: weight for name, weight in version.weights.items() if not np.isnan(parts[name])}
    mean = sum(weight * parts[name] for name, weight in known.items()) / sum(known.values())
    return multiplied(parts, version) * mean


@dataclass(frozen=True, eq=False)
class ScoredPlan:
    """The parts of a plan, its tracked states, which the next plan's EC needs, and its score.

    Attributes:
        parts: After the human filter; `own` before it.
        states: The tracked states `(41, 9)`.
        version: The version by which it is scored.
    """

    parts: Mapping[str, float]
    own: Mapping[str, float]
    states: FloatArray
    version: Version

    @property
    def score(self) -> float:
        """The score of the parts, by the version."""
        return total(self.parts if self.version.scores_filtered else self.own, self.version)

    def with_comfort(self, extended: float) -> ScoredPlan:
        """Return the plan with another EC."""
        return replace(self, parts={**self.parts, "EC": extended}, own={**self.own, "EC": extended})


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What the plans of a window are compared with.

    Attributes:
        others: The road users as logged.
        best: PDM-Closed's way along its centre line times its multipliers, m.
        human: The parts of the log's driver; empty without the human filter.
    """

    others: WindowAgents
    best: float
    human: Mapping[str, float]


def yardstick(at: ScoredWindow, version: Version) -> Yardstick:
    """Return what all plans of a window are compared with."""
    car = at.scenario.vehicle
    others = logged_others(at.scenario, at.t, version.seen_s)
    others = others.apart(at.box) if version.drops else others
    rival, way = judged(simulated(plan_of(at, version), at.start, car.wheelbase), others, at.ground, version)
    human = judged(driven(at, human_poses(at)), others, at.ground, version)[0] if version.filters else {}
    return Yardstick(others, multiplied(rival, version) * way, human)


def scored(
    at: ScoredWindow,
    poses: FloatArray,
    version: Version,
    before: ScoredPlan | None = None,
    beside: Yardstick | None = None,
) -> ScoredPlan:
    """Score a plan: eight poses x, y, yaw of the rear axle `(8, 3)`, every 0.5 s from the window's begin.

    `before` is the plan of 0.5 s earlier; `beside` is `yardstick(at, version)`, if it is known.
    """
    beside = beside or yardstick(at, version)
    states = driven(at, poses)
    parts, way = judged(states, beside.others, at.ground, version)
    product = multiplied(parts, version)
    best = max(product * way, beside.best)
    parts["EP"] = progress(way, best, multiplier=product, masks=version.masks)
    parts["HC"] = history_comfort(at, states, version)
    parts["EC"] = nan if before is None else extended_comfort(states, before.states, round(POSE_S / STEP_S))
    filtered = parts | {name: 1.0 for name, value in beside.human.items() if value == 0.0}
    return ScoredPlan(filtered, parts, states, version)
