"""The scores of nuPlan and CARLA, computed from drives.

(1) score = product of the multipliers x (sum of weight x part) / (sum of weights)

Every part is in 0 .. 1, and the table shows it beside its score. A multiplier that cannot be measured makes the score
unavailable, unless it is optional (no traffic lights, no stop signs); the row of the score then names it ("without: red
lights").

nuPlan, closed loop: `metrics.nuplan`. The scores of NAVSIM judge plans of 4 s: `replay.score`.
nuPlan, open loop, over the horizons 3, 5 and 8 s that the log allows (devkit e9241677):
(2) miss x (ade + fde + 2 ahe + 2 fhe) / 6
CARLA leaderboard 2.x, in 0 .. 1:
(3) completion x penalties x red_lights x stop_signs x inside_lanes

    miss              1 where at most 0.3 of the plans miss at each horizon; a plan that does not reach it misses
    ade, fde; ahe, fhe   1 where the mean over frames and horizons is at most 8 m; 0.8 rad
    penalties         0.5 per pedestrian touched, 0.6 per vehicle, 0.65 per object, regardless of fault
    red_lights, stop_signs   0.7 and 0.8 per crossing
    inside_lanes      share of the distance that was driven neither off the lanes nor against them
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from types import MappingProxyType

import numpy as np

from logs.agents import AgentKind
from logs.once import once
from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics import nuplan, plans, progress, safety, traffic_rules
from metrics.metric import FINAL, Measured, Metric, Series, Unavailable

MISS_SHARE, NEAR_M, NEAR_RAD = 0.3, 8.0, 0.8
OPEN_HORIZONS_S = (3, 5, 8)
CARLA_HITS = MappingProxyType({AgentKind.PEDESTRIAN: 0.5, AgentKind.OBJECT: 0.65})
CARLA_VEHICLE, CARLA_RED, CARLA_STOP = 0.6, 0.7, 0.8
Value = float | Unavailable
Part = Callable[[Trace, Scenario], Value]


@dataclass(frozen=True, slots=True)
class Formula:
    """How a score is computed from its parts (1).

    Attributes:
        multipliers: Names in `PARTS`.
        weights: Weight by name in `PARTS`; empty: the score is the product.
        optional: Multipliers that are left out where they cannot be measured.
    """

    multipliers: tuple[str, ...]
    weights: Mapping[str, float]
    optional: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """All parts."""
        return (*self.multipliers, *self.weights)


def _series(metric: Metric, trace: Trace, scenario: Scenario) -> Series | Unavailable:
    found = metric.found(trace, scenario)
    if isinstance(found, Mapping):
        raise TypeError(f"{metric.name} has parts")
    return found


def _part_of(metric: Metric, judge: Callable[[Series], float]) -> Part:
    """Return a part that is computed from the series of one metric."""

    def part(trace: Trace, scenario: Scenario) -> Value:
        found = _series(metric, trace, scenario)
        return found if isinstance(found, Unavailable) else float(judge(found))

    return part


def _penalties(trace: Trace, scenario: Scenario) -> Value:
    met = [c for c in safety.contacts(trace, scenario) if c.kind is not safety.ContactKind.FROM_START]
    return prod((CARLA_HITS.get(trace.agents.kinds[c.agent], CARLA_VEHICLE) for c in met), start=1.0)


def _inside_lanes(trace: Trace, scenario: Scenario) -> Value:
    off, against = (_series(metric, trace, scenario) for metric in (safety.OFF_ROAD, traffic_rules.WRONG_WAY))
    if isinstance(off, Unavailable) or isinstance(against, Unavailable):
        return off if isinstance(off, Unavailable) else traffic_rules.NO_LANES
    wrong = (off.value > safety.OFF_ROAD_M) | (against.value > traffic_rules.AGAINST_MPS)
    metres = np.hypot(np.diff(trace.ego.x), np.diff(trace.ego.y))
    return 1.0 - float(metres[wrong[1:]].sum() / metres.sum()) if metres.sum() > 0.0 else 1.0


def _open_loop(metric: Metric, judge: Callable[[list[Series]], bool]) -> Part:
    """Return a part that is computed from a metric's series at the horizons of nuPlan that the log covers."""

    def part(trace: Trace, scenario: Scenario) -> Value:
        found = metric.found(trace, scenario)
        if not isinstance(found, Mapping):
            return found if isinstance(found, Unavailable) else float(judge([found]))
        allowed = [one for one in (found[f"{h}s"] for h in OPEN_HORIZONS_S) if isinstance(one, Series)]
        nothing = Unavailable(f"the log ends less than {OPEN_HORIZONS_S[0]} s after every frame")
        return float(judge(allowed)) if allowed else nothing

    return part


def _mean_within(bound: float, found: list[Series]) -> bool:
    values = np.concatenate([series.value[series.known] for series in found])
    return len(values) > 0 and float(values.mean()) <= bound


