"""Bags with several drives (a clock restarts), with journals beside them, and with poses of a
sensor's frame.
"""

import sqlite3
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ros_bags as bags
from hypothesis import given, strategies as st
from ros_bags import SPEED, START_NS, Row, ego_pose, header, message, pose, seconds, stamp

from replan.core.errors import LogError
from replan.logs.readers import LogSettings, read_log
from replan.logs.readers.ros.frames import OTHER_CLOCK_S, restarts
from replan.logs.scenario import Scenario

TRACKED = "autoware_perception_msgs/msg/TrackedObjects"
TOPIC = "/perception/object_recognition/tracking/objects"
ODOMETRY, CLOCK, TF = "nav_msgs/msg/Odometry", "rosgraph_msgs/msg/Clock", "tf2_msgs/msg/TFMessage"
S = 1_000_000_000


def check_drive(scenario: Scenario, origin: tuple[float, float] = (0.0, 0.0)) -> None:
    """The ego is on the arc at its stamps, the arc's begin moved to `origin`, at the arc's
    speed.
    """
    truth = np.array([ego_pose(t) for t in scenario.ego.t + seconds(scenario.start_ns)])
    assert scenario.ego.x + scenario.origin[0] - origin[0] == pytest.approx(truth[:, 0], abs=1e-4)
    assert scenario.ego.y + scenario.origin[1] - origin[1] == pytest.approx(truth[:, 1], abs=1e-4)
    assert scenario.ego.yaw == pytest.approx(truth[:, 2], abs=1e-6)
    assert scenario.ego.v == pytest.approx(SPEED, abs=0.02)


# Clocks that restart


def apart(rows: list[Row], east: float) -> list[Row]:
    for _, kind, _, each in rows:
        if kind == ODOMETRY:
            each.pose.pose.position.x += east
        elif kind == TF:
            for one in each.transforms:
                one.transform.translation.x += east * (one.child_frame_id == "odom")
    return rows


def lights(red_at: float, group: int) -> list[Row]:
    kind, out = "autoware_perception_msgs/msg/TrafficLightGroupArray", []
    for ns in bags.times(10):
        shown = [
            {
                "traffic_light_group_id": group,
                "elements": [{"color": 1 if seconds(ns) >= red_at else 3}],
            }
        ]
        out.append(
            ("/lights", kind, ns, message(kind, stamp=stamp(ns), traffic_light_groups=shown))
        )
    return out


def drive(by: str, until_s: float, group: int) -> list[Row]:
    """Ego, the others and a light until a time, s."""
    rows = bags.odometry() if by == "odometry" else bags.transforms()
    rows += bags.autoware_objects(TRACKED, TOPIC) + lights(2.0, group)
    return [row for row in rows if row[2] <= START_NS + round(1e9 * until_s)]


@pytest.mark.parametrize("by", ["odometry", "transforms"])
@pytest.mark.parametrize(("first", "second"), [(3.0, 5.0), (5.0, 3.0), (4.0, 4.0)])
def test_a_drive_is_chosen_where_the_clock_restarts(
    by: str, first: float, second: float, tmp_path: Path
) -> None:
    """A simulator that began anew after 6 s, elsewhere: no drive is read as both, and each can be
    read.
    """
    rows = drive(by, first, 1) + apart(bags.later(drive(by, second, 2), 6.0, 0.0), 43.0)
    path = bags.write_ros2(tmp_path / "bag", rows)
    topic = "/localization/kinematic_state" if by == "odometry" else "/tf"
    with pytest.raises(
        LogError, match=rf"clock of {topic} restarts at 6\.0 s of the bag: 2 drives.*--from/--to"
    ):
        read_log(path)
    with pytest.raises(LogError, match="2 drives"):
        read_log(path, LogSettings(begin=2.0, end=8.0))
    for settings, length, east, group in (
        (LogSettings(end=6.0), first, 0.0, 1),
        (LogSettings(begin=6.0), second, 43.0, 2),
        (LogSettings(begin=5.9, end=12.0), second, 43.0, 2),
    ):
        scenario = read_log(path, settings)
        check_drive(scenario, (east, 0.0))
        assert scenario.duration == pytest.approx(length, abs=0.6)
        assert scenario.ego.t[0] == pytest.approx(0.0, abs=0.6)
        assert [light.id for light in scenario.lights] == [group]
        t = scenario.tracks.t[scenario.tracks.samples(0)] + seconds(scenario.start_ns)
        assert scenario.tracks.x[scenario.tracks.samples(0)] + scenario.origin[0] == pytest.approx(
            ego_pose(0.0)[0] + 30.0 + 6.0 * t, abs=1e-6
        )
        assert not any("stale" in note for note in scenario.notes)
        assert sum("2 drives" in note for note in scenario.notes) == 1
    part = read_log(path, LogSettings(begin=7.0, end=8.5))
    check_drive(part, (43.0, 0.0))
    assert (part.start_ns, part.duration) == (
        pytest.approx(START_NS + 1 * S, abs=4_000_000),
        pytest.approx(1.5, abs=0.03),
    )


