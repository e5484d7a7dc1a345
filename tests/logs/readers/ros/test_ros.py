"""Bags of ROS 2 and ROS 1: what rosbags wrote comes back as it was driven.

Whatever the bytes, a log or a LogError.
"""

import shutil
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
import ros_bags as bags
from any_bytes import goes_round, read_or_refused
from differences import differences
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from ros_bags import (
    RATE_HZ,
    SPEED,
    START_NS,
    Row,
    ego_pose,
    header,
    message,
    objects_at,
    pose,
    seconds,
    stamp,
)

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.edit.cut import cut
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, read_log, reader_of
from replan.logs.readers.ros import bag as door
from replan.logs.readers.ros.fields import MOST_FIELDS, decoder
from replan.logs.readers.ros.fits import rates
from replan.logs.readers.ros.objects import smallest_rectangles
from replan.logs.readers.ros.tracks import joined
from replan.logs.repair.detections import no_identities
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.states import OnboardPlan
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop

TRACKED = "autoware_perception_msgs/msg/TrackedObjects"
TOPIC = "/perception/object_recognition/tracking/objects"
GOAL = "geometry_msgs/msg/PoseStamped"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rows = bags.transforms() + bags.autoware_objects(TRACKED, TOPIC)
    return bags.write_ros2(tmp_path_factory.mktemp("ros") / "plain", rows)


def check_drive(scenario: Scenario, tolerance: float = 1e-3) -> None:
    """The ego is on the arc at its times, with the arc's speed and curvature."""
    t = scenario.ego.t + seconds(scenario.start_ns)
    truth = np.array([ego_pose(each) for each in t])
    assert scenario.ego.x + scenario.origin[0] == pytest.approx(truth[:, 0], abs=1e-6)
    assert scenario.ego.y + scenario.origin[1] == pytest.approx(truth[:, 1], abs=1e-6)
    assert scenario.ego.yaw == pytest.approx(truth[:, 2], abs=1e-6)
    assert scenario.ego.v == pytest.approx(SPEED, abs=tolerance + 1e-2)
    assert scenario.ego.kappa == pytest.approx(1.0 / bags.RADIUS, abs=1e-4)


AS_LOGGED = LogSettings(repair="off")


def check_others(scenario: Scenario, *, sizes: bool = True, within: float = 1e-6) -> None:
    """The three others are where they were, in order of their appearance."""
    tracks = scenario.tracks
    assert tracks.kinds == (AgentKind.CAR, AgentKind.CAR, AgentKind.PEDESTRIAN)
    for i in range(3):
        part = tracks.samples(i)
        truth = np.array(
            [objects_at(t + seconds(scenario.start_ns))[i][2:] for t in tracks.t[part]]
        )
        assert len(truth) == 61
        assert tracks.x[part] + scenario.origin[0] == pytest.approx(truth[:, 0], abs=within)
        assert tracks.y[part] + scenario.origin[1] == pytest.approx(truth[:, 1], abs=within)
        velocity = truth[:, 3] * np.array([np.cos(truth[:, 2]), np.sin(truth[:, 2])])
        assert np.array([tracks.vx[part], tracks.vy[part]]) == pytest.approx(velocity, abs=1e-6)
        if sizes:
            assert (tracks.length[i], tracks.width[i]) == pytest.approx(truth[0, 4:], abs=1e-6)


# What is decoded

numbers = st.floats(-1e9, 1e9, width=32)


@st.composite
def detections(draw: st.DrawFn) -> dict[str, Any]:
    """A DetectedObjectArray with texts and lists of any length, so that nothing lies where it did
    before.
    """
    items = [
        {
            "header": header(draw(st.integers(0, 2**60)), draw(st.text("abc", max_size=5))),
            "id": draw(st.integers(0, 2**32 - 1)),
            "label": draw(st.text(max_size=7)),
            "pose": pose(draw(numbers), draw(numbers), draw(st.floats(-3.0, 3.0))),
            "convex_hull": {
                "polygon": {
                    "points": [{"x": draw(numbers)} for _ in range(draw(st.integers(0, 3)))]
                }
            },
            "velocity_reliable": draw(st.booleans()),
        }
        for _ in range(draw(st.integers(0, 3)))
    ]
    return {"header": header(5, draw(st.text("xyz", max_size=5))), "objects": items}


@given(detections(), st.sampled_from(["little", "big", "ros1"]))
def test_fields_are_those_that_rosbags_decodes(values: dict[str, Any], coding: str) -> None:
    kind = "autoware_msgs/msg/DetectedObjectArray"
    types = bags.store(ros1=True) if coding == "ros1" else bags.STORE
    written = message(kind, types, **values)
    item = (
        "id",
        "label",
        "pose.position.x",
        "pose.orientation.w",
        ("convex_hull.polygon.points", ("x",)),
        "velocity_reliable",
    )
    wanted = ("header.stamp.nanosec", "header.frame_id", ("objects", item))
    read = decoder(types.fielddefs, kind, wanted, cdr=coding != "ros1")
    if coding == "ros1":
        raw = bytes(types.serialize_ros1(written, kind))
    else:
        raw = bytes(types.serialize_cdr(written, kind, little_endian=coding == "little"))
    expected = [
        (
            each.id,
            each.label,
            each.pose.position.x,
            each.pose.orientation.w,
            [(point.x,) for point in each.convex_hull.polygon.points],
            each.velocity_reliable,
        )
        for each in written.objects
    ]
    assert read(raw) == (5, written.header.frame_id, expected)
    for cut_off in range(4, len(raw), 7):
        with pytest.raises((ValueError, IndexError, door.struct.error)):
            read(raw[:cut_off])


