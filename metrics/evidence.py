"""Evidence of a drive: how much was driven, whether the replay ended it, whether plans were
refused, robustness.

EVIDENCE measures at which steps a drive has the evidence that verdicts need, as one series of 0 and
1 for each kind:

    traffic   the other road users were observed (`Scenario.traffic_spans`)
    lights    the colour of the traffic light is known, on lanes that lead to a stop line with a
              light
    limit     the log states a speed limit (not assumed) for the lane under the ego's centre
    lane      a lane of the log's map lies under the ego's centre

(1) share = duration of the steps with evidence / duration of all steps that need evidence
        (`metric.durations`)
(2) way_share = the same with the distance driven in place of the duration;
        (1) if the ego does not move

In the log, the others reacted to the logged ego. With the ego's position p(t), and the logged
position q(t), speed v(t) and heading h(t):

(3) d(t) = |p - q|, along(t) = (p - q) . h, across(t) = (p - q) x h
(4) the drive departs from the log if |along| > max(v AWAY_S, `LENGTH_M`) or |across| > `WIDTH_M`,
    or if a road user is farther than `OFF_M` from its logged position, or is present in only one of
    the two

The replay is weak evidence from the first such step to the end of the drive. `AWAY_S`: one second
of driving is about the least gap that drivers should keep; farther away, the ego may be where
another road user was. At low speed the bound is the length of a car, and sideways the width of a
lane. `OFF_M` is smaller than these bounds, and larger than the differences between resampled
tracks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.observed import described, within
from replan.logs.plan import PlanStatus
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import metric
from replan.metrics.boxes import each, ego_boxes, name_of, phantoms, some_at
from replan.metrics.lanes import limits_at, mapped_lanes, off_lanes, points_inside, stated_lanes
from replan.metrics.metric import (
    Direction,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    where_followed,
)
from replan.metrics.plans import NO_PLANS, frame_times

AWAY_S, LENGTH_M, WIDTH_M = 1.0, 5.0, 3.5
OFF_M = 0.5
_NO_DRIVE = Unavailable("the log holds one ego state only: there is no drive to part from")


def _coverage(trace: Trace, scenario: Scenario) -> Mapping[str, Measured] | Unavailable:
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
    """1 with evidence, 0 without, NaN where no evidence is needed; `way` is the distance of each
    step, m.
    """

    way: FloatArray = field(default_factory=partial(np.empty, 0))


def _evidence(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    (x, y), t, spans = ego_boxes(trace.ego, scenario)[:2], trace.ego.t, scenario.traffic_spans
    observed = (
        f"traffic is recorded {described(spans)}, the drive lasts from {t[0]:.1f} s to "
        f"{t[-1]:.1f} s"
    )
    stated, mapped, none = (
        stated_lanes(scenario.road),
        mapped_lanes(scenario.road),
        np.zeros(len(t), np.bool_),
    )
    limit = none if stated is None else np.isfinite(limits_at(stated, x, y))
    lane = none if mapped is None else off_lanes(mapped, x, y) == 0.0
    no_lane = (
        "the log has no lanes for cars"
        if mapped is None
        else "no lane of the log's map lies under the ego"
    )
    return {
        "traffic": _series_of(trace, within(spans, t), observed),
        "lights": _lights(trace, scenario, x, y),
        "limit": _series_of(
            trace, limit, "the log has no speed limit here: it is assumed, or not asked for"
        ),
        "lane": _series_of(trace, lane, no_lane),
    }


def _series_of(
    trace: Trace, known: BoolArray, why: str, needed: BoolArray | None = None
) -> Evidence:
    """Return the series of one kind of evidence; `why` is the label of steps that need evidence and
    have none.
    """
    ego = trace.ego
    needed = np.ones(len(known), np.bool_) if needed is None else needed
    value = np.where(needed, known.astype(np.float64), np.nan)
    labels = tuple(why if lacking else "" for lacking in (needed & ~known).tolist())
    return Evidence(
        ego.t,
        value,
        labels,
        way=metric.split_to_neighbours(np.hypot(np.diff(ego.x), np.diff(ego.y))),
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
            at = np.searchsorted(light.t, trace.ego.t + 1e-9, side="right") - 1
            shown = (at >= 0) & (lit[np.maximum(at, 0)] | (not lit.any()))
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


def _share(series: Series, *, of_way: bool = False) -> tuple[float, int]:
    """Return (1) or (2), and the first step without evidence."""
    known = series.known
    weight = series.way if of_way and isinstance(series, Evidence) else metric.durations(series.t)
    weight = weight if weight[known].sum() > 0.0 else metric.durations(series.t)
    weight = weight if weight[known].sum() > 0.0 else np.ones(len(known))
    return float(np.average(series.value[known], weights=weight[known])), metric.first_of(
        series.value == 0.0
    )


def _replay_contact(trace: Trace, scenario: Scenario) -> Measured:
    ran = trace.end is EndReason.REPLAY_CONTACT
    return Series(trace.ego.t[-1:], np.array([float(ran)]), (trace.detail if ran else "",))


@where_followed
def _by_status(status: PlanStatus, trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return NO_PLANS
    plans = [frame.plan for frame in trace.frames]
    flags = np.array([float(plan.status is status) for plan in plans])
    return Series(
        frame_times(trace), flags, tuple(p.reason if p.status is status else "" for p in plans)
    )


def _phantom(trace: Trace, scenario: Scenario) -> Measured:
    found = phantoms(scenario)
    names = "; ".join(dict.fromkeys(phantom.name for phantom in found))
    return Series(trace.ego.t[:1], np.array([float(len(found))]), (names,))


def _agent_interval(trace: Trace, scenario: Scenario) -> Measured:
    tracks = scenario.tracks
    apart = np.diff(tracks.t, append=np.inf)
    apart[tracks.offsets[1:] - 1] = np.inf
    apart = apart[
        np.isfinite(apart) & ~np.repeat(tracks.static, np.diff(tracks.offsets)) & ~tracks.gap_after
    ]
    if not len(apart):
        return Unavailable("the log has no road user that is sampled twice")
    return Series(trace.ego.t[-1:], np.array([float(np.median(apart))]))


def _distances(trace: Trace, scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d of (3), and along and across divided by their bounds (4), `(k,)` each; NaN after the
    logged ego ends.
    """
    drive, log = trace.ego, scenario.ego
    x, y, yaw, v = (np.interp(drive.t, log.t, column) for column in (log.x, log.y, log.yaw, log.v))
    dx, dy, c, s = drive.x - x, drive.y - y, np.cos(yaw), np.sin(yaw)
    lasts = np.where(drive.t <= log.t[-1] + 1e-6, 1.0, np.nan)
    along = (c * dx + s * dy) / np.maximum(np.abs(v) * AWAY_S, LENGTH_M)
    return np.hypot(dx, dy) * lasts, along * lasts, (c * dy - s * dx) / WIDTH_M * lasts


