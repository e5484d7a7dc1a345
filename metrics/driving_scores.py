"""The scores of nuPlan and CARLA, computed from drives.

(1) score = product of the multipliers x (sum of weight x part) / (sum of weights)

Every part is in 0 .. 1, and the table shows it beside its score. A multiplier that cannot be
measured makes the score unavailable, unless it is optional (no traffic lights, no stop signs); the
row of the score then names it ("without: red lights").

The scores of NAVSIM judge plans of 4 s: `replan.score`. The parts of nuPlan's closed-loop score are
in `nuplan_closed_loop`.
nuPlan, open loop, over the horizons 3, 5 and 8 s that the log allows (devkit e9241677):
(2) miss x (ade + fde + 2 ahe + 2 fhe) / 6
CARLA leaderboard 2.x, in 0 .. 1:
(3) completion x penalties x red_lights x stop_signs x inside_lanes

    miss              1 where at most 0.3 of the plans miss at each horizon; a plan that does not
                      reach it misses
    ade, fde; ahe, fhe   1 where the mean over frames and horizons is at most 8 m; 0.8 rad
    penalties         0.5 per pedestrian touched, 0.6 per vehicle, 0.65 per object, regardless of
                      fault
    red_lights, stop_signs   0.7 and 0.8 per crossing
    inside_lanes      share of the distance that was driven neither off the lanes nor against them
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from types import MappingProxyType
from typing import Any

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, Trace
from replan.metrics.accuracy import ade, ahe, fde, fhe, miss
from replan.metrics.collisions import ContactKind, contacts
from replan.metrics.lane_position import AGAINST_MPS, wrong_way
from replan.metrics.metric import Measure, Measured, Metric, Parts, Series, Unavailable, metric
from replan.metrics.nuplan_closed_loop import closed_loop_parts
from replan.metrics.off_road import OFF_ROAD_M, off_road
from replan.metrics.progress import completion
from replan.metrics.reductions import FINAL
from replan.metrics.stop_lines import red_light, stop_sign

MISS_SHARE, NEAR_M, NEAR_RAD = 0.3, 8.0, 0.8
OPEN_HORIZONS_S = (3, 5, 8)
CARLA_HITS = MappingProxyType({AgentKind.PEDESTRIAN: 0.5, AgentKind.OBJECT: 0.65})
CARLA_VEHICLE, CARLA_RED, CARLA_STOP = 0.6, 0.7, 0.8
Value = float | Unavailable
Part = Callable[[Trace, Scenario], Value]


@dataclass(frozen=True, slots=True)
class Formula:
    """How a score is computed from its parts (1)."""

    multipliers: tuple[str, ...]  # Names in `PARTS`
    weights: Mapping[str, float]  # Weight by name in `PARTS`; empty: the score is the product
    # Multipliers that are left out where they cannot be measured
    optional: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """All parts."""
        return (*self.multipliers, *self.weights)


def _penalties(trace: Trace, scenario: Scenario) -> Value:
    met = [c for c in contacts(trace, scenario) if c.kind is not ContactKind.FROM_START]
    return prod(
        (CARLA_HITS.get(trace.agents.kinds[c.agent], CARLA_VEHICLE) for c in met), start=1.0
    )


def _inside_lanes(trace: Trace, scenario: Scenario) -> Value:
    off, against = off_road(trace, scenario), wrong_way(trace, scenario)
    if isinstance(off, Unavailable):
        return off
    if isinstance(against, Unavailable):
        return against
    assert isinstance(off, Series) and isinstance(against, Series)
    wrong = (off.value > OFF_ROAD_M) | (against.value > AGAINST_MPS)
    metres = np.hypot(np.diff(trace.ego.x), np.diff(trace.ego.y))
    return 1.0 - float(metres[wrong[1:]].sum() / metres.sum()) if metres.sum() > 0.0 else 1.0


def _part_of(metric: Metric, judge: Callable[[list[Series]], float]) -> Part:
    """Return a part that is computed from a metric's series, or from those at nuPlan's horizons
    that the log covers.
    """

    def part(trace: Trace, scenario: Scenario) -> Value:
        measured = metric(trace, scenario)
        if isinstance(measured, Unavailable):
            return measured
        if isinstance(measured, Series):
            return float(judge([measured]))
        horizons = [measured[f"{h}s"] for h in OPEN_HORIZONS_S]
        allowed = [series for series in horizons if isinstance(series, Series)]
        if not allowed:
            return Unavailable(f"the log ends less than {OPEN_HORIZONS_S[0]} s after every frame")
        return float(judge(allowed))

    return part


def _factor_per_event(factor: float, events: list[Series]) -> float:
    return factor ** float(np.nansum(events[0].value))


def _few_miss(horizons: list[Series]) -> bool:
    return all(np.mean(~(series.value == 0.0)) <= MISS_SHARE for series in horizons)


def _mean_within(bound: float, horizons: list[Series]) -> bool:
    values = np.concatenate([series.value[series.known] for series in horizons])
    return len(values) > 0 and float(values.mean()) <= bound


PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "completion": _part_of(completion, lambda series: series[0].value[-1]),
        "penalties": _penalties,
        "red_lights": _part_of(red_light, partial(_factor_per_event, CARLA_RED)),
        "stop_signs": _part_of(stop_sign, partial(_factor_per_event, CARLA_STOP)),
        "inside_lanes": _inside_lanes,
        "miss": _part_of(miss, _few_miss),
        "ade": _part_of(ade, partial(_mean_within, NEAR_M)),
        "fde": _part_of(fde, partial(_mean_within, NEAR_M)),
        "ahe": _part_of(ahe, partial(_mean_within, NEAR_RAD)),
        "fhe": _part_of(fhe, partial(_mean_within, NEAR_RAD)),
    }
)
NUPLAN_CLOSED = Formula(
    ("collisions", "drivable", "direction", "making_progress"),
    {"progress": 5.0, "ttc": 5.0, "speed_limit": 4.0, "comfort": 2.0},
)
NUPLAN_OPEN = Formula(("miss",), {"ade": 1.0, "fde": 1.0, "ahe": 2.0, "fhe": 2.0})
CARLA = Formula(
    ("completion", "penalties", "red_lights", "stop_signs", "inside_lanes"),
    {},
    frozenset({"red_lights", "stop_signs"}),
)


def combined(formula: Formula, parts: Mapping[str, Value]) -> tuple[Value, str]:
    """Return (1), and the label that names the parts left out."""
    for name in formula.multipliers:
        if isinstance(value := parts[name], Unavailable) and name not in formula.optional:
            return Unavailable(f"{name.replace('_', ' ')}: {value.reason}"), ""
    known = {name: value for name, value in parts.items() if not isinstance(value, Unavailable)}
    weight = sum(weight for name, weight in formula.weights.items() if name in known)
    if formula.weights and not weight:
        return Unavailable("no part of the weighted mean can be measured"), ""
    mean = sum(
        weight * known[name] for name, weight in formula.weights.items() if name in known
    ) / (weight or 1.0)
    product = prod((known[name] for name in formula.multipliers if name in known), start=1.0)
    left_out = ", ".join(name.replace("_", " ") for name in formula.names if name not in known)
    return product * (mean if formula.weights else 1.0), f"without: {left_out}" if left_out else ""


def _score_metric(formula: Formula, **keywords: Any) -> Callable[[Measure], Metric]:
    """Make a metric of a score, with a series for the score and for each of its parts."""
    return metric(
        unit="1",
        better="higher",
        reductions=(FINAL,),
        parts=("score", *formula.names),
        parameters=(f"weight of {part} {weight:g}" for part, weight in formula.weights.items()),
        **keywords,
    )


@_score_metric(
    NUPLAN_CLOSED,
    needs="lanes, a logged drive",
    source="nuPlan devkit e9241677, closed_loop_nonreactive_agents_weighted_average",
    version=2,
)
def nuplan_closed(trace: Trace, scenario: Scenario) -> Parts:
    """The closed-loop score of nuPlan, as its devkit computes it for the same drive. A drive that
    ends early is judged until then, and by the progress of the whole log.

    Formula: collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4
    speed_limit + 2 comfort) / 16
    """
    measured = closed_loop_parts(trace, scenario)
    parts: Mapping[str, Value] = (
        dict.fromkeys(NUPLAN_CLOSED.names, measured)
        if isinstance(measured, Unavailable)
        else measured
    )
    return _score_and_parts(NUPLAN_CLOSED, parts, trace)


@_score_metric(
    NUPLAN_OPEN,
    modes=(Mode.OPEN,),
    needs="a logged drive of 3 s after some frame",
    source="nuPlan devkit e9241677, open_loop_boxes_weighted_average",
)
def nuplan_open(trace: Trace, scenario: Scenario) -> Parts:
    """The open-loop score of nuPlan. It differs: plans are compared at 10 Hz and at the rear axle,
    a plan that does not reach a horizon misses there, horizons beyond the log are left out.

    Formula: miss x (ade + fde + 2 ahe + 2 fhe) / 6
    """
    parts = {name: PARTS[name](trace, scenario) for name in NUPLAN_OPEN.names}
    return _score_and_parts(NUPLAN_OPEN, parts, trace)


@_score_metric(
    CARLA,
    needs="lanes, a route with a goal or a logged drive of 10 m",
    source="CARLA leaderboard 2.x aec81319, statistics_manager.py",
)
def carla(trace: Trace, scenario: Scenario) -> Parts:
    """CARLA's driving score, in 0 .. 1. It differs: the drive ends at a collision; no penalties for
    a time-out, for yielding to emergency vehicles and for too little speed; outside are the lanes'
    edge and oncoming lanes.

    Formula: completion x 0.5^pedestrians x 0.6^vehicles x 0.65^objects x 0.7^red lights x 0.8^stop
    signs x inside_lanes
    """
    parts = {name: PARTS[name](trace, scenario) for name in CARLA.names}
    return _score_and_parts(CARLA, parts, trace)


def _score_and_parts(formula: Formula, parts: Mapping[str, Value], trace: Trace) -> Parts:
    """Return a score (1) and its parts as series of one step, the last one."""

    def at_end(value: Value, label: str = "") -> Measured:
        if isinstance(value, Unavailable):
            return value
        return Series(trace.ego.t[-1:], np.array([value]), (label,))

    score = at_end(*combined(formula, parts))
    return {"score": score, **{name: at_end(parts[name]) for name in formula.names}}