# What is read


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
@pytest.mark.parametrize("name", ["TrackedObjects", "PredictedObjects", "DetectedObjects"])
def test_autoware_objects_come_back(package: str, name: str, tmp_path: Path) -> None:
    rows = bags.odometry() + bags.autoware_objects(f"{package}/msg/{name}", TOPIC)
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows), AS_LOGGED)
    check_drive(scenario)
    check_others(scenario)
    assert scenario.tags == ("recorded", "ros") and scenario.name == "bag"
    assert "/localization/kinematic_state" in " ".join(scenario.notes)
    joined_by_position = any("joined from frame to frame" in note for note in scenario.notes)
    assert joined_by_position == (name == "DetectedObjects")


@pytest.mark.parametrize("frame", ["map", "base_link"])
@pytest.mark.parametrize("shape", [0, 1, 2])
def test_frames_and_shapes(frame: str, shape: int, tmp_path: Path) -> None:
    rows = bags.transforms() + bags.autoware_objects(TRACKED, TOPIC, frame, shape)
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    check_drive(scenario)
    check_others(scenario, sizes=shape != 1)
    if shape == 1:
        assert scenario.tracks.length.tolist() == scenario.tracks.width.tolist()
    assert any("map -> odom -> base_link" in note for note in scenario.notes)


def test_static_transforms_place_what_a_sensor_saw(tmp_path: Path) -> None:
    rows = bags.transforms()
    kind = "vision_msgs/msg/Detection3DArray"
    for ns in bags.times(10):
        items = []
        for name, label, x, y, yaw, _, length, width in objects_at(seconds(ns)):
            here = bags.to_frame(*bags.to_frame(x, y, yaw, ego_pose(seconds(ns))), (1.0, 0.5, 0.3))
            word = "car" if label == 1 else "pedestrian"
            items.append(
                {
                    "id": name,
                    "bbox": {"center": pose(*here), "size": {"x": length, "y": width}},
                    "results": [{"hypothesis": {"class_id": word, "score": 0.9}}],
                }
            )
        rows.append(
            ("/detections", kind, ns, message(kind, header=header(ns, "lidar"), detections=items))
        )
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    assert scenario.tracks.ids == ("ahead", "parked", "walker")
    for i in range(3):
        part = scenario.tracks.samples(i)
        truth = np.array(
            [objects_at(t + seconds(scenario.start_ns))[i][2:5] for t in scenario.tracks.t[part]]
        )
        assert scenario.tracks.x[part] + scenario.origin[0] == pytest.approx(truth[:, 0], abs=1e-6)
        assert np.cos(scenario.tracks.yaw[part] - truth[:, 2]) == pytest.approx(1.0, abs=1e-9)
    moving = scenario.tracks.samples(0)
    assert np.isnan(scenario.tracks.vx[moving][0])  # nothing is known yet
    # derived: the type has no velocity
    assert scenario.tracks.vx[moving][3:] == pytest.approx(6.0, abs=1e-6)
    assert any("derived from their positions" in note for note in scenario.notes)
    standing = scenario.tracks.samples(1)
    assert np.abs(scenario.tracks.vx[standing][1:]).max() == 0.0


@pytest.mark.parametrize("in_map", [True, False])
def test_the_frame_of_velocities_is_found_in_the_data(in_map: bool, tmp_path: Path) -> None:
    kind, rows = "derived_object_msgs/msg/ObjectArray", bags.odometry()
    for ns in bags.times(10):
        items = []
        for k, (_, label, x, y, yaw, speed, length, width) in enumerate(objects_at(seconds(ns))):
            turn = yaw if in_map else 0.0
            items.append(
                {
                    "id": k,
                    "pose": pose(x, y, yaw),
                    "classification": 6 if label == 1 else 4,
                    "twist": {"linear": {"x": speed * cos(turn), "y": speed * sin(turn)}},
                    "shape": {"type": 1, "dimensions": [length, width, 1.5]},
                }
            )
        rows.append(("/objects", kind, ns, message(kind, header=header(ns), objects=items)))
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    check_others(scenario)
    assert any(f"in the {'message' if in_map else 'object'}'s" in note for note in scenario.notes)


def indexed(turned: Callable[[int], bool] = lambda k: False) -> list[Row]:
    """Detections whose ids are places in a list that is shuffled in every frame."""
    kind, out = "autoware_msgs/msg/DetectedObjectArray", []
    rng = np.random.default_rng(3)
    for k, ns in enumerate(bags.times(10)):
        items = objects_at(seconds(ns))
        rng.shuffle(items)
        objects = [
            {
                "id": i,
                "label": "car" if label == 1 else "pedestrian",
                "dimensions": {"x": length, "y": width},
                "pose": pose(x, y, yaw + (pi if label == 1 and turned(k) else 0.0)),
            }
            for i, (_, label, x, y, yaw, _, length, width) in enumerate(items)
        ]
        out.append(
            ("/detected_objects", kind, ns, message(kind, header=header(ns), objects=objects))
        )
    return out


