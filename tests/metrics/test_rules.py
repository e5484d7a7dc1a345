"""Red lights, stop signs, crosswalks and right of way, by drives of which the answer is known."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, moving, scenario
from handmade import crossing_without_a_map, track, tracks
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.road import Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics import METRICS, evaluate, series
from replan.metrics.judge import judge
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Outcome, load_gates

LINE_X = 50.0
PED, CAR = AgentKind.PEDESTRIAN, AgentKind.CAR
NAMES_OF_RULES = (
    "red_light",
    "yellow_light",
    "stop_sign",
    "crosswalk",
    "priority_gap",
    "priority_gap_assumed",
)
RULES = {name: METRICS[name] for name in NAMES_OF_RULES}
NAMES = ("red_light.count", "stop_sign.count", "crosswalk.count", "priority_gap.below_1s")


def lane(
    i: int, begin: float, end: float, *, axis: str = "x", at: float = 0.0, **more: object
) -> Lane:
    """A lane 3.5 m wide along an axis, its middle at the other coordinate `at`."""
    u = np.linspace(begin, end, max(2, round((end - begin) / 2.0) + 1))
    sides = [np.column_stack([u, np.full(len(u), at + left)]) for left in (1.75, -1.75)]
    if axis == "y":
        sides = [np.column_stack([np.full(len(u), at - left), u]) for left in (1.75, -1.75)]
    return Lane(i, *sides, **more)  # type: ignore[arg-type]


def lined(*lines: StopLine, crosswalks: tuple[Crosswalk, ...] = ()) -> Road:
    lanes = {0: lane(0, -100.0, LINE_X, successors=(1,)), 1: lane(1, LINE_X, 500.0)}
    return Road(lanes, stop_lines=lines, crosswalks=crosswalks)


def forked(*lines: StopLine) -> Road:
    """After the line, lane 1 goes straight on and lane 2 bends to the left."""
    s = np.linspace(0.0, 60.0, 40)
    bend = np.column_stack([LINE_X + 25.0 * np.sin(s / 25.0), 25.0 * (1.0 - np.cos(s / 25.0))])
    normal = np.column_stack([-np.sin(s / 25.0), np.cos(s / 25.0)])
    lanes = {
        0: lane(0, -100.0, LINE_X, successors=(1, 2)),
        1: lane(1, LINE_X, 500.0),
        2: Lane(2, bend + 1.75 * normal, bend - 1.75 * normal),
    }
    return Road(lanes, stop_lines=lines)


def line(**more: object) -> StopLine:
    return StopLine(7, 0, np.array([[LINE_X, 1.75], [LINE_X, -1.75]]), **more)  # type: ignore[arg-type]


WALK = Crosswalk(3, np.array([[60.0, -6.0], [64.0, -6.0], [64.0, 6.0], [60.0, 6.0]]))
RED = TrafficLight(9, np.array([0.0]), (Colour.RED,))


def rows(log: Scenario, trace: Trace | None = None) -> pd.DataFrame:
    return evaluate(trace or drive(log), log, metrics=RULES).set_index("metric")


def value(log: Scenario, name: str, trace: Trace | None = None) -> float:
    found = rows(log, trace)
    assert found.available[name], found.reason[name]
    return float(found.value[name])


# what is not there --------------------------------------------------------------------------------


def test_a_log_without_rules_has_reasons_in_place_of_the_metrics() -> None:
    found = rows(scenario(along(grid(3.0), 10.0)))
    reasons = {
        "red_light.count": "the log shows no traffic light with a stop line",
        "stop_sign.count": "the log has no stop sign",
        "crosswalk.count": "the log has no crosswalk",
        "priority_gap.min": "the log names no right of way",
    }
    for name, reason in reasons.items():
        assert not found.available[name]
        assert found.reason[name] == reason


# red lights ---------------------------------------------------------------------------------------


@given(st.floats(5.0, 15.0), st.floats(0.5, 8.0))
def test_a_red_light_is_run_where_the_front_crosses_after_it_turned_red(
    v: float, change: float
) -> None:
    light = TrafficLight(9, np.array([0.0, change]), (Colour.GREEN, Colour.RED))
    log = scenario(along(grid(12.0), v), road=lined(line(light=9)), lights=(light,))
    crosses = (LINE_X - log.vehicle.axle_to_front) / v
    if abs(crosses - change) > 0.02:
        assert value(log, "red_light.count") == float(crosses > change and crosses < 12.0)


@given(st.floats(5.0, 15.0), st.floats(-1.0, 6.0), st.sampled_from([Colour.RED, Colour.GREEN]))
def test_a_yellow_light_is_run_where_a_comfortable_stop_was_possible_when_it_began(
    v: float, before: float, then: Colour
) -> None:
    ahead = LINE_X - scenario(along(grid(1.0), v)).vehicle.axle_to_front
    crosses, needed = ahead / v, v * 1.0 + v**2 / (2.0 * 3.05)
    colours = (Colour.GREEN, Colour.YELLOW, then)
    begins = crosses - before
    if begins < 0.1 or abs(before * v - needed) < 0.1 or abs(before) < 0.05:
        return
    light = TrafficLight(9, np.array([0.0, begins, max(begins, crosses) + 1.0]), colours)
    log = scenario(along(grid(14.0), v), road=lined(line(light=9)), lights=(light,))
    assert value(log, "yellow_light.count") == float(before * v > needed and crosses < 14.0)
    assert value(log, "red_light.count") == 0.0


@pytest.mark.parametrize("colour", [Colour.GREEN, Colour.YELLOW, Colour.OFF])
def test_other_colours_are_not_run(colour: Colour) -> None:
    light = TrafficLight(9, np.array([0.0]), (colour,))
    log = scenario(along(grid(8.0), 10.0), road=lined(line(light=9)), lights=(light,))
    assert value(log, "red_light.count") == 0.0


def test_a_stop_before_the_line_and_a_start_behind_it_are_no_crossings() -> None:
    t = grid(12.0)
    stops = along(t, np.maximum(10.0 - 1.2 * t, 0.0))
    for ego in (stops, along(t, 10.0, x=LINE_X)):
        assert (
            value(scenario(ego, road=lined(line(light=9)), lights=(RED,)), "red_light.count") == 0.0
        )


def turning(seconds: float) -> Trajectory:
    """Along x to the line, then round the bend of lane 2, at 10 m/s."""
    t = grid(seconds)
    s = 10.0 * t - LINE_X
    x = np.where(s < 0.0, LINE_X + s, LINE_X + 25.0 * np.sin(np.maximum(s, 0.0) / 25.0))
    y = np.where(s < 0.0, 0.0, 25.0 * (1.0 - np.cos(np.maximum(s, 0.0) / 25.0)))
    yaw = np.maximum(s, 0.0) / 25.0
    return Trajectory(
        t, x, y, yaw, np.full(len(t), 10.0), np.zeros(len(t)), np.where(s < 0.0, 0.0, 0.04)
    )


@pytest.mark.parametrize(("ego", "taken"), [(along(grid(9.0), 10.0), 1), (turning(9.0), 2)])
def test_a_light_counts_for_the_way_that_was_taken(ego: Trajectory, taken: int) -> None:
    for towards in (1, 2):
        log = scenario(ego, road=forked(line(light=9, towards=(towards,))), lights=(RED,))
        assert value(log, "red_light.count") == float(towards == taken)


def test_a_neighbours_line_is_not_the_egos() -> None:
    beside = replace(line(light=9), points=np.array([[LINE_X, 5.25], [LINE_X, 2.4]]))
    log = scenario(along(grid(8.0), 10.0), road=lined(beside), lights=(RED,))
    assert value(log, "red_light.count") == 0.0


# stop signs ---------------------------------------------------------------------------------------


def stop_at(front: float, slowest: float) -> Callable[[np.ndarray], np.ndarray]:
    """Speed at the front's station: 8 m/s, and `slowest` within 0.3 m of `front`."""
    return lambda x: np.where(np.abs(x + 3.608 - front) < 0.3, slowest, 8.0)


