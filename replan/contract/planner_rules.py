"""The contract of planners."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np

from replan.contract.breaches import LOOP, Findings, call, difference, scenarios_or_default
from replan.logs.frame import PLAN_HORIZON_S, Frame, PlannerContext
from replan.logs.plan import Plan, PlanStart, PlanStatus
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS
from replan.logs.trace import EndReason
from replan.logs.tracks import Tracks
from replan.metrics.arrival import goal_of
from replan.planners.base import Planner
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.plan_check import START_M, START_MPS, SWING_MPS, checked
from replan.replay.loop.planning import Planning, planner_context
from replan.replay.parts import Factory
from replan.replay.perception import Perception
from replan.replay.planner_process.coordinates import (
    built,
    context_in_map,
    coordinates_of,
    frame_in_map,
)
from replan.replay.planner_process.past_messages import NOT_ASKED, past_s_of
from replan.replay.planner_process.planner_config import of_class, planner_part
from replan.replay.world import World, logged_ego

PLANNER_RULES: Mapping[str, str] = {
    "build": "Class(context) builds a planner: give every other argument a default",
    "answer": (
        "return a Plan at every frame; if there is none, a fallback with its status and a reason"
    ),
    "time": "begin the trajectory at frame.t",
    "start": (
        "begin in the ego's state, or with PlanStart.PREVIOUS_PLAN in "
        "frame.previous.trajectory.at(frame.t)"
    ),
    "horizon": "plan for at least context.horizon",
    "reason": "say in `reason` why the plan is a fallback",
    "columns": "compute speed, heading, curvature and acceleration of the positions",
    "drivable": "plan what a car can drive",
    "frame": "copy the frame's arrays before changing them",
    "deterministic": "use no clock, and no random numbers without a seed",
    "memory": "use nothing of earlier frames where frame.previous is None",
    "future": "use the frame and the context only",
    "batch": "return a list from plan_batch: a plan for each frame",
}
"""The rules for planners, with their remedies."""
SHARES = (0.0, 0.35, 0.7)
"""The frames that are examined one by one, as shares of the logged drive."""
RECENT_FRAMES = 5
RECENT_S = RECENT_FRAMES * LOOP.plan_period_s
"""Before each of these frames the planner gets those of the last `RECENT_S`."""
CLOSED_S = 2.0
"""Length of the closed loop, s."""
ROUNDING = 1e-9
"""A solver that was set up by another problem rounds otherwise."""

Build = Callable[[Scenario], Planner]
"""Builds a planner for a scenario; one that is no oracle uses only its `context_of`."""


def check_planner(planner: Factory | str, *, scenarios: Iterable[Scenario] | None = None) -> None:
    """Check the contract of a planner: at single frames with a new memory, and in closed loop.

    The rules are those of `replan.contract.PLANNER_RULES`.

    Args:
        planner: The class, a function that builds a planner from the context, a name, or
            "module:Class".
        scenarios: The scenarios to plan in; None: some of the catalogue.

    Raises:
        ContractError: A rule is broken.
        ConfigError: No planner has this name, or it is a program.
        PlannerError: The planner cannot be loaded.
    """
    factory = planner_part(planner).factory if isinstance(planner, str) else planner
    findings = Findings(PLANNER_RULES)
    prepare = of_class(factory, "prepare")
    if prepare is not None:
        prepare()
    for scenario in scenarios_or_default(scenarios):
        _check_frames(factory, scenario, findings)
        # With these no drive goes on
        if not {"build", "answer", "time", "reason"} & findings.breaches.keys():
            _check_closed_loop(factory, scenario, findings)
            _check_batch(factory, scenario, findings)
    findings.report(f"planner {_name_of(planner)}")


def _name_of(extension: object) -> str:
    return (
        extension
        if isinstance(extension, str)
        else getattr(extension, "__qualname__", repr(extension))
    )


def context_of(scenario: Scenario) -> PlannerContext:
    """Return the context of a planner for a scenario."""
    start = logged_ego(scenario.ego, scenario.vehicle, float(scenario.ego.t[0]))
    return planner_context(scenario, start, goal_of(scenario)[0], LOOP.plan_period_s)


def frame_of(scenario: Scenario, t: float) -> Frame:
    """Return the frame at a time of the logged drive, without a previous plan."""
    return frames_of(scenario, [t])[0]


def frames_of(scenario: Scenario, times: Sequence[float]) -> list[Frame]:
    """Return frames of the logged drive that follow each other, without a previous plan."""
    perception = Perception(scenario, LOOP)
    egos = (logged_ego(scenario.ego, scenario.vehicle, t) for t in times)
    return [perception.frame(World(ego, scenario.tracks), None) for ego in egos]


def frame_times_of(scenario: Scenario) -> list[float]:
    """Return the times of the frames that are examined one by one."""
    first, last = float(scenario.ego.t[0]), float(scenario.ego.t[-1])
    return [round(first + share * (last - first), 2) for share in SHARES]


def recent_times(scenario: Scenario, t: float) -> list[float]:
    """Return the times of the frames just before a time, as far as the log has them."""
    times = [round(t - RECENT_S + k * LOOP.plan_period_s, 6) for k in range(RECENT_FRAMES)]
    return [earlier for earlier in times if earlier >= scenario.ego.t[0]]


def until(tracks: Tracks, t: float) -> Tracks:
    """Return the tracks cut at a time: no later sample, and no agent that appears later."""
    keep = tracks.t <= t + 1e-9
    first = tracks.offsets[:-1][tracks.static]
    keep[first] = True
    return tracks.taken(keep)


def _check_frames(factory: Factory, scenario: Scenario, findings: Findings) -> None:
    """Check the rules about single frames; the frames of one planner follow each other."""

    def build(seen_scenario: Scenario) -> Planner:
        return WithAskedPast.of(factory, built(factory, context_of(seen_scenario)))

    first, second = (call(findings, "build", scenario.name, build, scenario) for _ in range(2))
    if first is None or second is None:
        return
    for t in frame_times_of(scenario):
        where = f"{scenario.name}, {t:.2f} s"
        frame, again = frame_of(scenario, t), frame_of(scenario, t)
        # What it saw just before is in the past of the frame, and must not be in its memory only
        for earlier in frames_of(scenario, recent_times(scenario, t)):
            for planner in (first, second):
                call(findings, "answer", where, planner.plan, earlier)
        plan = call(findings, "answer", where, first.plan, frame)
        check_plan(plan, frame, where, findings)
        changed = difference(frame, again)
        if changed:
            findings.add("frame", where, f"it changed frame.{changed}")
        other = call(findings, "answer", where, second.plan, again)
        if changed or not isinstance(plan, Plan) or not isinstance(other, Plan):
            return
        differs = _plans_differ(plan, other)
        if differs:
            findings.add(
                "deterministic", where, f"two planners with the same frames differ: {differs}"
            )
        if "deterministic" not in findings.breaches:
            new = call(findings, "memory", where, _plan_anew, build, scenario, t)
            differs = _plans_differ(plan, new, ROUNDING) if new else ""
            if differs:
                findings.add(
                    "memory",
                    where,
                    f"a planner that saw earlier frames and a new one differ: {differs}",
                )
            changes = call(findings, "future", where, future_changes, build, scenario, t)
            if changes:
                findings.add(
                    "future", where, f"samples of agents after the frame change the plan: {changes}"
                )


def _plan_anew(build: Build, scenario: Scenario, t: float) -> Plan:
    return build(scenario).plan(frame_of(scenario, t))


def future_changes(build: Build, scenario: Scenario, t: float) -> str:
    """Return how samples of agents later than `t` change the plan at `t`; "" if they do not."""
    without = replace(scenario, tracks=until(scenario.tracks, t))
    return _plans_differ(_plan_anew(build, scenario, t), _plan_anew(build, without, t))


def _plans_differ(first: Plan, second: Plan, tolerance: float = 0.0) -> str:
    """Return how two plans differ by more than the tolerance, or ""."""
    if first.status is not second.status:
        return f"the plans are '{first.status.value}' and '{second.status.value}'"
    a, b = first.trajectory, second.trajectory
    if len(a) != len(b):
        return f"the plans have {len(a)} and {len(b)} states"
    worst = {
        name: float(np.max(np.abs(getattr(a, name) - getattr(b, name))))
        for name in TRAJECTORY_COLUMNS
    }
    name = next((name for name, largest in worst.items() if largest > tolerance), "")
    return f"{name} by up to {worst[name]:.3g}" if name else ""


def check_plan(plan: object, frame: Frame, where: str, findings: Findings) -> None:
    """Check what holds for every plan.

    A trajectory is finite and its times increase (`Trajectory`).
    """
    if not isinstance(plan, Plan):
        findings.add("answer", where, f"it returned {type(plan).__name__}")
        return
    trajectory = plan.trajectory
    if abs(float(trajectory.t[0]) - frame.t) > 1e-6:
        findings.add("time", where, f"the trajectory begins at {trajectory.t[0]:.2f} s")
        return
    if plan.status.is_fallback and not plan.reason:
        findings.add("reason", where, f"the status is '{plan.status.value}', without a reason")
    begins, on = frame.ego, "the ego"
    if plan.start is PlanStart.PREVIOUS_PLAN:
        if frame.previous is None:
            findings.add("start", where, "it starts on a previous plan, and there is none")
            return
        begins, on = frame.previous.trajectory.at(frame.t), "the previous plan"
    away, faster = (
        hypot(trajectory.x[0] - begins.x, trajectory.y[0] - begins.y),
        float(trajectory.v[0]) - begins.v,
    )
    # As `replan.replay.loop.plan_check` (1)
    stopped = trajectory.v[0] == 0.0 and -SWING_MPS <= begins.v < 0.0
    if away > START_M or (abs(faster) > START_MPS and not stopped):
        findings.add("start", where, f"it starts {away:.2f} m and {faster:+.2f} m/s off {on}")
        return
    if trajectory.t[-1] < frame.t + PLAN_HORIZON_S - 1e-6:
        findings.add("horizon", where, f"the plan ends after {trajectory.t[-1] - frame.t:.2f} s")
    driven = checked(plan, frame)
    if driven.status is not plan.status:
        rule = "columns" if driven.status is PlanStatus.CORRECTED else "drivable"
        findings.add(rule, where, driven.reason)


class WithAskedPast:
    """A planner whose frames have a past only if its class asks for it, as in its own process."""

    def __init__(self, planner: Planner, asked: float) -> None:
        self._planner, self._asked = planner, asked

    @classmethod
    def of(cls, factory: Factory, planner: Planner) -> WithAskedPast:
        """A planner as its factory built it."""
        return cls(planner, past_s_of(factory))

    def plan(self, frame: Frame) -> Plan:
        """Return the planner's answer."""
        return self._planner.plan(frame if self._asked else replace(frame, earlier=NOT_ASKED))


