"""CommonRoad XML -> Scenario: laws on written snippets, examples of every shape, errors, and the
recorded files.
"""

from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
from commonroad_files import (
    RECTANGLE,
    driving,
    exact,
    lanelet,
    points,
    problem,
    state,
    straight,
    vehicle,
    written,
)
from hypothesis import HealthCheck, given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.readers import read_log
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.readers.commonroad.document import parse
from replan.logs.readers.commonroad.document_records import Obstacle
from replan.logs.readers.commonroad.lanelets import _crossable
from replan.logs.readers.commonroad.tracks import (
    _prediction_error,
    ego_log,
    sized,
    turned,
    velocities,
)
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    x=st.floats(-1e5, 1e5),
    y=st.floats(-1e5, 1e5),
    yaw=st.floats(-pi, pi),
    length=st.floats(3.0, 15.0),
    v=st.floats(1.0, 30.0),
)
def test_a_straight_drive_is_itself(
    tmp_path: Path, x: float, y: float, yaw: float, length: float, v: float
) -> None:
    """Box centre = origin + rear axle + axle_to_center along the heading, exactly.

    V constant, a = kappa = 0.
    """
    shape = f"<rectangle><length>{length!r}</length><width>2.0</width></rectangle>"
    rows = driving(x, y, v, yaw=yaw)
    scenario = read_commonroad(written(tmp_path, straight(1), vehicle(7, rows, shape)), ego="7")
    ego, car = scenario.ego, scenario.vehicle
    assert car.length == length
    centers = np.array([row[1:3] for row in rows])
    back = np.column_stack(
        [ego.x + car.axle_to_center * np.cos(ego.yaw), ego.y + car.axle_to_center * np.sin(ego.yaw)]
    )
    np.testing.assert_allclose(back + scenario.origin, centers, atol=1e-9)
    np.testing.assert_allclose(ego.v, v, rtol=1e-12)
    np.testing.assert_allclose(ego.a, 0.0, atol=1e-6)
    np.testing.assert_allclose(ego.kappa, 0.0, atol=1e-6)
    assert scenario.duration == pytest.approx(2.0)
    assert len(scenario.tracks) == 0


@settings(max_examples=20)
@given(radius=st.floats(20.0, 500.0), v=st.floats(3.0, 20.0), sign=st.sampled_from([1.0, -1.0]))
def test_a_circle_has_its_curvature(radius: float, v: float, sign: float) -> None:
    """A rear axle on a circle: the log's kappa is 1/R, and the box centres go back to the same axle
    positions.
    """
    t = 0.1 * np.arange(40)
    yaw = sign * v * t / radius
    rear = np.column_stack([radius * np.sin(np.abs(yaw)), sign * radius * (1.0 - np.cos(yaw))])
    obstacle = Obstacle(1, "car", False, 4.5, 1.8, np.empty(0))
    offset = sized(obstacle).axle_to_center
    center = rear + offset * np.column_stack([np.cos(yaw), np.sin(yaw)])
    states = np.column_stack([np.arange(40.0), center, yaw, np.full(40, v), np.zeros(40)])
    ego, _ = ego_log(replace(obstacle, states=states), 0.1, sized(obstacle), (0.0, 0.0))
    np.testing.assert_allclose(np.column_stack([ego.x, ego.y]), rear, atol=1e-9)
    np.testing.assert_allclose(ego.kappa, sign / radius, rtol=2e-3)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(askew=st.floats(-0.3, 0.3), cut=st.integers(3, 19))
def test_velocities_are_causal(tmp_path: Path, askew: float, cut: int) -> None:
    """Samples after `cut` do not change velocities up to it, whichever rule is taken."""
    rng = np.random.default_rng(cut)
    rows = [(k, k * 1.0 + 0.02 * rng.standard_normal(), 0.0, askew, 9.0) for k in range(20)]
    for stored in (9.0, 4.0):
        table = [(*row[:4], stored) for row in rows]
        bent = table[: cut + 1] + [
            (k, x + 0.1, y + 0.05, yaw, v) for k, x, y, yaw, v in table[cut + 1 :]
        ]
        first, second = (
            velocities(parse(written(tmp_path, straight(1), vehicle(3, each))))[0][3]
            for each in (table, bent)
        )
        assert (first[: cut + 1] == second[: cut + 1]).all()