def passing(speed_at: Callable[[np.ndarray], np.ndarray], seconds: float = 40.0) -> Trajectory:
    t, x, states = grid(seconds), 0.0, []
    for _ in t:
        v = float(speed_at(np.array(x)))
        states.append((x, v))
        x += 0.01 * max(v, 0.05)
    columns = np.array(states).T
    still = np.zeros(len(t))
    return Trajectory(t, columns[0], still, still, columns[1], still, still)


@pytest.mark.parametrize(
    ("front", "slowest", "run"),
    [(48.0, 0.05, False), (48.0, 0.5, True), (43.0, 0.05, True), (51.5, 0.05, True)],
)
def test_a_stop_sign_wants_a_rest_within_five_metres(
    front: float, slowest: float, *, run: bool
) -> None:
    log = scenario(passing(stop_at(front, slowest)), road=lined(line(must_stop=True)))
    assert value(log, "stop_sign.count") == float(run)


def test_a_drive_that_begins_at_the_line_may_have_stopped_before() -> None:
    log = scenario(along(grid(5.0), 5.0, x=LINE_X - 6.0), road=lined(line(must_stop=True)))
    assert value(log, "stop_sign.count") == 0.0


# crosswalks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("y", "vy", "count"),
    [
        (0.0, 0.0, 1.0),  # stands in the ego's way
        (4.0, 0.0, 0.0),  # stands on the other half
        (-8.4, 1.4, 1.0),  # is on the ego's half when the ego is
        (2.0, 1.4, 0.0),  # has left it
        (-14.0, 1.4, 0.0),  # comes later
    ],
)
def test_a_pedestrian_on_the_egos_half(y: float, vy: float, count: float) -> None:
    walk = ("p", PED, (0.5, 0.5), moving(62.0, y, 0.0, vy, 1.57))
    log = scenario(along(grid(8.0), 10.0), [walk], road=lined(crosswalks=(WALK,)))
    assert value(log, "crosswalk.count") == count


