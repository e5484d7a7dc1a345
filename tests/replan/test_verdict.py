"""The verdict as a whole: adversaries are caught, and what others did is not held against a
planner.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from adversaries import ADVERSARIES
from drives import along, drive, grid, moved, moving, scenario, straight_road
from handmade import crossing_without_a_map

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.cut import cut
from replan.logs.plan import PlanStatus
from replan.logs.readers import read_log
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode
from replan.metrics import evaluate
from replan.metrics.boxes import phantoms
from replan.metrics.judge import CAREFUL, DRIVER, REFERENCE, Verdict, judge
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.deadline import judge_deadline
from replan.metrics.judge.gates import Outcome, load_gates
from replan.metrics.time_to_collision import least_contact_times
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.reference_drives import (
    reference_drives,
    reference_table,
    with_avoidability,
    with_follower,
)
from replan.replay.loop_config import LoopConfig

GRID = grid(4.0, 0.1)
FAST = ("short", "teleport", "wild_end", "stop_end")


def driven(
    log: Scenario, planner: str, *modes: Mode, **loop: object
) -> tuple[list[Drive], tuple[Verdict, ...]]:
    config = LoopConfig(**loop)  # type: ignore[arg-type]
    log, follower = with_follower(with_avoidability(log), config)
    runs = {Mode.OPEN: run_open_loop, Mode.CLOSED: run_closed_loop}
    drives = [runs[mode](log, planner, config=config) for mode in modes]
    rows = [evaluate(drive.trace, log) for drive in drives]
    gates = load_gates(None).asked_of([mode.value for mode in modes])
    table = pd.concat([*rows, reference_table(log), follower])
    return drives, judge(gates, table, {log.name: LogLabels(tags=log.tags)})


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in ADVERSARIES],
)
def test_an_adversary_is_failed_by_the_gate_that_is_about_it(name: str) -> None:
    one = ADVERSARIES[name]
    planner = f"adversaries:{one.planner.__name__}"
    log = one.scenario()
    drives, verdicts = driven(log, planner, Mode.CLOSED, vehicle=one.vehicle)
    if one.gate == "deadline":
        times = pd.DataFrame(
            [vars(time) if hasattr(time, "__dict__") else _row(time) for time in drives[0].timings]
        )
        verdicts = judge_deadline(
            times.assign(log=log.name, planner=planner, mode="closed"), 0.1, {log.name: LogLabels()}
        )
    failed = {
        verdict.gate.metric.partition(".")[0]
        for verdict in verdicts
        if verdict.outcome is Outcome.FAIL
    }
    assert one.gate in failed


def _row(time: object) -> dict[str, object]:
    return {"t_s": time.t, "stage": time.stage, "seconds": time.seconds}  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["short", "far_ahead", "liar"])
def test_plans_that_are_none_fail_in_open_loop_too(name: str) -> None:
    one = ADVERSARIES[name]
    _, verdicts = driven(
        CATALOGUE["paper/free_road"].scenario(), f"adversaries:{one.planner.__name__}", Mode.OPEN
    )
    assert one.gate in {
        v.gate.metric.partition(".")[0] for v in verdicts if v.outcome is Outcome.FAIL
    }


def test_no_plan_of_an_adversary_is_driven_as_it_is_where_it_is_impossible() -> None:
    (drive,), _ = driven(
        CATALOGUE["paper/free_road"].scenario(),
        "adversaries:Teleport",
        Mode.CLOSED,
        vehicle="perfect",
    )
    ego = drive.trace.ego
    assert np.hypot(np.diff(ego.x), np.diff(ego.y)).max() < 0.01 * 13.0


def test_a_blind_speeder_on_a_crossing_without_a_map_is_failed_for_the_pedestrian() -> None:
    """1.3 times as fast as the recorded driver, who let the pedestrian go first."""
    _, verdicts = driven(crossing_without_a_map(), "adversaries:Blind", Mode.CLOSED)
    (said,) = [v for v in verdicts if v.gate.metric == "yielding.recorded.below_1500ms"]
    assert said.outcome is Outcome.FAIL
    assert re.search(
        r"pedestrian 17: the ego goes first, 1\.\d s before it, which the recorded driver let",
        said.reason,
    )


@pytest.mark.parametrize(
    ("v", "road", "outcome"),
    [
        (15.0, None, Outcome.PASS),
        (26.0, None, Outcome.FAIL),
        (26.0, straight_road(), Outcome.FAIL),
        (26.0, straight_road(limit=30.0), Outcome.NOT_ASKED),
        (26.0, moved(scenario(along(GRID, 1.0)), 0.0, 0.0, 50.0).road, Outcome.NOT_ASKED),
    ],
)
def test_an_assumed_limit_is_judged_with_a_margin(
    v: float, road: Road | None, outcome: Outcome
) -> None:
    """Without a map and on lanes without a limit.

    Not where a lane has one, and not beside the lanes.
    """
    log = crossing_without_a_map()
    log = log if road is None else replace(log, road=road)
    verdicts = judge(
        load_gates(None).asked_of(["closed"]),
        evaluate(drive(log, along(GRID, v)), log),
        {log.name: LogLabels()},
    )
    (said,) = [v for v in verdicts if v.gate.metric == "assumed_limit_excess.time_above_1mps"]
    assert said.outcome is outcome
    assert (
        outcome is not Outcome.FAIL
        or "(assumed limit: 13.9 m/s, the log's driver 11.4 m/s)" in said.reason
    )


def followed(**changes: object) -> Scenario:
    """The logged ego drives 12 m/s on a straight road, a car 15 m behind it as well."""
    behind = ("7", AgentKind.CAR, (4.5, 1.8), moving(-20.0, 0.0, 12.0, 0.0))
    return scenario(along(grid(8.0, 0.1), 12.0), [behind], **changes)


def test_an_ego_that_is_hit_from_behind_does_not_fail() -> None:
    (drive,), verdicts = driven(followed(), "adversaries:Park", Mode.CLOSED, traffic="time")
    assert drive.trace.end is EndReason.REPLAY_CONTACT
    outcomes = {verdict.gate.metric: verdict.outcome for verdict in verdicts}
    failed = {metric for metric, outcome in outcomes.items() if outcome is Outcome.FAIL}
    assert failed == {"needless_braking.max"}, "it stops for nothing; the hit is not its fault"
    for metric in ("completed.final", "route_progress.final", "replay_contact.final"):
        assert outcomes[metric] is Outcome.INCONCLUSIVE, metric
    assert outcomes["collision_at_fault.count"] is Outcome.PASS
    (said,) = [v for v in verdicts if v.gate.metric == "completed.final"]
    assert "the replay ran into the ego (car 7:" in said.reason


def test_the_default_traffic_gives_way_and_the_verdict_is_on_the_planner() -> None:
    (drive,), verdicts = driven(followed(), "adversaries:Park", Mode.CLOSED)
    assert drive.trace.end is EndReason.END_OF_LOG
    assert "route_progress.final" in {v.gate.metric for v in verdicts if v.outcome is Outcome.FAIL}


def test_a_phantom_ends_no_drive_and_is_named() -> None:
    """A recorded ego at 10 m/s, and a box that stands on its way from 2 s on: it was driven
    through.
    """
    t = grid(2.0, 0.1)
    box = ("9", AgentKind.CAR, (4.0, 1.8), lambda t: (0 * t + 30.0, 0 * t, 0 * t))
    log = scenario(along(grid(4.0, 0.1), 10.0), [box], metadata={}, tags=("recorded",))
    assert t[-1] == 2.0
    (drive,), _ = driven(log, "constant_speed", Mode.CLOSED)
    assert drive.trace.end in (EndReason.END_OF_LOG, EndReason.GOAL)
    table = evaluate(drive.trace, log).set_index("metric")
    assert table.loc["phantom.count", "value"] == 1.0
    assert table.loc["phantom.count", "reason"] == "car 9"
    assert table.loc["collision.count", "value"] == 0.0
    made = replace(log, metadata={"generator": "test"}, tags=())
    (crash,), _ = driven(made, "constant_speed", Mode.CLOSED)
    assert crash.trace.end is EndReason.COLLISION


def test_without_a_recorded_drive_the_route_follower_is_the_yardstick() -> None:
    log = scenario(along(grid(0.0), 12.0), duration=10.0)
    for planner, passes in (("constant_speed", True), ("adversaries:Park", False)):
        _, verdicts = driven(log, planner, Mode.CLOSED)
        (said,) = [v for v in verdicts if v.gate.metric == "route_progress.final"]
        assert said.outcome is (Outcome.PASS if passes else Outcome.FAIL), said.reason


def test_reference_drives_end_as_a_planners_would() -> None:
    log = with_avoidability(CATALOGUE["everyday/cut_in"].scenario())
    found = {trace.planner: trace for trace in reference_drives(log)}
    assert set(found) == {DRIVER, CAREFUL}
    assert found[DRIVER].end is EndReason.GOAL
    assert found[CAREFUL].ego.t[0] == log.ego.t[0]
    assert (
        np.hypot(found[CAREFUL].ego.x[0] - log.ego.x[0], found[CAREFUL].ego.y[0] - log.ego.y[0])
        < 0.01
    )


@pytest.mark.parametrize("recorded", [True, False])
def test_only_a_recorded_driver_says_what_may_be_asked(recorded: bool) -> None:
    log = followed(metadata={} if recorded else {"generator": "test"})
    rows = reference_table(with_avoidability(log))
    assert set(rows["mode"]) == {REFERENCE}
    assert rows["oracle"].all()
    driver = rows[rows["planner"] == DRIVER]["metric"]
    assert ("gap.min" in set(driver)) == recorded
    assert {"goal.final", "route_progress.final"} <= set(driver)


def test_a_short_log_before_a_red_light_is_measured_by_a_driver_that_stops_there() -> None:
    """The last 3 s before the log's driver stands at the light, its first state alone: no more way
    is asked for.
    """
    whole = CATALOGUE["everyday/traffic_light"].scenario()
    stands = float(whole.ego.t[np.argmax(whole.ego.v < 0.1)])
    log = cut(whole, stands - 3.0, stands)
    alone = replace(log, ego=log.ego.between(0.0, 0.0), goal=None)
    _, verdicts = driven(alone, "dp_qp", Mode.CLOSED)
    (said,) = [v for v in verdicts if v.gate.metric == "route_progress.final"]
    assert said.outcome is Outcome.PASS, said.reason


@pytest.mark.parametrize(
    "planner", [pytest.param("adversaries:Park", marks=pytest.mark.slow), "adversaries:Creep"]
)
def test_waiting_until_the_time_of_a_goal_is_no_arrival(planner: str) -> None:
    log = replace(CATALOGUE["paper/free_road"].scenario(), goal=Goal(t=(10.0, 11.0)))
    (drive,), verdicts = driven(log, planner, Mode.CLOSED)
    assert drive.trace.end is EndReason.GOAL
    assert {v.gate.metric for v in verdicts if v.outcome is Outcome.FAIL} >= {
        "route_progress.final"
    }


def test_a_fallback_before_a_phantom_is_not_held_against_the_planner() -> None:
    """The recorded ego drives through a box: at the frames of that, a planner has no way out."""
    box = ("9", AgentKind.CAR, (4.0, 1.8), lambda t: (0 * t + 30.0, 0 * t, 0 * t))
    log = scenario(along(grid(6.0, 0.1), 10.0), [box], metadata={}, tags=("recorded",))
    frames = run_open_loop(log, "constant_speed").trace
    (phantom,) = phantoms(log)
    stop = PlanStatus.HARD_STOP
    fell = [
        replace(f, plan=replace(f.plan, status=stop)) if 2.45 < f.t < 3.45 else f
        for f in frames.frames
    ]
    assert phantom.agent == "9"
    for tag, rate in (("recorded", 0.0), ("synthetic", 10 / len(fell))):
        table = evaluate(replace(frames, frames=tuple(fell)), replace(log, tags=(tag,)))
        assert table.set_index("metric").loc["fallback.rate", "value"] == pytest.approx(rate)


def test_a_planner_that_stops_before_a_phantom_is_not_judged_by_its_progress() -> None:
    """The recorded ego drives through a box that stands across its lane, as under a bridge."""
    box = ("9", AgentKind.TRUCK, (12.0, 2.5), lambda t: (0 * t + 70.0, 0 * t, 0 * t + 0.5 * np.pi))
    log = scenario(along(grid(14.0, 0.1), 10.0), [box], metadata={}, tags=("recorded",))
    _, verdicts = driven(log, "idm", Mode.CLOSED)
    progress = [v for v in verdicts if v.gate.metric == "route_progress.final"]
    assert [v.outcome for v in progress] == [Outcome.INCONCLUSIVE]


@pytest.mark.slow
def test_turning_right_before_an_oncoming_car_is_no_near_collision(shared_data: Path) -> None:
    """3.5 m/s, a car in the next lane comes the other way: straight on they would touch in less
    than 0.95 s.
    """
    log = read_log(shared_data / "verdict2" / "ttc_false_alarm_lohmar" / "DEU_Lohmar-40_1_T-1.xml")
    (drive,), verdicts = driven(log, "dp_qp", Mode.CLOSED)
    assert np.nanmin(least_contact_times(drive.trace, log, False)[0][1]) < 0.95
    (found,) = (one for one in verdicts if one.gate.metric == "ttc.time_below_950ms")
    assert (found.outcome, found.value) == (Outcome.PASS, 0.0)


@pytest.mark.parametrize("closing", [True, False])
def test_hard_braking_is_about_the_road_user_that_it_is_for(closing: bool) -> None:
    """10 m/s towards a car that stands 25 m ahead, -6 m/s2 from 1 s on.

    Or the same on a free road, for nothing.
    """
    t = grid(3.0)
    v = np.maximum(10.0 - 6.0 * np.maximum(t - 1.0, 0.0), 0.0)
    ego = replace(
        along(t, 10.0),
        x=np.r_[0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))],
        v=v,
        a=np.where((t >= 1.0) & (v > 0.0), -6.0, 0.0),
    )
    ahead = ("7", AgentKind.CAR, (4.5, 1.8), lambda t: (0 * t + 30.0, 0 * t, 0 * t))
    log = scenario(along(t, 10.0), [ahead] if closing else [])
    table = evaluate(drive(log, ego), log).set_index("metric")
    for metric in ("lon_accel.worst_episode", "lon_jerk_nuplan.worst_episode"):
        assert table.loc[metric, "reason"] == ("car 7" if closing else "")