def test_boxes_keep_their_front(tmp_path: Path) -> None:
    rows = bags.transforms() + indexed(lambda k: k % 7 in (3, 4))
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows), AS_LOGGED)
    for i, kind in enumerate(scenario.tracks.kinds):
        part = scenario.tracks.samples(i)
        assert np.abs(np.diff(scenario.tracks.yaw[part])).max() < 0.01
        if kind is AgentKind.CAR and scenario.tracks.vx[part][-1] > 1.0:
            assert np.cos(scenario.tracks.yaw[part]) == pytest.approx(1.0)
    assert any("front and back exchanged" in note for note in scenario.notes)


# Raw detections


def test_scores_are_read_from_their_fields(tmp_path: Path) -> None:
    """Existence, or how likely the class is; 0 of clusters, which were not scored, is not known."""
    rows = bags.transforms() + indexed()
    for _, kind, _, each in rows:
        if kind == "autoware_msgs/msg/DetectedObjectArray":
            for i, one in enumerate(each.objects):
                one.score = (0.0, 0.25, 0.5)[i]
    made = read_log(bags.write_ros2(tmp_path / "mini", rows)).repair
    assert (
        made is not None
        and len(made.detections) == 3 * 61
        and set(made.detections.ids) == {"0", "1", "2"}
    )
    by_place = {
        name: made.detections.score[np.array(made.detections.ids) == name]
        for name in ("0", "1", "2")
    }
    assert (
        np.isnan(by_place["0"]).all()
        and set(by_place["1"]) == {0.25}
        and set(by_place["2"]) == {0.5}
    )
    rows = bags.odometry() + bags.autoware_objects(
        "autoware_perception_msgs/msg/DetectedObjects", TOPIC
    )
    for _, kind, _, each in rows:
        if kind.endswith("DetectedObjects"):
            for one in each.objects:
                one.existence_probability = 0.75
    made = read_log(bags.write_ros2(tmp_path / "autoware", rows)).repair
    assert (
        made is not None
        and set(made.detections.score) == {0.75}
        and set(made.detections.ids) == {""}
    )


def test_detections_become_tracks_where_the_log_asks_for_it_or_the_user_does(
    tmp_path: Path,
) -> None:
    raw = bags.write_ros2(tmp_path / "raw", bags.transforms() + indexed(lambda k: k % 7 in (3, 4)))
    repaired = read_log(raw)
    assert (
        repaired.repair is not None
        and repaired.repair.tracks is repaired.tracks
        and repaired.detections is None
    )
    assert len(repaired.tracks) == 3 and len(repaired.repair.detections) == 3 * 61
    (note,) = (note for note in repaired.notes if "made of 183 detections" in note)
    assert "no identities" in note and not any(
        "joined from frame to frame" in each for each in repaired.notes
    )
    assert read_log(raw, LogSettings(repair="on")).repair is not None
    assert differences(repaired, read_log(raw)) == [], "the same log, the same tracks"
    off = read_log(raw, AS_LOGGED)
    assert off.repair is None and off.detections is None
    clean = bags.write_ros2(
        tmp_path / "clean", bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    )
    assert differences(read_log(clean), read_log(clean, AS_LOGGED)) == []
    assert read_log(clean, LogSettings(repair="on")).repair is not None


def test_a_repaired_log_round_trips_and_is_not_repaired_again(tmp_path: Path) -> None:
    scenario = read_log(bags.write_ros2(tmp_path / "bag", bags.transforms() + indexed()))
    write_scenario(tmp_path / "log.mcap", scenario)
    for repair in ("auto", "off"):
        assert (
            differences(read_log(tmp_path / "log.mcap", LogSettings(repair=repair)), scenario) == []
        )
    again = read_log(tmp_path / "log.mcap", LogSettings(repair="on"))
    assert differences(again.tracks, scenario.tracks) == []


def test_an_id_that_flickers_stays_one_track(tmp_path: Path) -> None:
    rows = bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    for k, (_, kind, _, each) in enumerate(rows):
        if kind == TRACKED and k % 3 == 0:
            each.objects[:] = each.objects[1:]
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    assert len(scenario.tracks) == 3 and min(np.diff(scenario.tracks.offsets)) == 41


def test_the_egos_own_box_is_left_out(tmp_path: Path) -> None:
    rows = bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    for _, kind, time, each in rows:
        if kind == TRACKED:
            x, y, yaw = ego_pose(seconds(time - 80_000_000))
            each.objects[0].kinematics.pose_with_covariance.pose = message(
                "geometry_msgs/msg/Pose", **pose(x + 1.4 * cos(yaw), y + 1.4 * sin(yaw), yaw)
            )
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    assert len(scenario.tracks) == 2 and any("is the ego itself" in note for note in scenario.notes)


# Clocks


def test_stamps_count_and_the_log_clock_can_be_asked_for(tmp_path: Path) -> None:
    path = bags.write_ros2(
        tmp_path / "bag",
        bags.odometry() + bags.autoware_objects(TRACKED, TOPIC, late_ns=150_000_000),
    )
    by_stamp, by_log = read_log(path), read_log(path, LogSettings(clock="log"))
    assert by_stamp.start_ns == START_NS and by_log.start_ns == START_NS + 2_000_000
    assert by_stamp.tracks.t[0] == 0.0 and by_log.tracks.t[0] == pytest.approx(0.148)
    assert any("recorded 0.150 s after its stamps (median)" in note for note in by_stamp.notes)