def _displaced_agents(trace: Trace, scenario: Scenario) -> Iterator[tuple[str, BoolArray]]:
    """Yield the name of each agent that departs from its logged position (4), and at which steps
    `(k,)`.
    """
    log, agents, t = scenario.tracks, trace.agents, trace.ego.t
    index = {name: i for i, name in enumerate(agents.ids)}
    for i, there, row in each(log, t) if agents is not log else ():
        at = index.get(log.ids[i], -1)
        off = there.there[row].copy()
        if at >= 0:
            here = some_at(agents, np.array([at]), t)
            both = here.there[0] & there.there[row]
            off = here.there[0] != there.there[row]
            off[both] = np.hypot(*(here.pose[:2, 0] - there.pose[:2, row])[:, both]) > OFF_M
        if off.any():
            yield name_of(log, i), off


def _divergence_weak(trace: Trace, scenario: Scenario) -> Measured:
    if len(scenario.ego) < 2:
        return _NO_DRIVE
    t, (_, along, across) = trace.ego.t, _distances(trace, scenario)
    ways = (
        ("the ego along its way", np.abs(along) > 1.0),
        ("the ego across its way", np.abs(across) > 1.0),
    )
    parted = {name: off for name, off in (*ways, *_displaced_agents(trace, scenario)) if off.any()}
    first = min((int(np.argmax(off)) for off in parted.values()), default=len(t))
    why = "; ".join(name for name, off in parted.items() if off[first])
    weak = np.where(np.arange(len(t)) >= first, t, np.nan)
    return Series(t, weak, (why,) * len(t), "the drive never parts from the log")


