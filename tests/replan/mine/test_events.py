"""Kinds of events: each finds what it is made for and nothing beside it, wherever in the world the
log lies.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from drives import Agent, along, changing, grid, moved, moving, scenario, straight_road
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.catalogue import scenario as synthesised
from replan.logs.road import Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import Unavailable
from replan.mine.conflicts import SHALLOW
from replan.mine.driven_log import (
    JUMPS,
    TYRES_MPS2,
    UNCLASSIFIED,
    DrivenLog,
    Event,
    EventKind,
    runs,
)
from replan.mine.kinds import KINDS

CAR, WALKER, BIKE = (4.5, 1.8), (0.5, 0.5), (1.8, 0.6)
T = grid(12.0, 0.1)


def found(log: Scenario, *names: str) -> dict[str, list[Event]]:
    """The events of some kinds (none: all), without those that find nothing or cannot be asked."""
    made, events = DrivenLog(log), {}
    for name in names or KINDS:
        answer = KINDS[name].find(made)
        if not isinstance(answer, Unavailable) and (listed := list(answer)):
            events[name] = sorted(listed, key=lambda event: event.begin)
    return events


def sideways(
    x: float, v: float, y0: float, y1: float, begin: float, lasts: float = 2.0
) -> Callable:
    """Along x, from the offset y0 to y1."""

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u = np.clip((t - begin) / lasts, 0.0, 1.0)
        y = y0 + (y1 - y0) * u * u * (3.0 - 2.0 * u)
        return x + v * t, y, np.arctan2(np.gradient(y, t), np.maximum(v, 0.1))

    return motion


def car(
    name: str, motion: Callable, kind: AgentKind = AgentKind.CAR, size: Sequence[float] = CAR
) -> Agent:
    return name, kind, size, motion


def stopping(t: np.ndarray, v: float, begin: float, decel: float) -> np.ndarray:
    return np.maximum(v - decel * np.maximum(t - begin, 0.0), 0.0)


def lead_car(x: float, speeds: np.ndarray, moved_m: np.ndarray | float = 0.0) -> Agent:
    """Drives along x at speeds at the times `T`; its samples lie elsewhere by `moved_m`."""
    travelled = np.cumsum(0.5 * np.diff(T) * (speeds[1:] + speeds[:-1]))
    places = x + np.r_[0.0, travelled] + moved_m
    return car("lead", lambda t: (np.interp(t, T, places), np.zeros(len(t)), np.zeros(len(t))))


def walker(x: float, v: float, at: float) -> Agent:
    """Crosses the lane from the right; is in its middle at a time."""
    return car("w", moving(x, -v * at, 0.0, v), AgentKind.PEDESTRIAN, WALKER)


def test_an_empty_road_has_no_event() -> None:
    assert found(scenario(along(T, 10.0), road=straight_road(lanes=2))) == {}


def test_cut_in_and_cut_out_name_the_car_and_the_gap() -> None:
    into = scenario(along(T, 10.0), [car("7", sideways(25.0, 10.0, 3.5, 0.0, 4.0))])
    (event,) = found(into)["cut_in"]
    assert event.agents == ("7",) and 4.0 < event.begin < 6.0
    assert event.value == pytest.approx(25.0 - 0.5 * CAR[0] - into.vehicle.axle_to_front, abs=0.3)
    out = scenario(along(T, 10.0), [car("7", sideways(25.0, 10.0, 0.0, 3.5, 4.0))])
    events = found(out)
    assert [event.agents for event in events["cut_out"]] == [("7",)]
    assert "cut_in" not in events


def test_a_car_that_stays_in_its_lane_neither_cuts_in_nor_out() -> None:
    log = scenario(
        along(T, 10.0),
        [car("lead", moving(25.0, 0.0, 10.0, 0.0)), car("side", moving(15.0, 3.5, 10.0, 0.0))],
    )
    assert not {"cut_in", "cut_out"} & found(log).keys()


def test_a_lane_change_of_the_ego_is_no_cut_in_of_another_vehicle() -> None:
    ego = changing(T, 10.0, 3.0, 3.0)
    log = scenario(ego, [car("there", moving(30.0, 3.5, 10.0, 0.0))], road=straight_road(lanes=2))
    events = found(log)
    assert "cut_in" not in events
    assert [event.what for event in events["lane_change"]] == ["left"]


def test_hard_braking_of_the_ego_has_its_deceleration() -> None:
    (event,) = found(scenario(along(T, stopping(T, 14.0, 4.0, 5.0))))["hard_braking"]
    assert event.value == pytest.approx(-5.0, abs=0.3)
    assert 3.9 < event.begin < 4.8


GENTLE = stopping(T, 14.0, 4.5, 2.5)


def test_hard_braking_of_the_lead_is_an_event_of_the_lead() -> None:
    log = scenario(along(T, GENTLE), [lead_car(40.0, stopping(T, 14.0, 4.0, 5.0))])
    assert [event.agents for event in found(log)["lead_braking"]] == [("lead",)]


def braking(jump_m: float, decel: float, step: int) -> list[Event]:
    """The braking of a lead of which one sample, of another step, lies back by a jump."""
    lead = lead_car(30.0, stopping(T, 14.0, 4.0, decel), -jump_m * (np.arange(len(T)) == step))
    return found(scenario(along(T, GENTLE), [lead]), "lead_braking").get("lead_braking", [])


@given(st.floats(3.0, 10.0), st.integers(30, 60), st.floats(2.0, 8.0))
@settings(max_examples=12)
def test_braking_of_a_lead_whose_label_jumps_is_in_doubt_and_no_harder_than_tyres(
    decel: float, step: int, jump: float
) -> None:
    for event in braking(jump, decel, step):
        assert event.doubt == JUMPS
        assert event.value >= -TYRES_MPS2


@given(st.floats(3.4, 10.0))
@settings(max_examples=12)
def test_a_lead_that_brakes_is_one_event_without_doubt(decel: float) -> None:
    assert [event.doubt for event in braking(0.0, decel, 0)] == [""]


def test_the_ego_slows_behind_a_lead_and_not_by_itself() -> None:
    ego = along(T, stopping(T, 10.0, 4.5, 2.0))
    lead = lead_car(25.0, stopping(T, 10.0, 4.0, 2.0))
    (event,) = found(scenario(ego, [lead]))["ego_slows"]
    assert event.agents == ("lead",)
    assert 4.0 <= event.begin < 5.5
    assert event.value > 8.0
    assert "ego_slows" not in found(scenario(ego))


def test_a_cyclist_who_crosses_does_not_ride_along() -> None:
    ego = along(T, stopping(T, 8.0, 2.0, 2.0))
    crossing = car("b", moving(40.0, -20.0, 0.0, 4.0), AgentKind.BICYCLE, BIKE)
    assert [event.agents for event in found(scenario(ego, [crossing]))["cyclist_crossing"]] == [
        ("b",)
    ]
    riding = car("b", sideways(30.0, 4.0, -2.5, 2.5, 3.0), AgentKind.BICYCLE, BIKE)
    assert "cyclist_crossing" not in found(scenario(ego, [riding]))


def contacts(y: float, kind: AgentKind = AgentKind.CAR) -> list[Event]:
    """With a vehicle that stands in the ego's way, at an offset from its middle."""
    stands = car("7", moving(60.0, y, 0.0, 0.0, 0.0), kind)
    return found(scenario(along(T, 10.0), [stands])).get("contact", [])


