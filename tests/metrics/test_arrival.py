"""Arrival: a goal is a place and the way to it; a drive that shows nothing is no pass."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, scenario
from handmade import square
from hypothesis import given, settings, strategies as st
from roads import strip

from replan.logs.edit.cut import cut
from replan.logs.edit.variations import varied
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.road import GOAL_LENGTH_M, Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason
from replan.metrics import METRICS, evaluate
from replan.metrics.arrival import Arrival, fault_of, goal_of, passed_early
from replan.metrics.health import findings
from replan.metrics.judge import Outcome, judge, load_gates, worst
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.excuses import COVERED, GOAL_ROUTE
from replan.metrics.log_faults import FaultKind
from replan.metrics.route_gain import gain_along, route_of

NAMES = "goal", "route_progress", "completed", "coverage", "covered", "goal_route"
PROGRESS = {name: METRICS[name] for name in NAMES}
GATES = load_gates(None)
STRAIGHT = scenario(along(grid(12.0, 0.1), 8.0), duration=12.0)


def along_points(points: np.ndarray, v: float = 8.0) -> Trajectory:
    """A drive along a polyline `(n, 2)`."""
    chord = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    t = np.arange(0.0, chord[-1] / v, 0.1)
    x, y, dx, dy = (
        np.interp(v * t, chord, column) for column in (*points.T, *np.gradient(points, axis=0).T)
    )
    return Trajectory(t, x, y, np.unwrap(np.arctan2(dy, dx)), v + 0.0 * t, 0.0 * t, 0.0 * t)


def ring(laps: float, radius: float = 30.0) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi * laps, max(round(200 * laps), 20))
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def eight(rounds: int, radius: float = 25.0) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)[:-1]
    up = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    return np.vstack([*[up, up * (1.0, -1.0)] * rounds, up[:1]])


def there_and_back(length: float) -> np.ndarray:
    """Out on y = 0, a turn of 8 m radius, back on y = 16 m and over to 3.5 m: it ends beside its
    start.
    """
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 60)
    back = [[length, 16.0], [60.0, 16.0], [40.0, 3.5], [0.0, 3.5]]
    return np.vstack(
        [
            [[0.0, 0.0]],
            np.column_stack([length + 8.0 * np.cos(turn), 8.0 + 8.0 * np.sin(turn)]),
            back,
        ]
    )


def driven_path(points: np.ndarray, **more: object) -> Scenario:
    ego = along_points(points)
    return scenario(ego, road=Road.along(np.column_stack([ego.x, ego.y]), speed_limit=10.0), **more)


def first_arrival(log: Scenario, ego: Trajectory | None = None) -> int:
    """The first step of a drive at which it has arrived, -1: none."""
    goal, _ = goal_of(log)
    columns = {name: getattr(ego or log.ego, name) for name in TRAJECTORY_COLUMNS}
    assert goal is not None
    arrival = Arrival(log, goal)
    return next((k for k in range(len(columns["t"])) if arrival.at(columns, k)), -1)


WAYS = st.one_of(
    st.builds(ring, st.floats(0.4, 3.3), st.floats(15.0, 40.0)),
    st.sampled_from([ring(1.0), ring(2.0), ring(3.0)]),
    st.builds(eight, st.integers(1, 2)),
    st.builds(there_and_back, st.floats(80.0, 200.0)),
)


@settings(max_examples=25, deadline=None)
@given(WAYS)
def test_the_logs_driver_arrives_at_the_end_of_its_drive_and_not_before(points: np.ndarray) -> None:
    """The goal that is made from a drive's end counts within a goal's length of the end, however
    often it is passed.
    """
    log = driven_path(points)
    at = first_arrival(log)
    gain = gain_along(route_of(log), log.ego).metres
    assert at >= 0 and gain[-1] - gain[at] <= GOAL_LENGTH_M


@pytest.mark.parametrize("laps", [1.0, 2.0, 2.25, 3.1])
@pytest.mark.parametrize("lanes", [False, True])
def test_a_goal_that_the_log_names_on_a_ring_counts_on_the_last_lap(
    laps: float, lanes: bool
) -> None:
    """Without lanes, and on four lanes, each a quarter of the ring."""
    quarters = {
        k: strip(
            k,
            30.0
            * np.column_stack(
                [f(np.linspace(k, k + 1.0, 20) * 0.5 * np.pi) for f in (np.cos, np.sin)]
            ),
            successors=((k + 1) % 4,),
        )
        for k in range(4)
    }
    log = driven_path(ring(laps))
    named = replace(
        log, goal=Goal((square(*ring(laps)[-1], 3.0),)), road=Road(quarters) if lanes else log.road
    )
    gain = gain_along(route_of(named), named.ego).metres
    assert gain[-1] - gain[first_arrival(named)] <= 6.0 and fault_of(named) is None
    assert route_of(named).length > 0.9 * gain[-1]


def test_a_part_of_the_way_is_that_part_and_no_pass() -> None:
    """A drive that ends in the place after a quarter of 2.25 laps, and one that drives them all."""
    log = driven_path(ring(2.25))
    quarter = log.ego.between(0.0, float(log.ego.t[-1]) / 9.0)
    for ego, share in ((quarter, 1.0 / 9.0), (log.ego, 1.0)):
        rows = evaluate(drive(log, ego, end=EndReason.GOAL), log, metrics=PROGRESS)
        assert rows.set_index("metric").loc["route_progress.final", "value"] == pytest.approx(
            share, abs=0.01
        )
        found = {v.outcome for v in judge(GATES, rows, {log.name: LogLabels()}) if v.logs}
        assert (worst(found) is Outcome.PASS) is (share == 1.0)
    assert first_arrival(log, quarter) == -1


GOALS = {
    "under": ((square(1.4, 0.0, 2.0),), "goal_route"),
    "behind": ((square(-40.0, 0.0, 2.0),), "goal_route"),
    "off": ((square(60.0, 40.0, 2.0),), "goal_route"),
    "a tenth": ((square(11.0, 0.0, 2.0),), "covered"),
}


@pytest.mark.parametrize("name", GOALS)
def test_a_goal_without_evidence_is_named_and_inconclusive(name: str) -> None:
    regions, metric = GOALS[name]
    log = replace(STRAIGHT, goal=Goal(regions))
    at = first_arrival(log)
    ended = (log.ego.between(0.0, max(float(log.ego.t[at]), 0.1)), EndReason.GOAL)
    ego, end = ended if at >= 0 else (log.ego, EndReason.END_OF_LOG)
    rows = evaluate(drive(log, ego, end=end), log, metrics=PROGRESS)
    # a driver of the run who comes to the goal off the lanes does not make it a failure
    other = evaluate(drive(log, ego, end=EndReason.GOAL), log, metrics=PROGRESS).assign(
        planner="other"
    )
    table = rows if at >= 0 else pd.concat([rows, other], ignore_index=True)
    found = [
        v for v in judge(GATES, table, {log.name: LogLabels()}) if v.logs and v.planner == "hand"
    ]
    outcomes = {v.gate.metric.partition(".")[0]: v.outcome for v in found}
    assert outcomes[metric] is Outcome.INCONCLUSIVE
    assert worst(outcomes.values()) is Outcome.INCONCLUSIVE
    assert FaultKind.GOAL in {one.kind for one in findings(log)}
    assert rows.set_index("metric").loc["route_progress.final", "value"] < 0.2 or at < 0


def test_an_early_arrival_that_is_far_enough_passes() -> None:
    log = replace(STRAIGHT, goal=Goal((square(50.0, 0.0, 2.0),)))
    ego = along(grid(4.8), 10.0)
    rows = evaluate(drive(log, ego, end=EndReason.GOAL), log, metrics=PROGRESS)
    assert rows.set_index("metric").loc["route_progress.final", "value"] == 1.0
    assert (
        worst(v.outcome for v in judge(GATES, rows, {log.name: LogLabels()}) if v.logs)
        is Outcome.PASS
    )
    assert passed_early(log) is None and FaultKind.GOAL not in {one.kind for one in findings(log)}


def test_the_way_goes_through_files_parts_and_variations(tmp_path: Path) -> None:
    log = driven_path(ring(2.25))
    goal, _ = goal_of(log)
    assert goal is not None and goal.way > 350.0
    made = replace(log, goal=goal)
    write_scenario(tmp_path / "log.mcap", made)
    again = read_scenario(tmp_path / "log.mcap").goal
    assert again is not None and again.way == goal.way
    part = cut(made, 10.0).goal
    assert part is not None and part.way == pytest.approx(goal.way - 80.0, abs=0.1)
    moved = varied(made, (), {"ego_start": 30.0})
    assert moved.goal is not None and moved.goal.way == goal.way - 30.0
    # On its route, from its own start
    assert first_arrival(moved, log.ego.between(30.0 / 8.0, 100.0)) > 0
    assert first_arrival(moved, log.ego.between(30.0 / 8.0, 30.0)) == -1


def test_the_bounds_of_the_gates_are_those_of_the_metrics() -> None:
    bounds = {gate.metric: gate.min for gate in GATES.gates}
    assert all(bounds[gate.metric] == gate.min for gate in (COVERED, GOAL_ROUTE))