def test_stale_messages_foreign_clocks_and_dropouts_are_said(tmp_path: Path) -> None:
    rows = bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    objects = [row for row in rows if row[1] == TRACKED]
    objects[10][3].header.stamp.sec -= 7
    rows = [row for row in rows if row not in objects[30:40]]
    stale = read_log(bags.write_ros2(tmp_path / "stale", rows))
    assert any("1 of 51 messages" in note and "7.0 s" in note for note in stale.notes)
    assert any("drops out: nothing for 1.10 s" in note for note in stale.notes)
    rows = bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    for _, kind, _, each in rows:
        if kind == TRACKED:
            each.header.stamp.sec -= 1000
    foreign = read_log(bags.write_ros2(tmp_path / "foreign", rows))
    assert any("another clock than the ego's (+1000.1 s)" in note for note in foreign.notes)
    assert foreign.tracks.t[0] == pytest.approx(0.078, abs=1e-3)


def test_a_transform_without_a_finite_value_is_none(tmp_path: Path) -> None:
    rows, kind = bags.transforms(), "tf2_msgs/msg/TFMessage"
    nowhere = {
        "header": header(START_NS),
        "child_frame_id": "lidar_2",
        "transform": {"translation": {"x": np.nan}},
    }
    rows.append(("/tf", kind, START_NS + 1, message(kind, transforms=[nowhere])))
    check_drive(read_log(bags.write_ros2(tmp_path / "bag", rows)))


def test_a_simulations_clock_may_run_slower(tmp_path: Path) -> None:
    """Stamps of simulated time, recorded at half its pace: the drive is as stamped, a part of it
    too.
    """
    rows = [
        (a, b, START_NS + 50_000_000_000 + 2 * (t - START_NS), m) for a, b, t, m in bags.odometry()
    ]
    rows += [
        (a, b, START_NS + 50_000_000_000 + 2 * (t - START_NS), m)
        for a, b, t, m in bags.autoware_objects(TRACKED, TOPIC)
    ]
    path = bags.write_ros2(tmp_path / "bag", rows)
    whole = read_log(path)
    check_drive(whole)
    part = read_log(path, LogSettings(begin=4.0, end=5.0))
    assert part.duration == pytest.approx(1.0)
    assert part.start_ns == whole.start_ns + 4_000_000_000


# Lights, goal, controls, plans


def with_everything() -> list[Row]:
    rows = bags.odometry() + bags.autoware_objects(TRACKED, TOPIC)
    x, y, yaw = ego_pose(8.0)
    rows.append(
        (
            "/initial",
            GOAL,
            START_NS,
            message(GOAL, header=header(START_NS), pose=pose(*ego_pose(0.0))),
        )
    )
    rows.append(
        (
            "/move_base_simple/goal",
            GOAL,
            START_NS,
            message(GOAL, header=header(START_NS), pose=pose(x, y, yaw)),
        )
    )
    lights, steering = (
        "autoware_perception_msgs/msg/TrafficLightGroupArray",
        "autoware_vehicle_msgs/msg/SteeringReport",
    )
    accel, plan = (
        "geometry_msgs/msg/AccelWithCovarianceStamped",
        "autoware_planning_msgs/msg/Trajectory",
    )
    for ns in bags.times(10):
        lamps = [
            {"color": c}
            for c in ((3,) if seconds(ns) < 2.0 else (1, 2) if seconds(ns) < 3.0 else (1,))
        ]
        shown_by_id = ((77, lamps), (5, [{"color": 2}]))
        groups = [{"traffic_light_group_id": i, "elements": some} for i, some in shown_by_id]
        shown = groups if seconds(ns) < 1.0 else groups[:1]
        rows.append(
            ("/lights", lights, ns, message(lights, stamp=stamp(ns), traffic_light_groups=shown))
        )
        rows.append(
            (
                "/steering_status",
                steering,
                ns,
                message(steering, stamp=stamp(ns), steering_tire_angle=0.03),
            )
        )
        told = {"accel": {"accel": {"linear": {"x": 0.25}}}}
        rows.append(
            ("/acceleration", accel, ns, message(accel, header=header(ns, "base_link"), **told))
        )
        points = [
            {"pose": pose(*ego_pose(seconds(ns) + ahead)), "longitudinal_velocity_mps": SPEED}
            for ahead in np.arange(-1.0, 4.0, 0.1)
        ]
        rows.append(
            (
                "/planning/scenario_planning/trajectory",
                plan,
                ns + 20_000_000,
                message(plan, header=header(ns), points=points),
            )
        )
    return rows


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return read_log(
        bags.write_ros2(tmp_path_factory.mktemp("ros") / "everything", with_everything())
    )


