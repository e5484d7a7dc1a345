"""Road users above and below the ego's way are left out by name; without sound heights nothing
changes.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from lanelet2_cases import MapWriter, driven_along

from replan.core.arrays import FloatArray
from replan.logs.heights import on_the_way
from replan.logs.maps import read_map
from replan.logs.maps.base import on_map
from replan.logs.readers.table import from_frames


def way(slope: float = 0.0, base: float = 0.0) -> FloatArray:
    x = np.arange(0.0, 120.0, 0.7)
    return np.column_stack([x, 0.0 * x, base + slope * x])


def crossing(z: float, name: str, x: float = 60.0) -> tuple[FloatArray, FloatArray, list[str]]:
    """Boxes of a road user that crosses the way at a height, its headings, and its names."""
    y = np.arange(-40.0, 40.0, 1.0)
    boxes = np.column_stack([0.0 * y + x, y, 0.0 * y + z])
    return boxes, np.full(len(y), 0.5 * np.pi), [name] * len(y)


def along(z: FloatArray, name: str) -> tuple[FloatArray, FloatArray, list[str]]:
    x = np.linspace(10.0, 110.0, len(z))
    return np.column_stack([x, 0.0 * x + 3.0, z]), np.zeros(len(z)), [name] * len(z)


def kept(
    places: FloatArray, *users: tuple[FloatArray, FloatArray, list[str]], height: float = 1.5
) -> tuple[set[str], list[str]]:
    """The names that are left, and the notes."""
    boxes, yaw = (np.concatenate([user[k] for user in users]) for k in (0, 1))
    names = [name for user in users for name in user[2]]
    notes: list[str] = []
    keep = on_the_way(places, boxes, yaw, np.full(len(boxes), height), names, notes)
    return {name for name, stays in zip(names, keep, strict=True) if stays}, notes


@given(st.floats(-0.12, 0.12), st.floats(-300.0, 3000.0), st.floats(4.5, 15.0))
@settings(max_examples=30, deadline=None)
def test_a_bridge_and_a_tunnel_are_not_in_the_way(slope: float, base: float, apart: float) -> None:
    places = way(slope, base)
    ground = base + slope * 60.0
    beside = along(base + slope * np.linspace(10.0, 110.0, 50) + 0.75, "beside")
    # on a slope, the ground within 15 m is up to 1.8 m higher or lower
    above = crossing(ground + apart + 0.75 + 15.0 * abs(slope), "bridge")
    below = crossing(ground - apart + 0.75 - 15.0 * abs(slope), "tunnel")
    left, notes = kept(places, beside, above, below)
    assert left == {"beside"}
    assert "2 road users" in notes[0] and "bridge" in notes[0] and "tunnel" in notes[0]


def test_a_road_user_that_comes_down_to_the_way_stays() -> None:
    ramp = along(np.linspace(8.0, 0.75, 60), "ramp")
    assert kept(way(), ramp, crossing(0.75, "car"))[0] == {"ramp", "car"}


@pytest.mark.parametrize("z", [0.0, 48.0, -32.0])
def test_equal_heights_of_all_are_not_used(z: float) -> None:
    assert kept(way(base=3.0), crossing(z, "a"), along(np.full(40, z), "b")) == ({"a", "b"}, [])


@pytest.mark.parametrize("zero", [6.0, -9.0, 12.0, 48.0])
def test_another_zero_of_heights_changes_nothing(zero: float) -> None:
    wavy = 0.75 + zero + 0.1 * np.sin(np.arange(50))
    left, notes = kept(way(), along(wavy, "lead"), along(wavy + 0.2, "other"))
    assert left == {"lead", "other"}
    assert all("heights of the road users are not used" in note for note in notes)


def test_heights_of_satellites_and_of_detectors_scatter() -> None:
    rng = np.random.default_rng(3)
    noisy = way()
    noisy[:, 2] += 6.0 * rng.normal(size=len(noisy))
    assert kept(noisy, crossing(7.0, "a"), crossing(0.7, "b"))[0] == {"a", "b"}
    scattered = 0.75 + 1.5 * rng.normal(size=60)
    assert kept(way(), along(scattered, "a"), crossing(0.75, "b"))[0] == {"a", "b"}


def test_boxes_without_a_name_stay() -> None:
    boxes, yaw, names = crossing(8.0, "")
    assert kept(way(), (boxes, yaw, names), crossing(0.75, "car"))[0] == {"", "car"}


def test_road_users_far_from_the_way_stay() -> None:
    boxes, yaw, names = crossing(9.0, "far")
    boxes[:, 0] += 200.0
    assert kept(way(), (boxes, yaw, names), crossing(0.75, "car"))[0] == {"far", "car"}


def test_a_way_that_passes_over_itself_keeps_both_levels() -> None:
    """A car park: whoever stands on a floor that the ego also drives on is in its way."""
    lower, upper = way(), way(base=3.2)[::-1]
    climb = np.column_stack(
        [np.full(20, 120.0), np.linspace(0.0, 20.0, 20), np.linspace(0, 3.2, 20)]
    )
    places = np.vstack([lower, climb, upper])
    assert kept(places, crossing(0.75, "low"), crossing(3.95, "high"))[0] == {"low", "high"}
    assert kept(places, crossing(0.75, "low"), crossing(8.5, "roof"))[0] == {"low"}


@pytest.mark.parametrize("with_ego", [True, False])
def test_heights_of_tables_are_read_where_both_have_them(with_ego: bool) -> None:
    t = np.arange(120) / 10
    ego = pd.DataFrame({"t": t, "x": 10.0 * t, "y": 0.0, "yaw": 0.0, "v": 10.0})
    if with_ego:
        ego["z"] = 231.0
    lead = pd.DataFrame({"t": t, "id": "lead", "x": 10.0 * t + 25.0, "y": 0.0, "z": 231.8})
    above = pd.DataFrame({"t": t, "id": "above", "x": 60.0, "y": 6.0 * t - 30.0, "z": 238.8})
    agents = pd.concat([lead, above], ignore_index=True).assign(height=1.6)
    scenario = from_frames(ego, agents)
    assert set(scenario.tracks.ids) == ({"lead"} if with_ego else {"lead", "above"})
    unused = from_frames(ego, agents, columns={"agents.z": "-"})
    assert set(unused.tracks.ids) == {"lead", "above"}


def bridged(z: float, ground: float = 3.0) -> MapWriter:
    """A road to the east, one that follows on it, and a crossing road at another height."""
    m = MapWriter()
    for x0, x1 in ((0.0, 80.0), (80.0, 160.0)):
        middle = 0.5 * (x0 + x1)
        sides = [m.way_at(ground, [(x0, y), (middle, y), (x1, y)]) for y in (2.0, -2.0)]
        m.lanelet(*sides)
    up = [
        m.way_at(ground + z, [(x, -50.0), (x, -20.0), (x, 20.0), (x, 50.0)]) for x in (48.0, 52.0)
    ]
    m.lanelet(*up)
    return m


@pytest.mark.parametrize(("z", "lanes"), [(6.5, 2), (-5.0, 2), (0.4, 3), (0.0, 3)])
@pytest.mark.parametrize("ground", [0.0, 214.0])
def test_lanes_on_a_bridge_are_left_out(
    z: float, lanes: int, ground: float, tmp_path: Path
) -> None:
    path = bridged(z, ground).write(tmp_path / "map.osm")
    line = np.column_stack([np.arange(2.0, 150.0, 2.0), np.zeros(74)])
    scenario = on_map(driven_along(line, speed=10.0), read_map(path), path, "Lanelet2")
    assert len(scenario.road.lanes) == lanes
    noted = any("above or below the ego's way" in note for note in scenario.notes)
    assert noted is (lanes == 2)