def test_a_contact_has_its_speed() -> None:
    (event,) = contacts(0.5)
    assert (event.agents, event.doubt) == (("7",), "")
    assert event.value == pytest.approx(10.0, abs=0.1)
    assert contacts(3.0) == []


def test_a_contact_with_an_unclassified_road_user_or_of_a_few_centimetres_is_in_doubt() -> None:
    (event,) = contacts(0.5, AgentKind.OBJECT)
    assert event.doubt == UNCLASSIFIED
    (event,) = contacts(0.5 * (CAR[1] + scenario(along(T, 10.0)).vehicle.width) - 0.1)
    assert event.doubt == SHALLOW


def test_a_queue_is_three_or_more_vehicles_that_stand_in_the_band() -> None:
    stand = [car(str(i), moving(60.0 + 8.0 * i, 0.0, 0.0, 0.0, 0.0)) for i in range(4)]
    ego = along(T, stopping(T, 10.0, 2.0, 2.0))
    (event,) = found(scenario(ego, stand))["standing_queue"]
    assert (event.value, event.agents) == (4.0, ("0", "1", "2", "3"))
    assert "standing_queue" not in found(scenario(ego, stand[:2]))


def test_an_oncoming_vehicle_in_the_band_is_an_event() -> None:
    head_on = car("7", moving(100.0, 0.3, -8.0, 0.0))
    assert [event.agents for event in found(scenario(along(T, 2.0), [head_on]))["oncoming"]] == [
        ("7",)
    ]
    passing = car("7", moving(100.0, 3.5, -8.0, 0.0))
    assert "oncoming" not in found(scenario(along(T, 2.0), [passing]))


