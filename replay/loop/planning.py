"""Builds, calls and times the planner of one scenario, checks its plans, and tests whether it is
deterministic.

The start of a drive is driven twice, each time with a newly built planner. The worlds are equal, so
the plans must be equal bit for bit: a difference comes from the planner (random numbers, a clock,
the order of a set, race conditions). It becomes a note of the drive and a mark in the reports,
because the results of a nondeterministic planner are those of a single try.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from replan.core.errors import ConfigError, PlannerError, ReplanError, raised
from replan.logs.frame import Frame, PlannerContext
from replan.logs.lane_groups import complete_road, lanes_of_lights
from replan.logs.lane_route import LaneRoute, RouteSource, lane_route
from replan.logs.plan import Plan
from replan.logs.road import Goal, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, EgoState
from replan.logs.trace import EndReason, Trace
from replan.metrics.arrival import goal_of
from replan.planners.base import Planner
from replan.replay.drive import FIRST, Drive, DriveKey, Mark, StageTime, Stopwatch
from replan.replay.loop.plan_check import checked
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import PLANNER
from replan.replay.planner_process.connection import ApartPlanner, FaultError, current_log
from replan.replay.planner_process.coordinates import InMap, built
from replan.replay.planner_process.planner_config import (
    is_apart,
    is_built_in,
    planner_part,
    prepared,
)

DRIVEN_PATH_NOTE = (
    "the road is the driven path: the planner knows where the log's driver went; open-loop errors "
    "across the path say nothing"
)

DRIVEN_ROUTE_NOTE = (
    "the route that the planner is shown follows the log's drive, since no lanes lead to the goal"
)


class Planning:
    """The planner named by the user, for one scenario.

    Args:
        scenario: The scenario; only an oracle receives it.
        spec: A name in `replan.replay.parts.PLANNER`, "module:Class", "exec:COMMAND" or
            "tcp://HOST:PORT".
        planner_config: Keywords of the planner; its configuration table where it runs in a process
            of its own.
        config: Configuration of the loop.
        start: The ego at the first frame.
        keep_internals: Whether the plans keep the planner's internals, in addition to its solvers'
            reports.
        place: Key of the drive.

    Attributes:
        is_oracle: Whether the planner knows the log.
        notes: Notes for the trace: an assumed goal, a planner that is trusted or batched.
        goal: The planner's goal.
        context: The context that the planner is built with.

    Raises:
        ConfigError: The planner does not exist, or does not accept these keywords.
        PlannerError: It cannot be loaded or built.
    """

    def __init__(
        self,
        scenario: Scenario,
        spec: str,
        planner_config: Mapping[str, object],
        config: LoopConfig,
        start: EgoState,
        *,
        keep_internals: bool = True,
        place: DriveKey = FIRST,
    ) -> None:
        goal, note = goal_of(scenario)
        self.is_oracle = spec in PLANNER.oracles
        known_path = DRIVEN_PATH_NOTE if scenario.road.source is RoadSource.DRIVEN_PATH else ""
        apart = is_apart(spec, config.apart)
        marks = {
            Mark.TRUSTED: (
                "the planner was trusted: it ran in the process that holds the log",
                not apart and not is_built_in(spec),
            ),
            Mark.BATCHED: (
                f"the planner's process was shared with other logs, up to {config.apart.batch} in "
                "all",
                apart and current_log() is not None,
            ),
        }
        self.marks = tuple(
            mark for mark, (_, holds) in marks.items() if holds and not self.is_oracle
        )
        self.notes = tuple(
            filter(None, (note, known_path, *(text for text, holds in marks.values() if holds)))
        )
        self.goal = goal
        self._keep = keep_internals
        self._name = f"planner '{spec}' on {scenario.name}"
        self._watch = Stopwatch()
        period = config.plan_period_ns / 1e9
        context = planner_context(scenario, start, goal, period, built_in=is_built_in(spec))
        if context.route.source is RouteSource.DRIVE:
            self.notes = (*self.notes, DRIVEN_ROUTE_NOTE)
        self.context = replace(context, lap=self._watch.lap)
        try:
            if apart:
                planner = ApartPlanner(
                    spec,
                    self.context,
                    planner_config,
                    config.apart,
                    self._watch,
                    keep_internals=keep_internals,
                    place=place,
                )
                in_map = planner.coordinates == "map"
                self._planner: Planner = InMap(planner, scenario.origin) if in_map else planner
            else:
                factory = planner_part(spec).factory
                more = (scenario,) if self.is_oracle else ()
                try:
                    inspect.signature(factory).bind(self.context, *more, **planner_config)
                except TypeError as error:
                    raise ConfigError(f"planner '{spec}' cannot be built: {error}") from None
                self._planner = built(
                    prepared(spec, planner_config), self.context, more, planner_config
                )
        except ReplanError:
            raise
        except FaultError as error:
            raise PlannerError(f"{self._name} {error}") from None
        except (Exception, SystemExit) as error:
            raise PlannerError(f"{self._name} cannot be built: {raised(error)}") from error

    @property
    def timings(self) -> tuple[StageTime, ...]:
        """The timings of all plans so far."""
        return self._watch.times

    def plan(self, frame: Frame) -> Plan:
        """Return the checked plan for a frame (`replan.replay.loop.plan_check`), with the internals
        to keep.

        The builders of internals refer to the frame, and the frame to the previous plan: they are
        resolved or dropped here.

        Raises:
            PlannerError: The planner raised, or its answer is not a plan.
        """
        self._watch.start()
        try:
            plan = self._planner.plan(frame)
        except FaultError as error:
            raise PlannerError(f"{self._name} {error}") from None
        except (Exception, SystemExit) as error:
            raise PlannerError(
                f"{self._name} raised at {frame.t:.2f} s: {raised(error)}"
            ) from error
        finally:
            self._watch.stop(frame.t)
        fault = _breach(plan, frame)
        if fault:
            raise PlannerError(f"{self._name} broke its contract at {frame.t:.2f} s: {fault}")
        origin = self.context.origin
        return (plan if self.is_oracle else checked(plan, frame, origin)).recorded(keep=self._keep)


def planner_context(
    scenario: Scenario, start: EgoState, goal: Goal | None, period: float, *, built_in: bool = False
) -> PlannerContext:
    """Return the context of a planner; the built-in ones get the log's road, and no route."""
    road, route = scenario.road, LaneRoute()
    if not built_in:  # such a planner could change objects that drives share
        road = complete_road(road)
        route = lane_route(road, start, goal, scenario.ego)
    return PlannerContext(
        road,
        goal,
        scenario.vehicle,
        period,
        start,
        origin=scenario.origin,
        route=route,
        light_lanes=lanes_of_lights(road),
        start_ns=scenario.start_ns,
    )