def test_by_log_time_the_drives_are_joined_as_asked(tmp_path: Path) -> None:
    path = bags.write_ros2(
        tmp_path / "bag",
        drive("odometry", 5.0, 1) + bags.later(drive("odometry", 3.0, 1), 6.0, 0.0),
    )
    scenario = read_log(path, LogSettings(clock="log"))
    assert scenario.duration == pytest.approx(9.0, abs=0.02)
    assert sum("2 drives" in note for note in scenario.notes) == 1
    part = read_log(path, LogSettings(clock="log", begin=6.5, end=8.5))
    assert part.ego.x[0] + part.origin[0] == pytest.approx(ego_pose(0.5)[0], abs=0.05)


def test_a_bag_that_was_played_in_a_loop(tmp_path: Path) -> None:
    rows = [row for k in range(4) for row in bags.later(drive("odometry", 3.0, 1), 3.02 * k, 0.0)]
    path = bags.write_ros2(tmp_path / "bag", rows, sqlite=True)
    with pytest.raises(LogError, match=r"restarts at 3\.0 s, 6\.0 s, 9\.1 s of the bag: 4 drives"):
        read_log(path)
    for k in range(4):
        scenario = read_log(
            path, LogSettings(begin=round(3.02 * k, 1), end=round(3.02 * (k + 1), 1))
        )
        check_drive(scenario)
        assert scenario.duration == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(
    "change", ["stale", "stale at the end", "two senders", "late by 0.9 s", "unsorted"]
)
def test_what_comes_late_or_out_of_order_is_no_restart(change: str, tmp_path: Path) -> None:
    rows = bags.odometry()
    if change == "stale":
        for _, _, _, each in rows[100:130]:
            each.header.stamp.sec -= 7
    elif change == "stale at the end":
        topic, kind, time, each = rows[-1]
        rows += bags.later([(topic, kind, time, row[3]) for row in rows[:5]], 0.01, 0.0)
    elif change == "two senders":
        rows += bags.later(rows[:-100:5], 2.0, 0.0)
    elif change == "late by 0.9 s":
        rows = rows[:100] + bags.later(rows[100:200], 0.9, 0.0) + rows[200:]
    path = tmp_path / "bag"
    bags.write_ros2(path, rows[::-1] if change == "unsorted" else rows)
    scenario = read_log(path)
    assert not any("restarts" in note for note in scenario.notes)
    assert scenario.duration == pytest.approx(bags.DURATION_S, abs=1e-6)
    check_drive(scenario)


def test_a_clock_of_the_others_that_restarts_is_said_and_nothing_is_lost(tmp_path: Path) -> None:
    others = bags.autoware_objects(TRACKED, TOPIC)
    rows = bags.odometry() + others[:40] + bags.later(others[40:], 0.0, -4.0)
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    assert any(f"clock of {TOPIC} restarts 4.08 s after" in note for note in scenario.notes)
    assert len(scenario.tracks.t) == 3 * len(others)


