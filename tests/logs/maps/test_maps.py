"""Maps in the place of a log's road: Lanelet2 read as Lanelet2 reads it, projections, and which map
fits a drive.
"""

from dataclasses import replace
from math import cos, hypot, nan, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from lanelet2_cases import MapWriter, crossroads, driven_along

from replan.core.errors import LogError
from replan.logs.maps import MapFile, lanelet2, read_map
from replan.logs.maps.lanelet2_file import placed_points, read_osm
from replan.logs.maps.lanelet2_lanes import Bound, crossable, oriented, paired, speed_in, strips_of
from replan.logs.maps.projections import Projection, parse_projection, utm
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.road import IN_JUNCTION, Road
from replan.logs.scenario import Scenario
from replan.run.log_source import LogSource

MAP, NAMES = crossroads()
CALLED = {number: name for name, number in NAMES.items()}
ORACLE = {
    "Town02": ("utm 0, 0", 72, 62, 2922.165, (7007.939, -16040.732, 7007.945, -16040.731)),
    "erm_parking": (
        "58.385345, 26.726272",
        42,
        40,
        3696.192,
        (64804.272, 55736.661, 64816.223, 55707.535),
    ),
    "ZalaZone_Uni_track_early": (
        "46.88, 16.84",
        44,
        48,
        1098.156,
        (-1657.352, 4926.134, -1668.736, 4931.766),
    ),
}
"""Of lanelet2 1.2.3: origin, lanelets, follow relations, length of all, sums of the first points'
coordinates.
"""


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return MAP.write(tmp_path_factory.mktemp("map") / "crossroads.osm")


@pytest.fixture(scope="module")
def read(crossing: Path) -> MapFile:
    return read_map(crossing)


def straight(
    first: tuple[float, float] = (5.0, -2.0), last: tuple[float, float] = (140.0, -2.0)
) -> Scenario:
    return driven_along(np.linspace(first, last, 30))


def logged(scenario: Scenario, tmp_path: Path) -> Path:
    path = tmp_path / "drive.mcap"
    write_scenario(path, scenario)
    return path


# Lanelet2: what the oracle says of the same file --------------------------------------------------


def test_lanes_follow_and_lie_beside_each_other_as_in_lanelet2(read: MapFile) -> None:
    lanes = {CALLED[i]: lane for i, lane in read.road.lanes.items()}
    after = {
        name: [CALLED[i] for i in lane.successors]
        for name, lane in lanes.items()
        if lane.successors
    }
    assert after == {
        "west 1": ["inner 1"],
        "west 2": ["inner 2"],
        "inner 1": ["east 1"],
        "inner 2": ["east 2"],
        "side": ["turn"],
        "turn": ["east 2"],
    }
    beside = {
        name: lane.right_neighbour
        for name, lane in lanes.items()
        if lane.right_neighbour is not None
    }
    assert {name: CALLED[i] for name, i in beside.items()} == {
        "west 1": "west 2",
        "inner 1": "inner 2",
        "east 1": "east 2",
    }
    assert all(lanes[CALLED[i]].left_neighbour == lanes[name].id for name, i in beside.items())
    assert {name for name, lane in lanes.items() if lane.left_opposite} == {"east 1", "back"}
    assert (
        not any(lane.right_opposite for lane in lanes.values())
        and read.road.drives_on_right
        and read.side_known
    )
    assert {name for name, lane in lanes.items() if not lane.drivable} == {"walk", "bikes"}
    assert lanes["back"].left[0].tolist() == [150.0, 4.0] and lanes["side"].left[0].tolist() == [
        64.0,
        -60.0,
    ]


def test_limits_have_their_units_and_signs_win(read: MapFile) -> None:
    limits = {
        CALLED[i]: lane.speed_limit
        for i, lane in read.road.lanes.items()
        if np.isfinite(lane.speed_limit)
    }
    given_limits = {"west 1": 50 / 3.6, "west 2": 13.4112, "inner 1": 10.0, "east 1": 30 / 3.6}
    assert limits == pytest.approx(given_limits)
    assert any("1 speed limits that are no number" in note for note in read.notes)