@given(offset=st.floats(-0.2, 0.2))
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_common_heading_error_is_removed(tmp_path: Path, offset: float) -> None:
    """Vehicles that all drive askew by one angle are turned by it.

    Below half a degree nothing is touched.
    """
    cars = [
        vehicle(i, [(*row[:3], offset, row[4]) for row in driving(0.0, 3.0 * i, 8.0 + i)])
        for i in range(6)
    ]
    document, notes = turned(parse(written(tmp_path, straight(100), *cars)))
    turned_by = document.obstacles[0].states[0, 3] - offset
    if abs(offset) > np.radians(0.51):
        assert turned_by == pytest.approx(-offset, abs=1e-9)
        assert "headings are turned" in notes[0]
    elif abs(offset) < np.radians(0.49):
        assert turned_by == 0.0
        assert notes == ()


def test_the_better_velocity_is_taken(tmp_path: Path) -> None:
    """A wrong stored speed loses against differences, noisy positions lose against a right stored
    speed.
    """
    wrong = written(
        tmp_path, straight(1), vehicle(3, [(*row[:4], 17.0) for row in driving(0.0, 0.0, 8.0)])
    )
    found, notes = velocities(parse(wrong))
    np.testing.assert_allclose(found[3][1:], [[8.0, 0.0]] * 20, atol=1e-9)
    assert found[3][0].tolist() == [17.0, 0.0]  # the first sample has nothing but its stored speed
    assert "backward differences" in notes[0]
    noisy = [(k, 0.8 * k + 0.1 * (-1) ** k, 0.0, 0.0, 8.0) for k in range(21)]
    document = parse(written(tmp_path, straight(1), vehicle(3, noisy)))
    found, notes = velocities(document)
    np.testing.assert_allclose(found[3], [[8.0, 0.0]] * 21)
    assert "stored speeds" in notes[0]
    assert _prediction_error(document.obstacles, [found[3]], 0.1) < 0.21


def test_road_neighbours_types_limits_and_markings(tmp_path: Path) -> None:
    sign = (
        '<trafficSign id="9"><trafficSignElement><trafficSignID>274</trafficSignID>'
        "<additionalValue>50.0</additionalValue></trafficSignElement></trafficSign>"
    )
    file = written(
        tmp_path,
        straight(
            1,
            inner=(
                '<successor ref="4"/><adjacentLeft ref="2" drivingDir="same"/><adjacentRight '
                'ref="5" '
                'drivingDir="opposite"/><laneletType>urban</laneletType><trafficSignRef ref="9"/>'
            ),
            marks=("dashed", "solid"),
        ),
        straight(
            2,
            4.0,
            '<adjacentRight ref="1" drivingDir="same"/><adjacentLeft ref="6" '
            'drivingDir="opposite"/>',
        ),
        straight(4, 20.0, "<laneletType>sidewalk</laneletType>"),
        straight(5, -4.0, "<userOneWay>bicycle</userOneWay>"),
        sign,
        problem(1, 0.0, 0.0, 10.0),
        benchmark="GBR_Test-1",
    )
    scenario = read_commonroad(file)
    lanes = scenario.road.lanes
    one, two = lanes[1], lanes[2]
    assert scenario.road.source is RoadSource.LANES
    assert not scenario.road.drives_on_right
    assert (one.left_neighbour, one.right_neighbour, one.left_opposite, one.right_opposite) == (
        2,
        None,
        False,
        True,
    )
    assert (two.left_neighbour, two.right_neighbour, two.left_opposite, two.right_opposite) == (
        None,
        1,
        True,
        False,
    )
    assert (one.left_crossable, one.right_crossable) == (True, False)
    assert one.successors == (4,)
    assert one.kind == "urban"
    assert [lanes[i].drivable for i in (1, 2, 4, 5)] == [True, True, False, False]
    assert one.speed_limit == 50.0
    assert scenario.road.limit(2) == pytest.approx(50.0 / 3.6)
    assert any("50 m/s on 1 lanes is kept" in note for note in scenario.notes)
    assert any(
        "speed limit missing on 1 of 2 lanes: urban default 13.89 m/s" in note
        for note in scenario.notes
    )


@pytest.mark.parametrize(
    ("marking", "from_left_lane", "from_right_lane"),
    [
        ("solid_dashed", False, True),
        ("dashed_solid", True, False),
        ("broad_solid", False, False),
        ("solid_solid", False, False),
        ("dashed_dashed", True, True),
        ("no_marking", True, True),
    ],
)
def test_double_markings(marking: str, from_left_lane: bool, from_right_lane: bool) -> None:
    """A lane's right marking is seen from its left: of a double line the near one counts."""
    assert _crossable(marking, near=0) is from_left_lane
    assert _crossable(marking, near=-1) is from_right_lane