@given(
    st.lists(st.floats(0.005, 0.4), min_size=4, max_size=60),
    st.lists(st.floats(0.0, 0.99), min_size=60, max_size=60),
    st.floats(0.1, 3.0),
)
def test_jitter_and_any_pace_is_no_restart(
    steps: list[float], late: list[float], pace: float
) -> None:
    """Messages that are each recorded up to 1 s (of their clock) late, in the order of their
    recording.
    """
    sent = START_NS + np.cumsum(np.rint(1e9 * np.array(steps)).astype(np.int64))
    log = sent + np.rint(1e9 * np.array(late[: len(steps)])).astype(np.int64)
    order = np.argsort(log, kind="stable")
    stamps = np.rint((sent - START_NS) * min(pace, 1.0)).astype(np.int64) + S
    assert len(restarts(log[order], stamps[order])) == 0


@given(st.integers(1, 4), st.floats(1.5, 100.0), st.floats(0.3, 2.0))
def test_every_restart_is_found(count: int, length: float, pace: float) -> None:
    n, step = max(int(length * 10), 15), 100_000_000
    log = START_NS + step * np.arange(n * (count + 1))
    stamps = np.tile(S + np.rint(pace * step * np.arange(n)).astype(np.int64), count + 1)
    expected = (log[n::n]).tolist() if pace * (n - 1) * 0.1 > OTHER_CLOCK_S else []
    assert restarts(log, stamps).tolist() == expected


# Journals of SQLite


@pytest.mark.parametrize("as_folder", [True, False])
@pytest.mark.parametrize("kept", [0.0, 0.3])
def test_messages_in_a_write_ahead_log_are_read(
    as_folder: bool, kept: float, tmp_path: Path
) -> None:
    """As a killed recorder leaves it: what it wrote last, or all, is in the file beside."""
    folder = bags.write_ros2(tmp_path / "bag", bags.odometry(), sqlite=True)
    whole, file = read_log(folder), next(folder.glob("*.db3"))
    database = sqlite3.connect(file, isolation_level=None)
    database.executescript("PRAGMA journal_mode = WAL; PRAGMA wal_autocheckpoint = 0;")
    (rows,) = database.execute("SELECT count(*) FROM messages").fetchone()
    late = database.execute("SELECT * FROM messages WHERE id > ?", (round(kept * rows),)).fetchall()
    database.execute("DELETE FROM messages WHERE id > ?", (round(kept * rows),))
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", late)
    after = tmp_path / "killed"
    after.mkdir()
    for each in folder.iterdir():
        if each.suffix != ".db3-shm":
            (after / each.name).write_bytes(each.read_bytes())
    database.close()
    names = sorted(each.name for each in after.iterdir())
    scenario = read_log(after if as_folder else after / file.name)
    assert (
        scenario.ego.t.tolist() == whole.ego.t.tolist()
        and scenario.ego.x.tolist() == whole.ego.x.tolist()
    )
    assert any(f"{file.name} was not closed" in note for note in scenario.notes)
    assert sorted(each.name for each in after.iterdir()) == names, "the bag itself is not touched"
    damaged = after / f"{file.name}-wal"
    damaged.write_bytes(damaged.read_bytes()[:-2000])  # the last transaction is not whole
    if kept:
        assert len(read_log(after if as_folder else after / file.name).ego) >= 0.3 * len(whole.ego)


# Poses of a sensor


