"""What the planner had instead of what a failed gate asks for, from the plans before the event.

`DEMANDS` has a row per kind of gate: the metrics, what they ask for, and where the plans are
searched for it. A plan without artefacts (decisions, graphs) shows only its trajectory.

(1) window   the plans of the last `WINDOW_S` before the time of the gate's value
(2) named    a plan whose S-T or S-L graph, or whose decisions, contain the subject
(3) led      the pose and speed that the plan of `LED_S` before has at the time of the event,
             against those that were driven: if they differ, the ego did not follow its plan
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, isfinite, sin

import numpy as np

from replan.core.names import counted
from replan.explain.course import BRAKES_MPS2, Course
from replan.logs.plan import Decision, DecisionKind, Graph, Plan
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace
from replan.metrics.boxes import name_of
from replan.planners.frenet.scene import VULNERABLE
from replan.results.load import StoredDrive

WINDOW_S = 3.0
LED_S = 1.0
SOON_S = 1.0
OFF_PLAN_M, OFF_PLAN_MPS = 0.3, 0.5
"""An ego that is farther from its plan of `LED_S` before, across or in speed, did not follow it."""


@dataclass(frozen=True, slots=True)
class BrokenGate:
    """A failed gate of a drive.

    Attributes:
        rule: The gate.
        metric: Its row of the table.
        t: Time of its value, s; NaN if it belongs to no instant.
        about: Kind and id of the road user or object; empty if there is none.
        reason: What the metric found.
    """

    rule: str
    metric: str
    t: float
    about: str
    reason: str


Answer = Callable[[BrokenGate, Trace, Scenario], str]


@dataclass(frozen=True, slots=True)
class Demand:
    """What a kind of gate asks for, and how the plans answer it.

    Attributes:
        metrics: The first words of the names of its metrics.
        asks: What it asks for, after "asks".
        answer: What the planner had instead, as a clause.
    """

    metrics: tuple[str, ...]
    asks: str
    answer: Answer


def broken_gates(drive: StoredDrive) -> list[str]:
    """A sentence for the failed gates of a drive that ask the same about the same road user or
    object, in the order of time; those that nothing is asked of come last.

    LogError if the trace is damaged.
    """
    failed = drive.verdicts[drive.verdicts["outcome"] == "fail"]
    about = dict(zip(drive.metrics["metric"], drive.metrics["about"].fillna(""), strict=True))
    gates = [
        BrokenGate(row["gate"], row["metric"], row["time_s"], about[row["metric"]], row["reason"])
        for row in failed.to_dict("records")
    ]
    groups: dict[tuple[Demand | None, str], list[BrokenGate]] = {}
    for gate in sorted(gates, key=_time_of):
        demand = _demand_of(gate)
        groups.setdefault((demand, gate.about if demand else ""), []).append(gate)
    nothing = groups.pop((None, ""), [])
    sentences = [
        f"{_describe_failures(group)}: asks {demand.asks}; "
        f"{demand.answer(group[0], drive.trace, drive.scenario)}."
        for (demand, _), group in groups.items()
        if demand is not None
    ]
    return [*sentences, f"{_describe_failures(nothing)}."] if nothing else sentences


def _demand_of(gate: BrokenGate) -> Demand | None:
    word = gate.metric.partition(".")[0]
    demands = [demand for demand in DEMANDS if word in demand.metrics and isfinite(gate.t)]
    return demands[0] if demands else None


def _describe_failures(gates: Sequence[BrokenGate]) -> str:
    """The failed gates with time and reason, of those with the same reason only the first."""
    parts, before = [], ""
    for gate in gates:
        when = f" at {gate.t:.2f} s" if isfinite(gate.t) else ""
        why = f" ({gate.reason})" if gate.reason and gate.reason != before else ""
        parts.append(f"{gate.rule}{when}{why}")
        before = gate.reason
    return f"FAIL {', '.join(parts)}"


def _time_of(gate: BrokenGate) -> float:
    return gate.t if isfinite(gate.t) else np.inf


def _window(frames: Sequence[PlannedFrame], t: float) -> list[PlannedFrame]:
    """(1)."""
    return [frame for frame in frames if t - WINDOW_S - 1e-9 <= frame.t <= t + 1e-9]


# what the plans had -------------------------------------------------------------------------------


def _stop_at_line(gate: BrokenGate, trace: Trace, scenario: Scenario) -> str:
    return _describe_naming([gate.about], "obstacle at it", gate, trace)


def _heed_agent(gate: BrokenGate, trace: Trace, scenario: Scenario) -> str:
    """The road user of the gate; for another object (a crosswalk), the pedestrian or rider who is
    nearest to the ego at the time.
    """
    truth, ego = trace.agents.truth(gate.t), trace.ego.at(gate.t)
    tracks = trace.agents
    names = [tracks.ids[i] for i in range(len(tracks)) if name_of(tracks, i) == gate.about]
    far_m = np.where(VULNERABLE[truth.codes], np.hypot(truth.x - ego.x, truth.y - ego.y), np.inf)
    if not names and np.isfinite(far_m).any():
        names = [truth.ids[int(np.argmin(far_m))]]
    return _describe_shown(names, gate, trace)


def _describe_shown(names: Sequence[str], gate: BrokenGate, trace: Trace) -> str:
    """How often an agent was shown to the planner, and what the plans had about it."""
    if not names:
        return "the trace does not hold that road user"
    window = _window(trace.frames, gate.t)
    shown = [frame for frame in window if names[0] in frame.agents]
    if not shown:
        return f"perception did not show {names[0]} in the {WINDOW_S:g} s before"
    shown_words = f"{names[0]} was shown to the planner in {len(shown)} of {len(window)} frames"
    return (
        f"{shown_words}; {_describe_naming(names, 'obstacle or decision about them', gate, trace)}"
    )


def _describe_naming(names: Sequence[str], thing: str, gate: BrokenGate, trace: Trace) -> str:
    """(2), and the decision of the last plan that names the subject."""
    window = _window(trace.frames, gate.t)
    before = f"the {counted(len(window), 'plan')} of the {WINDOW_S:g} s before"
    if not any(_has_artefacts(frame.plan) for frame in window):
        return f"{before} have no decisions and graphs, so what they had instead is not known"
    named = [frame for frame in window if _decisions(frame.plan, names)]
    if not named:
        return f"no {thing} in any of {before}"
    last = _decisions(named[-1].plan, names)[0]
    why = f" ({last.reason})" if last.reason else ""
    gone = f", none after {named[-1].t:.2f} s" if named[-1] is not window[-1] else ""
    return (
        f"{thing} in {len(named)} of {before}, from {named[0].t:.2f} s on{gone}; the last decides: "
        f"{last.kind.value}{why}, and {_describe_motion(Course.of(named[-1].plan))}"
    )


def _has_artefacts(plan: Plan) -> bool:
    return any(isinstance(item, Graph | Decision) for item in plan.internals)


def _decisions(plan: Plan, names: Sequence[str]) -> list[Decision]:
    """The decisions of a plan about a subject, those of its graphs last."""
    graphs = [item for item in plan.internals if isinstance(item, Graph)]
    decided = [item for item in plan.internals if isinstance(item, Decision)]
    drawn = [
        Decision(obstacle.agent, obstacle.decision, graph.plane, "")
        for graph in graphs
        for obstacle in graph.obstacles
    ]
    about = [item for item in (*decided, *drawn) if item.agent in names]
    return sorted(about, key=_is_ignored)


def _is_ignored(decision: Decision) -> bool:
    return decision.kind is DecisionKind.IGNORE


def _describe_motion(course: Course) -> str:
    """What a plan does next, and its hardest braking."""
    if course.a_least > BRAKES_MPS2:
        return f"{course.action.value} without braking"
    return f"{course.action.value}; it brakes by {-course.a_least:.1f} m/s²{ahead(course)}"


def ahead(course: Course) -> str:
    """Where in the plan its hardest braking is, " 4.5 s ahead"; empty within its first second."""
    return f" {course.t_hardest:.1f} s ahead" if course.t_hardest >= SOON_S else ""


def _compare_with_plan(gate: BrokenGate, trace: Trace, scenario: Scenario) -> str:
    """(3): the newest plan that is at least `LED_S` older than the value, and reaches to it."""
    older = [
        frame
        for frame in trace.frames
        if frame.t <= gate.t - LED_S + 1e-9 and frame.plan.trajectory.t[-1] >= gate.t
    ]
    if not older:
        return f"no plan is {LED_S:g} s older"
    led, ego = older[-1].plan.trajectory.at(gate.t), trace.ego.at(gate.t)
    aside_m = (ego.y - led.y) * cos(led.yaw) - (ego.x - led.x) * sin(led.yaw)
    is_followed = abs(aside_m) <= OFF_PLAN_M and abs(ego.v - led.v) <= OFF_PLAN_MPS
    return (
        f"the plan of {older[-1].t:.2f} s leads to {abs(aside_m):.2f} m beside where the ego was, "
        f"at {led.v:.1f} m/s (the ego: {ego.v:.1f} m/s): "
        + ("it is as planned" if is_followed else "the ego did not follow its plan")
    )


DEMANDS = (
    Demand(
        ("red_light", "yellow_light", "stop_sign"),
        "for a stop at the line",
        _stop_at_line,
    ),
    Demand(
        ("crosswalk", "priority_gap", "priority_gap_assumed", "yielding"),
        "to let them go first (yield, or stop)",
        _heed_agent,
    ),
    Demand(
        (
            "collision_at_fault",
            "gap_kept",
            "gap_kept_vulnerable",
            "passing_room",
            "ttc",
            "ttc_vulnerable",
        ),
        "to keep clear of them (yield, stop, follow or nudge)",
        _heed_agent,
    ),
    Demand(("thw",), "to follow them at a distance", _heed_agent),
    Demand(
        ("off_road", "lane_line", "wrong_way", "lane_offset"),
        "for a path within its bounds",
        _compare_with_plan,
    ),
    Demand(
        ("speed_excess", "assumed_limit_excess", "curve_accel"),
        "for a lower speed",
        _compare_with_plan,
    ),
)
"""The kinds of gates; gates of other metrics are named without a search of the plans."""