@pytest.mark.parametrize(
    ("text", "speed"),
    [
        ("36", 10.0),
        ("36 km/h", 10.0),
        ("36kmh", 10.0),
        ("10 mph", 4.4704),
        ("8.5 m/s", 8.5),
        ("de274-36", 10.0),
        ("de274.1-36", 10.0),
        ("", nan),
        ("0", nan),
        ("-5", nan),
        ("walk", nan),
        ("1e9", nan),
        ("99999", nan),
    ],
)
def test_speed_texts(text: str, speed: float) -> None:
    assert speed_in(text) == pytest.approx(speed, nan_ok=True)


@pytest.mark.parametrize(
    ("tags", "left", "right"),
    [
        ({"type": "line_thin", "subtype": "dashed"}, True, True),
        ({}, True, True),
        ({"type": "virtual"}, True, True),
        ({"type": "line_thin", "subtype": "solid"}, False, False),
        ({"type": "line_thick", "subtype": "solid_dashed"}, True, False),
        ({"type": "curbstone"}, False, False),
        ({"type": "line_thin", "subtype": "dashed_solid"}, False, True),
        ({"type": "line_thin", "subtype": "solid", "lane_change": "yes"}, True, True),
        ({"type": "virtual", "lane_change:vehicle": "no"}, False, False),
        ({"type": "guard_rail"}, False, False),
    ],
)
def test_who_may_cross_which_marking(tags: dict[str, str], left: bool, right: bool) -> None:
    bound = Bound((0, 1), tags, against=False)
    assert crossable(bound, near=-1) is left and crossable(bound, near=0) is right
    # Seen from the other direction the sides change places
    if len(tags) < 3 and "solid" in tags.get("subtype", ""):
        assert (
            crossable(bound.turned(), near=-1) is right
            and crossable(bound.turned(), near=0) is left
        )


def test_stop_lines_right_of_way_crosswalks_and_what_is_not_read(read: MapFile) -> None:
    light = NAMES["light"]
    lines = {CALLED[line.lane]: line for line in read.road.stop_lines}
    assert {name: line.light for name, line in lines.items()} == {
        "west 1": light,
        "west 2": light,
        "side": None,
    }
    # The part across that lane
    assert sorted(lines["west 1"].points.tolist()) == [[59.0, 0.0], [59.0, 4.0]]
    assert not lines["side"].must_stop and NAMES["light way"] in read.aliases[light]
    waits = {
        CALLED[i]: [CALLED[j] for j in lane.yields_to]
        for i, lane in read.road.lanes.items()
        if lane.yields_to
    }
    # It meets the lane behind the one that has right of way, and no other
    assert waits == {"turn": ["inner 2"]}
    assert [walk.id for walk in read.road.crosswalks] == [NAMES["walk"]]
    text = " ".join(read.notes)
    assert "1 detection_area" in text and "1 multipolygon" in text
    assert {
        CALLED[i] for i, lane in read.road.lanes.items() if IN_JUNCTION in lane.kind.split("+")
    } == {"turn"}
    grounds = {
        tuple(area.mean(axis=0)): np.ptp(area, axis=0).tolist() for area in read.road.open_ground
    }
    assert grounds == {(66.0, -2.0): [12.0, 12.0], (85.0, 15.0): [10.0, 10.0]}
    parks, crossings = read.road.car_parks, read.road.intersections
    assert [tuple(area.mean(axis=0)) for area in (*parks, *crossings)] == [
        (85.0, 15.0),
        (66.0, -2.0),
    ]


@pytest.mark.parametrize("broken", ["hole", "gap", "open"])
def test_an_area_that_is_no_plain_ring_is_not_read(tmp_path: Path, broken: str) -> None:
    m, _ = crossroads()
    there = len(read_map(m.write(tmp_path / "map.osm")).road.open_ground)
    side, far = (
        m.way([(0.0, 30.0), (9.0, 30.0), (9.0, 39.0)]),
        m.way([(9.5, 39.0), (0.0, 39.0), (0.0, 30.0)]),
    )
    whole = m.way([(9.0, 39.0), (0.0, 39.0), (0.0, 30.0)])
    sides = {"hole": (side, whole), "gap": (side, far), "open": (side,)}[broken]
    members = [("way", "outer", each) for each in sides] + [("way", "inner", side)] * (
        broken == "hole"
    )
    m.relation(members, type="multipolygon", subtype="parking")
    found = read_map(m.write(tmp_path / "map.osm"))
    assert len(found.road.open_ground) == there and any(
        "2 multipolygon" in note for note in found.notes
    )