def test_pedestrians_beside_the_crosswalk_do_not_count() -> None:
    walk = ("p", PED, (0.5, 0.5), moving(70.0, 0.0, 0.0, 0.0, 0.0))
    for agents in ([walk], []):
        log = scenario(along(grid(8.0), 10.0), agents, road=lined(crosswalks=(WALK,)))
        assert value(log, "crosswalk.count") == 0.0


def test_an_ego_that_waits_before_the_crosswalk_fails_no_pedestrian() -> None:
    t = grid(20.0)
    v = np.where(t < 5.0, 10.0 - 2.0 * t, np.where(t < 12.0, 0.0, 2.0 * (t - 12.0)))
    walk = ("p", PED, (0.5, 0.5), moving(62.0, -10.0, 0.0, 1.0, 1.57))
    log = scenario(along(t, np.maximum(v, 0.0), x=30.0), [walk], road=lined(crosswalks=(WALK,)))
    assert value(log, "crosswalk.count") == 0.0


# right of way -------------------------------------------------------------------------------------


def crossing() -> Road:
    lanes = {
        0: lane(0, -100.0, 44.0, successors=(1,)),
        1: lane(1, 44.0, 56.0, successors=(2,), yields_to=(11,)),
        2: lane(2, 56.0, 500.0),
        10: lane(10, -200.0, -6.0, axis="y", at=50.0, successors=(11,)),
        11: lane(11, -6.0, 6.0, axis="y", at=50.0, successors=(12,)),
        12: lane(12, 6.0, 200.0, axis="y", at=50.0),
    }
    return Road(lanes)


def met(delay: float, *, speed: float = 10.0) -> Scenario:
    """The ego's middle is at the crossing after 5 s, the other's `delay` s later."""
    ego = along(grid(12.0), 10.0, x=-1.354)
    other = ("c", CAR, (4.5, 1.8), moving(50.0, -speed * (5.0 + delay), 0.0, speed))
    return scenario(ego, [other], road=crossing())