def test_a_close_pass_has_the_distance_to_a_cyclist_and_to_a_parked_car() -> None:
    bike = car("b", moving(20.0, -2.0, 4.0, 0.0), AgentKind.BICYCLE, BIKE)
    events = found(scenario(along(T, 10.0), [bike]))
    assert [event.agents for event in events["cyclist_along"]] == [("b",)]
    half = 0.5 * scenario(along(T, 10.0)).vehicle.width
    assert events["close_pass"][0].value == pytest.approx(2.0 - 0.3 - half, abs=0.02)
    parked = car("p", moving(50.0, -2.4, 0.0, 0.0, 0.0))
    assert "close_pass" not in found(scenario(along(T, 10.0), [parked]))
    nearer = car("p", moving(50.0, -2.2, 0.0, 0.0, 0.0))
    assert found(scenario(along(T, 10.0), [nearer]))["close_pass"][0].value == pytest.approx(
        2.2 - 0.9 - half, abs=0.02
    )


CROSSWALK = np.array([[38.0, -4.0], [42.0, -4.0], [42.0, 4.0], [38.0, 4.0]])


def test_only_the_map_says_that_a_pedestrian_who_crosses_jaywalks() -> None:
    log = scenario(along(T, stopping(T, 8.0, 2.0, 2.0)), [walker(40.0, 1.4, 5.0)])
    events = found(log)
    assert "jaywalking" not in events
    assert len(events["pedestrian_crossing"]) == 1
    for shift, times in ((0.0, 0), (30.0, 1)):
        walk = Crosswalk(1, CROSSWALK + np.array([shift, 0.0]))
        on_road = replace(log, road=replace(straight_road(), crosswalks=(walk,)))
        assert len(found(on_road).get("jaywalking", [])) == times


def test_a_crosswalk_on_the_egos_path_is_an_event() -> None:
    road = replace(straight_road(), crosswalks=(Crosswalk(1, CROSSWALK),))
    (event,) = found(scenario(along(T, 8.0), road=road))["crosswalk"]
    assert event.what == "crosswalk 1"


def test_a_pedestrian_along_the_road_does_not_cross() -> None:
    beside = car("w", moving(40.0, -2.5, 1.4, 0.0), AgentKind.PEDESTRIAN, WALKER)
    assert "pedestrian_crossing" not in found(scenario(along(T, 8.0), [beside]))


def test_a_log_without_kinds_is_not_asked_for_pedestrians() -> None:
    thing = car("w", moving(40.0, -7.0, 0.0, 1.4), AgentKind.OBJECT, WALKER)
    assert isinstance(
        KINDS["pedestrian_crossing"].find(DrivenLog(scenario(along(T, 8.0), [thing]))), Unavailable
    )


def test_the_ego_that_goes_second_yields() -> None:
    slows, goes_on = np.maximum(8.0 - 2.0 * (T - 2.0), 0.0), 2.0 * np.maximum(T - 7.0, 0.0)
    v = np.where(T < 2.0, 8.0, np.maximum(slows, goes_on))
    events = found(scenario(along(T, v), [walker(45.0, 1.4, 5.0)]))
    assert [event.agents for event in events["ego_yields"]] == [("w",)]
    assert "ego_is_yielded_to" not in events