def test_later_traffic_does_not_change_an_assumed_limit(tmp_path: Path) -> None:
    def limit(v: float, *, later: float = 0.0, extra: int = 0) -> float:
        """With five who are at first at `v`, then (not 0) at `later`, and others who come later."""
        begin = [driving(5.0 * i, 0.0, v) for i in range(5)]
        rows = [
            [each[0], *((*row[:4], later) for row in each[1:])] if later else each[:1]
            for each in begin
        ]
        rows += [[(k + 5, *row) for k, *row in driving(4.0 * i, 0.0, 40.0)] for i in range(extra)]
        cars = [vehicle(2 + i, each) for i, each in enumerate(rows)]
        lane = straight(1, inner="<laneletType>urban</laneletType>")
        return (
            read_commonroad(
                written(tmp_path, lane, *cars, problem(90, -20.0, 0.0, 10.0))
            ).road.limit(1)
            * 3.6
        )

    for v, expected in ((8.0, 50.0), (19.0, 70.0)):
        assert (
            limit(v)
            == limit(v, later=30.0)
            == limit(v, later=v, extra=9)
            == pytest.approx(expected)
        )


def test_default_limit_follows_the_kind_of_road_and_the_pace(tmp_path: Path) -> None:
    def limit(benchmark: str, tags: str, v: float) -> float:
        file = written(
            tmp_path,
            straight(1, inner="<laneletType>urban</laneletType>"),
            *(vehicle(i, driving(5.0 * i, 0.0, v)) for i in range(2, 8)),
            f"<scenarioTags>{tags}</scenarioTags>",
            problem(90, -20.0, 0.0, 10.0),
            benchmark=benchmark,
        )
        return read_commonroad(file).road.limit(1) * 3.6

    assert limit("DEU_A-1", "", 8.0) == pytest.approx(50.0)
    assert limit("DEU_A-1", "", 19.0) == pytest.approx(70.0)
    assert limit("DEU_A-1", "<highway/>", 19.0) == pytest.approx(130.0)
    assert limit("USA_A-1", "<interstate/>", 19.0) == pytest.approx(65.0 * 1.609344)


@pytest.mark.parametrize(
    ("least", "most", "on", "limit"),
    [
        (5.0, 30.0, 1, 50.0),
        (13.0, 30.0, 1, 50.0),
        (14.0, 20.0, 1, 70.0),
        (14.0, 1000.0, 1, 70.0),
        (14.0, 20.0, 2, 50.0),
    ],
)
def test_a_goal_on_a_lane_that_asks_for_more_disproves_its_assumed_limit(
    tmp_path: Path, least: float, most: float, on: int, limit: float
) -> None:
    """Lane 2 has a sign of its own: a goal there says nothing of lane 1."""
    wanted = f"<velocity><intervalStart>{least}</intervalStart><intervalEnd>{most}</intervalEnd></velocity>"  # noqa: E501
    place = f'<position><lanelet ref="{on}"/></position>'
    file = written(
        tmp_path,
        straight(1, inner="<laneletType>urban</laneletType>"),
        straight(2, y=20.0, inner='<laneletType>urban</laneletType><trafficSignRef ref="7"/>'),
        '<trafficSign id="7"><trafficSignElement><trafficSignID>274</trafficSignID>'
        "<additionalValue>33.0</additionalValue></trafficSignElement></trafficSign>",
        problem(90, -20.0, 0.0, 10.0, goal=place + wanted),
        benchmark="DEU_A-1",
    )
    assert read_commonroad(file).road.limit(1) * 3.6 == pytest.approx(limit)


def test_degenerate_lanelets_are_repaired_or_dropped(tmp_path: Path) -> None:
    good = points((0, 2), (0, 2), (10, 2), (20, 2)), points((0, -2), (0, -2), (10, -2), (20, -2))
    uneven = points((0, 6), (20, 6)), points((0, 2), (5, 2), (20, 2))
    nothing = points((0, 6), (0, 6)), points((0, 2), (0, 2))
    file = written(
        tmp_path,
        lanelet(1, *good),
        lanelet(2, *uneven),
        lanelet(3, *nothing),
        lanelet(4, points((0, 0)), points((0, 1))),
        problem(1, 1.0, 0.0, 5.0),
    )
    scenario = read_commonroad(file)
    assert sorted(scenario.road.lanes) == [1, 2]
    assert len(scenario.road.lanes[1].left) == 3
    assert scenario.road.lanes[2].left.shape == scenario.road.lanes[2].right.shape == (3, 2)
    assert [note for note in scenario.notes if "dropped" in note] == [
        "lanelet 3 is dropped: its boundaries are no strip",
        "lanelet 4 is dropped: its boundaries are no strip",
    ]


