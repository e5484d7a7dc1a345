"""Features of a frame: the same in a moved world, the nearest first, never of the future."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.contract.planner_rules import context_of, frames_of
from replan.core.errors import ConfigError
from replan.features import (
    AGENT_COLUMNS,
    EGO_COLUMNS,
    LANE_COLUMNS,
    OBJECT_COLUMNS,
    ROUTE_COLUMNS,
    STEPS,
    Features,
    FeatureSizes,
    features_of,
)
from replan.features.map_features import route_line
from replan.logs import catalogue
from replan.logs.agents import AgentKind, Agents, ObjectClass
from replan.logs.edit.transform import moved
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.lane_route import LaneRoute
from replan.logs.road import Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters

FAMILIES = ("everyday/junction", "everyday/crosswalk", "everyday/bend", "paper/static_obstacles")
LOGS = {name: catalogue.scenario(name) for name in FAMILIES}
PREFIXES = ("agents", "objects", "lanes", "crosswalks", "route")
X = np.linspace(-50.0, 250.0, 31)


def features_at(log: Scenario, t: float, sizes: FeatureSizes | None = None) -> Features:
    """The features at a time, with the frames of the last two seconds before it."""
    times = [round(t - 0.1 * k, 6) for k in range(20, -1, -1) if t - 0.1 * k >= 0.0]
    frame = frames_of(log, times)[-1]
    return features_of(frame, context_of(log), sizes or FeatureSizes())


def lane(name: int, y: float, x: np.ndarray = X, **fields: object) -> Lane:
    """A lane along x, 4 m wide."""
    left, right = np.c_[x, 0 * x + y + 2.0], np.c_[x, 0 * x + y - 2.0]
    return Lane(name, left, right, **fields)  # type: ignore[arg-type]


def scene(road: Road, route: tuple[int, ...], **fields: object) -> tuple[Frame, PlannerContext]:
    """The ego at the origin, at 10 m/s along x, alone."""
    ego, nothing = EgoState(0.0, 0.0, 0.0, 0.0, 10.0), np.empty(0)
    agents = Agents((), (), *[nothing] * 7)
    futures = Predictions(np.zeros(1), np.empty(0, np.int64), nothing, *[np.empty((0, 1))] * 3, "")
    frame = Frame(0.0, ego, agents, futures)
    context = PlannerContext(road, None, VehicleParameters(), 0.1, ego, route=LaneRoute(route))
    lights = fields.pop("lights", {})
    return replace(frame, lights=lights), replace(context, **fields)  # type: ignore[arg-type]


def with_agents(frame: Frame, places: list[tuple[float, float]], kind: AgentKind) -> Frame:
    count = len(places)
    x, y = np.array(places).reshape(-1, 2).T
    still, one = np.zeros(count), np.ones(count)
    names = tuple(map(str, range(count)))
    agents = Agents(names, (kind,) * count, one, one, x, y, still, still, still)
    return replace(frame, agents=agents)


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from(FAMILIES),
    st.integers(0, 80),
    st.floats(-300.0, 300.0),
    st.floats(-300.0, 300.0),
    st.floats(-3.1, 3.1),
)
def test_features_do_not_depend_on_where_the_world_lies(
    family: str, tick: int, dx: float, dy: float, dyaw: float
) -> None:
    log = LOGS[family]
    here = features_at(log, 0.1 * tick).arrays()
    there = features_at(moved(log, dx, dy, dyaw), 0.1 * tick).arrays()
    for name, array in here.items():
        np.testing.assert_allclose(there[name], array, atol=2e-3, err_msg=name)


@pytest.mark.parametrize("family", FAMILIES)
def test_rows_beyond_the_mask_are_empty_and_all_shapes_are_those_of_the_sizes(family: str) -> None:
    sizes = FeatureSizes(agents=3, objects=2, lanes=9, crosswalks=2, route_points=50)
    features = features_at(LOGS[family], 4.0, sizes)
    assert features.ego.shape == (STEPS, len(EGO_COLUMNS))
    assert features.agents.shape == (3, STEPS, len(AGENT_COLUMNS))
    assert features.objects.shape == (2, len(OBJECT_COLUMNS))
    assert features.lanes.shape == (9, 20, len(LANE_COLUMNS))
    assert features.crosswalks.shape == (2, 8, 2)
    assert features.route.shape == (50, len(ROUTE_COLUMNS))
    for name, array in features.arrays().items():
        assert array.dtype in (np.float32, np.int64, np.bool_) and not array.flags.writeable
        prefix = name.partition("_")[0]
        if prefix in PREFIXES:
            mask = getattr(features, f"{prefix}_mask")
            assert (mask == np.sort(mask)[::-1]).all(), "used rows are first"
            empty = -1 if array.dtype == np.int64 else 0
            assert (array[~mask] == empty).all(), name


@given(
    st.lists(st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)), max_size=12),
    st.integers(1, 5),
    st.booleans(),
)
def test_the_nearest_agents_within_the_radius_are_kept_first(
    places: list[tuple[float, float]], count: int, is_object: bool
) -> None:
    frame, context = scene(Road({1: lane(1, 0.0)}), (1,))
    kind = AgentKind.OBJECT if is_object else AgentKind.CAR
    sizes = FeatureSizes(agents=count, objects=count, radius_m=100.0)
    features = features_of(with_agents(frame, places, kind), context, sizes)
    points = features.objects if is_object else features.agents[:, -1]
    mask = features.objects_mask if is_object else features.agents_mask
    away = np.sort([np.hypot(x, y) for x, y in places])
    expected = away[away <= 100.0][:count]
    np.testing.assert_allclose(np.hypot(*points[mask][:, :2].T), expected, atol=1e-3)
    assert not (features.agents_mask if is_object else features.objects_mask).any()


def test_objects_have_their_class_where_the_log_says_it() -> None:
    frame, context = scene(Road({1: lane(1, 0.0)}), (1,))
    frame = with_agents(frame, [(10.0, 2.0), (20.0, 2.0)], AgentKind.OBJECT)
    classes = {frame.agents.ids[1]: ObjectClass.SIGN, "gone": ObjectClass.CONE}
    features = features_of(replace(frame, object_classes=classes), context)
    assert features.objects_class[:3].tolist() == [
        -1,
        list(ObjectClass).index(ObjectClass.SIGN),
        -1,
    ]


@pytest.mark.parametrize("family", FAMILIES)
def test_fewer_places_hold_the_first_of_many(family: str) -> None:
    few = features_at(LOGS[family], 3.0, FeatureSizes(agents=1, lanes=4, route_points=10))
    many = features_at(LOGS[family], 3.0)
    for name, array in few.arrays().items():
        np.testing.assert_array_equal(getattr(many, name)[: len(array)], array, err_msg=name)


@pytest.mark.parametrize("family", FAMILIES)
def test_what_happens_later_changes_nothing(family: str) -> None:
    log, t = LOGS[family], 3.0
    later = log.tracks.t > t + 1e-6
    x = np.where(later, log.tracks.x + 500.0, log.tracks.x)
    wild = replace(log, tracks=replace(log.tracks, x=x))
    for name, array in features_at(log, t).arrays().items():
        np.testing.assert_array_equal(getattr(features_at(wild, t), name), array, err_msg=name)


def test_the_history_of_the_ego_is_its_drive_seen_from_now() -> None:
    log = LOGS["paper/static_obstacles"]
    features, now = features_at(log, 5.0), log.ego.at(5.0)
    assert features.ego_known[2:].all()
    before = log.ego.at(4.0)
    row = dict(zip(EGO_COLUMNS, features.ego[-11].tolist(), strict=True))
    x, y = now.offset_of(np.array(before.x), np.array(before.y))
    assert (row["x"], row["y"]) == pytest.approx((float(x), float(y)), abs=1e-3)
    assert row["cos_yaw"] == pytest.approx(np.cos(before.yaw - now.yaw), abs=1e-5)
    assert np.hypot(row["vx"], row["vy"]) == pytest.approx(before.v, abs=1e-4)
    np.testing.assert_allclose(features.ego[-1, :4], (0.0, 0.0, 1.0, 0.0), atol=1e-6)


def test_the_first_frame_has_a_history_that_is_marked_as_not_known() -> None:
    features = features_at(LOGS["everyday/junction"], 0.0)
    assert features.ego_known.tolist() == [False] * (STEPS - 1) + [True]
    assert features.agents_seen[features.agents_mask].any(axis=1).all()
    assert not features.agents_seen[:, :-1].any()


def test_agents_have_their_kind_and_place_in_the_frame() -> None:
    frame, context = scene(Road({1: lane(1, 0.0)}), (1,))
    frame = with_agents(frame, [(30.0, 0.0), (5.0, 3.0)], AgentKind.PEDESTRIAN)
    features = features_of(frame, context)
    assert features.agents_row[:3].tolist() == [1, 0, -1]
    assert features.agents_kind[:3].tolist() == [5, 5, -1]


def test_a_long_lane_is_cut_into_equal_pieces_with_their_boundaries() -> None:
    frame, context = scene(Road({7: lane(7, 1.0, speed_limit=12.0)}), (7,))
    features = features_of(frame, context, FeatureSizes(lane_points=5, piece_m=50.0))
    first = features.lanes[0]
    np.testing.assert_allclose(first[:, 1], 1.0, atol=1e-5)
    np.testing.assert_allclose(np.diff(first[:, 0]), 12.5, atol=1e-5)
    np.testing.assert_allclose(first[:, 2:], [(1, 0, 0, 2, 0, -2)] * 5, atol=1e-5)
    used = features.lanes_mask
    assert used.sum() == 4, "those from -50 m to 150 m are within 120 m"
    assert (features.lanes_id[used] == 7).all() and (features.lanes_route[used] == 0).all()
    assert (features.lanes_limit[used] == 12.0).all() and features.lanes_limit_stated[used].all()


@pytest.mark.parametrize(
    ("colour", "code", "column"),
    [(Colour.RED, 3, "red"), (Colour.YELLOW, 2, "yellow"), (Colour.GREEN, 1, None)],
)
def test_a_light_is_at_its_stop_line_and_its_lanes(
    colour: Colour, code: int, column: str | None
) -> None:
    stop = StopLine(1, 1, np.array([[30.5, 2.0], [30.5, -2.0]]), light=4)
    lanes = {1: lane(1, 0.0, X[:9], successors=(2,)), 2: lane(2, 0.0, X[8:])}
    road = Road(lanes, stop_lines=(stop,))
    frame, context = scene(road, (1, 2), lights={4: colour}, light_lanes={4: (2,)})
    features = features_of(frame, context)
    is_second = features.lanes_id == 2
    assert (features.lanes_light[is_second] == code).all() and is_second.any()
    assert (features.lanes_light[features.lanes_id == 1] == 0).all()
    demands = {name: features.route[:, ROUTE_COLUMNS.index(name)] for name in ("red", "yellow")}
    for name, weights in demands.items():
        expected = np.zeros(len(weights))
        if name == column:  # 30.5 m is between 30 m and 32 m
            expected[15], expected[16] = 0.75, 0.25
        np.testing.assert_allclose(weights, expected, atol=1e-3)


def test_crosswalks_signs_and_priority_are_marked_on_the_route() -> None:
    sign = StopLine(3, 1, np.array([[20.0, 2.0], [20.0, -2.0]]), must_stop=True)
    zebra = Crosswalk(5, np.array([(39.0, -5.0), (43.0, -5.0), (43.0, 5.0), (39.0, 5.0)]))
    lanes = {
        1: lane(1, 0.0, X[:9], successors=(2,)),
        2: lane(2, 0.0, X[8:], yields_to=(9,), speed_limit=8.0),
    }
    frame, context = scene(Road(lanes, stop_lines=(sign,), crosswalks=(zebra,)), (1, 2))
    features = features_of(frame, context)
    columns = dict(zip(ROUTE_COLUMNS, features.route.T, strict=True))
    assert np.flatnonzero(columns["must_stop"]).tolist() == [10]
    assert np.flatnonzero(columns["crosswalk"]).tolist() == [20, 21]
    assert columns["yields"][14] == 0.0 and columns["yields"][16] == 1.0
    assert columns["limit"][16] == 8.0 and columns["left"][16] == pytest.approx(2.0)
    assert features.crosswalks_mask.tolist() == [True] + [False] * 7


def test_where_the_route_changes_lanes_its_line_is_that_of_the_second() -> None:
    lanes = {
        1: lane(1, 0.0, left_neighbour=2),
        2: lane(2, 4.0, right_neighbour=1),
    }
    frame, context = scene(Road(lanes), (1, 2))
    features = features_of(frame, context)
    np.testing.assert_allclose(features.route[:, 1], 4.0, atol=1e-4)
    np.testing.assert_allclose(features.route[:, 0], 2.0 * np.arange(80), atol=1e-3)
    order = {1: 0, 2: 1}
    assert all(
        order[name] == place
        for name, place in zip(features.lanes_id, features.lanes_route, strict=True)
        if name >= 0
    )


def test_the_route_ends_where_its_lanes_end() -> None:
    frame, context = scene(Road({1: lane(1, 0.0, X[:9])}), (1,))
    features = features_of(frame, context)
    assert features.route_mask.sum() == 16, "30 m, every 2 m"


def test_without_a_route_its_line_is_empty() -> None:
    frame, context = scene(Road({1: lane(1, 0.0)}), ())
    assert route_line(context.road, ()) is None
    features = features_of(frame, context)
    assert not features.route_mask.any() and not features.route.any()
    assert (features.lanes_route == -1).all()


@pytest.mark.parametrize("wrong", [{"agents": 0}, {"lane_points": 1}, {"radius_m": -1.0}])
def test_sizes_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        FeatureSizes(**wrong)  # type: ignore[arg-type]
