"""What a drive can be evidence of: how much was driven, did the replay end it, were its plans plans, is it robust."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from logs.scenario import Scenario
from logs.trace import EndReason, Mode, PlanStatus, Trace
from metrics.metric import COUNT, FINAL, RATE, Measured, Metric, Reduction, Series, Unavailable
from metrics.phantoms import phantoms
from metrics.plans import frame_times


def _coverage(trace: Trace, scenario: Scenario) -> Mapping[str, Measured] | Unavailable:
    if trace.mode is Mode.OPEN and len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to plan along")
    start, end = float(scenario.ego.t[0]), trace.ego.t[-1:]
    last = scenario.duration if trace.mode is Mode.CLOSED else float(scenario.ego.t[-1])
    return {
        "log_s": Series(end, np.array([last - start])),
        "driven_s": Series(end, end - start),
    }


def _replay_contact(trace: Trace, scenario: Scenario) -> Measured:
    ran = trace.end is EndReason.REPLAY_CONTACT
    return Series(trace.ego.t[-1:], np.array([float(ran)]), (trace.detail if ran else "",))


def _with_status(status: PlanStatus, trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return Unavailable("the drive has no plans")
    plans = [frame.plan for frame in trace.frames]
    flags = np.array([float(plan.status is status) for plan in plans])
    return Series(frame_times(trace), flags, tuple(p.reason if p.status is status else "" for p in plans))


def _phantom(trace: Trace, scenario: Scenario) -> Measured:
    found = phantoms(scenario)
    names = "; ".join(dict.fromkeys(phantom.name for phantom in found))
    return Series(trace.ego.t[:1], np.array([float(len(found))]), (names,))


def _agent_interval(trace: Trace, scenario: Scenario) -> Measured:
    tracks = scenario.tracks
    apart = np.diff(tracks.t, append=np.inf)
    apart[tracks.offsets[1:] - 1] = np.inf
    apart = apart[np.isfinite(apart) & ~np.repeat(tracks.static, np.diff(tracks.offsets)) & ~tracks.gap_after]
    if not len(apart):
        return Unavailable("the log has no road user that is sampled twice")
    return Series(trace.ego.t[-1:], np.array([float(np.median(apart))]))


COVERAGE = Metric(
    "coverage", "s", "higher", (Mode.OPEN, Mode.CLOSED), _coverage, (FINAL,),
    "Time that the log lasts from the ego's first state on (log_s; open loop: as long as the log has an ego), and that"
    " was driven or planned (driven_s).",
    parts=("log_s", "driven_s"), formula="last time - first time",
    needs="open loop: a log that holds a drive",
)  # fmt: skip
AGENT_INTERVAL = Metric(
    "agent_interval", "s", "none", (Mode.OPEN, Mode.CLOSED), _agent_interval, (FINAL,),
    "Time between two samples of a road user in the log, the median over all that are not static: how near to its bound"
    " a value is marginal (`metrics.marginal`).",
    formula="median of t_k - t_(k-1), gaps left out", needs="a road user with two samples",
)  # fmt: skip
REPLAY_CONTACT = Metric(
    "replay_contact", "1", "lower", (Mode.CLOSED,), _replay_contact, (FINAL,),
    "1 if a replayed road user ran into the ego without its fault and so ended the drive.",
    formula="[the drive ended by the replay]",
)  # fmt: skip
PLAN_REFUSED = Metric(
    "plan_refused", "1", "lower", (Mode.OPEN, Mode.CLOSED), partial(_with_status, PlanStatus.REFUSED), (RATE,),
    "Share of the frames whose plan does not start at the ego, or is impossible for a road car: it is not driven.",
    formula="refused plans / plans; bounds: replay/plan_check.py", needs="a plan",
)  # fmt: skip
PLAN_CORRECTED = Metric(
    "plan_corrected", "1", "lower", (Mode.OPEN, Mode.CLOSED), partial(_with_status, PlanStatus.CORRECTED), (RATE,),
    "Share of the frames whose plan says another speed, heading, curvature or acceleration than its positions have.",
    formula="corrected plans / plans; bounds: replay/plan_check.py", needs="a plan",
)  # fmt: skip
ENSEMBLE = Metric(
    "ensemble", "1", "none", (Mode.OPEN, Mode.CLOSED),
    lambda trace, scenario: Unavailable("the run has no ensemble (--ensemble N)"),
    (
        Reduction("pass_share", lambda series: (float(series.value[0]), -1), direction="higher"),
        Reduction("fragile", lambda series: (float(series.value[0]), -1), direction="lower"),
    ),
    "Whether the verdict on a log holds where it is driven again in worlds that should not matter: share of them in"
    " which it passes, and 1 where one of them has another verdict.",
    formula="members that pass / members; [a member has another verdict]", needs="--ensemble N",
)  # fmt: skip
PHANTOM = Metric(
    "phantom", "count", "none", (Mode.OPEN, Mode.CLOSED), _phantom, (COUNT,),
    "Boxes in which the recorded ego stood: they are left out of all metrics and end no drive, from 1 s before to 1 s"
    " after.",
    formula="number of boxes that overlap the recorded ego's; 0 in synthesised logs",
)  # fmt: skip