def test_shapes_become_boxes_at_their_centres(tmp_path: Path) -> None:
    shifted = (
        "<rectangle><length>4.0</length><width>2.0</width><orientation>0.5</orientation>"
        "<center><x>1.0</x><y>0.0</y></center></rectangle>"
    )
    shapes = {
        2: shifted,
        3: "<circle><radius>0.4</radius></circle>",
        4: f"<polygon>{points((-1, -1), (3, -1), (3, 2), (-1, 2), (-1, -1))}</polygon>",
        5: RECTANGLE + "<circle><radius>0.5</radius><center><x>3.0</x><y>0.0</y></center></circle>",
    }
    static = [
        f'<staticObstacle id="{i}"><type>parkedVehicle</type><shape>{shape}</shape>'
        f"{state(0, 10.0, 20.0, pi / 2, 0.0, tag='initialState')}</staticObstacle>"
        for i, shape in shapes.items()
    ]
    tracks = read_commonroad(
        written(tmp_path, straight(1), *static, problem(1, 0.0, 0.0, 5.0))
    ).tracks
    assert tracks.static.all()
    np.testing.assert_allclose(tracks.length, [4.0, 0.8, 4.0, 5.5])
    np.testing.assert_allclose(tracks.width, [2.0, 0.8, 3.0, 2.0], rtol=0.01)
    np.testing.assert_allclose(tracks.x, [10.0, 10.0, 9.5, 10.0], atol=1e-9)
    np.testing.assert_allclose(tracks.y, [21.0, 20.0, 21.0, 20.75], atol=1e-9)
    np.testing.assert_allclose(tracks.yaw, pi / 2 + np.array([0.5, 0.0, 0.0, 0.0]))


def test_version_2018b_with_intervals_and_speed_limits(tmp_path: Path) -> None:
    def middle(tag: str, low: float, high: float) -> str:
        return (
            f"<{tag}><intervalStart>{low}</intervalStart><intervalEnd>{high}</intervalEnd></{tag}>"
        )

    uncertain = (
        "<position><rectangle><length>2</length><width>1</width><orientation>0</orientation><center><x>30</x><y>1</y>"
        f"</center></rectangle></position>{middle('orientation', 0.1, 0.3)}{exact('time', 0)}{middle('velocity', 4, 6)}"  # noqa: E501
    )
    obstacle = (
        "<obstacle "
        'id="5"><role>dynamic</role><type>truck</type><shape><rectangle><length>8</length><width>2.5</width>'
        f"</rectangle></shape><initialState>{uncertain}</initialState><trajectory>{state(1, 30.5, 1.0, 0.2, 5.0)}"  # noqa: E501
        "</trajectory></obstacle>"
    )
    file = written(
        tmp_path,
        straight(1, inner="<speedLimit>13.4112</speedLimit>"),
        obstacle,
        problem(9, 0.0, 0.0, 10.0),
        version="2018b",
        benchmark="USA_Test-1",
        more='tags="urban highway"',
        source="Next Generation Simulation (NGSIM)",
    )
    scenario = read_commonroad(file)
    tracks = scenario.tracks
    assert scenario.road.limit(1) == 13.4112
    assert tracks.kinds == (AgentKind.TRUCK,)
    assert (tracks.x[0], tracks.y[0], tracks.yaw[0]) == (30.0, 1.0, pytest.approx(0.2))
    assert np.hypot(tracks.vx[0], tracks.vy[0]) == pytest.approx(5.0)
    assert scenario.tags == ("commonroad", "recorded", "ngsim", "urban", "highway")