def test_a_line_at_a_lanes_begin_lies_across_the_lane_before(tmp_path: Path) -> None:
    """As Autoware's maps have it: the lanelet in the junction names the light."""
    m = MapWriter()
    stop = m.way([(60.0, 2.0), (60.0, -2.0)], type="stop_line")
    light = m.rule("traffic_light", [("way", "ref_line", stop)])
    left, right = (
        (m.way([(0.0, y), (60.0, y)]), m.way([(60.0, y), (80.0, y)])) for y in (2.0, -2.0)
    )
    bend = m.way([(60.0, 2.0), (70.0, 12.0)]), m.way([(60.0, -2.0), (74.0, 10.0)])
    before, ahead, turn = (
        m.lanelet(left[0], right[0]),
        m.lanelet(left[1], right[1], [light]),
        m.lanelet(*bend),
    )
    road = read_map(m.write(tmp_path / "a.osm")).road
    assert set(road.lanes[before].successors) == {ahead, turn}
    assert [(line.lane, line.light, line.towards) for line in road.stop_lines] == [
        (before, light, (ahead,))
    ]


def test_a_rule_that_no_lanelet_names_is_placed_by_its_line(tmp_path: Path) -> None:
    m = MapWriter()
    stop = m.way([(60.0, 2.0), (60.0, -2.0)], type="stop_line")
    m.rule("traffic_light", [("way", "ref_line", stop)])
    there = m.lanelet(m.way([(0.0, 2.0), (60.0, 2.0)]), m.way([(0.0, -2.0), (60.0, -2.0)]))
    m.lanelet(m.way([(60.0, 2.0), (160.0, 2.0)]), m.way([(60.0, -2.0), (160.0, -2.0)]))
    found = read_map(m.write(tmp_path / "a.osm"))
    assert [line.lane for line in found.road.stop_lines] == [there]
    assert any("named by no lanelet" in note for note in found.notes)


def test_both_directions_participants_and_negative_ids(tmp_path: Path) -> None:
    m = MapWriter()
    left, right = m.way([(0.0, 2.0), (60.0, 2.0)]), m.way([(0.0, -2.0), (60.0, -2.0)])
    m.lanelet(left, right, one_way="no")
    m.lanelet(left, right, participant__bus="yes")
    m.lanelet(left, right, subtype="bicycle_lane", participant__vehicle="yes")
    text = m.text().replace('id="', 'id="-').replace('ref="', 'ref="-')
    path = tmp_path / "a.osm"
    path.write_text(text, encoding="utf-8")
    lanes = list(read_map(path).road.lanes.values())
    assert [lane.drivable for lane in lanes] == [True, False, True, True] and all(
        lane.id > 0 for lane in lanes
    )
    assert lanes[3].left.tolist() == lanes[0].right[::-1].tolist() and lanes[3].successors == ()


@pytest.mark.parametrize("name", ORACLE)
def test_real_maps_against_lanelet2(name: str, shared_data: Path) -> None:
    origin, count, follows, length, first = ORACLE[name]
    path = shared_data / "tartu" / "lanelet2" / f"{name}.osm"
    road = read_map(path, LogSettings(map_origin=origin)).road
    osm = read_osm(path)
    nodes, _, xy = placed_points(osm, path, {"map_origin": origin})
    strips = strips_of(osm, {node.id: k for k, node in enumerate(nodes)}, xy, [])
    begins = {(s.left.points[0], s.right.points[0], s.id) for s in strips}
    shared = {
        (a.id, i)
        for a in strips
        for l, r, i in begins
        if (l, r) == (a.left.points[-1], a.right.points[-1])
    }
    assert len(road.lanes) == count and len(shared) == follows
    found = {(lane.id, after) for lane in road.lanes.values() for after in lane.successors}
    assert shared <= found
    for lane, after in found - shared:  # points of their own at the same place
        assert np.hypot(*(road.lanes[lane].left[-1] - road.lanes[after].left[0])) < 0.05
    assert sum(lane.length for lane in road.lanes.values()) == pytest.approx(length, rel=0.01)
    sums = np.sum([np.r_[lane.left[0], lane.right[0]] for lane in road.lanes.values()], axis=0)
    assert sums == pytest.approx(first, abs=2e-3)


