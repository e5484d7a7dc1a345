"""comma2k19: a segment made here goes where it was made to go.

So does the recorded one, where the test data has it.
"""

from pathlib import Path

import numpy as np
import pytest
from any_bytes import CHANGES, changed, read_or_refused
from hypothesis import HealthCheck, example, given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.readers import read_log, reader_of

T = np.arange(0.0, 5.0, 0.05)
SEMI_MAJOR_M, ECCENTRICITY_2 = 6378137.0, 0.00669437999014
"""WGS 84: the semi-major axis, and the first eccentricity squared."""
GPS_EPOCH_S, WEEK_S = 315964800, 604800
"""Unix time of 1980-01-06; the reader subtracts no leap seconds."""


def segment(
    folder: Path,
    heading: float = 0.5,
    v: float = 12.0,
    latitude: float = 0.6,
    longitude: float = -2.1,
) -> Path:
    """A straight drive at a heading from east, at a place on the ellipsoid of WGS 84.

    East and north are computed here: with the reader's own, an error in them would cancel.
    """
    sin, cos = np.sin(latitude), np.cos(latitude)
    across_m = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY_2 * sin**2)
    start = across_m * np.array(
        [cos * np.cos(longitude), cos * np.sin(longitude), (1.0 - ECCENTRICITY_2) * sin]
    )
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    north = np.array([-sin * np.cos(longitude), -sin * np.sin(longitude), cos])
    forward = np.cos(heading) * east + np.sin(heading) * north
    down = -np.cross(east, north)
    matrix = np.column_stack([forward, np.cross(down, forward), down])  # the camera's axes in ECEF
    pose = folder / "global_pose"
    pose.mkdir(parents=True, exist_ok=True)
    arrays = {
        "frame_positions": start + v * T[:, None] * forward,
        "frame_velocities": np.tile(v * forward, (len(T), 1)),
        "frame_orientations": np.tile(quaternion(matrix), (len(T), 1)),
        "frame_times": 46408.5 + T,
        "frame_gps_times": np.column_stack([np.full(len(T), 2012.0), 404106.4 + T]),
    }
    for name, array in arrays.items():
        with (pose / name).open("wb") as file:
            np.save(file, array)
    return folder


def quaternion(matrix: np.ndarray) -> np.ndarray:
    """The unit quaternion of a rotation, scalar first: the eigenvector of Bar-Itzhack's matrix."""
    m = matrix
    k = np.array(
        [
            [m.trace(), m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    return np.asarray(np.linalg.eigh(k)[1][:, -1])


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-3.1, 3.1))
@example(1.5, 0.8, 1.0)  # where a plane of a sphere would be off by most, 0.3 mm
@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_it_goes_where_it_was_made_to_go(
    tmp_path: Path, heading: float, latitude: float, longitude: float
) -> None:
    scenario = read_log(segment(tmp_path / "7", heading, latitude=latitude, longitude=longitude))
    ego = scenario.ego
    assert ego.v == pytest.approx(12.0) and np.cos(ego.yaw - heading) == pytest.approx(1.0)
    assert ego.x == pytest.approx(12.0 * T * np.cos(heading), abs=1e-5)
    assert ego.y == pytest.approx(12.0 * T * np.sin(heading), abs=1e-5)
    assert scenario.is_recorded and scenario.start_ns == (
        GPS_EPOCH_S + 2012 * WEEK_S
    ) * 10**9 + round(404106.4e9)


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    folder = segment(tmp_path / "7")
    reader = reader_of(folder)
    assert reader is not None
    assert [topic.messages for topic in reader.contents(folder).topics] == [len(T)] * 5
    for name, content, words in (
        ("frame_times", np.arange(7.0), "the arrays have 100, 100, 100, 7, 100 rows"),
        ("frame_positions", np.zeros((100, 3)), "not on the earth"),
        ("frame_velocities", np.full((100, 3), np.nan), "a value is not finite"),
        ("frame_velocities", np.zeros((100, 2)), "expected \\(n, 3\\) numbers"),
    ):
        segment(folder)
        with (folder / "global_pose" / name).open("wb") as file:
            np.save(file, content)
        with pytest.raises(LogError, match=words):
            read_log(folder)
    segment(folder)
    (folder / "global_pose" / "frame_gps_times").unlink()
    with pytest.raises(LogError, match="frame_gps_times: the array cannot be read"):
        read_log(folder)


@given(CHANGES, st.sampled_from(["frame_positions", "frame_times"]))
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_mutated_arrays_are_read_or_refused(
    tmp_path: Path, changes: list[tuple[int, int]], name: str
) -> None:
    file = segment(tmp_path / "7") / "global_pose" / name
    raw = file.read_bytes()
    file.write_bytes(changed(raw[:400], changes) + raw[400:])
    read_or_refused(tmp_path / "7")


def test_the_recorded_segment(shared_data: Path) -> None:
    scenario = read_log(shared_data / "comma2k19" / "segment_40")
    assert len(scenario.ego) == 1200 and scenario.duration == pytest.approx(59.95, abs=0.01)
    way = np.hypot(np.diff(scenario.ego.x), np.diff(scenario.ego.y)).sum()
    assert way == pytest.approx(
        float(np.sum(scenario.ego.v[1:] * np.diff(scenario.ego.t))), rel=0.01
    )
