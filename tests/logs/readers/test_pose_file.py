"""Files of poses of TUM and KITTI read as the drive that they were written from."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.readers import read_log, reader_of

CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera's axes (x right, y down, z forward), as columns in the car's (forward, left, up)."""


def bend(count: int = 80) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times, places and headings of a drive at 8 m/s."""
    t = 0.1 * np.arange(count)
    yaw = 0.08 * t
    return t, 100.0 * np.sin(yaw), 100.0 * (1.0 - np.cos(yaw)), yaw


def matrices(yaw: FloatArray) -> FloatArray:
    """The car's axes in the world, as columns, `(n, 3, 3)`."""
    c, s, zero, one = np.cos(yaw), np.sin(yaw), 0.0 * yaw, 0.0 * yaw + 1.0
    return np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)


def quaternions(turns: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turns).as_quat())


@pytest.mark.parametrize("suffix", [".txt", ".tum"])
@pytest.mark.parametrize("of_camera", [False, True])
def test_a_tum_file_is_its_drive(suffix: str, of_camera: bool, tmp_path: Path) -> None:
    t, x, y, yaw = bend()
    body = matrices(yaw) @ CAMERA if of_camera else matrices(yaw)
    rows = np.column_stack([t + 1.6e9, x, y, 0.02 * np.sin(t), quaternions(body)])
    path = tmp_path / f"truth{suffix}"
    np.savetxt(path, rows, header="timestamp tx ty tz qx qy qz qw", fmt="%.9f")
    read = read_log(path)
    np.testing.assert_allclose(read.ego.yaw, yaw, atol=1e-6)
    np.testing.assert_allclose(read.ego.x + read.origin[0], x, atol=1e-6)
    assert np.median(read.ego.v) == pytest.approx(8.0, abs=0.01)
    assert not len(read.tracks)
    assert f"the body's {'z' if of_camera else 'x'} axis" in read.notes[0]


@pytest.mark.parametrize("times", ["times.txt", "../sequences/00/times.txt", ""])
def test_a_kitti_file_is_its_drive(times: str, tmp_path: Path) -> None:
    t, x, y, yaw = bend()
    first = matrices(np.zeros(1))[0] @ CAMERA
    turns = first.T @ matrices(yaw) @ CAMERA
    places = np.column_stack([x, y, 0.0 * x]) @ first
    rows = np.concatenate([turns, places[:, :, None]], axis=2).reshape(-1, 12)
    path = tmp_path / "poses" / "00.txt"
    path.parent.mkdir()
    np.savetxt(path, rows)
    if times:
        place = path.parent / times
        place.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(place, 2.0 * t)
    read = read_log(path)
    np.testing.assert_allclose(read.ego.yaw, yaw, atol=1e-6)
    np.testing.assert_allclose(read.ego.y + read.origin[1], y, atol=1e-6)
    assert np.median(read.ego.v) == pytest.approx(4.0 if times else 8.0, abs=0.01)
    assert any("as KITTI's" in note for note in read.notes) is (not times)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=14))
@settings(max_examples=30, deadline=None)
def test_other_numbers_are_not_claimed(tmp_path_factory: pytest.TempPathFactory, row: list) -> None:  # type: ignore[type-arg]
    path = tmp_path_factory.mktemp("texts") / "numbers.txt"
    path.write_text("\n".join(" ".join(map(str, row)) for _ in range(3)))
    reader = reader_of(path)
    assert reader is None or reader.name == "poses"
    if len(row) not in (8, 12):
        assert reader is None


def test_damage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "short.tum"
    path.write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(LogError, match="fewer than two poses"):
        read_log(path)
    lines = ["0 0 0 0 0 0 0 1"] * 30
    path.write_text("\n".join([*lines, "1 2 3"]))
    with pytest.raises(LogError, match="line 31 has 3 numbers, the first 8"):
        read_log(path)