def test_only_the_start_is_known(tmp_path: Path) -> None:
    speeds = "<velocity><intervalStart>1</intervalStart><intervalEnd>9</intervalEnd></velocity>"
    goal = f"<position><lanelet ref='1'/></position>{speeds}"
    file = written(
        tmp_path,
        straight(1),
        vehicle(3, driving(50.0, 0.0, 5.0)),
        problem(1, 100.4, 0.0, 10.0, goal),
    )
    scenario = read_commonroad(file)
    assert scenario.origin == (100.0, 0.0)
    assert len(scenario.ego) == 1
    assert scenario.ego.x[0] + scenario.vehicle.axle_to_center == pytest.approx(0.4)
    assert (
        "only the start of the ego is known (planning problem 1): no drive to compare with"
        in scenario.notes
    )
    assert scenario.goal is not None
    assert scenario.goal.t == pytest.approx((2.0, 3.0))
    assert scenario.goal.reached(2.5, 0.0, 0.0, 0.0, 5.0)
    assert not scenario.goal.reached(2.5, 0.0, 0.0, 0.0, 10.0)
    assert scenario.duration == pytest.approx(3.0)


def test_the_recorded_driver_leaves_the_traffic_and_time_begins_with_him(tmp_path: Path) -> None:
    human = [(k + 5, x, y, yaw, v) for k, x, y, yaw, v in driving(10.0, 0.0, 8.0)]
    file = written(
        tmp_path,
        straight(1),
        vehicle(4, human),
        vehicle(6, driving(60.0, 0.0, 5.0, 40)),
        vehicle(7, driving(90.0, 0.0, 5.0, 4)),
        problem(90004, 10.0, 0.0, 8.0, step=5),
    )
    scenario = read_commonroad(file)
    assert scenario.ego.t[[0, -1]].tolist() == pytest.approx([0.0, 2.0])
    assert scenario.tracks.ids == ("6",)
    assert scenario.tracks.t[0] == pytest.approx(0.0)
    assert scenario.tracks.x[0] + scenario.origin[0] == pytest.approx(62.5)
    assert scenario.goal is not None
    assert scenario.goal.t == pytest.approx((1.5, 2.5))
    assert scenario.start_ns == 500_000_000
    assert scenario.metadata["ego_obstacle"] == "4"


def test_goals_keep_their_own_bounds(tmp_path: Path) -> None:
    """A goal at rest near by and one at any speed far away: passing the near one at speed reaches
    neither.
    """
    shape = "<rectangle><length>20</length><width>4</width><center><x>{}</x><y>0</y></center></rectangle>"  # noqa: E501
    place = f"<position>{shape}</position>"
    rest = "<velocity><intervalStart>0.0</intervalStart><intervalEnd>0.0</intervalEnd></velocity>"
    both = problem(1, 0.0, 0.0, 10.0, place.format(100.0)).replace(
        "</goalState>", f"</goalState><goalState>{place.format(40.0)}{rest}</goalState>"
    )
    goal = read_commonroad(written(tmp_path, straight(1), both)).goal
    assert goal is not None and len(goal.alternatives) == 2
    assert not goal.reached(2.5, 40.0, 0.0, 0.0, 10.0)
    assert goal.reached(9.0, 40.0, 0.0, 0.0, 0.0)
    assert goal.reached(2.5, 100.0, 0.0, 0.0, 10.0) and not goal.reached(9.0, 100.0, 0.0, 0.0, 10.0)


def test_a_renumbered_problem_finds_its_driver_by_id_and_speed(tmp_path: Path) -> None:
    human = [(k + 30, *row[1:]) for k, row in enumerate(driving(10.0, 0.0, 8.0))]
    parts = (straight(1), vehicle(4, human))
    found = read_commonroad(written(tmp_path, *parts, problem(90004, 10.0, 0.0, 8.0)))
    assert len(found.ego) == 21
    assert any("its recorded driver 3.0 s later" in note for note in found.notes)
    other = read_commonroad(written(tmp_path, *parts, problem(90005, 10.0, 0.0, 8.0)))
    assert len(other.ego) == 1
    assert any("appears later where the ego starts" in note for note in other.notes)


def test_a_clipped_first_sample_is_dropped(tmp_path: Path) -> None:
    rows = driving(0.0, 0.0, 15.0)
    rows[0] = (0, 1.0, 0.0, 0.0, 15.0)
    scenario = read_commonroad(written(tmp_path, straight(1), vehicle(4, rows)), ego="4")
    assert len(scenario.ego) == 20
    np.testing.assert_allclose(scenario.ego.v, 15.0)
    assert any(
        "first sample is dropped: its position is off by 1.0 m" in note for note in scenario.notes
    )