@given(st.floats(0.8, 4.0))
def test_the_gap_is_the_time_between_leaving_and_taking(delay: float) -> None:
    """The ego's rear leaves the other's track (2.254 + 0.9) m after the crossing.

    The other is there as far before.
    """
    expected = delay - (2.254 + 0.9 + 2.25 + 0.805) / 10.0
    assert value(met(delay), "priority_gap.min") == pytest.approx(expected, abs=0.15)
    assert value(met(delay), "priority_gap.below_1s") == float(
        value(met(delay), "priority_gap.min") < 1.0
    )


def test_an_ego_that_goes_second_yields() -> None:
    found = rows(met(-1.0))
    assert not found.available["priority_gap.min"]
    assert (
        found.reason["priority_gap.min"] == "the ego was never ahead of a road user that goes first"
    )
    assert found.value["priority_gap.below_1s"] == 0.0


def test_an_ego_with_priority_may_go_first() -> None:
    log = met(1.0)
    lanes = {i: replace(each, yields_to=()) for i, each in log.road.lanes.items()}
    assert not rows(replace(log, road=replace(log.road, lanes=lanes))).available["priority_gap.min"]


def test_an_assumed_right_of_way_is_a_metric_of_its_own() -> None:
    log = met(1.0)
    waits = frozenset(i for i, each in log.road.lanes.items() if each.yields_to)
    guessed = replace(log, road=replace(log.road, assumed_priority=waits))
    found = rows(guessed)
    assert not found.available["priority_gap.min"]
    assert found.value["priority_gap_assumed.min"] == rows(log).value["priority_gap.min"]
    assert not rows(log).available["priority_gap_assumed.min"]


# all of them --------------------------------------------------------------------------------------


def everything() -> Scenario:
    """A drive that breaks each rule once."""
    base, walk = crossing(), ("p", PED, (0.5, 0.5), moving(82.0, 0.0, 0.0, 0.0, 0.0))
    lines = (
        StopLine(1, 0, np.array([[20.0, 1.75], [20.0, -1.75]]), light=9),
        StopLine(2, 0, np.array([[43.0, 1.75], [43.0, -1.75]]), must_stop=True),
    )
    crosswalk = Crosswalk(4, WALK.polygon + np.array([20.0, 0.0]))
    other = ("c", CAR, (4.5, 1.8), moving(50.0, -60.0, 0.0, 10.0))
    road = replace(base, stop_lines=lines, crosswalks=(crosswalk,))
    return scenario(along(grid(12.0), 10.0, x=-1.354), [other, walk], road=road, lights=(RED,))


@given(st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.booleans())
def test_turned_shifted_and_mirrored_the_answers_are_the_same(
    turn: float, dx: float, mirror: bool
) -> None:
    log = everything()
    there = moved(log, turn, dx, -dx, mirror=mirror)
    one, two = (
        rows(log),
        rows(there, drive(there, moved_ego(log.ego, turn, dx, -dx, mirror=mirror))),
    )
    assert (
        one.value[list(NAMES)].tolist() == two.value[list(NAMES)].tolist() == [1.0, 1.0, 1.0, 1.0]
    )


def test_the_series_counts_where_the_table_says() -> None:
    log = everything()
    steps, table = series(drive(log), log, metrics=RULES), rows(log)
    for name in ("red_light", "stop_sign", "crosswalk"):
        mine = steps[steps.metric == name]
        assert mine.value.sum() == 1.0
        assert mine.t_s[mine.value > 0.0].iloc[0] == table.time_s[f"{name}.count"]


# gates --------------------------------------------------------------------------------------------


def test_the_default_gates_ask_for_the_rules_where_a_log_has_them() -> None:
    default, free, broken = load_gates(None), scenario(along(grid(3.0), 10.0)), everything()
    asked = {
        each.gate.metric: each.outcome
        for each in judge(default, evaluate(drive(broken), broken), {broken.name: LogLabels()})
    }
    assert [asked[name] for name in NAMES] == [Outcome.FAIL] * 4
    found = judge(default, evaluate(drive(free), free), {free.name: LogLabels()})
    assert {each.gate.metric for each in found if each.outcome is Outcome.NOT_ASKED} >= set(NAMES)


