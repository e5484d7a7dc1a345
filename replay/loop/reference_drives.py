"""Reference drives: how other drivers drive a log, measured like every other drive.

    "driver"     the ego as logged, among the others as logged, if the log holds a drive
    "careful"    the careful driver of UN R157 (`replan.metrics.reference_drivers`) from the log's
                 first state along the lane
    "follower"   the route follower: the planner `idm` in a perfect car, which accelerates, steers
                 along its route, follows others and obeys the rules, among the traffic of the run

They end like a planner's drive: in the goal, or when a road user touches them. Their rows have the
mode "reference" and are marked as oracles; `replan.metrics.judge` uses them to decide whether a
broken bound is evidence against a planner. For the driver of a synthesised log only progress is
measured, so such a log excuses no collision. The follower excuses none either. Its progress is
measured until its time to collision falls below `replan.metrics.time_to_collision.CLOSE_S`; after
that it is no yardstick. Because it takes time, the follower is driven only if the log holds no
drive as a yardstick of progress, or if a planner of the run misses the goal.

The reference drivers of `replan.metrics.reference_drivers.DRIVERS` also judge each scenario; their
verdicts go into its `references` (`with_avoidability`). Their line is the reference line of the
planners' route up to its first lane change; from there on the driver keeps its lane, like that of
UN R157.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import pandas as pd

from replan import metrics
from replan.core.errors import LogError
from replan.core.once import once
from replan.logs.forward import drivable_part
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Goal, Road
from replan.logs.route import find_route
from replan.logs.scenario import References, Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, EgoState, Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import GROUPS, METRICS
from replan.metrics.arrival import Arrival, goal_of
from replan.metrics.boxes import ego_boxes, name_of, phantoms, without_phantoms
from replan.metrics.collisions import contacts
from replan.metrics.driver_models import STEP_S
from replan.metrics.evidence import evidence
from replan.metrics.judge import CAREFUL, DRIVER, FOLLOWER, REFERENCE
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.cases import CLEAN, needs_follower
from replan.metrics.judge.discrimination import BAD_DRIVERS, Discrimination, discrimination
from replan.metrics.judge.gates import load_gates
from replan.metrics.metric import Series
from replan.metrics.reference_drivers import DRIVERS, RETURN_S, careful_drive
from replan.metrics.route_gain import gain_along, route_of
from replan.metrics.time_to_collision import CLOSE_S, ttc
from replan.planners.frenet.route_line import make_line
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig

SHORTEST = 2
"""A log with fewer ego states holds no drive."""
FOLLOWER_PERIODS_S = 0.5, 0.05
"""Plan and control period of the follower: long, because its plans are smooth and a yardstick
should be cheap.
"""


BAD_PERIODS_S = 4.0, 0.2
"""Those of the bad drivers, who react to no road user: a plan lasts 8 s."""


def reference_line(scenario: Scenario) -> ReferenceLine:
    """Return the line from the log's first state along its lane towards the goal.

    Straight without a lane.
    """
    return _line(scenario.road, scenario.ego.state(0), scenario.goal)


@once  # needed before the scenario has its references, and again for the reference drives
def _line(road: Road, start: EgoState, goal: Goal | None) -> ReferenceLine:
    route = find_route(road, start, goal)
    connected = 1  # lanes until the first change of lane
    for before, now in pairwise(route):
        if now not in road.lanes[before].successors:
            break
        connected += 1
    return make_line(road, route[:connected], start)[1]


def with_avoidability(scenario: Scenario) -> Scenario:
    """Return the scenario with new verdicts of the reference drivers."""
    line = reference_line(scenario)
    verdicts = {name: driver(scenario, line, None) for name, driver in DRIVERS.items()}
    return replace(scenario, references=References(verdicts))


def with_follower(scenario: Scenario, loop: LoopConfig) -> tuple[Scenario, pd.DataFrame]:
    """Return the scenario with the follower's gain in its references, and the follower's rows.

    Args:
        scenario: What is driven.
        loop: Configuration of the run, for its traffic; the car is perfect, and the follower
            perceives ground truth.
    """
    trace = _drive_in_traffic(scenario, "idm", FOLLOWER, loop)
    times = ttc(trace, scenario)
    near = np.zeros(1, np.bool_)
    if isinstance(times, Series):
        near = np.asarray(times.value < CLOSE_S)
    last = int(np.argmax(near)) if near.any() else -1
    gain = gain_along(route_of(scenario), trace.ego).metres[last]
    scenario = replace(scenario, references=replace(scenario.references, follower_gain=float(gain)))
    return scenario, _measure_drives(
        [(trace, ("safety", "rules", "progress", "comfort"))], scenario
    )


def _drive_in_traffic(
    scenario: Scenario,
    planner: str,
    name: str,
    loop: LoopConfig,
    periods_s: tuple[float, float] = FOLLOWER_PERIODS_S,
    settings: Mapping[str, object] = MappingProxyType({}),
) -> Trace:
    """Drive a built-in planner in a perfect car among the traffic of the run.

    The trace has no plans.
    """
    traffic = {key: table for key, table in loop.settings.items() if key == "traffic"}
    same = LoopConfig(*periods_s, vehicle="perfect", traffic=loop.traffic, settings=traffic)
    driven = run_closed_loop(
        scenario, planner, planner_config=settings, config=same, keep_internals=False
    ).trace
    return replace(driven, planner=name, oracle=True, frames=())


def discriminating_tables(scenario: Scenario, loop: LoopConfig) -> list[pd.DataFrame]:
    """Return the rows of the drives that a log should fail
    (`replan.metrics.judge.discrimination.BAD_DRIVERS`), in order.

    A log that is shorter than their control period has none.
    """
    if scenario.duration - float(scenario.ego.t[0]) < BAD_PERIODS_S[1]:
        return []
    tables = []
    for name, bad in BAD_DRIVERS.items():
        trace = _drive_in_traffic(scenario, bad.planner, name, loop, BAD_PERIODS_S, bad.settings)
        rows = metrics.rows_of(
            trace, scenario, metrics={name: METRICS[name] for name in bad.judged_by}
        )
        tables.append(metrics.as_table(rows).assign(mode=REFERENCE))
    return tables


def discriminate(scenario: Scenario, loop: LoopConfig = DEFAULT_LOOP) -> tuple[Discrimination, ...]:
    """Return whether the bad drivers break a packaged gate of a log, in the part of it that is
    driven.

    Nothing is returned for a log that only reverses, or that is too short to be driven.
    """
    try:
        scenario = with_avoidability(drivable_part(scenario))
    except LogError:  # nothing of it is driven, and `replan inspect` states why
        return ()
    if (
        scenario.duration - float(scenario.ego.t[0]) >= BAD_PERIODS_S[1]
        and len(scenario.ego) < SHORTEST
    ):
        scenario = with_follower(scenario, loop)[0]
    labels = LogLabels(scenario.family, scenario.dataset, scenario.tags)
    tables = discriminating_tables(scenario, loop)
    gates = load_gates(None)
    values = [dict(zip(table["metric"], table["value"], strict=True)) for table in tables]
    return tuple(
        discrimination(driver, gates, labels, metrics_of)
        for driver, metrics_of in zip(BAD_DRIVERS, values, strict=False)
    )


def with_references(scenario: Scenario, loop: LoopConfig) -> tuple[Scenario, list[pd.DataFrame]]:
    """Return the scenario and the rows of its reference drives, with the follower if the log holds
    no drive.
    """
    follower = []
    if len(scenario.ego) < SHORTEST:
        scenario, rows = with_follower(scenario, loop)
        follower = [rows]
    return scenario, [reference_table(scenario), *follower]


def late_follower(
    tables: Sequence[pd.DataFrame], scenario: Scenario, loop: LoopConfig
) -> list[pd.DataFrame]:
    """Return the rows of the follower if they are missing, and a closed drive in the tables of a
    log needs it.
    """
    values: dict[str, dict[str, float]] = {}
    asked = {gate.metric for gate in CLEAN}
    for table in tables:
        columns = (table[name].tolist() for name in ("planner", "mode", "metric", "value"))
        for planner, mode, metric, value in zip(*columns, strict=True):
            if planner == FOLLOWER:
                return []
            if mode == Mode.CLOSED.value and metric in asked:
                values.setdefault(planner, {})[metric] = value
    needed = any(needs_follower(of_planner) for of_planner in values.values())
    return [with_follower(scenario, loop)[1]] if needed else []


def _measure_drives(
    drives: Iterable[tuple[Trace, tuple[str, ...]]], scenario: Scenario
) -> pd.DataFrame:
    rows = []
    for trace, groups in drives:
        measures = {
            metric.name: METRICS[metric.name]
            for group in groups
            for metric in (*GROUPS[group], evidence)
        }
        rows += metrics.rows_of(trace, scenario, metrics=measures)
    return metrics.as_table(rows).assign(mode=REFERENCE)


def reference_table(scenario: Scenario) -> pd.DataFrame:
    """Return the rows of the log's own and the careful driver.

    Columns as of `replan.metrics.evaluate`.
    """
    groups = {
        DRIVER: ("safety", "rules", "progress") if scenario.is_recorded else ("progress",),
        CAREFUL: ("safety", "progress", "comfort"),  # the careful driver knows no rules
    }
    return _measure_drives(
        ((trace, groups[trace.planner]) for trace in reference_drives(scenario)), scenario
    )


def reference_drives(scenario: Scenario) -> Iterator[Trace]:
    """Yield the reference drives as traces without plans."""
    if len(scenario.ego) >= SHORTEST:
        yield _end_drive(DRIVER, scenario.ego, scenario)
    line, start = reference_line(scenario), scenario.ego.state(0)
    drive = careful_drive(scenario, line)
    s0, l0 = line.project(start.x, start.y)
    u = np.minimum((drive.s - s0) / max(RETURN_S * start.v, 10.0), 1.0)
    offset = l0 * (1.0 - u * u * (3.0 - 2.0 * u))
    frames = np.array([line.frame(s) for s in drive.s])
    x, y = (
        frames[:, 0] - offset * np.sin(frames[:, 2]),
        frames[:, 1] + offset * np.cos(frames[:, 2]),
    )
    t = start.t + STEP_S * np.arange(len(drive.s))
    rear_axle = Trajectory(t, x, y, np.unwrap(frames[:, 2]), drive.v, drive.a, frames[:, 3])
    yield _end_drive(CAREFUL, rear_axle, scenario)


def _end_drive(name: str, ego: Trajectory, scenario: Scenario) -> Trace:
    """Return the drive up to the goal or its first contact."""
    agents = without_phantoms(scenario.tracks, phantoms(scenario))
    whole = Trace(scenario.name, name, Mode.CLOSED, True, ego, agents, (), EndReason.END_OF_LOG)
    ends: list[tuple[int, EndReason, str]] = []
    goal = goal_of(scenario)[0] if scenario.goal is not None else None
    if goal is not None:
        x, y = ego_boxes(ego, scenario)[:2]
        near = np.full(len(x), not goal.regions)
        for region in goal.regions:
            (low_x, low_y), (high_x, high_y) = region.min(axis=0), region.max(axis=0)
            near |= (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
        columns = {name: getattr(ego, name) for name in TRAJECTORY_COLUMNS}
        arrival = Arrival(scenario, goal)
        reached = next((k for k in np.flatnonzero(near).tolist() if arrival.at(columns, k)), None)
        if reached is not None:
            ends.append((reached, EndReason.GOAL, ""))
    for contact in contacts(whole, scenario)[:1]:
        reason = EndReason.COLLISION if contact.at_fault else EndReason.REPLAY_CONTACT
        ends.append(
            (contact.step, reason, f"{name_of(agents, contact.agent)}: {contact.kind.value}")
        )
    if not ends:
        return whole
    step, reason, detail = min(ends, key=lambda end: end[0])
    driven = ego.between(float(ego.t[0]), float(ego.t[step]))
    return Trace(scenario.name, name, Mode.CLOSED, True, driven, agents, (), reason, detail)