# geometry -----------------------------------------------------------------------------------------


@given(
    st.floats(6.0, 60.0),
    st.floats(0.2, 5.0),
    st.floats(1.0, 5.0),
    st.integers(3, 60),
    st.integers(3, 60),
)
@settings(max_examples=50)
def test_paired_points_lie_across_a_bend(
    radius: float, angle: float, width: float, n: int, m: int
) -> None:
    """On concentric arcs of any sampling every pair is as far apart as the lane is wide, and the
    middle is an arc.
    """
    assume(radius > 2.0 * width)
    turns = [np.linspace(0.0, angle, count) for count in (n + 40, m + 40)]
    left, right = (
        r * np.column_stack([np.cos(at), np.sin(at)])
        for r, at in zip((radius, radius + width), turns, strict=True)
    )
    l, r = paired(left, right)
    piece = max(angle * (radius + width) / 40.0, 0.5)
    apart = np.hypot(*(l - r).T)
    assert apart.min() > 0.98 * width - 0.02 and (apart < hypot(width, piece)).all()
    assert np.abs(np.hypot(*(0.5 * (l + r)).T) - radius - 0.5 * width).max() < 0.05 + 0.1 * piece
    assert (l[0] == left[0]).all() and (r[-1] == right[-1]).all()


@given(st.booleans(), st.booleans(), st.booleans(), st.floats(-pi, pi))
def test_a_lane_keeps_left_on_the_left_however_its_ways_run(
    one: bool, other: bool, swapped: bool, yaw: float
) -> None:
    """The side that is called left decides the direction; the directions of the ways do not."""
    turn = np.array([[cos(yaw), sin(yaw)], [-sin(yaw), cos(yaw)]])
    left, right = (np.array([[0.0, y], [20.0, y], [50.0, y + 10.0]]) @ turn for y in (2.0, -2.0))
    xy = np.vstack([left, right])
    a, b = (2, 1, 0) if one else (0, 1, 2), (5, 4, 3) if other else (3, 4, 5)
    named = (b, a) if swapped else (a, b)
    l, r = lanelet2_bounds(named, xy)
    along = (2, 1, 0) if swapped else (0, 1, 2)
    assert (l, r) == (
        (tuple(i + 3 for i in along), along) if swapped else (along, tuple(i + 3 for i in along))
    )


def lanelet2_bounds(
    named: tuple[tuple[int, ...], ...], xy: np.ndarray
) -> tuple[tuple[int, ...], ...]:
    return tuple(
        bound.points
        for bound in oriented(*(Bound(points, {}, against=False) for points in named), xy)
    )


# projections --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("origin", "place", "expected"),
    [
        ("utm 58.388, 26.73", (58.398, 26.75), (1173.5014517461532, 1108.8761731944978)),
        ("enu 58.388, 26.73", (58.398, 26.75), (1169.506159801931, 1114.0193636657507)),
        ("utm -33.87, 151.18", (-33.86, 151.2), (1830.6977878707694, 1141.5484161358327)),
        ("enu -33.87, 151.18", (-33.86, 151.2), (1850.721368255192, 1109.0194759926926)),
        ("60.38, 5.3", (60.39, 5.32), (1163.7737679430284, 1050.807638858445)),
        ("-0.009, -0.018", (0.001, 0.002), (2228.561681780382, 1106.811301857233)),
    ],
)
def test_projections_agree_with_lanelet2(
    origin: str, place: tuple[float, float], expected: tuple[float, float]
) -> None:
    """Expected: lanelet2's UtmProjector and LocalCartesianProjector (GeographicLib)."""
    assert parse_projection(origin)(np.array([place]))[0] == pytest.approx(expected, abs=1e-7)


def test_mgrs_squares() -> None:
    """38SMB 4484 is the middle of Baghdad, 18SUJ 23394 07395 the White House (published
    examples).
    """
    white_house = np.array([[38.8977, -77.0365]])
    assert parse_projection("18SUJ")(white_house)[0] == pytest.approx([23394, 7395], abs=20.0)
    assert parse_projection("mgrs")(white_house)[0] == pytest.approx(
        parse_projection("18SUJ")(white_house)[0]
    )
    two = np.array([[38.8977, -77.0365], [39.8977, -77.0365]])
    assert parse_projection("18SUJ")(two)[1, 1] > 1e5  # beyond the square the coordinates go on