HALF, TAIL = 0.805 + 0.25, 0.9
TIMES = np.arange(0.0, 15.05, 0.1)


def judged(log: Scenario, ego: Trajectory) -> pd.DataFrame:
    return evaluate(drive(log, ego), log, metrics={"yielding": METRICS["yielding"]}).set_index(
        "metric"
    )


def after(gap: float) -> Trajectory:
    """A drive at 12 m/s whose tail leaves the pedestrian's way `gap` s before the pedestrian takes
    it.
    """
    taken = 6.3 - HALF / 1.4
    return along(TIMES, 12.0, x=60.25 + TAIL - 12.0 * (taken - gap))


@settings(max_examples=25, deadline=None)
@given(st.floats(0.3, 2.6))
def test_the_gap_is_the_time_until_the_pedestrian_takes_the_place(gap: float) -> None:
    table = judged(crossing_without_a_map(), after(gap))
    for part, bound in (("recorded", 1.5), ("pedestrian", 1.0)):
        found = table.value[f"yielding.{part}.min"]
        assert found == pytest.approx(gap, abs=0.06)
        name = {1.5: "below_1500ms", 1.0: "below_1s"}[bound]
        assert (table.value[f"yielding.{part}.{name}"] > 0.0) == (found < bound - 1e-6)


def test_the_recorded_driver_and_an_ego_far_ahead_take_no_priority() -> None:
    log = crossing_without_a_map()
    for ego in (log.ego, after(4.0)):
        table = judged(log, ego)
        assert not table.available["yielding.recorded.min"]
        assert table.value["yielding.recorded.below_1500ms"] == 0.0


def test_yielding_is_measured_where_the_recorded_driver_let_a_road_user_go_first() -> None:
    log = crossing_without_a_map()
    alone = replace(log, tracks=tracks())
    assert (
        judged(alone, after(1.0))
        .reason["yielding.recorded.below_1500ms"]
        .startswith("the recorded driver let no")
    )
    made = replace(log, tags=("synthetic",))
    assert (
        judged(made, after(1.0)).reason["yielding.recorded.below_1500ms"]
        == "the log has no recorded driver"
    )


def test_a_track_that_changes_its_id_counts_as_one_and_a_flicker_does_not() -> None:
    log = crossing_without_a_map()
    t, y = log.tracks.t, log.tracks.y
    pieces = np.array_split(np.arange(len(t)), len(t) // 4)
    walker = {
        "kind": AgentKind.PEDESTRIAN,
        "length": 0.5,
        "width": 0.5,
        "yaw": np.pi / 2.0,
        "vx": 0.0,
        "vy": 1.4,
    }
    flickers = tracks(
        *(track(f"p{k}", t[i], 0.0 * t[i] + 60.0, y[i], **walker) for k, i in enumerate(pieces))
    )
    whole, parts = judged(log, after(1.1)), judged(replace(log, tracks=flickers), after(1.1))
    assert parts.value["yielding.recorded.min"] == pytest.approx(
        whole.value["yielding.recorded.min"], abs=0.21
    )
    assert parts.value["yielding.recorded.below_1500ms"] > 0.0
    at = np.flatnonzero(np.abs(t - 6.0) < 0.15)
    ghost = tracks(track("g", t[at], 0.0 * t[at] + 60.0, 0.0 * t[at], **walker))
    assert not (judged(replace(log, tracks=ghost), after(1.0)).value > 0.0).any()


@settings(max_examples=10, deadline=None)
@given(st.floats(-3.0, 3.0), st.booleans())
def test_the_verdict_does_not_depend_on_where_the_world_lies(turn: float, mirror: bool) -> None:
    log, ego = crossing_without_a_map(), after(1.2)
    here = judged(log, ego)
    there = judged(
        moved(log, turn, 3.0, -7.0, mirror=mirror), moved_ego(ego, turn, 3.0, -7.0, mirror=mirror)
    )
    np.testing.assert_allclose(here.value.to_numpy(), there.value.to_numpy(), atol=1e-6)