PARTS: Mapping[str, Part] = MappingProxyType({
    "completion": _part_of(progress.COMPLETION, lambda series: series.value[-1]),
    "penalties": _penalties,
    "red_lights": _part_of(traffic_rules.RED_LIGHT, lambda series: CARLA_RED ** float(np.nansum(series.value))),
    "stop_signs": _part_of(traffic_rules.STOP_SIGN, lambda series: CARLA_STOP ** float(np.nansum(series.value))),
    "inside_lanes": _inside_lanes,
    "miss": _open_loop(plans.MISS, lambda found: all(np.mean(~(one.value == 0.0)) <= MISS_SHARE for one in found)),
    "ade": _open_loop(plans.ADE, partial(_mean_within, NEAR_M)),
    "fde": _open_loop(plans.FDE, partial(_mean_within, NEAR_M)),
    "ahe": _open_loop(plans.AHE, partial(_mean_within, NEAR_RAD)),
    "fhe": _open_loop(plans.FHE, partial(_mean_within, NEAR_RAD)),
})  # fmt: skip

NUPLAN_CLOSED = Formula(
    ("collisions", "drivable", "direction", "making_progress"),
    {"progress": 5.0, "ttc": 5.0, "speed_limit": 4.0, "comfort": 2.0},
)
NUPLAN_OPEN = Formula(("miss",), {"ade": 1.0, "fde": 1.0, "ahe": 2.0, "fhe": 2.0})
CARLA = Formula(
    ("completion", "penalties", "red_lights", "stop_signs", "inside_lanes"), {},
    frozenset({"red_lights", "stop_signs"}),
)  # fmt: skip


def combined(formula: Formula, parts: Mapping[str, Value]) -> tuple[Value, str]:
    """Return (1), and the label that names the parts left out."""
    for name in formula.multipliers:
        if isinstance(value := parts[name], Unavailable) and name not in formula.optional:
            return Unavailable(f"{name.replace('_', ' ')}: {value.reason}"), ""
    known = {name: value for name, value in parts.items() if not isinstance(value, Unavailable)}
    weight = sum(weight for name, weight in formula.weights.items() if name in known)
    if formula.weights and not weight:
        return Unavailable("no part of the weighted mean can be measured"), ""
    mean = sum(weight * known[name] for name, weight in formula.weights.items() if name in known) / (weight or 1.0)
    product = prod((known[name] for name in formula.multipliers if name in known), start=1.0)
    left_out = ", ".join(name.replace("_", " ") for name in formula.names if name not in known)
    return product * (mean if formula.weights else 1.0), f"without: {left_out}" if left_out else ""


@once
def _value_of(trace: Trace, scenario: Scenario, name: str) -> Value:
    return PARTS[name](trace, scenario)


def _scores(formula: Formula, trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    return _rows(formula, trace, {name: _value_of(trace, scenario, name) for name in formula.names})


def _nuplan_closed(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    found = nuplan.closed_loop_parts(trace, scenario)
    names = NUPLAN_CLOSED.names
    parts: Mapping[str, Value] = dict.fromkeys(names, found) if isinstance(found, Unavailable) else found
    return _rows(NUPLAN_CLOSED, trace, {name: parts[name] for name in names})


def _rows(formula: Formula, trace: Trace, parts: Mapping[str, Value]) -> Mapping[str, Measured]:
    total, label = combined(formula, parts)
    rows = {"score": (total, label), **{name: (value, "") for name, value in parts.items()}}
    return {
        name: value if isinstance(value, Unavailable) else Series(trace.ego.t[-1:], np.array([value]), (words,))
        for name, (value, words) in rows.items()
    }


def _score_metric(
    name: str, formula: Formula, mode: Mode, meaning: str, source: str, text: str, needs: str, *, version: int = 1,
    measure: Callable[[Trace, Scenario], Mapping[str, Measured]] | None = None,
) -> Metric:  # fmt: skip
    return Metric(
        name, "1", "higher", (mode,), measure or partial(_scores, formula), (FINAL,), meaning, source, version,
        parts=("score", *formula.names), formula=text, needs=needs,
        parameters=tuple(f"weight of {part} {weight:g}" for part, weight in formula.weights.items()),
    )  # fmt: skip


_LANES = "lanes, a logged drive"
NUPLAN_CLOSED_SCORE = _score_metric(
    "nuplan_closed", NUPLAN_CLOSED, Mode.CLOSED,
    "nuPlan's closed-loop score, as its devkit computes it for the same drive. A drive that ends early is judged until"
    " then, and by the progress of the whole log.",
    "nuPlan devkit e9241677, closed_loop_nonreactive_agents_weighted_average",
    "collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2 comfort) / 16",
    _LANES, version=2, measure=_nuplan_closed,
)  # fmt: skip
NUPLAN_OPEN_SCORE = _score_metric(
    "nuplan_open", NUPLAN_OPEN, Mode.OPEN,
    "nuPlan's open-loop score. It differs: plans are compared at 10 Hz and at the rear axle, a plan that does not reach"
    " a horizon misses there, horizons beyond the log are left out.",
    "nuPlan devkit e9241677, open_loop_boxes_weighted_average", "miss x (ade + fde + 2 ahe + 2 fhe) / 6",
    "a logged drive of 3 s after some frame",
)  # fmt: skip
CARLA_SCORE = _score_metric(
    "carla", CARLA, Mode.CLOSED,
    "CARLA's driving score, in 0 .. 1. It differs: the drive ends at a collision; no penalties for a time-out, for"
    " yielding to emergency vehicles and for too little speed; outside are the lanes' edge and oncoming lanes.",
    "CARLA leaderboard 2.x aec81319, statistics_manager.py",
    "completion x 0.5^pedestrians x 0.6^vehicles x 0.65^objects x 0.7^red lights x 0.8^stop signs x inside_lanes",
    "lanes, a route with a goal or a logged drive of 10 m",
)  # fmt: skip
