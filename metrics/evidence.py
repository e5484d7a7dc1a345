"""Evidence of a drive: how much was driven, whether the replay ended it, whether plans were
refused, robustness.

`evidence` measures at which steps a drive has the evidence that verdicts need, as one series of 0
and 1 for each kind:

    traffic   the other road users were observed (`Scenario.traffic_spans`)
    lights    the colour of the traffic light is known, on lanes that lead to a stop line with a
              light
    limit     the log states a speed limit (not assumed) for the lane under the ego's centre
    lane      a lane of the log's map lies under the ego's centre

(1) share = duration of the steps with evidence / duration of all steps that need evidence
        (`reductions.durations`)
(2) way_share = the same with the distance driven in place of the duration;
        (1) if the ego does not move
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.driving import DrivingMode
from replan.logs.observed import described, within
from replan.logs.plan import PlanStatus
from replan.logs.polylines import points_inside
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics.boxes import ego_boxes, phantoms
from replan.metrics.lanes import limits_at, mapped_lanes, off_lanes, stated_lanes
from replan.metrics.metric import (
    BOTH_LOOPS,
    Measured,
    Parts,
    Reduction,
    Series,
    Unavailable,
    metric,
    where_followed,
)
from replan.metrics.plans import NO_PLANS, frame_times
from replan.metrics.reductions import COUNT, FINAL, RATE, durations, first_of, split_to_neighbours

DRIVEN_BY = MappingProxyType(
    {
        "stack": (DrivingMode.AUTONOMOUS,),
        "person": (DrivingMode.MANUAL,),
        "both": (DrivingMode.STEERED, DrivingMode.PACED),
        "unknown": (DrivingMode.UNKNOWN, DrivingMode.GIVEN_UP),
    }
)
"""The modes of each part of `driven_by`."""


@metric(
    unit="s",
    better="higher",
    modes=BOTH_LOOPS,
    reductions=(FINAL,),
    parts=("log_s", "driven_s"),
    needs="open loop: a log that holds a drive",
)
def coverage(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Time that the log lasts from the ego's first state on (log_s; open loop: as long as the log
    has an ego; where the drive ends with the evidence: as long as that), and that was driven or
    planned (driven_s).

    Formula: last time - first time
    """
    if trace.mode is Mode.OPEN and len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to plan along")
    start, end = float(scenario.ego.t[0]), trace.ego.t[-1:]
    last = scenario.duration if trace.mode is Mode.CLOSED else float(scenario.ego.t[-1])
    # `end_with_evidence` ended it
    if trace.mode is Mode.CLOSED and trace.end is EndReason.END_OF_LOG and trace.detail:
        last = float(trace.ego.t[-1])
    return {"log_s": Series(end, np.array([last - start])), "driven_s": Series(end, end - start)}


@dataclass(frozen=True, eq=False, slots=True)
class Evidence(Series):
    """1 with evidence, 0 without, NaN where no evidence is needed; `metres` is the distance of each
    step, m.
    """

    metres: FloatArray = field(default_factory=partial(np.empty, 0))


def _share(series: Series, *, of_way: bool = False) -> tuple[float, int]:
    """Return (1) or (2), and the first step without evidence."""
    known = series.known
    weight = series.metres if of_way and isinstance(series, Evidence) else durations(series.t)
    weight = weight if weight[known].sum() > 0.0 else durations(series.t)
    weight = weight if weight[known].sum() > 0.0 else np.ones(len(known))
    return float(np.average(series.value[known], weights=weight[known])), first_of(
        series.value == 0.0
    )


@metric(
    unit="1",
    better="higher",
    modes=BOTH_LOOPS,
    reductions=(Reduction("share", _share), Reduction("way_share", partial(_share, of_way=True))),
    parts=("traffic", "lights", "limit", "lane"),
    needs="lights: a stop line with a traffic light on the driven way",
)
def evidence(trace: Trace, scenario: Scenario) -> Parts:
    """Share of the driven time, and of the driven way, with what verdicts rest on: the other road
    users observed (traffic), the light ahead known (lights), a speed limit of the log's own
    (limit), a lane of its map (lane).

    Formula: time or way with evidence / time or way that needs it
    """
    (x, y), t, spans = ego_boxes(trace.ego, scenario)[:2], trace.ego.t, scenario.traffic_spans
    observed = (
        f"traffic is recorded {described(spans)}, the drive lasts from {t[0]:.1f} s to "
        f"{t[-1]:.1f} s"
    )
    stated, mapped = stated_lanes(scenario.road), mapped_lanes(scenario.road)
    nowhere = np.zeros(len(t), np.bool_)
    limit = nowhere if stated is None else np.isfinite(limits_at(stated, x, y))
    lane = nowhere if mapped is None else off_lanes(mapped, x, y) == 0.0
    no_limit = "the log has no speed limit here: it is assumed, or not asked for"
    no_lane = "no lane of the log's map lies under the ego"
    if mapped is None:
        no_lane = "the log has no lanes for cars"
    return {
        "traffic": _series_of(trace, within(spans, t), observed),
        "lights": _lights(trace, scenario, x, y),
        "limit": _series_of(trace, limit, no_limit),
        "lane": _series_of(trace, lane, no_lane),
    }


