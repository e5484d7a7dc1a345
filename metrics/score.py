"""The scores of nuPlan, NAVSIM and CARLA, computed from the metrics of replan.

(1) score = product of the multipliers x (sum of weight x part) / (sum of weights)

Every part is in 0 .. 1, and the table shows it beside its score. A weighted part that cannot be measured is left out
with its weight, and the row of the score names it ("without: red lights"). A multiplier that cannot be measured makes
the score unavailable, unless it is optional (no traffic lights, no stop signs).

nuPlan, closed loop (devkit e9241677):
(2) collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2 comfort) / 16
nuPlan, open loop, over the horizons 3, 5 and 8 s that the log allows:
(3) miss x (ade + fde + 2 ahe + 2 fhe) / 6
NAVSIM, 0a380a90:
(4) PDMS = collisions x drivable x (5 progress + 5 ttc + 2 comfort) / 12
(5) EPDMS = collisions x drivable x direction x red_lights x (5 ttc + 5 progress + 2 comfort + 2 lane_keeping
    + 2 extended_comfort) / 16;  a part is 1 if the log's driver has 0 in it
CARLA leaderboard 2.x, in 0 .. 1:
(6) completion x penalties x red_lights x stop_signs x inside_lanes

    collisions        product over {pedestrians and riders, vehicles, objects} of max(0, 1 - n / (1, 1, 2)), n at fault
    drivable          1 unless the ego's outline is 0.3 m off the lanes (the sources look at its corners)
    direction         1, 0.5, 0: less than 2 m, 6 m driven against a lane within 1 s
    making_progress   1 where progress is at least 0.2
    ttc               1 where the straight time of `safety` is always above 0.95 s and no collision is at fault
    speed_limit       `speed_excess.compliance`, the excess at the start included
    comfort           1 where all six signals that nuPlan filters are always within their bounds
    lane_keeping      1 where no episode beyond 0.5 m lasts 2 s
    extended_comfort  share of the pairs of plans 0.5 s apart within all four bounds
    miss              1 where at most 0.3 of the plans miss at each horizon; a plan that does not reach it misses
    ade, fde; ahe, fhe   1 where the mean over frames and horizons is at most 8 m; 0.8 rad
    penalties         0.5 per pedestrian touched, 0.6 per vehicle, 0.65 per object, regardless of fault
    red_lights, stop_signs   0.7 and 0.8 per crossing in CARLA; in (5) 1 without crossings, else 0
    inside_lanes      share of the distance that was driven neither off the lanes nor against them
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from types import MappingProxyType

import numpy as np

from logs.scenario import AgentKind, Scenario
from logs.trace import Mode, Trace
from metrics import comfort, plans, progress, rules, safety
from metrics.metric import FINAL, Measured, Metric, Series, Unavailable, longest, once

LEAST_PROGRESS, MISS_SHARE, NEAR_M, NEAR_RAD = 0.2, 0.3, 8.0, 0.8
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
        excused: Whether a part is 1 if the log's driver has 0 in it.
    """

    multipliers: tuple[str, ...]
    weights: Mapping[str, float]
    optional: frozenset[str] = frozenset()
    excused: bool = False

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


def _collisions(trace: Trace, scenario: Scenario) -> Value:
    hit = [trace.agents.kinds[c.agent] for c in safety.contacts(trace, scenario) if c.at_fault]
    vulnerable, objects = sum(kind.is_vulnerable for kind in hit), hit.count(AgentKind.OBJECT)
    vehicles = len(hit) - vulnerable - objects
    return prod(max(0.0, 1.0 - n / allowed) for n, allowed in ((vulnerable, 1), (vehicles, 1), (objects, 2)))


def _ttc(trace: Trace, scenario: Scenario) -> Value:
    if any(contact.at_fault for contact in safety.contacts(trace, scenario)):
        return 0.0
    (_, straight), _ = safety.least_contact_times(trace, scenario, False)
    return float(not (straight <= safety.CLOSE_S).any())


def _direction(series: Series) -> float:
    metres = rules.worst_metres(series)[0]
    return 1.0 if metres < rules.COMPLIANT_M else 0.5 if metres < rules.HALF_M else 0.0


def _comfort(trace: Trace, scenario: Scenario) -> Value:
    for metric, (_, low, high) in zip(comfort.NUPLAN, comfort.NUPLAN_BOUNDS.values(), strict=True):
        found = _series(metric, trace, scenario)
        if isinstance(found, Unavailable):
            return found
        if ((found.value < low) | (found.value > high)).any():
            return 0.0
    return 1.0


def _speed_limit(trace: Trace, scenario: Scenario) -> Value:
    found = progress.excess(trace, scenario, all_of_it=True)
    if isinstance(found, Unavailable):
        return found
    return progress.compliance(found)[0] if found.known.any() else Unavailable(found.missing)


def _penalties(trace: Trace, scenario: Scenario) -> Value:
    met = [c for c in safety.contacts(trace, scenario) if c.kind is not safety.ContactKind.FROM_START]
    return prod((CARLA_HITS.get(trace.agents.kinds[c.agent], CARLA_VEHICLE) for c in met), start=1.0)


