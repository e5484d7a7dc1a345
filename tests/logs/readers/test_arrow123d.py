"""123D logs and maps: what the files say arrives, nothing of the future does, damage is an error
that names it.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from any_bytes import goes_round, read_or_refused, spoiled
from differences import differences
from hypothesis import HealthCheck, given, settings, strategies as st
from recorded_cases import (
    START_US,
    lane,
    packed,
    street,
    turn,
    wkb,
    write_123d,
    write_ipc,
    write_map,
)

from replan.core.arrow_tables import Lists, array_of, ipc_table, metadata_of, vectors
from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.maps.arrow123d_map import road_of_map
from replan.logs.maps.arrow123d_objects import LANE, read_objects
from replan.logs.maps.strips import crossable
from replan.logs.readers import read_log, reader_of
from replan.logs.readers.arrow123d import READER, read_ego, read_frames
from replan.logs.readers.arrow123d_boxes import BOXES
from replan.logs.readers.recorded import fitted, heading, kept, product, rotated, unit_of_wxyz
from replan.logs.road import RoadSource
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.run.sources import select

SAMPLES = ("av2_sync", "av2_async", "av2_v010", "madeup")
A, B = "3b3570b4-7b0b-3268-a571-b0889dbf40b6", "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
unit_floats = st.floats(-1.0, 1.0)


def real_log(shared: Path, sample: str, name: str) -> Path:
    return shared / "py123d" / sample / "logs" / "av2-sensor_val" / name


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_map(tmp_path / "maps" / "nuplan" / "nuplan_here.arrow", street())
    return write_123d(tmp_path / "logs" / "nuplan_val" / "street")


# Laws of poses


@given(
    st.lists(unit_floats, min_size=8, max_size=8),
    st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
)
def test_turning_twice_is_turning_by_the_product(numbers: list[float], place: list[float]) -> None:
    q, r = np.array([numbers[:4]]), np.array([numbers[4:]])
    if min(np.abs(q).max(), np.abs(r).max()) < 1e-2:
        return
    q, r = (unit_of_wxyz(each / np.sqrt((each * each).sum())) for each in (q, r))
    b = np.array([place])
    assert rotated(q, rotated(r, b)) == pytest.approx(rotated(product(q, r), b), abs=1e-9)
    ahead = rotated(q, np.array([[1.0, 0.0, 0.0]]))[0]
    assert np.hypot(*ahead[:2]) < 1e-6 or heading(q)[0] == pytest.approx(
        np.arctan2(ahead[1], ahead[0]), abs=1e-9
    )


@given(
    st.floats(-20.0, 20.0), st.floats(-5.0, 5.0), st.sampled_from([10, 50, 170]), st.integers(0, 99)
)
@settings(max_examples=30)
def test_a_parabola_is_fitted_exactly_and_without_later_samples(
    v: float, a: float, rate: int, seed: int
) -> None:
    t = np.cumsum(np.random.default_rng(seed).uniform(0.8, 1.2, 200) / rate)
    x = np.column_stack([3.0 + v * t + 0.5 * a * t**2])
    first, second = fitted(t, x)
    curved = np.isfinite(second[:, 0])
    assert curved[t > t[0] + 0.6].all()
    assert first[curved, 0] == pytest.approx(v + a * t[curved], abs=1e-6) and second[
        curved
    ] == pytest.approx(a, abs=1e-5)
    half = len(t) // 2
    early = fitted(t[:half], x[:half])
    assert np.array_equal(first[:half], early[0], equal_nan=True)
    assert np.array_equal(second[:half], early[1], equal_nan=True)


def test_states_are_kept_at_frames_and_between_rare_ones() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    assert t[kept(t, np.array([0.101, 0.2, 0.3]))] == pytest.approx([0.1, 0.2, 0.3])
    rare = t[kept(t, np.array([0.0, 0.5, 1.0]))]
    assert rare == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    assert len(kept(t, np.empty(0))) == 40


def test_of_a_double_line_the_near_one_counts() -> None:
    assert not crossable("DASH_SOLID_YELLOW", left=True) and crossable(
        "DASH_SOLID_YELLOW", left=False
    )
    assert crossable("DASHED_WHITE", left=True) and not crossable("DOUBLE_SOLID_WHITE", left=False)
    assert crossable("NONE", left=True) and crossable("", left=True)


# A made-up log


def test_a_log_arrives(log: Path) -> None:
    assert (
        READER.claims(log)
        and reader_of(log / "sync.arrow") is READER
        and READER.span(log) == (0.0, pytest.approx(2.9))
    )
    scenario = read_log(log)
    ego, tracks, road = scenario.ego, scenario.tracks, scenario.road
    assert (scenario.name, scenario.tags) == ("street", ("123d", "recorded", "nuplan"))
    assert (
        scenario.start_ns == 1000 * START_US
        and len(ego) == 30
        and scenario.duration == pytest.approx(2.9)
    )
    # The rear axle
    assert ego.x + scenario.origin[0] == pytest.approx(8.0 * ego.t) and ego.y == pytest.approx(0.0)
    assert ego.v == pytest.approx(8.0, abs=2e-3) and ego.a == pytest.approx(0.5)
    vehicle = scenario.vehicle
    assert (
        vehicle.length,
        vehicle.width,
        vehicle.wheelbase,
        vehicle.rear_overhang,
    ) == pytest.approx((5.0, 2.0, 3.0, 1.1))
    assert tracks.ids == ("car", "cone") and tracks.kinds == (AgentKind.CAR, AgentKind.OBJECT)
    assert tracks.length[0] == pytest.approx(4.6) and tracks.static.tolist() == [False, True]
    assert tracks.vx[tracks.samples(0)] == pytest.approx(5.0 + ego.t)
    assert (
        sorted(road.lanes) == [1, 2, 3, 9]
        and road.lanes[1].successors == (2,)
        and road.limit(1) == 10.0
    )
    assert (
        road.lanes[1].left_opposite
        and road.lanes[1].left_neighbour is None
        and road.drives_on_right
    )
    assert (
        not road.lanes[1].left_crossable
        and road.lanes[1].right_crossable
        and len(road.crosswalks) == 1
    )
    (line,) = road.stop_lines
    assert (line.lane, line.light, line.towards) == (1, 2, (2,)) and line.points[
        :, 0
    ] + scenario.origin[0] == pytest.approx(58.0, abs=0.5)
    (light,) = scenario.lights
    assert (
        light.id == 2
        and light.at(1.4) is Colour.RED
        and light.at(1.5) is Colour.GREEN
        and len(light.t) == 2
    )
    assert any(
        "1 of 2 traffic lights are for lanes that are not in the map" in note
        for note in scenario.notes
    )


def test_only_what_is_read_counts_as_the_log(log: Path) -> None:
    names = [path.stem for path in READER.files(log)]
    assert names == [
        "sync",
        "ego_state_se3",
        "box_detections_se3",
        "traffic_light_detections",
        "nuplan_here",
    ]
    (source,) = select([log]).sources
    first = source.identity()
    (log / "camera.pcam_f0.arrow").write_bytes(b"something else")
    assert source.identity() == first
    topics = {topic.topic: topic.messages for topic in READER.contents(log).topics}
    assert topics == {"ego_state_se3": 30, "box_detections_se3": 30}


def test_nothing_later_than_a_state_is_in_it(tmp_path: Path) -> None:
    whole = read_log(write_123d(tmp_path / "whole", 30, velocities=False))
    part = read_log(write_123d(tmp_path / "part", 18, velocities=False))
    n = len(part.ego)
    assert any("second frame" in note for note in whole.notes) and whole.start_ns == 1000 * (
        START_US + 100_000
    )
    for name in ("t", "x", "y", "yaw", "v", "a", "kappa"):
        assert np.array_equal(getattr(part.ego, name), getattr(whole.ego, name)[:n])
    for t in np.arange(0.0, part.duration, 0.1):
        now, later = part.tracks.perceived(float(t)), whole.tracks.perceived(float(t))
        assert (now.x[0], now.vx[0]) == (later.x[0], later.vx[0])
    # Known at the start, from the first frame
    assert whole.tracks.perceived(0.0).vx[0] == pytest.approx(5.05)


def test_differences_to_later_frames_are_no_velocities(tmp_path: Path) -> None:
    folder = write_123d(tmp_path / "log", 30)
    rows = read_ego(folder)
    table = ipc_table(folder / "ego_state_se3.arrow")
    t = (rows.time_us - rows.time_us[0]) / 1e6
    x = 8.0 * t + 0.01 * np.sin(40.0 * t)  # poses that wander
    central = np.r_[(x[1] - x[0]) / 0.1, (x[2:] - x[:-2]) / 0.2, (x[-1] - x[-2]) / 0.1]
    poses = [[at, 0.0, 0.0, *turn(0.0)] for at in x]
    columns = {
        "ego_state_se3.timestamp_us": table["ego_state_se3.timestamp_us"],
        "ego_state_se3.imu_se3": pa.array(poses, pa.list_(pa.float64(), 7)),
        "ego_state_se3.dynamic_state_se3": pa.array(
            [[v, *[0.0] * 8] for v in central], pa.list_(pa.float64(), 9)
        ),
    }
    write_ipc(folder / "ego_state_se3.arrow", columns, metadata_of(table))
    scenario = read_log(folder)
    assert any("are derived" in note for note in scenario.notes)
    assert np.abs(scenario.ego.v - central[1:]).max() > 1e-3 and scenario.ego.v == pytest.approx(
        8.0, abs=0.5
    )


def test_old_logs_and_foreign_files_are_refused_in_one_line(tmp_path: Path) -> None:
    table = pa.table({"uuid": ["a"]}).replace_schema_metadata({b"log_metadata": b"{}"})
    with (
        pa.OSFile(str(tmp_path / "old.arrow"), "wb") as sink,
        pa.ipc.new_file(sink, table.schema) as writer,
    ):
        writer.write_table(table)
    with pytest.raises(
        LogError, match=r"old.arrow: a 123D log of py123d 0.0.8 or 0.0.9.*0.1.0 or newer"
    ):
        read_log(tmp_path / "old.arrow")
    write_map(tmp_path / "map.arrow", street())
    assert not READER.claims(tmp_path / "map.arrow") and not READER.claims(tmp_path / "nowhere")
    folder = write_123d(tmp_path / "log")
    (folder / "ego_state_se3.arrow").unlink()
    with pytest.raises(LogError, match="the log has no ego"):
        read_log(folder)


def test_a_place_that_is_a_path_is_not_followed(tmp_path: Path) -> None:
    write_map(tmp_path / "secret_here.arrow", street())
    folder = write_123d(tmp_path / "logs" / "s" / "log", dataset="../secret", location="here")
    assert read_log(folder).road.source is RoadSource.DRIVEN_PATH


def test_a_log_without_map_drives_along_its_path_and_says_so(tmp_path: Path) -> None:
    scenario = read_log(write_123d(tmp_path / "log"))
    assert scenario.road.source is RoadSource.DRIVEN_PATH and not scenario.lights
    assert any("2 traffic lights are left out" in note for note in scenario.notes)


# Maps


def test_early_connectors_of_nuplan_are_put_right(tmp_path: Path) -> None:
    swapped = street(successor_ids=[1], predecessor_ids=[3])
    write_map(tmp_path / "map.arrow", swapped, version="0.4.0")
    notes: list[str] = []
    assert road_of_map(tmp_path / "map.arrow", notes=notes).lanes[2].successors == (3,)
    assert any("swapped" in note for note in notes)
    write_map(tmp_path / "map.arrow", swapped, version="0.5.0")
    assert road_of_map(tmp_path / "map.arrow").lanes[2].successors == (1,)


def test_the_route_of_nuplan_is_the_lanes_of_its_groups(tmp_path: Path) -> None:
    """Groups in the route's order.

    A group without lanes here, and a name that is no number, name none.
    """
    groups = {1: 71, 2: 72, 3: 73, 9: 73}
    objects = [(i, layer, {**f, "lane_group_id": groups.get(i)}, g) for i, layer, f, g in street()]
    write_map(tmp_path / "maps" / "nuplan" / "nuplan_here.arrow", objects)
    folder = write_123d(tmp_path / "logs" / "nuplan_val" / "street")
    assert read_log(folder).road.route == ()
    for named, expected in ((["73", "71", "5", "end"], (3, 9, 1)), ([], ()), (None, ())):
        said = [msgspec.msgpack.encode({"route_roadblock_ids": named, "lidar_token": "a"})] * 2
        columns = {
            "custom.scenario.timestamp_us": pa.array([0, 1], pa.int64()),
            "custom.scenario.data": pa.array(said),
        }
        write_ipc(folder / "custom.scenario.arrow", columns, {})
        road = read_log(folder).road
        assert road.route == expected
    write_ipc(
        folder / "custom.scenario.arrow",
        {**columns, "custom.scenario.data": pa.array([b"\xc1", b""])},
        {},
    )
    with pytest.raises(LogError, match=r"custom.scenario.arrow"):
        read_log(folder)


def test_singapore_drives_on_the_left_and_far_lanes_are_left_out(tmp_path: Path) -> None:
    objects = [*street(), (50, 0, lane((5000.0, 5050.0), 0.0), b"")]
    write_map(tmp_path / "map.arrow", objects, location="sg-one-north")
    near = np.array([[0.0, 0.0], [50.0, 0.0]])
    road = road_of_map(tmp_path / "map.arrow", (10.0, 5.0), near)
    assert not road.drives_on_right and 50 not in road.lanes
    assert road.lanes[1].center[0] == pytest.approx([-30.0, -5.0])
    assert 50 in road_of_map(tmp_path / "map.arrow").lanes


def test_stop_signs_and_zones_inside_a_crossing(tmp_path: Path) -> None:
    ring = [[60.0, -1.75], [60.4, -1.75], [60.4, 1.75], [60.0, 1.75], [60.0, -1.75]]
    zones = [
        (4, 7, {"outline": packed(ring), "stop_zone_type": 2, "lane_ids": [2]}, b""),
        (5, 7, {"outline": packed(np.add(ring, 500.0)), "stop_zone_type": 2, "lane_ids": [2]}, b""),
    ]
    write_map(tmp_path / "map.arrow", [each for each in street() if each[1] != 7] + zones)
    notes: list[str] = []
    (line,) = road_of_map(tmp_path / "map.arrow", notes=notes).stop_lines
    assert line.must_stop and line.light is None and (line.lane, line.towards) == (1, (2,))
    assert line.points[:, 0] == pytest.approx(60.0)
    assert any("1 of 2 stop zones lie on none" in note for note in notes)


def test_lanes_that_are_no_strips_are_left_out(tmp_path: Path) -> None:
    bad = lane((0.0, 10.0), 20.0) | {"left_boundary": packed([[0.0, np.nan], [1.0, 0.0]])}
    point = lane((0.0, 10.0), 20.0) | {"left_boundary": packed([[5.0, 5.0], [5.0, 5.0]])}
    write_map(tmp_path / "map.arrow", [*street(), (70, 0, bad, b""), (71, 0, point, b"")])
    notes: list[str] = []
    assert sorted(road_of_map(tmp_path / "map.arrow", notes=notes).lanes) == [1, 2, 3, 9]
    assert any("2 of 6 lanes are left out" in note for note in notes)
    write_map(
        tmp_path / "map.arrow", [(5, 9, {"road_line_type": 4}, wkb([[0.0, 0.0], [1.0, 0.0]]))]
    )
    with pytest.raises(LogError, match="the map has no lanes"):
        road_of_map(tmp_path / "map.arrow")


# Damage

MUTATIONS = 250
PARTS = ("sync", "ego_state_se3", BOXES, "traffic_light_detections", "map")
SECONDS = 2.0


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = write_123d(tmp_path_factory.mktemp("fuzz") / "log", 12, camera=False)
    write_map(folder / "map.arrow", street())
    return {name: (folder / f"{name}.arrow").read_bytes() for name in PARTS} | {
        "": str(folder).encode()
    }


@given(st.sampled_from(PARTS), st.data())
@settings(max_examples=MUTATIONS, deadline=None, suppress_health_check=list(HealthCheck))
def test_damage_is_an_error_that_names_the_log(
    damaged: dict[str, bytes], name: str, data: st.DataObject
) -> None:
    """250 mutated files: a scenario or a LogError, each within 2 s."""
    folder = Path(damaged[""].decode())
    path = folder / f"{name}.arrow"
    path.write_bytes(spoiled(damaged[name], data))
    try:
        read_or_refused(folder, SECONDS)
        READER.contents(folder), READER.span(folder), READER.files(folder)
    finally:
        path.write_bytes(damaged[name])


@pytest.fixture
def figures(shared_data: Path) -> dict[str, Any]:
    return json.loads((shared_data / "py123d" / "figures.json").read_text())


@pytest.mark.parametrize("sample", SAMPLES)
def test_samples_are_what_their_figures_say(
    shared_data: Path, figures: dict[str, Any], sample: str
) -> None:
    told = {name: facts for name, facts in figures.items() if name.startswith(f"{sample}/logs/")}
    assert told
    for name, facts in told.items():
        folder = shared_data / "py123d" / name
        times, about = read_frames(folder)
        assert (len(times), times[0], times[-1]) == (
            facts["frames"],
            facts["first_time_us"],
            facts["last_time_us"],
        )
        assert about["version"] == facts["version"]
        table = ipc_table(folder / "ego_state_se3.arrow")
        row = ipc_table(folder / "sync.arrow")["ego_state_se3"][0].as_py()
        assert len(table) == facts["ego_rows"]
        assert vectors(table["ego_state_se3.imu_se3"], 7)[row].tolist() == facts["first_imu_se3"]
        rows = read_ego(folder)
        assert dict(rows.about) == facts["vehicle"]
        at = int(np.searchsorted(rows.time_us, table["ego_state_se3.timestamp_us"][row].as_py()))
        for part, key in (
            ("rear_axle_to_imu_se3", "first_rear_axle"),
            ("center_to_imu_se3", "first_center"),
        ):
            assert rows.world(rows.part(part))[at] == pytest.approx(facts[key], abs=1e-6)
        assert heading(rows.q)[at] == pytest.approx(facts["first_yaw"], abs=1e-6)
        boxes = ipc_table(folder / f"{BOXES}.arrow")
        lists = Lists(boxes, f"{BOXES}.label")
        labels, counts = np.unique(lists.numbers(f"{BOXES}.label"), return_counts=True)
        assert {str(k): n for k, n in zip(labels, counts, strict=True)} == facts["labels"]
        assert (len(lists.row), int((lists.row == 0).sum())) == (
            facts["boxes_total"],
            facts["boxes_first_frame"],
        )
        assert (
            len(lists.words(f"{BOXES}.track_token")[1])
            == facts["tracks"]
            == len(read_log(folder).tracks)
        )


def test_maps_are_what_their_figures_say(shared_data: Path, figures: dict[str, Any]) -> None:
    root, count = shared_data / "py123d", 0
    for name, facts in figures.items():
        place = (
            root / "madeup/maps/madeup/madeup_crossing.arrow"
            if "madeup" in name
            else root / name / "map.arrow"
        )
        path = place if place.is_file() else root / name
        if "lanes" not in facts or not path.is_file():
            continue
        objects, road = read_objects(path), road_of_map(path)
        assert {str(layer): len(objects.of(layer)) for layer in sorted(objects.layers)} == facts[
            "layers"
        ]
        assert len(road.lanes) == facts["lanes"]
        assert set(road.lanes[facts["lane"]].successors) == set(facts["lane_successors"])
        lengths = [
            np.hypot(*np.diff(array_of(f["centerline"])[:, :2], axis=0).T).sum()
            for _, f, _ in objects.of(LANE)
        ]
        assert sum(lane.length for lane in road.lanes.values()) == pytest.approx(
            sum(lengths), rel=2e-3
        )
        assert (
            sum(np.isfinite(lane.speed_limit) for lane in road.lanes.values())
            == facts["speed_limits"]
        )
        count += 1
    assert count >= 5


def test_a_town_is_a_map(shared_data: Path) -> None:
    notes: list[str] = []
    road = road_of_map(
        shared_data / "py123d/carla_map/maps/opendrive/opendrive_Town02.arrow",
        (0.0, 0.0),
        None,
        notes,
    )
    assert len(road.lanes) == 88 and {lane.speed_limit for lane in road.lanes.values()} == {11.176}
    assert set(road.lanes[1].successors) == {83, 84} and road.drives_on_right
    lights = {line.light for line in road.stop_lines}
    assert len(road.stop_lines) >= 39 and None not in lights and lights <= set(road.lanes)
    for line in road.stop_lines:  # at the end of a lane before the one that its light is for
        assert line.towards == (line.light,) and line.light in road.lanes[line.lane].successors
        assert np.abs(line.points.mean(axis=0) - road.lanes[line.lane].center[-1]).max() < 2.0


@pytest.mark.parametrize(("sample", "name"), [("av2_sync", A), ("av2_sync", B)])
def test_argoverse_by_two_ways(shared_data: Path, sample: str, name: str) -> None:
    """Directly and through 123D: the same poses within 1e-6, the same lanes to the bit."""
    one = read_log(shared_data / "argoverse2" / name)
    two = read_log(real_log(shared_data, sample, name))
    assert one.origin == two.origin and abs(one.start_ns - two.start_ns) < 1000
    for column in ("t", "x", "y", "yaw"):
        assert getattr(one.ego, column) == pytest.approx(getattr(two.ego, column), abs=1e-6)
    assert np.abs(one.ego.v - two.ego.v).max() < 0.25  # from poses at 170 Hz and at 10 Hz
    places = {i: k for k, i in enumerate(two.tracks.ids)}
    assert set(one.tracks.ids) == set(places)
    for k, i in enumerate(one.tracks.ids):
        a, b = one.tracks.samples(k), two.tracks.samples(places[i])
        assert one.tracks.kinds[k] is two.tracks.kinds[places[i]]
        assert one.tracks.static[k] == two.tracks.static[places[i]]
        sizes = [
            (tracks.length[j], tracks.width[j])
            for tracks, j in ((one.tracks, k), (two.tracks, places[i]))
        ]
        assert sizes[0] == pytest.approx(sizes[1], abs=1e-6)
        for column in ("t", "x", "y", "yaw"):
            assert getattr(one.tracks, column)[a] == pytest.approx(
                getattr(two.tracks, column)[b], abs=1e-6
            )
    _same_lanes(one, two)


def _same_lanes(one: Scenario, two: Scenario) -> None:
    assert set(one.road.lanes) == set(two.road.lanes)
    for i, first in one.road.lanes.items():
        inside = tuple(s for s in first.successors if s in one.road.lanes)
        second = two.road.lanes[i]  # with groups and centre lines of 123D
        first = replace(first, successors=inside, group=second.group, line=second.line)
        assert not differences(first, second)
    walks = {walk.id: walk for walk in two.road.crosswalks}
    assert set(walks) == {walk.id for walk in one.road.crosswalks}
    for walk in one.road.crosswalks:
        corners = {tuple(corner) for corner in walks[walk.id].polygon.round(6).tolist()}
        assert {tuple(corner) for corner in walk.polygon.round(6).tolist()} == corners
    assert (
        one.road.drives_on_right == two.road.drives_on_right
        and one.vehicle.length == two.vehicle.length
    )


def test_an_asynchronous_log_is_read_as_the_poses_are(shared_data: Path) -> None:
    """Its ego rows are those of the feather file, rounded to microseconds: the same states come
    out.
    """
    one = read_log(shared_data / "argoverse2" / B)
    two = read_log(real_log(shared_data, "av2_async", B))
    assert len(one.ego) == len(two.ego) == 155
    for column, tolerance in (
        ("t", 2e-6),
        ("x", 1e-6),
        ("y", 1e-6),
        ("yaw", 1e-6),
        ("v", 0.02),
        ("a", 0.2),
    ):
        assert getattr(one.ego, column) == pytest.approx(getattr(two.ego, column), abs=tolerance)
    assert np.abs(two.ego.a).max() < 4.0  # stored: 397 m/s2


@pytest.mark.parametrize(("sample", "name"), [("av2_sync", A), ("av2_async", B), ("av2_v010", B)])
def test_real_logs_go_round(shared_data: Path, tmp_path: Path, sample: str, name: str) -> None:
    goes_round(read_log(real_log(shared_data, sample, name)), tmp_path)
