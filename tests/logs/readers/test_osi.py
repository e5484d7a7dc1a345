"""Bare OSI traces, written here with ASAM's own package.

The recorded ones where they are at hand.
"""

import struct
from pathlib import Path

import numpy as np
import pytest
from any_bytes import CHANGES, changed, goes_round, read_or_refused
from hypothesis import HealthCheck, given, settings, strategies as st
from osi3.osi_groundtruth_pb2 import GroundTruth
from osi3.osi_sensorview_pb2 import SensorView

from replan.core.errors import LogError
from replan.logs.readers import LogSettings, read_log, reader_of

STEPS = 20


def truth(k: int, host: int | None = 4) -> GroundTruth:
    """Frame k of 10 Hz: object 4 at 10 m/s, object 9 ahead of it at 8 m/s."""
    message = GroundTruth()
    message.timestamp.seconds, message.timestamp.nanos = 50 + k // 10, k % 10 * 100_000_000
    if host is not None:
        message.host_vehicle_id.value = host
    for name, x, v in ((4, 100.0, 10.0), (9, 130.0, 8.0)):
        item = message.moving_object.add()
        item.id.value, item.type = name, item.TYPE_VEHICLE
        base = item.base
        base.position.x, base.position.y, base.velocity.x = x + v * 0.1 * k, 7.0, v
        base.dimension.length, base.dimension.width, base.orientation.yaw = 4.4, 1.9, 0.0
    return message


def trace(path: Path, messages: list[GroundTruth] | list[SensorView]) -> Path:
    raw = [message.SerializeToString() for message in messages]
    path.write_bytes(b"".join(struct.pack("<I", len(each)) + each for each in raw))
    return path


def test_a_trace_of_ground_truth_is_read(tmp_path: Path) -> None:
    path = trace(tmp_path / "run.osi", [truth(k) for k in range(STEPS)])
    scenario = read_log(path)
    assert scenario.ego.v == pytest.approx(10.0) and scenario.ego.t == pytest.approx(
        0.1 * np.arange(STEPS)
    )
    assert scenario.tracks.ids == ("9",) and scenario.start_ns == 50 * 10**9
    goes_round(scenario, tmp_path)
    reader = reader_of(path)
    assert reader is not None and reader.contents(path).topics[0].messages == STEPS


@pytest.mark.parametrize("name", ["run.osi", "20260101_sv_380_run.osi"])
def test_a_trace_of_sensor_views_is_the_same_log(name: str, tmp_path: Path) -> None:
    views = []
    for k in range(STEPS):
        view = SensorView()
        view.timestamp.seconds = 50
        view.global_ground_truth.CopyFrom(truth(k))
        views.append(view)
    plain = read_log(trace(tmp_path / "plain.osi", [truth(k) for k in range(STEPS)]))
    seen = read_log(trace(tmp_path / name, views))
    assert seen.ego.x.tolist() == plain.ego.x.tolist() and seen.source.endswith("SensorView")


def test_the_ego_is_named_where_no_host_is(tmp_path: Path) -> None:
    path = trace(tmp_path / "run.osi", [truth(k, None) for k in range(STEPS)])
    with pytest.raises(
        LogError, match=r"no host_vehicle_id; name one of the moving objects \(4, 9\) with --ego"
    ):
        read_log(path)
    with pytest.raises(LogError, match="no moving object 12"):
        read_log(path, LogSettings(ego="12"))
    scenario = read_log(path, LogSettings(ego="9"))
    assert scenario.ego.v == pytest.approx(8.0) and scenario.tracks.ids == ("4",)


@given(CHANGES, st.integers(0, 300))
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_mutated_traces_are_read_or_refused(
    tmp_path: Path, changes: list[tuple[int, int]], cut: int
) -> None:
    path = trace(tmp_path / "run.osi", [truth(k) for k in range(5)])
    raw = changed(path.read_bytes(), changes)
    path.write_bytes(raw[: len(raw) - cut])
    read_or_refused(path)


@pytest.mark.parametrize(("name", "states"), [("acc-test", 1010), ("alks_cut-in", 305)])
def test_recorded_traces(name: str, states: int, shared_data: Path) -> None:
    scenario = read_log(shared_data / "osi" / f"{name}.osi", LogSettings(ego="0"))
    assert (
        len(scenario.ego) == states and len(scenario.tracks) == 1 and len(scenario.road.lanes) == 6
    )


@pytest.mark.parametrize(("z", "left"), [(7.2, ()), (-5.5, ()), (0.75, ("11",))])
def test_what_drives_on_a_bridge_or_in_a_tunnel_is_left_out(
    z: float, left: tuple[str, ...], tmp_path: Path
) -> None:
    messages = []
    for k in range(STEPS):
        message = truth(k)
        for item in message.moving_object:
            item.base.position.z, item.base.dimension.height = 0.75, 1.5
        crossing = message.moving_object.add()
        crossing.CopyFrom(message.moving_object[1])
        crossing.id.value = 11
        position = crossing.base.position
        position.x, position.y, position.z = 112.0, 4.0 + 0.6 * k, z
        crossing.base.velocity.x, crossing.base.velocity.y = 0.0, 6.0
        crossing.base.orientation.yaw = 1.5707963
        messages.append(message)
    scenario = read_log(trace(tmp_path / "run.osi", messages))
    assert scenario.tracks.ids == ("9", *left)
    assert any("above or below the ego's way" in note for note in scenario.notes) is (not left)