def test_ego_by_id_drives_to_where_its_log_ends(tmp_path: Path) -> None:
    file = written(
        tmp_path, straight(1), *(vehicle(i, driving(20.0 * i, 0.0, 5.0)) for i in (1, 2))
    )
    scenario = read_commonroad(file, ego="2")
    assert scenario.tracks.ids == ("1",)
    last = scenario.ego.state(20)
    assert scenario.goal is not None
    assert scenario.goal.holds_place(last.x + scenario.vehicle.axle_to_center, last.y)
    assert not scenario.goal.holds_place(last.x - 9.0, last.y)
    assert scenario.name == "test_ego2"


@pytest.mark.parametrize(
    ("parts", "options", "words"),
    [
        (("<x",), {}, ["is no complete XML"]),
        ((straight(1),), {}, ["no planning problem", "name a vehicle"]),
        (
            (straight(1), problem(5, 0, 0, 1)),
            {"problem": 7},
            ["no planning problem 7", "the file has 5"],
        ),
        ((straight(1), problem(5, 0, 0, 1)), {"ego": "8"}, ["no vehicle 8", "none"]),
        ((straight(1), vehicle(2, [(0, 0.0, float("nan"), 0.0, 1.0)])), {}, ["obstacle 2", "nan"]),
        (
            (straight(1), vehicle(2, [(0, 0.0, 0.0, 0.0, 1.0)], "<ellipse/>")),
            {},
            ["obstacle 2/shape"],
        ),
        ((problem(5, 0, 0, 1),), {}, ["no lanelet"]),
        (
            (lanelet(1, points((0, 1)), "<point><x>0</x></point>"),),
            {},
            ["lanelet 1/rightBound", "<y> is missing"],
        ),
        (
            (straight(1), '<planningProblem id="5"/>'),
            {},
            ["planningProblem 5", "<initialState> is missing"],
        ),
    ],
)
def test_errors_name_elements(
    tmp_path: Path, parts: tuple[str, ...], options: dict[str, object], words: list[str]
) -> None:
    with pytest.raises(LogError) as caught:
        read_commonroad(written(tmp_path, *parts), **options)  # type: ignore[arg-type]
    line = str(caught.value)
    assert "\n" not in line
    for word in ["test.xml", ";", *words]:
        assert word in line


def test_other_files_are_refused(tmp_path: Path) -> None:
    for version in ("2017a", "2030x"):
        with pytest.raises(LogError, match=r"2018b, 2020a"):
            read_commonroad(written(tmp_path, straight(1), problem(1, 0, 0, 1), version=version))
    other = tmp_path / "other.xml"
    other.write_text("<OpenDRIVE/>")
    with pytest.raises(LogError, match="root element is <OpenDRIVE>"):
        read_commonroad(other)
    with pytest.raises(LogError, match="cannot be read"):
        read_commonroad(tmp_path / "missing.xml")
    other.write_text('<?xml version="1.0" encoding="UTF-17"?><commonRoad/>')
    with pytest.raises(LogError, match="is no complete XML: unknown encoding"):
        read_commonroad(other)


def _facts(scenario: Scenario) -> None:
    """What every converted scenario must be."""
    ego, car, road = scenario.ego, scenario.vehicle, scenario.road
    x, y = (
        ego.x[0] + car.axle_to_center * cos(ego.yaw[0]),
        ego.y[0] + car.axle_to_center * sin(ego.yaw[0]),
    )
    assert ego.t[0] == 0.0
    assert abs(x) < 1.0
    assert abs(y) < 1.0
    assert any(lane.drivable for lane in road.lanes_at(x, y))
    assert all(np.isfinite(road.limit(i)) for i in road.lanes)
    assert np.isfinite(scenario.tracks.vx).all()
    assert scenario.tracks.t.min(initial=0.0) >= 0.0
    assert scenario.goal is not None


def _recorded(folder: Path) -> list[Path]:
    files = sorted((folder / "commonroad").glob("*.xml"))
    if not files:
        pytest.skip("no CommonRoad files among the recorded data")
    return files


def _convert_all(files: list[Path]) -> None:
    """Each file converts into something drivable; each MONA file has its human."""
    for file in files:
        scenario = read_log(file)
        _facts(scenario)
        assert len(scenario.ego) > 1 or "MONA" not in file.name


def test_recorded_files_convert(shared_data: Path) -> None:
    _convert_all(_recorded(shared_data)[1::15])


@pytest.mark.slow
def test_every_recorded_file_converts(shared_data: Path) -> None:
    _convert_all(_recorded(shared_data))