def test_lights_goal_steering_and_acceleration(everything: Scenario) -> None:
    assert [light.id for light in everything.lights] == [5, 77]
    yellow, light = everything.lights
    assert [light.at(t) for t in (0.0, 1.95, 2.05, 3.05)] == [
        Colour.GREEN,
        Colour.GREEN,
        Colour.RED_YELLOW,
        Colour.RED,
    ]
    # Not reported then
    assert [yellow.at(t) for t in (0.5, 2.8, 3.0)] == [Colour.YELLOW, Colour.YELLOW, Colour.OFF]
    assert everything.goal is not None and everything.controls is not None
    x, y, yaw = ego_pose(8.0)
    ahead = everything.vehicle.axle_to_center
    place = x + ahead * cos(yaw) - everything.origin[0], y + ahead * sin(yaw) - everything.origin[1]
    assert everything.goal.holds_place(*place) and not everything.goal.holds_place(
        place[0] - 6.0, place[1]
    )
    assert (
        everything.controls.steer == pytest.approx(0.03)
        and np.isnan(everything.controls.throttle).all()
    )
    assert everything.ego.a == pytest.approx(0.25)


def test_on_board_plans_are_timed_by_their_speeds(everything: Scenario) -> None:
    assert len(everything.onboard) == 61
    plan = everything.onboard[20]
    assert plan.known == pytest.approx(2.018)
    times = plan.trajectory.t
    truth = np.array([ego_pose(t + seconds(everything.start_ns)) for t in times])
    assert times[0] == pytest.approx(2.0, abs=1e-3) and times[-1] > 5.5
    assert plan.trajectory.x + everything.origin[0] == pytest.approx(truth[:, 0], abs=1e-2)


@pytest.mark.parametrize("mode", ["open", "closed"])
def test_the_on_board_plan_is_a_planner(everything: Scenario, mode: str) -> None:
    run = run_open_loop if mode == "open" else run_closed_loop
    trace = run(
        replace(
            everything, tracks=everything.tracks.taken(np.zeros(len(everything.tracks.t), bool))
        ),
        "onboard",
    ).trace
    assert trace.oracle
    plans = [frame.plan for frame in trace.frames]
    assert plans[0].status.is_fallback and "no on-board plan was made so far" in plans[0].reason
    assert not any(plan.status.is_fallback for plan in plans[1:])
    if mode == "closed":
        end = trace.ego.state(len(trace.ego) - 1)
        truth = everything.ego.at(end.t)
        assert np.hypot(end.x - truth.x, end.y - truth.y) < 0.5


def test_nothing_of_a_later_on_board_plan_is_known(everything: Scenario) -> None:
    """A plan is answered from when it was known on.

    A log whose later plans are others gets the same answers before.
    """
    later = tuple(
        each
        if each.known < 3.0
        else OnboardPlan(each.known, replace(each.trajectory, y=each.trajectory.y + 50.0))
        for each in everything.onboard
    )
    one, other = (
        run_open_loop(log, "onboard").trace
        for log in (everything, replace(everything, onboard=later))
    )
    for a, b in zip(one.frames, other.frames, strict=True):
        same = a.plan.trajectory.y.tolist() == b.plan.trajectory.y.tolist()
        assert same == (a.t < 3.018)


def test_plans_go_with_the_part_and_round_trip(everything: Scenario, tmp_path: Path) -> None:
    part = cut(everything, 2.0, 4.0)
    assert part.onboard[0].known == pytest.approx(1.918 - 2.0) and part.onboard[-1].known <= 2.0
    goes_round(everything, tmp_path)


# Which topics


def test_topics_are_chosen_by_a_stated_rule_and_by_the_settings(tmp_path: Path) -> None:
    predicted = bags.autoware_objects(
        "autoware_perception_msgs/msg/PredictedObjects", "/perception/objects"
    )
    few = [
        row for row in bags.autoware_objects(TRACKED, "/few") if row[2] < START_NS + 2_000_000_000
    ]
    rows = (
        bags.odometry()
        + bags.transforms()
        + predicted
        + bags.autoware_objects(TRACKED, TOPIC)
        + few
    )
    path = bags.write_ros2(tmp_path / "bag", rows)
    scenario = read_log(path)
    assert any(
        f"those of {TOPIC}, not of /few, /perception/objects: tracked before" in note
        for note in scenario.notes
    )
    assert len(read_log(path, LogSettings(topics={"agents": "/few"})).tracks.t) < len(
        scenario.tracks.t
    )
    assert len(read_log(path, LogSettings(topics={"agents": "-"})).tracks) == 0
    by_transforms = read_log(path, LogSettings(topics={"ego": "/tf"}))
    assert any("map -> odom -> base_link" in note for note in by_transforms.notes)
    with pytest.raises(
        LogError, match=r"/tf.*for 'agents' has the type tf2_msgs/msg/TFMessage.*'-' takes none"
    ):
        read_log(path, LogSettings(topics={"agents": "/tf"}))
    for wrong in (
        LogSettings(topics={"agnets": "/few"}),
        LogSettings(frames={"bsae": "base_link"}),
    ):
        with pytest.raises(LogError, match=r"has no (agnets|bsae); its keys are "):
            read_log(path, wrong)
    sized = read_log(
        path, LogSettings(car={"length": 4.9, "width": 1.9, "wheelbase": 2.8, "rear_overhang": 1.0})
    )
    assert (sized.vehicle.length, sized.vehicle.wheelbase) == (4.9, 2.8)