def sensor(
    child: str,
    placed: tuple[float, float, float],
    *,
    turning: bool = True,
    twist: bool = True,
    axes: float = 0.0,
) -> list[Row]:
    """Odometry of a frame that lies at `placed` (x, y, yaw) in the base, with the velocity there,
    in its axes.
    """
    x, y, yaw = placed
    out, turn = [], SPEED / bags.RADIUS if turning else 0.0
    velocity = np.array([SPEED - turn * y, turn * x])
    c, s = np.cos(-yaw), np.sin(-yaw)
    vx, vy = c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]
    for k, ns in enumerate(bags.times(bags.RATE_HZ)):
        ex, ey, eyaw = ego_pose(seconds(ns))
        at = (
            ex + np.cos(eyaw) * x - np.sin(eyaw) * y,
            ey + np.sin(eyaw) * x + np.cos(eyaw) * y,
            eyaw + yaw,
        )
        moves = (
            {"linear": {"x": vx + 1e-3 * (k == 0), "y": vy}, "angular": {"z": turn}}
            if twist
            else {}
        )
        told = {"pose": {"pose": pose(*at)}, "twist": {"twist": moves}}
        out.append(
            (
                "/odom",
                ODOMETRY,
                ns + 2_000_000,
                message(ODOMETRY, header=header(ns), child_frame_id=child, **told),
            )
        )
    return out


def static(
    *edges: tuple[str, str, tuple[float, float, float]], topic: str = "/tf_static"
) -> list[Row]:
    out = []
    for parent, child, at in edges:
        moved = {
            "translation": {**pose(*at)["position"], "z": 0.0},
            "rotation": pose(*at)["orientation"],
        }
        for ns in (START_NS,) if topic == "/tf_static" else bags.times(10):
            one = {"header": header(ns, parent), "child_frame_id": child, "transform": moved}
            out.append((topic, TF, ns, message(TF, transforms=[one])))
    return out


def turned(at: tuple[float, float, float]) -> tuple[float, float, float]:
    """The parent in the child."""
    return bags.to_frame(0.0, 0.0, 0.0, at)


IMU = (1.6, 0.4, pi / 2)


@pytest.mark.parametrize("twist", [True, False])
@pytest.mark.parametrize(
    ("child", "edges", "base"),
    [
        ("imu_link", [("base_link", "imu_link", IMU)], ""),
        ("imu_link", [("imu_link", "base_link", turned(IMU))], ""),
        (
            "/imu_link",
            [("base_link", "rack", (1.0, 0.0, 0.0)), ("rack", "imu_link", (0.6, 0.4, pi / 2))],
            "",
        ),
        (
            "imu_link",
            [("base_footprint", "base_link", (0, 0, 0)), ("base_footprint", "imu_link", IMU)],
            "",
        ),
        ("imu_link", [("base_footprint", "imu_link", IMU)], ""),
        ("imu_link", [("ego_vehicle", "imu_link", IMU)], ""),
        ("imu_link", [("rear_axle", "imu_link", IMU)], "rear_axle"),
        ("base_footprint", [("base_footprint", "base_link", turned(IMU))], ""),
        ("base_link", [("base_link", "rear", turned(IMU))], "rear"),
    ],
)
def test_poses_of_a_sensor_become_the_bases(
    child: str, edges: list[Any], base: str, twist: bool, tmp_path: Path
) -> None:
    for topic in ("/tf_static", "/tf"):
        rows = sensor(child, IMU, twist=twist) + static(*edges, topic=topic)
        settings = LogSettings(topics={"ego": "/odom"}, frames={"base": base} if base else {})
        scenario = read_log(bags.write_ros2(tmp_path / topic[1:], rows), settings)
        check_drive(scenario)
        assert sum(f"poses of frame '{child.lstrip('/')}'" in note for note in scenario.notes) == 1
        assert any("speed is that of /odom" in note for note in scenario.notes) == twist


