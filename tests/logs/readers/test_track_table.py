"""Tables of tracks in the shapes of public data sets: one road user becomes the ego, the others
stay agents.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from any_bytes import CHANGES, changed, read_or_refused
from hypothesis import HealthCheck, given, settings

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.readers import LogSettings, logs_in, read_log, reader_of
from replan.logs.readers.table import from_frames
from replan.logs.scenario import CENTRE, EGO_POSE, Scenario

SIZES = {"1": (4.5, 1.8), "2": (12.0, 2.5), "3": (4.0, 1.7)}


def truth(rate: float = 25.0, *, straight: bool = False) -> pd.DataFrame:
    """Two vehicles one after the other and an oncoming one, 12 s, box centres.

    On arcs, or along x as on a motorway.
    """
    rows = []
    for name, (start, v, y) in {
        "1": (0.0, 20.0, -4.0),
        "2": (40.0, 18.0, -4.0),
        "3": (300.0, -15.0, 4.0),
    }.items():
        k = np.arange(0 if name == "1" else 10, round(12 * rate))
        t = k / rate
        s = start + v * t
        row = {
            "frame": k,
            "t": t,
            "id": name,
            "x": s,
            "y": y + 0.0 * t,
            "yaw": 0.0 if v > 0.0 else np.pi,
        }
        if not straight:
            radius = 200.0 - y
            a = s / 200.0
            row |= {
                "x": radius * np.sin(a),
                "y": 200.0 - radius * np.cos(a),
                "yaw": a + (0.0 if v > 0.0 else np.pi),
            }
        pace = abs(v) * (1.0 if straight else (200.0 - y) / 200.0)
        row |= {"vx": pace * np.cos(row["yaw"]), "vy": pace * np.sin(row["yaw"])}
        rows.append(pd.DataFrame(row | {"length": SIZES[name][0], "width": SIZES[name][1]}))
    return pd.concat(rows, ignore_index=True)


def high_d(folder: Path) -> Path:
    table = truth(straight=True)
    columns = {"frame": table.frame, "id": table.id, "x": (table.x - table.length / 2).round(2)}
    columns |= {
        "y": (-table.y - table.width / 2).round(2),
        "width": table.length,
        "height": table.width,
    }
    pd.DataFrame(columns | {"xVelocity": table.vx, "yVelocity": -table.vy, "laneId": 2}).to_csv(
        folder / "01_tracks.csv", index=False
    )
    meta = pd.DataFrame(
        {"id": [1, 2, 3], "class": ["Car", "Truck", "Car"], "drivingDirection": [2, 2, 1]}
    )
    meta.to_csv(folder / "01_tracksMeta.csv", index=False)
    pd.DataFrame({"id": [1], "frameRate": [25]}).to_csv(
        folder / "01_recordingMeta.csv", index=False
    )
    return folder / "01_tracks.csv"


def in_d(folder: Path) -> Path:
    table = truth()
    columns = {
        "recordingId": 7,
        "trackId": table.id,
        "frame": table.frame,
        "xCenter": table.x,
        "yCenter": table.y,
    }
    columns |= {
        "heading": np.degrees(table.yaw) % 360.0,
        "width": table.width,
        "length": table.length,
    }
    pd.DataFrame(columns | {"xVelocity": table.vx, "yVelocity": table.vy}).to_csv(
        folder / "07_tracks.csv", index=False
    )
    meta = pd.DataFrame(
        {"recordingId": 7, "trackId": [1, 2, 3], "class": ["car", "truck_bus", "car"]}
    )
    meta.to_csv(folder / "07_tracksMeta.csv", index=False)
    pd.DataFrame({"recordingId": [7], "frameRate": [25.0]}).to_csv(
        folder / "07_recordingMeta.csv", index=False
    )
    return folder / "07_tracks.csv"


def interaction(folder: Path) -> Path:
    table = truth(10.0)
    columns = {
        "track_id": table.id,
        "frame_id": table.frame + 1,
        "timestamp_ms": 100 * (table.frame + 1),
    }
    columns |= {
        "agent_type": table.id.map({"1": "car", "2": "truck", "3": "car"}),
        "x": table.x,
        "y": table.y,
    }
    columns |= {
        "vx": table.vx,
        "vy": table.vy,
        "psi_rad": table.yaw,
        "length": table.length,
        "width": table.width,
    }
    pd.DataFrame(columns).to_csv(folder / "vehicle_tracks_000.csv", index=False)
    walk = pd.DataFrame(
        {
            "track_id": "P1",
            "frame_id": 1 + np.arange(120),
            "timestamp_ms": 100 * (1 + np.arange(120)),
        }
    )
    walk = walk.assign(
        agent_type="pedestrian/bicycle", x=30.0, y=0.13 * np.arange(120), vx=0.0, vy=1.3
    )
    walk.to_csv(folder / "pedestrian_tracks_000.csv", index=False)
    return folder / "vehicle_tracks_000.csv"


def ngsim(folder: Path) -> Path:
    table, foot = truth(10.0, straight=True), 0.3048
    ahead = table.length / 2
    columns = {
        "Vehicle_ID": table.id,
        "Frame_ID": table.frame,
        "Global_Time": 1118846980200 + 100 * table.frame,
    }
    columns |= {
        "Local_X": (table.x + ahead * np.cos(table.yaw)) / foot,
        "v_length": table.length / foot,
    }
    columns |= {
        "Local_Y": (table.y + ahead * np.sin(table.yaw)) / foot,
        "v_Width": table.width / foot,
    }
    columns |= {
        "v_Class": table.id.map({"1": 2, "2": 3, "3": 2}),
        "v_Vel": np.hypot(table.vx, table.vy) / foot,
    }
    pd.DataFrame(columns).to_csv(folder / "trajectories.csv", index=False)
    return folder / "trajectories.csv"


def argoverse(folder: Path) -> Path:
    table = truth(10.0)
    columns = {
        "TIMESTAMP": 315968330.0 + table.t,
        "TRACK_ID": table.id.map(lambda name: f"00000000-0000-{name}"),
    }
    columns |= {
        "OBJECT_TYPE": table.id.map({"1": "AV", "2": "AGENT", "3": "OTHERS"}),
        "X": table.x,
        "Y": table.y,
    }
    pd.DataFrame(columns | {"CITY_NAME": "PIT"}).sort_values("TIMESTAMP").to_csv(
        folder / "1.csv", index=False
    )
    return folder / "1.csv"


def own(folder: Path) -> Path:
    table = truth(10.0).drop(columns="frame")
    turned = table.assign(qx=0.0, qy=0.0, qz=np.sin(table.yaw / 2), qw=np.cos(table.yaw / 2)).drop(
        columns="yaw"
    )
    turned.assign(kind=table.id.map({"1": "car", "2": "truck", "3": "car"})).to_parquet(
        folder / "mine.parquet"
    )
    return folder / "mine.parquet"


SHAPES: dict[Callable[[Path], Path], tuple[float, str, float]] = {
    high_d: (25.0, "highD", 0.02),
    in_d: (25.0, "inD, rounD, exiD or uniD", 1e-6),
    interaction: (10.0, "INTERACTION", 1e-6),
    ngsim: (10.0, "NGSIM", 0.03),
    argoverse: (10.0, "Argoverse 1", 0.02),
    own: (10.0, "", 1e-6),
}
"""Rate, Hz, data set, and tolerance of positions, m (highD's are rounded to 1 cm)."""


def centres(scenario: Scenario) -> np.ndarray:
    """The centres of the ego's box `(n, 2)` in the table's coordinates."""
    ego, ahead = scenario.ego, scenario.vehicle.axle_to_center
    return (
        np.column_stack([ego.x + ahead * np.cos(ego.yaw), ego.y + ahead * np.sin(ego.yaw)])
        + scenario.origin
    )


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_every_shape_gives_the_same_drive(tmp_path: Path, shape: Callable[[Path], Path]) -> None:
    rate, source, tolerance = SHAPES[shape]
    path = shape(tmp_path)
    assert [log for log, reader in logs_in(tmp_path) if reader is not None] == [path]
    ego = "AV" if shape is argoverse else "1"
    scenario = read_log(path, LogSettings(ego=ego))
    table = truth(rate, straight=shape in (high_d, ngsim))
    mine = table[table.id == "1"]
    assert scenario.source == source and scenario.metadata[EGO_POSE] == CENTRE
    np.testing.assert_allclose(scenario.ego.t, mine.t, atol=1e-6)
    np.testing.assert_allclose(centres(scenario), mine[["x", "y"]], atol=max(tolerance, 1e-6))
    np.testing.assert_allclose(scenario.ego.v[5:], np.hypot(mine.vx, mine.vy)[5:], atol=0.05)
    np.testing.assert_allclose(
        scenario.ego.kappa[30:], 0.0 if shape in (high_d, ngsim) else 1.0 / 204.0, atol=1e-3
    )
    assert np.abs(scenario.ego.a[30:]).max() < 0.1
    if shape is not argoverse:
        assert (scenario.vehicle.length, scenario.vehicle.width) == pytest.approx(SIZES["1"])
    ids = [name.removeprefix("00000000-0000-") for name in scenario.tracks.ids]
    assert ids == ["2", "3"] + ["P1"] * (shape is interaction)
    for i, name in enumerate(("2", "3")):
        rows, theirs = table[table.id == name], scenario.tracks.samples(i)
        own_centres = (
            np.column_stack([scenario.tracks.x[theirs], scenario.tracks.y[theirs]])
            + scenario.origin
        )
        np.testing.assert_allclose(own_centres, rows[["x", "y"]], atol=2.0 * max(tolerance, 1e-6))
        np.testing.assert_allclose(scenario.tracks.t[theirs], rows.t, atol=1e-6)
        if shape is not argoverse:
            assert scenario.tracks.length[i] == pytest.approx(SIZES[name][0])
            assert scenario.tracks.kinds[i] is (AgentKind.TRUCK if name == "2" else AgentKind.CAR)
    if shape is interaction:
        assert scenario.tracks.kinds[2] is AgentKind.PEDESTRIAN and scenario.tracks.length[2] == 0.5


@pytest.mark.parametrize("ego", ["2", "3"])
@pytest.mark.parametrize("shape", [high_d, in_d, interaction, ngsim])
def test_any_vehicle_can_be_the_ego(
    tmp_path: Path, shape: Callable[[Path], Path], ego: str
) -> None:
    rate, _, tolerance = SHAPES[shape]
    scenario = read_log(shape(tmp_path), LogSettings(ego=ego))
    table = truth(rate, straight=shape in (high_d, ngsim))
    mine = table[table.id == ego]
    np.testing.assert_allclose(centres(scenario), mine[["x", "y"]], atol=3.0 * max(tolerance, 1e-6))
    assert (
        scenario.vehicle.length == pytest.approx(SIZES[ego][0]) and ego not in scenario.tracks.ids
    )
    assert scenario.tracks.t.min() == pytest.approx(-10 / rate, abs=1e-6)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_without_an_ego_those_who_drove_farthest_are_named(
    tmp_path: Path, shape: Callable[[Path], Path]
) -> None:
    path = shape(tmp_path)
    if shape is argoverse:
        assert read_log(path).ego.x[0] == read_log(path, LogSettings(ego="AV")).ego.x[0]
        return
    for ego, what in (("", "no ego"), ("99", "no agent 99")):
        with pytest.raises(LogError) as error:
            read_log(path, LogSettings(ego=ego))
        assert what in error.value.what and "--ego" in (error.value.remedy or "")
        assert [word for word in (error.value.remedy or "").split() if word in SIZES] == [
            "1",
            "2",
            "3",
        ]


def test_frames_need_a_rate(tmp_path: Path) -> None:
    path = in_d(tmp_path)
    whole = read_log(path, LogSettings(ego="1"))
    (tmp_path / "07_recordingMeta.csv").unlink()
    with pytest.raises(LogError, match=r'_recordingMeta\.csv .*"frame \[25 Hz\]"'):
        read_log(path, LogSettings(ego="1"))
    again = read_log(path, LogSettings(ego="1", columns={"t": "frame [25 Hz]"}))
    assert again.ego.t.tolist() == whole.ego.t.tolist()
    half = read_log(path, LogSettings(ego="1", columns={"t": "frame [12.5 Hz]"}))
    assert half.duration == pytest.approx(2.0 * whole.duration)


def test_columns_of_their_own_are_named(tmp_path: Path) -> None:
    path = tmp_path / "theirs.csv"
    names = {"t": "stamp", "id": "object", "x": "east", "y": "north", "yaw": "course"}
    truth(10.0).drop(columns="frame").rename(columns=names).to_csv(path, index=False)
    assert reader_of(path) is None
    with pytest.raises(LogError, match=r"columns stamp, object, east, .*\[log\.columns\]"):
        read_log(path, LogSettings(ego="1"))
    scenario = read_log(str(path), LogSettings(ego="1", columns=names))  # text names a log, too
    assert (
        scenario.ego.x.tolist()
        == from_frames("1", truth(10.0).drop(columns="frame")).ego.x.tolist()
    )


def test_the_point_of_the_ego_is_a_setting(tmp_path: Path) -> None:
    table = truth(10.0).drop(columns="frame")
    centre, axle = from_frames(1, table), from_frames(1, table, ego_point="rear_axle")
    np.testing.assert_allclose(
        centres(centre), np.column_stack([axle.ego.x, axle.ego.y]) + axle.origin
    )
    ego = table[table.id == "1"].drop(columns=["id", "vx", "vy", "length", "width"])
    ego.to_csv(tmp_path / "ego.csv", index=False)
    of_settings = [
        read_log(tmp_path, LogSettings(ego_point=point)) for point in ("", "rear_axle", "centre")
    ]
    assert (
        of_settings[0].ego.x.tolist() == of_settings[1].ego.x.tolist()
        and EGO_POSE not in of_settings[0].metadata
    )
    np.testing.assert_allclose(centres(of_settings[2]), ego[["x", "y"]], atol=1e-9)
    assert of_settings[2].metadata[EGO_POSE] == CENTRE
    with pytest.raises(ValueError, match="ego_point is 'middle'"):
        LogSettings(ego_point="middle")
    with pytest.raises(LogError, match=r"ego 1 is asked for, but ego\.csv has the ego"):
        read_log(tmp_path, LogSettings(ego="1"))


def test_quaternions_give_the_heading_of_both_tables() -> None:
    table = truth(10.0).drop(columns="frame")
    q = pd.DataFrame(
        {"qx": 0.0, "qy": 0.0, "qz": np.sin(table.yaw / 2), "qw": np.cos(table.yaw / 2)}
    )
    turned = pd.concat([table.drop(columns="yaw"), q], axis=1)
    mine, theirs = (
        each[each.id == "1"].drop(columns=["id", "vx", "vy"]) for each in (table, turned)
    )
    plain, other = (
        from_frames(mine, table[table.id != "1"]),
        from_frames(theirs, turned[turned.id != "1"]),
    )
    np.testing.assert_allclose(other.ego.yaw, plain.ego.yaw, atol=1e-9)
    np.testing.assert_allclose(np.cos(other.tracks.yaw - plain.tracks.yaw), 1.0, atol=1e-9)
    with pytest.raises(LogError, match="quaternion of row 0 is not of unit length"):
        from_frames(theirs.assign(qw=2.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: pd.concat([table, table.assign(Location="i-80")]), "2 recordings"),
        (lambda table: pd.concat([table, table[table.Vehicle_ID == "1"]]), "two rows of one time"),
        (lambda table: table[(table.Vehicle_ID != "1") | (table.Frame_ID == 5)], "one row"),
        (lambda table: table[table.Vehicle_ID == "9"], "no rows"),
        (lambda table: table.assign(v_Class=8), "an agent is a '8'"),
        (
            lambda table: table.assign(Local_X=1.0, Local_Y=1.0),
            "moves less than 1 m and has no heading",
        ),
    ],
)
def test_ambiguous_tables_are_refused(
    tmp_path: Path, change: Callable[[pd.DataFrame], pd.DataFrame], words: str
) -> None:
    table = pd.read_csv(ngsim(tmp_path), dtype={"Vehicle_ID": str}).assign(Location="us-101")
    with pytest.raises(LogError) as error:
        from_frames("1", change(table))
    assert words in str(error.value) and "\n" not in str(error.value)


def test_only_the_time_of_the_ego_is_read(tmp_path: Path) -> None:
    table = truth(10.0).drop(columns="frame")
    late = table.assign(t=table.t + 600.0, id="late " + table.id)
    scenario = from_frames("1", pd.concat([table, late]))
    assert scenario.tracks.ids == ("2", "3") and scenario.duration == pytest.approx(11.9)
    assert any("611.9 s" in note for note in scenario.notes)
    assert replace(scenario, notes=()).ego.x.tolist() == from_frames("1", table).ego.x.tolist()


@given(CHANGES)
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_mutated_tables_are_read_or_refused(tmp_path: Path, changes: list[tuple[int, int]]) -> None:
    path = in_d(tmp_path)
    head = b"".join(path.read_bytes().splitlines(keepends=True)[:60])
    path.write_bytes(changed(head, changes))
    with_ego = LogSettings(ego="1")
    try:
        read_log(path, with_ego)
    except LogError as error:
        assert "\n" not in str(error)
    read_or_refused(path)