COVERAGE = Metric(
    "coverage",
    "s",
    "higher",
    (Mode.OPEN, Mode.CLOSED),
    _coverage,
    (metric.FINAL,),
    "Time that the log lasts from the ego's first state on (log_s; open loop: as long as the log "
    "has an ego; where the"
    " drive ends with the evidence: as long as that), and that"
    " was driven or planned (driven_s).",
    parts=("log_s", "driven_s"),
    formula="last time - first time",
    needs="open loop: a log that holds a drive",
)
EVIDENCE = Metric(
    "evidence",
    "1",
    "higher",
    (Mode.OPEN, Mode.CLOSED),
    _evidence,
    (Reduction("share", _share), Reduction("way_share", partial(_share, of_way=True))),
    "Share of the driven time, and of the driven way, with what verdicts rest on: the other road "
    "users observed"
    " (traffic), the light ahead known (lights), a speed limit of the log's own (limit), a lane of "
    "its map (lane).",
    parts=("traffic", "lights", "limit", "lane"),
    formula="time or way with evidence / time or way that needs it",
    needs="lights: a stop line with a traffic light on the driven way",
)
AGENT_INTERVAL = Metric(
    "agent_interval",
    "s",
    "none",
    (Mode.OPEN, Mode.CLOSED),
    _agent_interval,
    (metric.FINAL,),
    "Time between two samples of a road user in the log, the median over all that are not static: "
    "how near to its bound"
    " a value is marginal.",
    formula="median of t_k - t_(k-1), gaps left out",
    needs="a road user with two samples",
)
REPLAY_CONTACT = Metric(
    "replay_contact",
    "1",
    "lower",
    (Mode.CLOSED,),
    _replay_contact,
    (metric.FINAL,),
    "1 if a replayed road user ran into the ego without its fault and so ended the drive.",
    formula="[the drive ended by the replay]",
)
PLAN_REFUSED = Metric(
    "plan_refused",
    "1",
    "lower",
    (Mode.OPEN, Mode.CLOSED),
    partial(_by_status, PlanStatus.REFUSED),
    (metric.RATE,),
    "Share of the frames whose plan does not start at the ego, or is impossible for a road car: it "
    "is not driven.",
    formula="refused plans / plans; bounds: replay/loop/plan_check.py",
    needs="a plan, and lanes or a path that the vehicle can follow",
)
PLAN_CORRECTED = Metric(
    "plan_corrected",
    "1",
    "lower",
    (Mode.OPEN, Mode.CLOSED),
    partial(_by_status, PlanStatus.CORRECTED),
    (metric.RATE,),
    "Share of the frames whose plan says another speed, heading, curvature or acceleration than "
    "its positions have.",
    formula="corrected plans / plans; bounds: replay/loop/plan_check.py",
    needs="a plan, and lanes or a path that the vehicle can follow",
)
_MEMBERS: tuple[tuple[str, Direction], ...] = (("pass_share", "higher"), ("fragile", "lower"))
ENSEMBLE = Metric(
    "ensemble",
    "1",
    "none",
    (Mode.OPEN, Mode.CLOSED),
    lambda trace, scenario: Unavailable("the run has no ensemble (--ensemble N)"),
    tuple(replace(metric.FINAL, name=name, direction=better) for name, better in _MEMBERS),
    "Whether the verdict on a log holds where it is driven again in worlds that should not matter: "
    "share of them in"
    " which it passes, and 1 where one of them has another verdict.",
    formula="members that pass / members; [a member has another verdict]",
    needs="--ensemble N",
)
ASKED = Metric(
    "asked",
    "1",
    "none",
    (Mode.OPEN, Mode.CLOSED),
    lambda trace, scenario: Unavailable("no gates were judged"),
    (replace(metric.FINAL, name="share", direction="higher"),),
    "Share of the gates of this loop that were asked of this log: the others had nothing to judge.",
    formula="gates that pass, fail or are inconclusive / gates of the loop",
    needs="a run with gates",
)
DISCRIMINATION = Metric(
    "discrimination",
    "1",
    "higher",
    (Mode.CLOSED,),
    lambda trace, scenario: Unavailable("no gates were judged"),
    tuple(replace(metric.FINAL, name=name) for name in ("parked", "creeping", "blind")),
    "Whether the log tells drivers apart: 1 where a gate of the run fails a driver that brakes to "
    "a stop and stays"
    " (parked), one that goes on at 2 m/s (creeping), and one that drives its route as if the road "
    "were empty (blind).",
    formula="[a gate on safety, rules or progress fails the reference drive]",
    needs="a run with gates",
)
PHANTOM = Metric(
    "phantom",
    "count",
    "none",
    (Mode.OPEN, Mode.CLOSED),
    _phantom,
    (metric.COUNT,),
    "Boxes in which the recorded ego stood: they are left out of all metrics and end no drive, "
    "from 1 s before to 1 s"
    " after.",
    formula="number of boxes that overlap the recorded ego's; 0 in synthesised logs",
)
FROM = Reduction(
    "from", lambda series: (float(series.value[series.known][0]), int(np.argmax(series.known)))
)
DIVERGENCE = Metric(
    "divergence",
    "m",
    "none",
    (Mode.CLOSED,),
    lambda trace, scenario: (
        Series(trace.ego.t, _distances(trace, scenario)[0]) if len(scenario.ego) > 1 else _NO_DRIVE
    ),
    (metric.MAX,),
    "Distance between the ego and where the log has it at the same time, while the log's ego "
    "lasts.",
    formula="|p - q|",
    needs="a log that holds the ego's drive",
)
WEAK = Metric(
    "divergence_weak",
    "s",
    "none",
    (Mode.CLOSED,),
    _divergence_weak,
    (FROM, Reduction("share", metric.HAVING.reduce, unit="1", direction="none", empty=0.0)),
    "From when on the drive has parted from its log, so that the replay is weak evidence, and the "
    "share after that.",
    parameters=(
        f"along {AWAY_S:g} s of way, at least {LENGTH_M:g} m",
        f"across {WIDTH_M:g} m",
        f"a road user {OFF_M:g} m",
    ),
    formula=(
        f"first t: |along| > max({AWAY_S:g} s v, {LENGTH_M:g} m) or |across| > {WIDTH_M:g} m "
        "or a road user off"
    ),
    needs="a log that holds the ego's drive",
)
DISPLACED = Metric(
    "displaced",
    "count",
    "none",
    (Mode.CLOSED,),
    lambda trace, scenario: metric.counted(
        trace.ego.t,
        ((int(np.argmax(off)), name) for name, off in _displaced_agents(trace, scenario)),
    ),
    (metric.COUNT,),
    "Road users who were not where the log has them, each once: who gave way, and who was held up "
    "by them.",
    formula="number of road users farther than this from where the log has them",
    parameters=(f"{OFF_M:g} m",),
)