def test_a_speed_topic_counts_where_it_covers_the_drive(tmp_path: Path) -> None:
    kind = "autoware_vehicle_msgs/msg/VelocityReport"
    reports = [
        (
            "/velocity_status",
            kind,
            ns,
            message(kind, header=header(ns, "base_link"), longitudinal_velocity=7.5),
        )
        for ns in bags.times(20)
    ]
    rows = bags.transforms() + reports
    scenario = read_log(bags.write_ros2(tmp_path / "all", rows))
    assert scenario.ego.v == pytest.approx(7.5)
    assert "No other road users" in " ".join(scenario.notes)
    short = read_log(bags.write_ros2(tmp_path / "short", bags.transforms() + reports[:40]))
    assert short.ego.v == pytest.approx(SPEED, abs=0.01)
    assert any(
        "/velocity_status has no speed for part of the drive" in note for note in short.notes
    )


def test_frames_have_names_of_their_own(tmp_path: Path) -> None:
    rows = bags.transforms()
    for _, _, _, each in rows:
        for transform in each.transforms:
            if transform.child_frame_id == "base_link":
                transform.child_frame_id = "ghost"
    path = bags.write_ros2(tmp_path / "bag", [row for row in rows if row[0] == "/tf"])
    scenario = read_log(path)
    check_drive(scenario)
    assert any(
        "frame 'ghost' (of the frames that move the one with most transforms)" in n
        for n in scenario.notes
    )
    with pytest.raises(
        LogError, match=r"no transform leads from frame 'map' to 'rear'; there are ghost, map, odom"
    ):
        read_log(path, LogSettings(frames={"base": "rear"}))


def test_what_is_no_drive_is_refused(tmp_path: Path) -> None:
    kind = "std_msgs/msg/String"
    path = bags.write_ros2(
        tmp_path / "bag", [("/talk", kind, START_NS, message(kind, data="hello"))]
    )
    with pytest.raises(
        LogError,
        match=r"nothing in the bag says where the ego is; it holds std_msgs/String; needed are /tf",
    ):
        read_log(path)


# One log in many shapes


def test_a_split_bag_is_one_log(plain: Path, tmp_path: Path) -> None:
    rows = bags.transforms() + bags.autoware_objects(TRACKED, TOPIC)
    middle = START_NS + 3_000_000_000
    one = bags.write_ros2(tmp_path / "one", [row for row in rows if row[2] < middle])
    two = bags.write_ros2(tmp_path / "two", [row for row in rows if row[2] >= middle])
    both = tmp_path / "plain"
    both.mkdir()
    shutil.copy(one / "one.mcap", both / "plain_0.mcap")
    shutil.copy(two / "two.mcap", both / "plain_1.mcap")
    text = (
        (plain / "metadata.yaml")
        .read_text()
        .replace("  - plain.mcap\n", "  - plain_0.mcap\n  - plain_1.mcap\n")
    )
    (both / "metadata.yaml").write_text(text)
    assert differences(read_log(both), read_log(plain)) == []
    (both / "plain_1.mcap").unlink()
    part = read_log(both)
    assert "metadata.yaml lists plain_1.mcap, missing or empty." in part.notes
    assert part.duration < 3.0


PART = "=" * 80 + "\nMSG: autoware_perception_msgs/"
NESTED = "uint8 a\n" + "".join(f"Level1 {c}\n" for c in "bcdefghi")
for level in range(1, 12):
    NESTED += f"{PART}Level{level}\n" + "".join(f"Level{level + 1} {c}\n" for c in "abcdefgh")