def test_the_ego_is_yielded_to_by_the_road_user_that_goes_second() -> None:
    def waits(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        y = np.interp(t, [0.0, 4.0, 7.0, T[-1]], [-7.0, -1.4, -1.4, -1.4 + 1.4 * (T[-1] - 7.0)])
        return np.full(len(t), 40.0), y, np.full(len(t), 1.57)

    events = found(scenario(along(T, 8.0), [car("w", waits, AgentKind.PEDESTRIAN, WALKER)]))
    assert [event.agents for event in events["ego_is_yielded_to"]] == [("w",)]
    assert "ego_yields" not in events


def test_a_car_that_crosses_behind_the_ego_is_a_near_miss_by_its_pet() -> None:
    """The ego's front is there at 4.6 s, the car at about 5.2 s."""
    crossing = car("7", moving(50.0, -31.0, 0.0, 6.0))
    assert found(scenario(along(T, 10.0), [crossing]))["near_miss_pet"][0].value < 1.0


def test_hard_braking_before_a_wall_is_a_near_miss_by_its_ttc() -> None:
    wall = car("wall", moving(52.0, 0.0, 0.0, 0.0, 0.0))
    (event,) = found(scenario(along(T, stopping(T, 14.0, 2.0, 8.0)), [wall]))["near_miss_ttc"]
    assert (event.agents, event.doubt) == (("wall",), "")


@pytest.mark.parametrize(("v", "decel", "times"), [(3.0, 1.5, 0), (14.0, 2.0, 0), (14.0, 5.0, 1)])
def test_a_stop_before_a_wall_is_a_near_miss_if_it_needs_hard_braking(
    v: float, decel: float, times: int
) -> None:
    ego = along(T, stopping(T, v, 2.0, decel))
    front = float(ego.x[-1]) + scenario(ego).vehicle.axle_to_front
    wall = car("wall", moving(front + 0.7 + 0.5 * CAR[0], 0.0, 0.0, 0.0, 0.0))
    assert len(found(scenario(ego, [wall]), "near_miss_ttc").get("near_miss_ttc", [])) == times


def test_a_car_that_drifts_towards_the_ego_and_one_outside_of_its_turn_are_no_near_miss() -> None:
    half = 0.5 * (CAR[1] + scenario(along(T, 10.0)).vehicle.width)

    def drifts(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return 4.0 + 10.0 * t, half + 1.2 - np.clip(t - 4.0, 0.0, 0.8), np.zeros(len(t))

    turn = T / 2.0
    ego = Trajectory(
        T, 10.0 * np.sin(turn), 10.0 * (1.0 - np.cos(turn)), turn, 0 * T + 5.0, 0 * T, 0 * T + 0.1
    )
    outside = car("7", moving(12.5, 10.0, 0.0, 0.0, 1.57))
    for log in (scenario(along(T, 10.0), [car("7", drifts)]), scenario(ego, [outside])):
        assert found(log, "near_miss_ttc") == {}


def test_events_where_the_ego_jumps_are_in_doubt() -> None:
    wall = car("wall", moving(52.0, 0.0, 0.0, 0.0, 0.0))
    for decel, doubt in ((8.0, ""), (20.0, JUMPS)):
        events = found(
            scenario(along(T, stopping(T, 14.0, 2.0, decel)), [wall]),
            "hard_braking",
            "near_miss_ttc",
        )
        assert {event.doubt for event in events["hard_braking"]} == {doubt}


LINE = StopLine(3, 0, np.array([[60.0, -1.75], [60.0, 1.75]]), light=9)


def test_a_light_is_an_event_while_it_is_red() -> None:
    red = TrafficLight(9, np.array([0.0, 8.0]), (Colour.RED, Colour.GREEN))
    road = replace(straight_road(), stop_lines=(LINE,))
    log = scenario(along(T, stopping(T, 8.0, 1.0, 1.2)), road=road, lights=(red,))
    (event,) = found(log)["red_light"]
    assert (event.end <= 8.0, event.what) == (True, "stop line 3")
    green = replace(red, colours=(Colour.GREEN, Colour.GREEN))
    assert "red_light" not in found(replace(log, lights=(green,)))


def test_a_line_at_which_all_must_stop_is_a_stop_sign() -> None:
    sign = StopLine(3, 0, LINE.points, must_stop=True)
    log = scenario(along(T, 8.0), road=replace(straight_road(), stop_lines=(sign,)))
    assert len(found(log)["stop_sign"]) == 1


def lane(name: int, points: Sequence[Sequence[float]], **more: object) -> Lane:
    xy = np.array(points, float)
    way = np.gradient(xy, axis=0)
    normal = np.column_stack([-way[:, 1], way[:, 0]]) / np.hypot(*way.T)[:, None]
    return Lane(name, xy + 1.75 * normal, xy - 1.75 * normal, **more)  # type: ignore[arg-type]


def test_a_turn_where_lanes_cross_is_protected_by_a_light_only() -> None:
    a = np.linspace(0.0, 0.5 * np.pi, 20)
    turn = np.column_stack([30.0 + 12.0 * np.sin(a), 12.0 - 12.0 * np.cos(a)])
    way = np.vstack(
        [np.column_stack([np.linspace(0.0, 29.0, 30), np.zeros(30)]), turn, [[42.0, 40.0]]]
    )
    road = Road({0: lane(0, way), 1: lane(1, [[80.0, 3.5], [30.0, 3.5], [-20.0, 3.5]])})
    s = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    at = 5.0 * T
    x, y = np.interp(at, s, way[:, 0]), np.interp(at, s, way[:, 1])
    yaw = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    ego = replace(along(T, 5.0), x=x, y=y, yaw=yaw)
    (event,) = found(scenario(ego, road=road), "unprotected_turn")["unprotected_turn"]
    assert event.value > 0.8 and event.what == "left, across oncoming traffic"
    lit = replace(
        road, stop_lines=(StopLine(1, 0, np.array([[25.0, -1.75], [25.0, 1.75]]), light=4),)
    )
    assert found(scenario(ego, road=lit), "unprotected_turn") == {}
    assert found(scenario(ego, road=Road({0: road.lanes[0]})), "unprotected_turn") == {}


def test_a_merge_needs_a_vehicle_on_the_other_lane() -> None:
    lanes = {
        0: lane(0, [[-20.0, 0.0], [40.0, 0.0]], successors=(2,)),
        1: lane(1, [[-20.0, -12.0], [40.0, 0.0]], successors=(2,)),
        2: lane(2, [[40.0, 0.0], [200.0, 0.0]]),
    }
    ego = along(T, 8.0)
    other = car("7", moving(-16.0, -11.2, 8.0, 1.6))
    log = scenario(ego, [other], road=Road(lanes))
    assert [event.agents for event in found(log, "merge")["merge"]] == [("7",)]
    assert found(scenario(ego, road=Road(lanes)), "merge") == {}


def test_a_circle_of_lanes_is_a_roundabout_and_a_block_is_none() -> None:
    def ring(points: np.ndarray) -> Road:
        parts = [
            points[i : i + len(points) // 4 + 1]
            for i in range(0, len(points) - 1, len(points) // 4)
        ]
        return Road(
            {i: lane(i, part, successors=((i + 1) % len(parts),)) for i, part in enumerate(parts)}
        )

    a = np.linspace(0.0, 2.0 * np.pi, 81)
    circle = 15.0 * np.column_stack([np.cos(a), np.sin(a)])
    at = 4.0 * T / 15.0
    ego = replace(along(T, 4.0), x=15.0 * np.cos(at), y=15.0 * np.sin(at), yaw=at + 0.5 * np.pi)
    assert len(found(scenario(ego, road=ring(circle)), "roundabout")["roundabout"]) == 1
    side = np.linspace(0.0, 50.0, 20, endpoint=False)
    block = np.vstack(
        [
            np.column_stack([side, 0.0 * side]),
            np.column_stack([0.0 * side + 50.0, 0.3 * side]),
            np.column_stack([50.0 - side, 0.0 * side + 15.0]),
            np.column_stack([0.0 * side, 15.0 - 0.3 * side]),
            [[0.0, 0.0]],
        ]
    )
    assert found(scenario(along(T, 4.0), road=ring(block)), "roundabout") == {}


@settings(max_examples=12, deadline=None)
@given(
    turn=st.floats(-3.0, 3.0),
    dx=st.floats(-500.0, 500.0),
    dy=st.floats(-500.0, 500.0),
    mirror=st.booleans(),
    name=st.sampled_from(
        ["everyday/cut_in", "everyday/crosswalk", "euro_ncap/cpnco_2023", "everyday/junction"]
    ),
)
def test_events_do_not_depend_on_where_the_log_lies(
    turn: float, dx: float, dy: float, mirror: bool, name: str
) -> None:
    log = synthesised(name)
    here, there = found(log), found(moved(log, turn, dx, dy, mirror=mirror))
    assert here and here.keys() == there.keys()
    for kind, events in here.items():
        for one, other in zip(events, there[kind], strict=True):
            assert one.agents == other.agents
            assert (one.begin, one.end) == pytest.approx((other.begin, other.end), abs=0.11)
            assert abs(one.value) == pytest.approx(abs(other.value), abs=0.05, nan_ok=True)


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 5), st.integers(0, 4))
def test_runs_cover_the_marked_indices_and_are_apart(
    marks: list[bool], least: int, hole: int
) -> None:
    flags = np.array(marks, bool)
    spans = list(runs(flags, None, least, hole))
    assert all(flags[first] and flags[last] and last - first + 1 >= least for first, last in spans)
    assert all(second[0] - first[1] > hole + 1 for first, second in pairwise(spans))
    if least == 1:
        inside = np.zeros(len(flags), bool)
        for first, last in spans:
            inside[first : last + 1] = True
        assert (inside | ~flags).all()


def test_a_kind_is_checked_when_it_is_made() -> None:
    with pytest.raises(ValueError, match="one word"):
        EventKind("two words", lambda log: (), "x")
