"""Evidence and divergence: shares against sums by hand; no divergence for the log's own drive."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commonroad_files import driving, problem, straight as lane, vehicle, written
from drives import along, drive, grid, moved, moved_ego, moving, scenario, straight_road
from handmade import drive as driven, scenario as handmade, straight
from hypothesis import given, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.driving import DrivingMode, DrivingModes
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.road import Road, RoadSource
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks
from replan.metrics import METRICS, evaluate
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

T = grid(10.0)
SLOW_THEN_FAST = along(T, np.where(T < 5.0, 2.0, 8.0))


def rows(log: Scenario, trace: Trace | None = None) -> dict[str, tuple[float, str]]:
    table = evaluate(
        trace or drive(log, SLOW_THEN_FAST), log, metrics={"evidence": METRICS["evidence"]}
    )
    return {
        row.metric.removeprefix("evidence."): (row.value, row.reason) for row in table.itertuples()
    }


@given(st.floats(0.0, 10.0))
def test_shares_are_of_time_and_of_way(until: float) -> None:
    log = scenario(SLOW_THEN_FAST, traffic=((0.0, until),))
    found = rows(log)
    assert found["traffic.share"][0] == pytest.approx(until / 10.0, abs=2e-3)
    way = 2.0 * min(until, 5.0) + 8.0 * max(until - 5.0, 0.0)
    assert found["traffic.way_share"][0] == pytest.approx(way / 50.0, abs=3e-3)


def test_an_assumed_limit_is_none_of_the_log() -> None:
    stated = straight_road(limit=10.0)
    assert rows(scenario(SLOW_THEN_FAST, road=stated))["limit.share"][0] == 1.0
    for road in (straight_road(), replace(stated, assumed_limits=frozenset({0}))):
        value, reason = rows(scenario(SLOW_THEN_FAST, road=road))["limit.share"]
        assert value == 0.0 and "assumed" in reason


def test_lanes_are_those_of_the_log_under_the_ego() -> None:
    assert rows(scenario(SLOW_THEN_FAST))["lane.share"][0] == 1.0
    off = along(T, 5.0, x=485.0)  # the map ends at 500 m, and goes on for 10 m
    log = scenario(off)
    assert 0.3 < rows(log, drive(log, off))["lane.share"][0] < 0.6
    made_up = replace(straight_road(), source=RoadSource.DRIVEN_PATH)
    assert rows(scenario(SLOW_THEN_FAST, road=made_up))["lane.share"][0] == 0.0


def lit(*lights: TrafficLight) -> Scenario:
    line = StopLine(0, 0, np.array([[40.0, -1.75], [40.0, 1.75]]), light=7)
    road: Road = replace(straight_road(), stop_lines=(line,))
    return scenario(SLOW_THEN_FAST, road=road, lights=lights)


def test_lights_are_known_from_when_they_were_observed() -> None:
    assert np.isnan(rows(scenario(SLOW_THEN_FAST))["lights.share"][0])
    value, reason = rows(lit())["lights.share"]
    assert value == 0.0 and reason == "traffic light 7 is not observed"
    late = TrafficLight(7, np.array([4.0, 6.0]), (Colour.RED, Colour.OFF))
    assert rows(lit(late))["lights.share"][0] == pytest.approx(0.2, abs=2e-3)
    assert rows(lit(TrafficLight(7, np.array([0.0]), (Colour.OFF,))))["lights.share"][0] == 1.0


@given(st.floats(-3.0, 3.0), st.booleans())
def test_shares_do_not_depend_on_the_world_around(turn: float, mirror: bool) -> None:
    log = replace(lit(TrafficLight(7, np.array([4.0]), (Colour.RED,))), traffic=((0.0, 3.0),))
    other = moved(log, turn, 30.0, -7.0, mirror=mirror)
    there = rows(other, drive(other, moved_ego(SLOW_THEN_FAST, turn, 30.0, -7.0, mirror=mirror)))
    assert {key: value for key, (value, _) in there.items()} == pytest.approx(
        {key: value for key, (value, _) in rows(log).items()}, nan_ok=True
    )


def test_a_drive_may_end_with_the_evidence_and_says_so() -> None:
    log = replace(handmade(driven(straight, 10.0, 6.0)), traffic=((0.0, 1.5),))
    whole = run_closed_loop(log, "constant_speed").trace
    short = run_closed_loop(log, "constant_speed", config=LoopConfig(end_with_evidence=True)).trace
    assert whole.ego.t[-1] > 5.0
    assert short.ego.t[-1] == pytest.approx(1.5)
    assert short.detail == "traffic is recorded until 1.5 s of 6.0 s, and the drive ends with it"
    log_s = [
        evaluate(one, log).set_index("metric").loc["coverage.log_s.final", "value"]
        for one in (short, whole)
    ]
    # So that a drive of a moment is judged as a log of a moment
    assert log_s == pytest.approx([1.5, 6.0])
    assert rows(log, short)["traffic.share"][0] == 1.0 > 0.5 > rows(log, whole)["traffic.share"][0]


def test_a_blind_drive_among_traffic_that_ends_at_once_has_no_evidence(tmp_path: Path) -> None:
    """Constant speed meets nobody, since nobody is there: nothing that a safety gate could rest
    on.
    """
    cars = [vehicle(20 + i, driving(20.0 * i, 4.0, 10.0, steps=2)) for i in range(4)]
    log = read_commonroad(
        written(tmp_path, lane(1), lane(2, y=4.0), *cars, problem(9, 0.0, 0.0, 10.0))
    )
    trace = run_closed_loop(log, "constant_speed").trace
    safe = evaluate(trace, log, metrics={"collision": METRICS["collision"]}).set_index("metric")
    assert safe.loc["collision.count", "value"] == 0.0
    assert rows(log, trace)["traffic.share"][0] < 0.1


@pytest.mark.slow
def test_published_files_have_the_evidence_that_their_traffic_gives(shared_data: Path) -> None:
    """Files whose traffic is a snapshot have next to none, those whose traffic is recorded have all
    of it.
    """
    files = sorted((shared_data / "commonroad_traps").glob("*.xml"))
    whole = sorted((shared_data / "commonroad").glob("*.xml"))[::15]
    if not files or not whole:
        pytest.skip("no CommonRoad files among the recorded data")
    for file in [*files, *whole]:
        log = read_commonroad(file)
        known = sum(min(last, log.duration) - max(first, 0.0) for first, last in log.traffic_spans)
        assert (known < 0.05 * log.duration) == ("_I-1" in file.name), file.name


NAMES = ("divergence", "divergence_weak", "displaced")
CAR = (4.5, 1.8)


def table(trace: Trace, log: Scenario) -> pd.DataFrame:
    return evaluate(trace, log, metrics={name: METRICS[name] for name in NAMES}).set_index("metric")


def shifted(tracks: Tracks, who: str, since: float, by: float) -> Tracks:
    """One agent is `by` behind along x from `since` on."""
    span = tracks.samples(tracks.ids.index(who))
    x = tracks.x.copy()
    x[span] -= np.where(tracks.t[span] >= since, by, 0.0)
    return replace(tracks, x=x)


LOG = scenario(
    along(T, 10.0),
    [
        ("a", AgentKind.CAR, CAR, moving(30.0, 0.0, 10.0, 0.0)),
        ("b", AgentKind.CAR, CAR, moving(-30, 0, 10, 0)),
    ],
)


def test_the_logs_own_drive_never_parts() -> None:
    rows = table(drive(LOG), LOG)
    assert rows.loc["divergence.max", "value"] == 0.0
    assert (
        rows.loc["divergence_weak.share", "value"] == 0.0
        and rows.loc["displaced.count", "value"] == 0.0
    )
    assert not rows.loc["divergence_weak.from", "available"]
    assert rows.loc["divergence_weak.from", "reason"] == "the drive never parts from the log"


@pytest.mark.parametrize(("v", "from_s"), [(8.0, 5.0), (12.0, 5.0), (9.0, 10.0)])
def test_a_second_of_way_along_is_too_far(v: float, from_s: float) -> None:
    """The log drives at 10 m/s: 10 m ahead or behind."""
    rows = table(drive(LOG, along(T, v)), LOG)
    assert rows.loc["divergence.max", "value"] == pytest.approx(abs(v - 10.0) * 10.0)
    if from_s == 10.0:
        assert not rows.loc["divergence_weak.from", "available"]
        return
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(from_s, abs=0.011)
    assert rows.loc["divergence_weak.from", "reason"] == "the ego along its way"
    assert rows.loc["divergence_weak.share", "value"] == pytest.approx(0.5, abs=0.002)


def test_at_low_speed_a_cars_length_is_and_across_a_lanes_width() -> None:
    log = scenario(along(T, 1.0))
    rows = table(drive(log, along(T, 2.0)), log)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(5.0, abs=0.011)
    aside = replace(log.ego, y=np.where(T >= 4.0, 3.6, 3.4))
    rows = table(drive(log, aside), log)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(4.0)
    assert rows.loc["divergence_weak.from", "reason"] == "the ego across its way"


def test_displaced_road_users_weaken_the_replay_and_are_counted() -> None:
    slow, back = (
        shifted(LOG.tracks, "b", 3.0, 0.6),
        replace(drive(LOG), agents=shifted(LOG.tracks, "b", 3.0, 0.4)),
    )
    rows = table(replace(drive(LOG), agents=slow), LOG)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(3.0, abs=0.011)
    assert (rows.loc["divergence_weak.from", "reason"], rows.loc["displaced.count", "reason"]) == (
        "car b",
        "car b",
    )
    assert rows.loc["displaced.count", "value"] == 1.0 and rows.loc[
        "displaced.count", "time_s"
    ] == pytest.approx(3.0, abs=0.011)
    assert table(back, LOG).loc["displaced.count", "value"] == 0.0
    gone = replace(drive(LOG), agents=Tracks.empty())
    assert table(gone, LOG).loc["displaced.count", "value"] == 2.0


def test_a_log_with_one_state_has_no_divergence() -> None:
    start = replace(
        LOG,
        ego=Trajectory(
            *(getattr(LOG.ego, name)[:1] for name in ("t", "x", "y", "yaw", "v", "a", "kappa"))
        ),
    )
    rows = table(drive(LOG, along(T, 3.0)), start)
    for name in ("divergence.max", "divergence_weak.from", "divergence_weak.share"):
        assert not rows.loc[name, "available"] and "one ego state only" in rows.loc[name, "reason"]
    assert rows.loc["displaced.count", "available"]


def test_divergence_of_the_ego_ends_with_the_logged_drive() -> None:
    short = replace(LOG, ego=along(grid(4.0), 10.0))
    rows = table(drive(LOG, along(T, 8.0)), short)
    assert (
        rows.loc["divergence.max", "value"] == pytest.approx(8.0)
        and not rows.loc["divergence_weak.from", "available"]
    )


@given(st.floats(-3.1, 3.1), st.floats(6.0, 14.0), st.booleans())
def test_turned_and_mirrored_worlds_part_alike(turn: float, v: float, mirror: bool) -> None:
    trace = replace(drive(LOG, along(T, v)), agents=shifted(LOG.tracks, "a", 7.0, 1.0))
    other = moved(LOG, turn, 50.0, -20.0, mirror=mirror)
    there = replace(
        drive(other, moved_ego(trace.ego, turn, 50.0, -20.0, mirror=mirror)),
        agents=moved(replace(LOG, tracks=trace.agents), turn, 50.0, -20.0, mirror=mirror).tracks,
    )
    one, two = table(trace, LOG), table(there, other)
    np.testing.assert_allclose(one["value"], two["value"], atol=1e-6)
    assert list(one["reason"]) == list(two["reason"])


def test_the_log_says_how_much_of_it_its_stack_drove() -> None:
    auto, manual, steered = DrivingMode.AUTONOMOUS, DrivingMode.MANUAL, DrivingMode.STEERED
    times = np.array([1.0, 4.0, 4.2, 6.0, 9.0])
    driving = DrivingModes(times, (auto, manual, auto, steered, manual), "/mode")
    log = replace(scenario(along(T, 5.0)), driving=driving)
    assert driven_by(log)["value"].to_dict() == pytest.approx(
        {"driven_by.stack.final": 0.5, "driven_by.person.final": 0.1}
        | {"driven_by.both.final": 0.3, "driven_by.unknown.final": 0.1}
    )
    unsaid = driven_by(scenario(along(T, 5.0)))
    assert set(unsaid["reason"]) == {"the log does not say who drove"}


def driven_by(log: Scenario) -> pd.DataFrame:
    asked = {"driven_by": METRICS["driven_by"]}
    return evaluate(drive(log), log, metrics=asked).set_index("metric")