def _inside_lanes(trace: Trace, scenario: Scenario) -> Value:
    off, against = (_series(metric, trace, scenario) for metric in (safety.OFF_ROAD, rules.WRONG_WAY))
    if isinstance(off, Unavailable) or isinstance(against, Unavailable):
        return off if isinstance(off, Unavailable) else rules.NO_LANES
    wrong = (off.value > safety.OFF_ROAD_M) | (against.value > rules.AGAINST_MPS)
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
    "collisions": _collisions,
    "drivable": _part_of(safety.OFF_ROAD, lambda series: not (series.value > safety.OFF_ROAD_M).any()),
    "direction": _part_of(rules.WRONG_WAY, _direction),
    "making_progress": _part_of(progress.PROGRESS, lambda series: series.value[-1] >= LEAST_PROGRESS),
    "progress": _part_of(progress.PROGRESS, lambda series: series.value[-1]),
    "ttc": _ttc,
    "speed_limit": _speed_limit,
    "comfort": _comfort,
    "lane_keeping": _part_of(
        rules.LANE_KEEPING,
        lambda series: longest(series, np.abs(series.value) > rules.KEEPING_M)[0] < rules.KEEPING_S - 1e-9,
    ),
    "extended_comfort": _part_of(
        plans.EXTENDED_COMFORT,
        lambda series: float(np.mean(series.value[series.known] <= 1.0)) if series.known.any() else 0.0,
    ),
    "no_red_light": _part_of(rules.RED_LIGHT, lambda series: np.nansum(series.value) == 0.0),
    "completion": _part_of(progress.COMPLETION, lambda series: series.value[-1]),
    "penalties": _penalties,
    "red_lights": _part_of(rules.RED_LIGHT, lambda series: CARLA_RED ** float(np.nansum(series.value))),
    "stop_signs": _part_of(rules.STOP_SIGN, lambda series: CARLA_STOP ** float(np.nansum(series.value))),
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
PDMS = Formula(("collisions", "drivable"), {"progress": 5.0, "ttc": 5.0, "comfort": 2.0})
EPDMS = Formula(
    ("collisions", "drivable", "direction", "no_red_light"),
    {"ttc": 5.0, "progress": 5.0, "comfort": 2.0, "lane_keeping": 2.0, "extended_comfort": 2.0},
    frozenset({"no_red_light"}), excused=True,
)  # fmt: skip
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
    parts = {name: _value_of(trace, scenario, name) for name in formula.names}
    if formula.excused and len(scenario.ego) > 1:
        human = replace(trace, ego=scenario.ego, agents=scenario.tracks, frames=())
        for name, value in parts.items():
            if value != 1.0 and _value_of(human, scenario, name) == 0.0:
                parts[name] = 1.0
    total, label = combined(formula, parts)
    rows = {"score": (total, label), **{name: (value, "") for name, value in parts.items()}}
    return {
        name: value if isinstance(value, Unavailable) else Series(trace.ego.t[-1:], np.array([value]), (words,))
        for name, (value, words) in rows.items()
    }


def _score_metric(name: str, formula: Formula, mode: Mode, meaning: str, source: str, text: str, needs: str) -> Metric:
    return Metric(
        name, "1", "higher", (mode,), partial(_scores, formula), (FINAL,), meaning, source,
        parts=("score", *formula.names), formula=text, needs=needs,
        parameters=tuple(f"weight of {part} {weight:g}" for part, weight in formula.weights.items()),
    )  # fmt: skip


_LANES = "lanes, a logged drive"
NUPLAN_CLOSED_SCORE = _score_metric(
    "nuplan_closed", NUPLAN_CLOSED, Mode.CLOSED,
    "nuPlan's closed-loop score. It differs: progress is along the driven path, time to collision is with velocity"
    " vectors, to all who are not behind and up to 10 s, the limit is that of the lanes under the ego.",
    "nuPlan devkit e9241677, closed_loop_nonreactive_agents_weighted_average",
    "collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2 comfort) / 16",
    _LANES,
)  # fmt: skip
NUPLAN_OPEN_SCORE = _score_metric(
    "nuplan_open", NUPLAN_OPEN, Mode.OPEN,
    "nuPlan's open-loop score. It differs: plans are compared at 10 Hz and at the rear axle, a plan that does not reach"
    " a horizon misses there, horizons beyond the log are left out.",
    "nuPlan devkit e9241677, open_loop_boxes_weighted_average", "miss x (ade + fde + 2 ahe + 2 fhe) / 6",
    "a logged drive of 3 s after some frame",
)  # fmt: skip
PDMS_SCORE = _score_metric(
    "pdms", PDMS, Mode.CLOSED,
    "NAVSIM's predictive driver model score. It differs: of the whole drive instead of one plan's 4 s, progress is over"
    " the log's driver instead of PDM-Closed, time to collision as in nuplan_closed.",
    "NAVSIM 0a380a90, pdm_scorer", "collisions x drivable x (5 progress + 5 ttc + 2 comfort) / 12", _LANES,
)  # fmt: skip
EPDMS_SCORE = _score_metric(
    "epdms", EPDMS, Mode.CLOSED,
    "NAVSIM's extended score; a part in which the log's driver has 0 is 1. It differs as pdms does; lights count at"
    " their stop lines, extended comfort is the share of all pairs of plans, changing lanes is not excused.",
    "NAVSIM 0a380a90, pdm_scorer (v2)",
    "collisions x drivable x direction x no_red_light x (5 ttc + 5 progress + 2 comfort + 2 lane_keeping"
    " + 2 extended_comfort) / 16", _LANES,
)  # fmt: skip
CARLA_SCORE = _score_metric(
    "carla", CARLA, Mode.CLOSED,
    "CARLA's driving score, in 0 .. 1. It differs: the drive ends at a collision; no penalties for a time-out, for"
    " yielding to emergency vehicles and for too little speed; outside are the lanes' edge and oncoming lanes.",
    "CARLA leaderboard 2.x aec81319, statistics_manager.py",
    "completion x 0.5^pedestrians x 0.6^vehicles x 0.65^objects x 0.7^red lights x 0.8^stop signs x inside_lanes",
    "lanes, a route with a goal or a logged drive of 10 m",
)  # fmt: skip