Seat = Callable[..., Planning]
"""Builds a `Planning` from its arguments."""


def _breach(plan: object, frame: Frame) -> str:
    """Return how an answer of the planner breaks its contract, or "".

    A Trajectory is always finite and increasing.
    """
    if not isinstance(plan, Plan):
        return f"it returned {type(plan).__name__} instead of a Plan"
    first = float(plan.trajectory.t[0])
    if abs(first - frame.t) > 1e-6:
        return f"its plan starts at {first:.3f} s, not at the frame's time"
    if plan.status.is_fallback and not plan.reason:
        return f"its status is '{plan.status.value}' without a reason"
    return ""


def with_probe(drive: Drive, again: Trace, until_s: float) -> Drive:
    """Return the drive, marked if a second drive of the same start differs from it.

    Args:
        drive: The drive.
        again: The same scenario, planner and loop, driven once more up to `until_s`.
        until_s: s since the scenario's start; later frames are not compared.
    """
    difference = nondeterminism(drive.trace, again, until_s)
    return marked_random(drive, difference) if difference else drive


def marked_random(drive: Drive, difference: str) -> Drive:
    """Return the drive with the mark and a note that its planner is not deterministic."""
    notes = (*drive.trace.notes, f"not deterministic: {difference}")
    return replace(
        drive, trace=replace(drive.trace, notes=notes), marks=(*drive.marks, Mark.NOT_DETERMINISTIC)
    )


def nondeterminism(trace: Trace, again: Trace, until_s: float) -> str:
    """Return where and by how much two equal drives differ, as a sentence; "" if they do not, up to
    `until_s`.
    """
    first, second = (
        [frame for frame in drive.frames if frame.t <= until_s] for drive in (trace, again)
    )
    for frame, other in zip_longest(first, second):
        if frame is None or other is None:
            shorter = again if other is None else trace
            failed = shorter.end is EndReason.PLANNER_FAILURE
            why = shorter.detail if failed else f"it ended by {shorter.end.value}"
            return f"{trace.planner}, driven twice: it goes on only once: {why}"
        a, b, status = frame.plan.trajectory, other.plan.trajectory, frame.plan.status
        if len(a) != len(b):
            difference = f"the plans have {len(a)} and {len(b)} states"
        elif status is not other.plan.status:
            difference = f"the plans are '{status.value}' and '{other.plan.status.value}'"
        elif any(
            getattr(a, name).tobytes() != getattr(b, name).tobytes() for name in TRAJECTORY_COLUMNS
        ):
            metres, speed = (
                float(np.max(np.hypot(a.x - b.x, a.y - b.y))),
                float(np.max(np.abs(a.v - b.v))),
            )
            difference = f"the plans differ by up to {metres:.3g} m and {speed:.3g} m/s"
        else:
            continue
        return f"{trace.planner}, driven twice: {difference} at {frame.t:.2f} s"
    return ""