def _series_of(
    trace: Trace, known: BoolArray, lacking_label: str, needed: BoolArray | None = None
) -> Evidence:
    """Return the series of one kind of evidence; `why` is the label of steps that need evidence and
    have none.
    """
    ego = trace.ego
    needed = np.ones(len(known), np.bool_) if needed is None else needed
    value = np.where(needed, known.astype(np.float64), np.nan)
    labels = tuple(lacking_label if lacking else "" for lacking in (needed & ~known).tolist())
    return Evidence(
        ego.t,
        value,
        labels,
        metres=split_to_neighbours(np.hypot(np.diff(ego.x), np.diff(ego.y))),
    )


def _lights(trace: Trace, scenario: Scenario, x: FloatArray, y: FloatArray) -> Measured:
    """Measure where lights are known; "off" for part of the log means not observed, "off"
    throughout: switched off.
    """
    lights = {light.id: light for light in scenario.lights}
    lines = [line for line in scenario.road.stop_lines if line.light is not None]
    if not lines:
        return Unavailable("the log's map has no stop line with a traffic light")
    needed, known, lacking = np.zeros(len(x), np.bool_), np.ones(len(x), np.bool_), set[int]()
    for line in lines:
        near = points_inside(scenario.road.lanes[line.lane].polygon, x, y)
        light, shown = lights.get(line.light or 0), np.zeros(len(x), np.bool_)
        if light is not None:
            lit = np.array([colour is not Colour.OFF for colour in light.colours])
            sample = np.searchsorted(light.t, trace.ego.t + 1e-9, side="right") - 1
            shown = (sample >= 0) & (lit[np.maximum(sample, 0)] | (not lit.any()))
        lacking |= {line.light or 0} if (near & ~shown).any() else set()
        needed, known = needed | near, known & (shown | ~near)
    if not needed.any():
        return Unavailable("no stop line with a traffic light lies on the driven way")
    return _series_of(
        trace,
        known,
        f"traffic light {', '.join(map(str, sorted(lacking)))} is not observed",
        needed,
    )


@metric(
    unit="s",
    better="none",
    modes=BOTH_LOOPS,
    reductions=(FINAL,),
    needs="a road user with two samples",
)
def agent_interval(trace: Trace, scenario: Scenario) -> Measured:
    """Time between two samples of a road user in the log, the median over all that are not static:
    how near to its bound a value is marginal.

    Formula: median of t_k - t_(k-1), gaps left out
    """
    tracks = scenario.tracks
    intervals = np.diff(tracks.t, append=np.inf)
    intervals[tracks.offsets[1:] - 1] = np.inf
    static = np.repeat(tracks.static, np.diff(tracks.offsets))
    intervals = intervals[np.isfinite(intervals) & ~static & ~tracks.gap_after]
    if not len(intervals):
        return Unavailable("the log has no road user that is sampled twice")
    return Series(trace.ego.t[-1:], np.array([float(np.median(intervals))]))


@metric(unit="1", better="lower", reductions=(FINAL,))
def replay_contact(trace: Trace, scenario: Scenario) -> Measured:
    """1 if a replayed road user ran into the ego without its fault and so ended the drive.

    Formula: [the drive ended by the replay]
    """
    ended = trace.end is EndReason.REPLAY_CONTACT
    label = trace.detail if ended else ""
    return Series(trace.ego.t[-1:], np.array([float(ended)]), (label,))


_status_metric = partial(
    metric,
    unit="1",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(RATE,),
    needs="a plan, and lanes or a path that the vehicle can follow",
)