@given(st.floats(-80.0, 80.0), st.floats(-2.9, 2.9), st.integers(1, 60))
def test_utm_is_conformal_and_of_its_scale(lat: float, off: float, zone: int) -> None:
    """A metre north and a metre east are as long as each other, at right angles, 0.9996 to 1.0015
    long.
    """
    lon, d = 6.0 * zone - 183.0 + off, 1e-4
    here, north, east = utm(
        np.array([[lat, lon], [lat + d, lon], [lat, lon + d]]), zone, north=True
    )
    e2, sine = 0.00669437999014, sin(radians(lat))
    meridian = 6_378_137.0 * (1.0 - e2) / (1.0 - e2 * sine**2) ** 1.5 * radians(d)
    parallel = 6_378_137.0 / (1.0 - e2 * sine**2) ** 0.5 * cos(radians(lat)) * radians(d)
    up, right = (north - here) / meridian, (east - here) / parallel
    assert hypot(*up) == pytest.approx(hypot(*right), abs=1e-4) and abs(up @ right) < 1e-4
    assert 0.9995 < hypot(*up) < 1.0016


def test_where_points_are(crossing: Path, tmp_path: Path) -> None:
    """Local coordinates, else what lies beside the map says, else CARLA's null island.

    The settings win.
    """
    plain = read_map(crossing)
    assert plain.frame == "local_x and local_y"
    text = crossing.read_text(encoding="utf-8").replace("local_x", "local_e")
    path = tmp_path / "globe.osm"
    path.write_text(text, encoding="utf-8")
    assumed = read_map(path)
    assert assumed.frame.startswith("tmerc 0, 0 (assumed")
    lane = NAMES["east 1"]
    assert np.abs(assumed.road.lanes[lane].left - plain.road.lanes[lane].left).max() < 1e-3
    (tmp_path / "map_projector_info.yaml").write_text(
        "projector_type: LocalCartesianUTM\nmap_origin:\n  latitude: 0.0 # here\n  longitude: "
        "0.0\n",
        encoding="utf-8",
    )
    said = read_map(path)
    assert "map_projector_info.yaml" in said.frame
    assert read_map(path, LogSettings(map_origin="mgrs")).frame.startswith(
        "mgrs (as [log] map_origin"
    )
    ratio = said.road.lanes[lane].length / plain.road.lanes[lane].length
    assert ratio == pytest.approx(1.00098, abs=1e-5)  # 3 degrees from the meridian of its zone
    (tmp_path / "map_projector_info.yaml").write_text("projector_type: Bonne\n", encoding="utf-8")
    with pytest.raises(LogError, match=r"map_projector_info\.yaml: projector_type is 'Bonne'"):
        read_map(path)
    assert Projection("mgrs", square="54SUE")  # as Autoware's sample map


# a map under a drive ------------------------------------------------------------------------------


def test_the_map_takes_the_place_of_the_road(crossing: Path, tmp_path: Path) -> None:
    moved = replace(straight(), origin=(0.0, 0.0), ego=straight().ego)
    log = logged(straight(), tmp_path)
    bare, mapped = read_log(log), read_log(log, LogSettings(map=str(crossing)))
    assert len(bare.road.lanes) == 1 and len(mapped.road.lanes) == 11
    lane = mapped.road.lanes[NAMES["west 2"]]
    assert lane.left[0].tolist() == [0.0 - mapped.origin[0], 0.0 - mapped.origin[1]]
    assert [lane.id for lane in mapped.road.lanes_at(mapped.ego.x[0], mapped.ego.y[0])] == [
        NAMES["west 2"]
    ]
    text = " ".join(mapped.notes)
    assert (
        "no lanes" not in text and "crossroads.osm (11 lanes" in text and "no speed limit" in text
    )
    assert (
        mapped.road.default_speed_limit == Road.default_speed_limit
        and mapped.metadata["map"] == "crossroads.osm"
    )
    assert (
        mapped.ego.x.tolist() == bare.ego.x.tolist()
        and mapped.origin == bare.origin != moved.origin
    )
    write_scenario(tmp_path / "again.mcap", mapped)
    again = read_scenario(tmp_path / "again.mcap")
    assert {i: lane.left.tolist() for i, lane in again.road.lanes.items()} == {
        i: lane.left.tolist() for i, lane in mapped.road.lanes.items()
    }
    assert again.road.stop_lines[0].light == NAMES["light"]