NESTED += f"{PART}Level12\nuint8 a\nstring b\n"
HOSTILE = {
    "breadth": (NESTED, f"has more than {MOST_FIELDS} fields"),
    "length": ("float64[100000000000] a\n", "a list of fixed length of more than 1073741824 bytes"),
    "digits": (
        f"float64[{'9' * 4000}] a\n",
        "a list of fixed length of more than 1073741824 bytes",
    ),
    "text": (
        "#" * (door.LARGEST_DEFINITION + 1) + "\n",
        f"at most {door.LARGEST_DEFINITION} are read",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_definition_costs_one_line_and_little_time_and_memory(
    plain: Path, tmp_path: Path, case: str
) -> None:
    definition, what = HOSTILE[case]
    file = tmp_path / "hostile.mcap"
    with next(plain.glob("*.mcap")).open("rb") as stream, file.open("wb") as out:
        writer, channels = Writer(out), dict[int, int]()
        writer.start("ros2")
        for schema, channel, each in make_reader(stream).iter_messages():
            if channel.id not in channels:
                text = schema.data if schema.name != TRACKED else definition.encode()
                kind = writer.register_schema(schema.name, schema.encoding, text)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind
                )
            writer.add_message(channels[channel.id], each.log_time, each.data, each.log_time)
        writer.finish()
    tracemalloc.start()
    begin = process_time()
    with pytest.raises(LogError) as caught:
        read_log(file)
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert process_time() - begin < 10.0 and used < 200e6
    line = str(caught.value)
    assert what in line and str(file) in line and TOPIC in line and len(line) < 500


def test_lists_of_fixed_length_are_stepped_over_at_any_length() -> None:
    inner = ([], [("p", (3, ((1, ("float64", 0)), 3))), ("none", (3, ((1, ("uint8", 0)), 0)))])
    fields = [
        ("a", (1, ("uint8", 0))),
        ("b", (3, ((2, "x/Inner"), 100_000))),
        ("c", (3, ((1, ("uint16", 0)), 7))),
    ]
    types = {
        "x/Inner": inner,
        "x/T": ([], [*fields, ("d", (1, ("uint32", 0))), ("e", (1, ("float64", 0)))]),
    }
    raw = b"\0\1\0\0" + struct.pack("<B7x", 9) + bytes(2_400_000)
    raw += struct.pack("<7H2xI4xd", *range(7), 4, 2.5)
    assert decoder(types, "x/T", ("a", "d", "e"), cdr=True)(raw) == (9, 4, 2.5)
    with pytest.raises(ValueError, match="cut off"):
        decoder(types, "x/T", ("a",), cdr=True)(raw[:1000])
    void: Any = {"x/0": ([], [])} | {
        f"x/{i + 1}": ([], [("a", (3, ((2, f"x/{i}"), 1000)))]) for i in range(6)
    }
    void["x/T"] = ([], [("a", (2, "x/6")), ("b", (4, ((2, "x/6"), 0))), ("c", (1, ("uint32", 0)))])
    assert decoder(void, "x/T", ("c",), cdr=False)(struct.pack("<II", 2, 5) + bytes(2)) == (5,)


def test_sqlite_without_definitions_and_a_bare_file_are_the_same_log(
    plain: Path, tmp_path: Path
) -> None:
    rows = bags.transforms() + bags.autoware_objects(TRACKED, TOPIC)
    folder = bags.write_ros2(tmp_path / "plain", rows, sqlite=True)
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        database.execute("delete from message_definitions")
    database.close()
    assert differences(read_log(folder), read_log(plain)) == []
    bare = next(plain.glob("*.mcap"))
    assert reader_of(bare) is reader_of(plain) is reader_of(file) is not None
    assert differences(read_log(bare), read_log(plain)) == []


def test_a_ros1_bag_is_the_same_log(tmp_path: Path) -> None:
    types = bags.store(ros1=True)
    rows = [
        (t, k, n, message(k, types, **bags.values_of(m)))
        for t, k, n, m in bags.transforms() + indexed()
    ]
    one = read_log(bags.write_ros1(tmp_path / "bag.bag", rows, types))
    two = read_log(bags.write_ros2(tmp_path / "bag", bags.transforms() + indexed()))
    assert differences(replace(one, source=two.source), two) == []


# A part of a log


@pytest.mark.slow
def test_a_part_reads_no_more_than_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten minutes with images: six seconds of them cost a fifteenth of the bytes at most."""
    duration = 600.0
    kind, noise = "std_msgs/msg/String", np.random.default_rng(1)
    rows = bags.odometry(duration=duration)
    rows += [
        ("/camera", kind, ns, message(kind, data=noise.bytes(6000).hex()))
        for ns in bags.times(5, duration)
    ]
    path = bags.write_ros2(tmp_path / "long", rows)
    size = sum(each.stat().st_size for each in path.iterdir())
    read = 0
    plain_open: Any = Path.open

    def counted(self: Path, *args: Any, **kwargs: Any) -> Any:
        stream = plain_open(self, *args, **kwargs)
        if self.suffix != ".mcap":
            return stream
        raw = stream.read

        class Counting:
            def __getattr__(self, name: str) -> Any:
                return getattr(stream, name)

            def __enter__(self) -> "Counting":
                return self

            def __exit__(self, *error: object) -> None:
                stream.close()

            def read(self, count: int = -1) -> bytes:
                nonlocal read
                data: bytes = raw(count)
                read += len(data)
                return data

        return Counting()

    monkeypatch.setattr(Path, "open", counted)
    part = read_log(path, LogSettings(begin=400.0, end=406.0))
    assert part.duration == pytest.approx(6.0) and len(part.ego) >= 6 * RATE_HZ
    assert read < size / 15, f"{read} of {size} bytes"


# Damage


def shaken(raw: bytes, draw: st.DrawFn) -> bytes:
    data = bytearray(raw)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, len(data) - 1))
        data[at] = draw(st.integers(0, 255))
    if draw(st.booleans()):
        del data[draw(st.integers(0, len(data) - 1)) :]
    return bytes(data)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A second of a drive, as MCAP with and without compression, as SQLite and as a ROS 1 bag."""
    folder = tmp_path_factory.mktemp("small")
    rows = [
        row for row in with_everything() + bags.transforms(1.0) if row[2] < START_NS + 1_000_000_000
    ]
    types = bags.store(ros1=True)
    old = [
        (t, k, n, message(k, types, **bags.values_of(m)))
        for t, k, n, m in bags.transforms(1.0) + indexed()[:10]
    ]
    files = {
        "zstd.mcap": next(bags.write_ros2(folder / "zstd", rows).glob("*.mcap")),
        "plain.mcap": next(bags.write_ros2(folder / "raw", rows, compressed=False).glob("*.mcap")),
        "log.db3": next(bags.write_ros2(folder / "sql", rows, sqlite=True).glob("*.db3")),
        "old.bag": bags.write_ros1(folder / "old.bag", old, types),
    }
    return {name: path.read_bytes() for name, path in files.items()}


@given(st.data(), st.sampled_from(["plain.mcap", "plain.mcap", "zstd.mcap", "log.db3", "old.bag"]))
@settings(
    max_examples=settings.default.max_examples * 5 // 2,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_bytes_give_a_log_or_a_log_error(
    small: dict[str, bytes], tmp_path: Path, data: Any, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(data.draw(st.composite(lambda draw: shaken(small[name], draw))()))
    reader = reader_of(path)
    if reader is None:
        return
    reader.contents(path)
    read_or_refused(path)


def test_a_frame_that_inflates_beyond_its_index_is_refused(tmp_path: Path) -> None:
    """The index says a few bytes, the zstd frame says 8 GiB: it is refused before it is
    inflated.
    """
    rows = [row for row in bags.odometry() if row[2] < START_NS + 1_000_000_000]
    file = next(bags.write_ros2(tmp_path / "bag", rows).glob("*.mcap"))
    raw = file.read_bytes()
    at = raw.index(b"\x28\xb5\x2f\xfd")
    # A single segment, its size in 8 bytes
    head = b"\x28\xb5\x2f\xfd\xe0" + (8 << 30).to_bytes(8, "little")
    file.write_bytes(raw[:at] + head + raw[at + len(head) :])
    with pytest.raises(LogError, match=r"a chunk of \d+ bytes would become 8589934592"):
        read_log(file)


@given(st.floats(-20.0, 20.0), st.floats(-5.0, 5.0), st.integers(0, 5))
def test_rates_are_exact_for_uniform_acceleration_and_know_no_later_sample(
    v: float, a: float, seed: int
) -> None:
    t = np.cumsum(np.random.default_rng(seed).uniform(0.01, 0.03, 60))
    values = np.array([v * t + 0.5 * a * t * t])
    first, window = np.zeros(60, np.int64), np.full(60, 0.6)
    found = rates(t, values, first, window, parabola=True)
    assert found[0][0, 6:] == pytest.approx(v + a * t[6:], abs=1e-6)
    assert found[1][0, 6:] == pytest.approx(a, abs=1e-4)
    earlier = rates(t[:40], values[:, :40], first[:40], window[:40], parabola=True)
    assert earlier[0].tolist()[0][1:] == found[0][:, :40].tolist()[0][1:]


@given(st.floats(-pi, pi), st.floats(0.2, 9.0), st.floats(0.2, 9.0), st.integers(0, 9))
def test_the_smallest_rectangle_around_a_box_is_the_box(
    yaw: float, length: float, width: float, extra: int
) -> None:
    rng = np.random.default_rng(extra)
    points = [
        (length / 2, width / 2),
        (-length / 2, width / 2),
        (-length / 2, -width / 2),
        (length / 2, -width / 2),
    ]
    c, s = cos(yaw), sin(yaw)
    turned = [(3.0 + c * x - s * y, -4.0 + s * x + c * y) for x, y in points]
    boxes = smallest_rectangles(
        [turned, [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0)], *([turned] if rng.random() > 0.5 else [])]
    )
    assert boxes[0, :2] == pytest.approx([3.0, -4.0], abs=1e-9)
    assert sorted(boxes[0, 3:]) == pytest.approx(sorted([length, width]), abs=1e-9)
    assert boxes[0, 3] * boxes[0, 4] == pytest.approx(length * width)


def test_identities_are_told_from_places_in_a_list() -> None:
    frame = np.repeat(np.arange(40), 2)
    t, x = 0.1 * frame, np.where(np.arange(80) % 2 == 0, 0.0, 40.0) + 0.1 * frame
    assert no_identities([str(k % 2) for k in range(80)], t, x, 0.0 * x) is None
    swapped = [str((k + (k // 2) % 2) % 2) for k in range(80)]
    assert "jumps" in (no_identities(swapped, t, x, 0.0 * x) or "")
    none = np.full((80, 2), np.nan)
    names = joined(frame, t, x, 0.0 * x, [AgentKind.CAR] * 80, none)
    assert names.tolist() == [1, 2] * 40


FEW = ("bot_garden", "pedestrian_crossing_05", "pedestrian_crossing_09", "pedestrian_crossing_15")
ALL = pytest.param("all", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["few", ALL])
def tartu(request: pytest.FixtureRequest, shared_data: Path) -> dict[str, Scenario]:
    """Recorded drives by name: four, slowly all thirteen."""
    paths = sorted((shared_data / "tartu" / "ros2").iterdir())
    return {
        path.name: read_log(path) for path in paths if request.param == "all" or path.name in FEW
    }


def test_recorded_drives_are_read(tartu: dict[str, Scenario]) -> None:
    assert len(tartu) in (4, 13)
    for name, scenario in tartu.items():
        assert (
            20.0 < scenario.duration < 55.0
            and scenario.goal is not None
            and len(scenario.lights) > 1
        ), name
        assert np.abs(scenario.ego.a).max() < 3.5 and scenario.ego.v.max() < 14.0, name
        way = np.hypot(np.diff(scenario.ego.x), np.diff(scenario.ego.y)).sum()
        driven = float(
            np.sum(0.5 * (scenario.ego.v[1:] + scenario.ego.v[:-1]) * np.diff(scenario.ego.t))
        )
        assert driven == pytest.approx(way, rel=0.01), name
        assert scenario.is_recorded and scenario.road.source.value.startswith(
            "the log has no lanes"
        ), name


def test_recorded_drives_round_trip(tartu: dict[str, Scenario], tmp_path: Path) -> None:
    for scenario in (tartu["bot_garden"], tartu["pedestrian_crossing_09"]):
        goes_round(scenario, tmp_path)
