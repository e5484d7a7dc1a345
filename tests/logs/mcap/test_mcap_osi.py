"""ASAM OSI logs: with a small descriptor made here, and the recorded ones where they are at
hand.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from differences import differences
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.road import RoadSource
from replan.logs.summary import summarise

ENUMS = {
    "Kind": ["TYPE_UNKNOWN", "TYPE_OTHER", "TYPE_VEHICLE", "TYPE_PEDESTRIAN"],
    "Vehicle": ["TYPE_UNKNOWN", "TYPE_CAR", "TYPE_BUS", "TYPE_BICYCLE"],
    "Standing": ["TYPE_UNKNOWN", "TYPE_POLE", "TYPE_BRIDGE"],
    "LaneType": ["TYPE_UNKNOWN", "TYPE_DRIVING", "TYPE_NONDRIVING"],
    "Line": ["TYPE_UNKNOWN", "TYPE_SOLID_LINE", "TYPE_DASHED_LINE"],
    "Move": [
        "MOVE_DIRECTION_UNKNOWN",
        "MOVE_DIRECTION_INCREASING_S",
        "MOVE_DIRECTION_DECREASING_S",
    ],
    "LogicalType": ["TYPE_UNKNOWN", "TYPE_NORMAL", "TYPE_SIDEWALK"],
}
MESSAGES = {
    "Vector": "x:double y:double z:double",
    "Angles": "roll:double pitch:double yaw:double",
    "Size": "length:double width:double height:double",
    "Id": "value:uint64",
    "Timestamp": "seconds:int64 nanos:uint32",
    "Base": "dimension:Size position:Vector orientation:Angles velocity:Vector acceleration:Vector",
    "Attributes": "bbcenter_to_rear:Vector bbcenter_to_front:Vector",
    "VehicleClass": "type:Vehicle",
    "Moving": (
        "id:Id base:Base type:Kind vehicle_attributes:Attributes "
        "vehicle_classification:VehicleClass"
    ),
    "StandingClass": "type:Standing",
    "Stationary": "id:Id base:Base classification:StandingClass",
    "Pairing": "antecessor_lane_id:Id successor_lane_id:Id",
    "LaneClass": (
        "type:LaneType centerline:Vector* centerline_is_driving_direction:bool "
        "left_adjacent_lane_id:Id* right_adjacent_lane_id:Id* lane_pairing:Pairing* "
        "left_lane_boundary_id:Id* right_lane_boundary_id:Id*"
    ),
    "Lane": "id:Id classification:LaneClass",
    "Point": "position:Vector",
    "BoundaryClass": "type:Line",
    "Boundary": "id:Id boundary_line:Point* classification:BoundaryClass",
    "LogicalBoundary": "id:Id boundary_line:Point*",
    "Link": "other_lane_id:Id",
    "LogicalLane": (
        "id:Id type:LogicalType move_direction:Move right_adjacent_lane:Link* "
        "left_adjacent_lane:Link*"
        " right_boundary_id:Id* left_boundary_id:Id* predecessor_lane:Link* successor_lane:Link*"
    ),
    "GroundTruth": (
        "timestamp:Timestamp host_vehicle_id:Id moving_object:Moving* "
        "stationary_object:Stationary* lane:Lane* lane_boundary:Boundary* "
        "logical_lane:LogicalLane* logical_lane_boundary:LogicalBoundary* traffic_light:Id*"
    ),
    "SensorView": "global_ground_truth:GroundTruth",
}


def descriptor(without: str = "") -> descriptor_pb2.FileDescriptorSet:
    """The part of OSI that a log needs, proto2 as the original."""
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="osi.proto", package="osi3")
    for name, values in ENUMS.items():
        enum = file.message_type.add(name=f"{name}Holder").enum_type.add(name=name)
        for number, value in enumerate(values):
            enum.value.add(name=value, number=number)
    for name, text in MESSAGES.items():
        message = file.message_type.add(name=name)
        for number, part in enumerate(text.split(), 1):
            field, kind = part.split(":")
            if field == without:
                continue
            repeated, kind = kind.endswith("*"), kind.rstrip("*")
            made = message.field.add(name=field, number=number, label=3 if repeated else 1)
            if kind in ENUMS:
                made.type, made.type_name = kinds.TYPE_ENUM, f".osi3.{kind}Holder.{kind}"
            elif kind in MESSAGES:
                made.type, made.type_name = kinds.TYPE_MESSAGE, f".osi3.{kind}"
            else:
                made.type = kinds.Type.Value(f"TYPE_{kind.upper()}")
    return descriptor_pb2.FileDescriptorSet(file=[file])


def message_class(files: descriptor_pb2.FileDescriptorSet, name: str) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def write_osi(
    path: Path,
    messages: list[tuple[int, Any]],
    schema: bytes | None = None,
    name: str = "osi3.GroundTruth",
) -> Path:
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema_id = writer.register_schema(
            name, "protobuf", schema or descriptor().SerializeToString()
        )
        channel = writer.register_channel("/truth", "protobuf", schema_id)
        for time, message in messages:
            payload = message if isinstance(message, bytes) else message.SerializeToString()
            writer.add_message(channel, time, payload, time)
        writer.finish()
    return path


GroundTruth = message_class(descriptor(), "osi3.GroundTruth")


def vector(x: float, y: float) -> dict[str, float]:
    return {"x": x, "y": y}


def car(
    ident: int, x: float, y: float = 0.0, yaw: float = 0.0, v: float = 10.0, **more: Any
) -> dict[str, Any]:
    base = {
        "dimension": {"length": 5.0, "width": 2.0},
        "position": vector(x, y),
        "orientation": {"yaw": yaw},
        "velocity": vector(v * math.cos(yaw), v * math.sin(yaw)),
    }
    return {
        "id": {"value": ident},
        "base": base,
        "type": 2,
        "vehicle_classification": {"type": 1},
        **more,
    }


def lane(
    ident: int, y: float, x: tuple[float, float] = (900.0, 1100.0), **more: Any
) -> dict[str, Any]:
    known = {
        "type": 1,
        "centerline": [vector(x[0], y), vector(x[1], y)],
        "centerline_is_driving_direction": True,
    }
    return {"id": {"value": ident}, "classification": {**known, **more}}


def ids(*values: int) -> list[dict[str, int]]:
    return [{"value": value} for value in values]


def truth(k: int, **more: Any) -> Any:
    objects = [
        car(7, 1000.0 + k, 2000.0, vehicle_attributes={"bbcenter_to_rear": {"x": -1.4}}),
        car(8, 1030.0, 2003.5),
    ]
    parts = {
        "host_vehicle_id": {"value": 7},
        "timestamp": {"seconds": k // 10, "nanos": k % 10 * 100_000_000},
    }
    return GroundTruth(**{**parts, "moving_object": objects, **more})


def frames(n: int = 11, **first: Any) -> list[tuple[int, Any]]:
    return [(k * 100_000_000, truth(k, **(first if k == 0 else {}))) for k in range(n)]


def test_ego_is_moved_to_its_rear_axle_and_to_a_local_origin(tmp_path: Path) -> None:
    scenario = read_scenario(write_osi(tmp_path / "log.mcap", frames()))
    assert scenario.origin == (1000.0, 2000.0)
    assert scenario.ego.x == pytest.approx(np.arange(11) - 1.4)
    assert scenario.ego.v == pytest.approx(np.full(11, 10.0))
    assert scenario.vehicle.rear_overhang == pytest.approx(1.1) and scenario.vehicle.length == 5.0
    assert (scenario.tracks.ids, scenario.tracks.x[0], scenario.tracks.y[0]) == (("8",), 30.0, 3.5)
    assert scenario.road.source is RoadSource.DRIVEN_PATH
    assert differences(
        scenario.vehicle.axle_to_center, 1.4
    ) == [] or scenario.vehicle.axle_to_center == pytest.approx(1.4)


def test_speed_and_acceleration_at_the_rear_axle_of_a_circle(tmp_path: Path) -> None:
    """Rear axle on a circle of 20 m at 5 m/s: the centre is faster and accelerates inward.

    The axle does neither.
    """
    d, radius, v = 1.4, 20.0, 5.0
    messages = []
    for k in range(21):
        w = v / radius * 0.1 * k
        x, y = radius * math.sin(w) + d * math.cos(w), radius * (1 - math.cos(w)) + d * math.sin(w)
        slip = v / radius * d
        ego = car(7, x, y, w, vehicle_attributes={"bbcenter_to_rear": {"x": -d}})
        ego["base"]["velocity"] = vector(
            v * math.cos(w) - slip * math.sin(w), v * math.sin(w) + slip * math.cos(w)
        )
        inward = v / radius
        ego["base"]["acceleration"] = vector(
            -inward * v * math.sin(w) - inward**2 * d * math.cos(w),
            inward * v * math.cos(w) - inward**2 * d * math.sin(w),
        )
        messages.append((k * 10**8, truth(k, moving_object=[ego])))
    ego = read_scenario(write_osi(tmp_path / "log.mcap", messages)).ego
    assert ego.v == pytest.approx(np.full(21, v))
    assert ego.kappa[1:] == pytest.approx(np.full(20, 1 / radius), rel=1e-3)
    assert ego.a[1:] == pytest.approx(np.zeros(20), abs=1e-3)


def test_objects_have_their_kinds_and_bridges_are_no_obstacles(tmp_path: Path) -> None:
    moving = [
        car(7, 1000.0, 2000.0),
        car(1, 1.0, vehicle_classification={"type": 2}),
        car(2, 2.0, vehicle_classification={"type": 3}),
        car(3, 3.0, type=3),
        car(4, 4.0, type=1),
    ]
    standing = [
        {
            "id": {"value": 20 + i},
            "base": {"position": vector(1010.0, 2005.0)},
            "classification": {"type": i},
        }
        for i in (1, 2)
    ]
    path = write_osi(
        tmp_path / "log.mcap", frames(moving_object=moving, stationary_object=standing)
    )
    tracks = read_scenario(path).tracks
    kinds = dict(zip(tracks.ids, tracks.kinds, strict=True))
    assert kinds == {
        "1": AgentKind.BUS,
        "2": AgentKind.BICYCLE,
        "3": AgentKind.PEDESTRIAN,
        "4": AgentKind.OBJECT,
        "8": AgentKind.CAR,
        "21": AgentKind.OBJECT,
    }
    assert [ident for ident, static in zip(tracks.ids, tracks.static, strict=True) if static] == [
        "21"
    ]
    assert (tracks.length[-1], tracks.width[-1]) == (1.0, 1.0)  # the pole has no size in the log


def test_lanes_around_centre_lines_reach_half_way_to_each_other(tmp_path: Path) -> None:
    lanes = [
        lane(
            1,
            2000.0,
            left_adjacent_lane_id=ids(2),
            lane_pairing=[{"successor_lane_id": {"value": 3}}],
        ),
        lane(2, 2004.0, right_adjacent_lane_id=ids(1), left_adjacent_lane_id=ids(4)),
        lane(3, 2000.0, (1100.0, 1200.0), type=2),
        lane(4, 2007.0, (1100.0, 900.0)),
        lane(9, 2050.0, centerline=[]),
    ]
    scenario = read_scenario(write_osi(tmp_path / "log.mcap", frames(lane=lanes)))
    road = scenario.road
    assert set(road.lanes) == {1, 2, 3, 4} and road.drives_on_right
    assert road.lanes[1].left[:, 1] == pytest.approx([2.0, 2.0])
    assert road.lanes[1].right[:, 1] == pytest.approx([-2.0, -2.0])
    assert road.lanes[3].left[:, 1] == pytest.approx([1.75, 1.75])
    assert (road.lanes[1].successors, road.lanes[3].successors) == ((3,), ())
    assert (road.lanes[1].left_neighbour, road.lanes[2].right_neighbour) == (2, 1)
    assert (road.lanes[2].left_neighbour, road.lanes[2].left_opposite) == (None, True)
    assert [road.lanes[i].drivable for i in (1, 3)] == [True, False]
    assert any("1 of 5 lanes" in note for note in scenario.notes)
    assert any("centre line only" in note for note in scenario.notes)


def test_lanes_between_boundaries_against_the_centre_line(tmp_path: Path) -> None:
    """The centre line runs against the driving direction, the left boundary comes in two pieces."""
    lines = {
        1: (900.0, 1000.0, 1998.0, 2),
        2: (1000.0, 1100.0, 1998.0, 2),
        3: (900.0, 1100.0, 2002.0, 1),
    }
    boundaries = [
        {
            "id": {"value": key},
            "boundary_line": [{"position": vector(x, y)} for x in (a, b)],
            "classification": {"type": kind},
        }
        for key, (a, b, y, kind) in lines.items()
    ]
    sides = {"left_lane_boundary_id": ids(1, 2), "right_lane_boundary_id": ids(3)}
    one = lane(5, 2000.0, centerline_is_driving_direction=False, **sides)
    road = read_scenario(
        write_osi(tmp_path / "log.mcap", frames(lane=[one], lane_boundary=boundaries))
    ).road
    (found,) = road.lanes.values()
    assert found.center[0, 0] == pytest.approx(100.0) and found.center[-1, 0] == pytest.approx(
        -100.0
    )
    assert found.left[:, 1] == pytest.approx(np.full(len(found.left), -2.0))
    assert (found.left_crossable, found.right_crossable) == (True, False)


@pytest.mark.parametrize("backward", [False, True])
def test_logical_lanes_come_first(tmp_path: Path, backward: bool) -> None:
    boundaries = [
        {
            "id": {"value": i},
            "boundary_line": [{"position": vector(x, y)} for x in (900.0, 1000.0, 1100.0)],
        }
        for i, y in ((1, 2002.0), (2, 1998.0), (3, 1994.0))
    ]
    lanes = [
        {
            "id": {"value": key},
            "type": 1,
            "move_direction": 2 if backward else 1,
            "left_boundary_id": ids(left),
            "right_boundary_id": ids(right),
            "successor_lane": [{"other_lane_id": {"value": 70}}],
            "predecessor_lane": [{"other_lane_id": {"value": 80}}],
            "left_adjacent_lane": [{"other_lane_id": {"value": i}} for i in near],
        }
        for key, left, right, near in ((50, 1, 2, []), (51, 2, 3, [50]))
    ]
    messages = frames(lane=[lane(1, 2000.0)], logical_lane=lanes, logical_lane_boundary=boundaries)
    road = read_scenario(write_osi(tmp_path / "log.mcap", messages)).road
    assert set(road.lanes) == {50, 51}
    found = road.lanes[51]
    assert found.successors == ((80,) if backward else (70,))
    assert found.center[0, 0] == pytest.approx(100.0 if backward else -100.0)
    assert (found.right_neighbour if backward else found.left_neighbour) == 50
    cross = np.cross(
        np.r_[found.center[-1] - found.center[0], 0.0], np.r_[found.left[0] - found.right[0], 0.0]
    )
    assert cross[2] > 0.0


def test_without_speeds_they_come_from_positions(tmp_path: Path) -> None:
    messages = frames()
    for _, message in messages:
        for item in message.moving_object:
            item.base.ClearField("velocity")
    scenario = read_scenario(write_osi(tmp_path / "log.mcap", messages))
    assert scenario.ego.v == pytest.approx(np.full(11, 10.0))
    assert np.isnan(scenario.tracks.vx).all() and any(
        "no ego speed" in note for note in scenario.notes
    )


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        (
            [(0, truth(0, host_vehicle_id=None))],
            "the log has no ego: no host_vehicle_id; name one of the moving",
        ),
        (
            [(0, truth(0, host_vehicle_id={"value": 99}))],
            "host vehicle 99 is not among the objects",
        ),
        (
            [*frames(3), (9 * 10**8, truth(2))],
            "time 0.900 s: time does not increase, from 0.200 s to 0.200 s",
        ),
        (
            [*frames(3), (3 * 10**8, truth(3, moving_object=[car(7, math.nan)]))],
            "0.300 s: x of moving object 7 is nan",
        ),
        (
            [*frames(3), (3 * 10**8, truth(3, moving_object=[car(8, math.inf)]))],
            "0.300 s: x of moving object 8 is inf",
        ),
        (
            [*frames(3), (3 * 10**8, b"\x0a\xff\xff")],
            "topic /truth, time 0.300 s: message cannot be decoded",
        ),
    ],
)
def test_a_broken_ground_truth_is_named(
    tmp_path: Path, messages: list[tuple[int, Any]], words: str
) -> None:
    with pytest.raises(LogError, match=words) as error:
        read_scenario(write_osi(tmp_path / "log.mcap", messages))
    assert str(tmp_path / "log.mcap") in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "schema", [b"garbage", descriptor_pb2.FileDescriptorSet().SerializeToString() or b"\x0a\x00"]
)
def test_a_broken_descriptor_is_refused(tmp_path: Path, schema: bytes) -> None:
    with pytest.raises(LogError, match="descriptor in the file cannot be used"):
        read_scenario(write_osi(tmp_path / "log.mcap", frames(), schema))


def test_an_old_descriptor_without_logical_lanes_will_do(tmp_path: Path) -> None:
    old = descriptor(without="logical_lane").SerializeToString()
    assert len(read_scenario(write_osi(tmp_path / "log.mcap", frames(), old)).ego) == 11
    bare = descriptor(without="lane_pairing").SerializeToString()
    with pytest.raises(
        LogError, match=r"has no field lane.classification.lane_pairing.antecessor_lane_id.value"
    ):
        read_scenario(write_osi(tmp_path / "log.mcap", frames(), bare))


@pytest.mark.slow
def test_the_recorded_osi_log_makes_sense(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "osi" / "osi_centerline_example.mcap"
    scenario = read_scenario(path)
    ego, road = scenario.ego, scenario.road
    assert (len(ego), len(scenario.tracks), len(road.lanes)) == (91, 13, 675)
    driven = np.hypot(np.diff(ego.x), np.diff(ego.y)) / np.diff(ego.t)
    assert np.abs(driven - ego.v[1:]).max() < 0.1 and 19.0 < ego.v.min() < ego.v.max() < 21.0
    assert all(road.is_drivable(x, y) for x, y in zip(ego.x, ego.y, strict=True))
    assert np.nanmax(np.hypot(scenario.tracks.vx, scenario.tracks.vy)) < 30.0
    route = [road.lanes_at(ego.x[i], ego.y[i])[0] for i in range(len(ego))]
    changes = [(a, b) for a, b in pairwise(route) if a.id != b.id]
    assert changes and all(
        b.id in {j for i in (a.id, *a.successors) for j in (i, *road.lanes[i].successors)}
        for a, b in changes
    )
    assert summarise(path).profile == "ASAM OSI log, osi3.GroundTruth"
    write_scenario(tmp_path / "native.mcap", scenario)
    assert differences(scenario, read_scenario(tmp_path / "native.mcap")) == []