class _WatchedPlanner:
    """A planner whose plans are checked as it makes them."""

    def __init__(self, planner: Planner, name: str, findings: Findings) -> None:
        self._planner, self._name, self._found = planner, name, findings

    def plan(self, frame: Frame) -> Plan:
        plan = self._planner.plan(frame)
        check_plan(plan, frame, f"{self._name}, closed loop, {frame.t:.2f} s", self._found)
        return plan


def _check_closed_loop(factory: Factory, scenario: Scenario, findings: Findings) -> None:
    class Seat(Planning):
        """Calls the planner that is checked."""

        def __init__(self, *arguments: Any, **keywords: Any) -> None:
            super().__init__(*arguments, **keywords)
            self.context = context_of(scenario)  # that of a built-in planner has no route
            asking = WithAskedPast.of(factory, built(factory, self.context))
            self._planner = _WatchedPlanner(asking, scenario.name, findings)

    before = dict(findings.breaches)
    trace = run_closed_loop(
        scenario, "constant_speed", config=LOOP, until_s=CLOSED_S, seat=Seat
    ).trace
    if trace.end is EndReason.PLANNER_FAILURE and findings.breaches == before:
        findings.add("answer", f"{scenario.name}, closed loop", trace.detail)


def _check_batch(factory: Factory, scenario: Scenario, findings: Findings) -> None:
    """Check that `plan_batch`, if there is one, plans each of two frames."""
    together = of_class(factory, "plan_batch")
    if together is None:
        return
    frames = [frame_of(scenario, t) for t in frame_times_of(scenario)[:2]]
    context = context_of(scenario)
    if coordinates_of(factory) == "map":
        frames = [frame_in_map(frame, context.origin) for frame in frames]
        context = context_in_map(context)
    where = f"{scenario.name}, plan_batch of {len(frames)} frames"
    plans = call(findings, "batch", where, together, frames, [factory(context) for _ in frames])
    if plans is None:
        return
    if not isinstance(plans, list) or len(plans) != len(frames):
        findings.add(
            "batch", where, f"it returned {type(plans).__name__}, not a list of {len(frames)} plans"
        )
        return
    for plan, frame in zip(plans, frames, strict=True):
        check_plan(plan, frame, f"{where}, {frame.t:.2f} s", findings)