def test_a_map_of_elsewhere_is_refused_with_the_distance(crossing: Path, tmp_path: Path) -> None:
    log = logged(straight((5.0, 500.0), (140.0, 500.0)), tmp_path)
    words = (
        r"map .*crossroads\.osm does not fit the drive: 0 % .* at least 50 % must; the nearest "
        r"lane is 49\d m away"
    )
    with pytest.raises(LogError, match=words) as error:
        read_log(log, LogSettings(map=str(crossing)))
    assert error.value.file == log and "map_origin" in str(error.value)


def test_a_drive_against_the_lanes_is_refused(crossing: Path, tmp_path: Path) -> None:
    log = logged(straight((140.0, -2.0), (5.0, -2.0)), tmp_path)
    with pytest.raises(
        LogError, match=r"0 % goes along them, at least 50 % must: most of it is against"
    ):
        read_log(log, LogSettings(map=str(crossing)))


def test_what_is_no_map_is_refused(tmp_path: Path) -> None:
    log = logged(straight(), tmp_path)
    for name, text, word in (
        ("gone.osm", None, "no such map"),
        ("map.txt", "x", "not a map that replan reads"),
        ("a.osm", "<osm><node", "no complete XML"),
        ("b.osm", "<gpx/>", "root element is <gpx>"),
        ("c.osm", "<osm/>", "less than four points"),
        ("d.osm", MAP.text().replace("road", "walkway"), "no lanelet on which a car may drive"),
        ("e.osm", MAP.text().replace('v="60.0"', 'v="sixty"'), "'sixty' is no coordinate"),
        (
            "f.osm",
            '<!DOCTYPE osm [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><osm>&b;</osm>',
            "document type declaration",
        ),
    ):
        if text is not None:
            (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(LogError, match=word) as error:
            read_log(log, LogSettings(map=str(tmp_path / name)))
        assert error.value.file == tmp_path / name


def test_the_map_is_part_of_what_a_log_is(crossing: Path, tmp_path: Path) -> None:
    log = logged(straight(), tmp_path)
    copy = tmp_path / "copy.osm"
    copy.write_text(MAP.text(), encoding="utf-8")
    plain, there, here = (
        LogSource("a", log, LogSettings(map=name)) for name in ("", str(crossing), str(copy))
    )
    assert (
        plain.identity() != there.identity() == here.identity()
        and str(crossing) not in there.identity()
    )
    copy.write_text(MAP.text().replace("50 km/h", "60 km/h"), encoding="utf-8")
    assert there.identity() != here.identity()
    (tmp_path / "map_projector_info.yaml").write_text("projector_type: Local\n", encoding="utf-8")
    assert len(here.identity()) > len(there.identity())


@given(data=st.data())
@settings(max_examples=300)
def test_any_bytes_are_a_map_or_an_error(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    raw = bytearray(MAP.text().encode())
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(raw) - 1))
        cut = data.draw(st.sampled_from([0, 1, 1, 1, 4, 40]))
        raw[at : at + cut] = data.draw(
            st.sampled_from([b"", b"9", b"-", b"e99", b'"', b"<", b"nan", b"1e8", b"road", b"&"])
        )
    path = tmp_path_factory.getbasetemp() / "fuzz.osm"
    path.write_bytes(raw)
    try:
        found = lanelet2.read_lanelet2(path, {})
    except LogError as error:
        assert error.file == path
    else:
        assert found.road.lanes


def test_a_123d_map_is_one_of_the_maps(shared_data: Path, tmp_path: Path) -> None:
    town = read_map(
        shared_data / "py123d" / "carla_map" / "maps" / "opendrive" / "opendrive_Town02.arrow"
    )
    assert len(town.road.lanes) == 88 and len(town.road.stop_lines) == 39
    (tmp_path / "map.arrow").write_bytes(b"ARROW1 and nothing else")
    with pytest.raises(LogError, match=r"map\.arrow"):
        read_map(tmp_path / "map.arrow")