@_status_metric()
def plan_refused(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames whose plan does not start at the ego, or is impossible for a road car: it
    is not driven.

    Formula: refused plans / plans; bounds: replay/loop/plan_check.py
    """
    return _with_status(PlanStatus.REFUSED, trace, scenario)


@_status_metric()
def plan_corrected(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames whose plan says another speed, heading, curvature or acceleration than
    its positions have.

    Formula: corrected plans / plans; bounds: replay/loop/plan_check.py
    """
    return _with_status(PlanStatus.CORRECTED, trace, scenario)


@metric(
    unit="1",
    better="none",
    modes=BOTH_LOOPS,
    reductions=(FINAL,),
    parts=tuple(DRIVEN_BY),
    needs="a log that says who drove",
)
def driven_by(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Share of the log's time in which its car was driven by its stack, by a person, by both (one
    axis each), or in which that is not known; flickers of less than 0.5 s are left out.

    Formula: time in the mode / time of the log's drive
    """
    begin, end = map(float, scenario.ego.t[[0, -1]])
    if scenario.driving is None or not begin < end:
        return Unavailable("the log does not say who drove")
    spans = scenario.driving.steady().spans(begin, end)
    shares = {
        part: sum(last - first for first, last, mode in spans if mode in modes) / (end - begin)
        for part, modes in DRIVEN_BY.items()
    }
    return {
        part: Series(np.array([trace.ego.t[-1]]), np.array([share]))
        for part, share in shares.items()
    }


@metric(unit="1", better="none", modes=BOTH_LOOPS, reductions=(RATE,), needs="plans")
def planned_afresh(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames at which the planner had no previous plan to continue (`Frame.previous`):
    in open loop all, in closed loop the first.

    Formula: frames without a previous plan / frames
    """
    if not trace.frames:
        return NO_PLANS
    t = frame_times(trace)
    return Series(t, np.ones(len(t)) if trace.mode is Mode.OPEN else (t == t[0]).astype(float))


@where_followed
def _with_status(status: PlanStatus, trace: Trace, scenario: Scenario) -> Measured:
    """Mark the frames whose plan has a status; labels are the reasons."""
    if not trace.frames:
        return NO_PLANS
    plans = [frame.plan for frame in trace.frames]
    flags = np.array([float(plan.status is status) for plan in plans])
    labels = tuple(plan.reason if plan.status is status else "" for plan in plans)
    return Series(frame_times(trace), flags, labels)


@metric(
    unit="1",
    better="none",
    modes=BOTH_LOOPS,
    reductions=(
        replace(FINAL, name="pass_share", direction="higher"),
        replace(FINAL, name="fragile", direction="lower"),
    ),
    needs="--ensemble N",
)
def ensemble(trace: Trace, scenario: Scenario) -> Measured:
    """Whether the verdict on a log holds where it is driven again in worlds that should not matter:
    share of them in which it passes, and 1 where one of them has another verdict.

    Formula: members that pass / members; [a member has another verdict]
    """
    return Unavailable("the run has no ensemble (--ensemble N)")


_NO_GATES = Unavailable("no gates were judged")


@metric(
    unit="1",
    better="none",
    modes=BOTH_LOOPS,
    reductions=(replace(FINAL, name="share", direction="higher"),),
    needs="a run with gates",
)
def asked(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the gates of this loop that were asked of this log: the others had nothing to judge.

    Formula: gates that pass, fail or are inconclusive / gates of the loop
    """
    return _NO_GATES


@metric(
    unit="1",
    better="higher",
    reductions=(replace(FINAL, name=name) for name in ("parked", "creeping", "blind")),
    needs="a run with gates",
)
def discrimination(trace: Trace, scenario: Scenario) -> Measured:
    """Whether the log tells drivers apart: 1 where a gate of the run fails a driver that brakes to
    a stop and stays (parked), one that goes on at 2 m/s (creeping), and one that drives its route
    as if the road were empty (blind).

    Formula: [a gate on safety, rules or progress fails the reference drive]
    """
    return _NO_GATES


@metric(unit="count", better="none", modes=BOTH_LOOPS, reductions=(COUNT,))
def phantom(trace: Trace, scenario: Scenario) -> Measured:
    """Boxes in which the recorded ego stood: they are left out of all metrics and end no drive,
    from 1 s before to 1 s after.

    Formula: number of boxes that overlap the recorded ego's; 0 in synthesised logs
    """
    boxes = phantoms(scenario)
    names = "; ".join(dict.fromkeys(box.name for box in boxes))
    return Series(trace.ego.t[:1], np.array([float(len(boxes))]), (names,))