def test_objects_in_the_frame_of_a_sensor_are_placed_below_the_moved_base(tmp_path: Path) -> None:
    """An inverted transform, and a lidar below the sensor: both stay in the tree."""
    objects = bags.autoware_objects(TRACKED, TOPIC)
    for _, _, ns, each in objects:
        origin = ego_pose(seconds(ns - 80_000_000))
        each.header.frame_id = "lidar"
        for one in each.objects:
            at = one.kinematics.pose_with_covariance.pose
            yaw = 2.0 * np.arctan2(at.orientation.z, at.orientation.w)
            base = bags.to_frame(at.position.x, at.position.y, yaw, origin)
            lidar = bags.to_frame(*bags.to_frame(*base, IMU), (0.5, 0.0, 0.1))
            moved = message("geometry_msgs/msg/Pose", **pose(*lidar))
            at.position, at.orientation = moved.position, moved.orientation
    rows = sensor("imu_link", IMU) + objects
    rows += static(("imu_link", "base_link", turned(IMU)), ("imu_link", "lidar", (0.5, 0.0, 0.1)))
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    check_drive(scenario)
    for i in range(3):
        part = scenario.tracks.samples(i)
        truth = np.array(
            [
                bags.objects_at(t + seconds(scenario.start_ns))[i][2:4]
                for t in scenario.tracks.t[part]
            ]
        )
        assert scenario.tracks.x[part] + scenario.origin[0] == pytest.approx(truth[:, 0], abs=1e-4)
        assert scenario.tracks.y[part] + scenario.origin[1] == pytest.approx(truth[:, 1], abs=1e-4)


def test_without_a_transform_the_frame_is_named_or_refused_where_another_is_set(
    tmp_path: Path,
) -> None:
    path = bags.write_ros2(
        tmp_path / "bag", sensor("gnss_link", (1.6, 0.4, 0.0)) + bags.transforms()[:1]
    )
    scenario = read_log(path, LogSettings(topics={"ego": "/odom"}))
    assert (
        sum("frame 'gnss_link', which is taken as the rear axle" in note for note in scenario.notes)
        == 1
    )
    with pytest.raises(
        LogError,
        match=r"/odom.*frame 'gnss_link', and no transform leads from there to 'base_link'",
    ):
        read_log(path, LogSettings(topics={"ego": "/odom"}, frames={"base": "base_link"}))
    same = read_log(path, LogSettings(topics={"ego": "/odom"}, frames={"base": "gnss_link"}))
    assert same.ego.x.tolist() == scenario.ego.x.tolist()


def test_transforms_through_the_world_move_nothing(tmp_path: Path) -> None:
    """Localisation by transforms and raw GNSS as odometry: their difference is an error, and no
    place on the car.
    """
    gnss = [row for row in sensor("gnss_link", (0.0, 0.0, 0.0)) if row]
    both = bags.transforms() + gnss
    for _, kind, ns, each in bags.transforms():
        one = each.transforms[0]
        if one.child_frame_id == "base_link":
            at = pose(*ego_pose(seconds(ns)))
            moved = {"translation": at["position"], "rotation": at["orientation"]}
            told = {"header": header(ns), "child_frame_id": "gnss_link", "transform": moved}
            both.append(("/tf", kind, ns, message(TF, transforms=[told])))
    scenario = read_log(
        bags.write_ros2(tmp_path / "bag", both), LogSettings(topics={"ego": "/odom"})
    )
    check_drive(scenario)
    assert (
        sum("frame 'gnss_link', which is taken as the rear axle" in note for note in scenario.notes)
        == 1
    )


@pytest.mark.parametrize("kind", ["TwistStamped", "TwistWithCovarianceStamped"])
def test_a_twist_of_a_sensor_becomes_the_speed_of_the_base(kind: str, tmp_path: Path) -> None:
    turn, name = SPEED / bags.RADIUS, f"geometry_msgs/msg/{kind}"
    rows = bags.transforms() + static(("base_link", "imu_link", IMU))
    for k, ns in enumerate(bags.times(20)):
        moves = {
            "linear": {"x": turn * 1.6 + 1e-3 * (k == 0), "y": -(SPEED - turn * 0.4)},
            "angular": {"z": turn},
        }
        told = {"twist": moves if kind == "TwistStamped" else {"twist": moves}}
        rows.append(("/imu_speed", name, ns, message(name, header=header(ns, "imu_link"), **told)))
    scenario = read_log(bags.write_ros2(tmp_path / "bag", rows))
    assert scenario.ego.v == pytest.approx(SPEED, abs=2e-3)
    assert any("/imu_speed is of frame 'imu_link'" in note for note in scenario.notes)
