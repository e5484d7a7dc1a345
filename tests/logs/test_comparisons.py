"""What a log states twice: each row of the table, by drives of several shapes and rates.

A wrong log reads as the right one, with a note; or it is refused, and reads as the right one when
its remedy is followed to the letter.
"""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.core.settings import strict
from replan.logs.comparisons import COMPARISONS
from replan.logs.log_settings import LogSettings
from replan.logs.readers import logs_in, read_log
from replan.logs.scenario import Scenario

DOCS = Path(__file__).parents[2] / "docs"
WHEELBASE = 2.578904
Tables = tuple[pd.DataFrame, pd.DataFrame]
Fault = Callable[[pd.DataFrame, pd.DataFrame], Tables]

SHAPES: dict[str, tuple[float, Callable[[FloatArray], FloatArray]]] = {
    "bend": (0.4, lambda t: 0.0 * t + 0.08),
    "slalom": (2.1, lambda t: 0.2 * np.sin(0.6 * t)),
    "right turn": (-1.0, lambda t: np.where((t > 4.0) & (t < 9.0), -0.3, 0.0)),
}
"""First heading, rad, and yaw rate over time, rad/s."""


def drive(shape: str, rate: float, seconds: float = 16.0) -> Tables:
    """A drive that brakes and accelerates, behind a car and past parked ones."""
    ahead_s = 1.5
    fine = np.arange(0.0, seconds + ahead_s, 0.005)
    yaw0, turn = SHAPES[shape]
    v = 9.0 + 1.5 * np.sin(0.5 * fine)
    yaw = yaw0 + np.cumsum(turn(fine)) * 0.005
    x, y = np.cumsum(v * np.cos(yaw)) * 0.005, np.cumsum(v * np.sin(yaw)) * 0.005
    steps = round(200.0 / rate)
    keep = slice(None, None, steps)
    ego = pd.DataFrame({"t": fine, "x": x, "y": y, "yaw": yaw, "v": v})
    ego["a"] = 0.75 * np.cos(0.5 * fine)
    ego["kappa"] = turn(fine) / v
    ego["steer"] = np.arctan(WHEELBASE * ego.kappa)
    lead = ego[["t", "x", "y", "yaw"]].assign(t=fine - ahead_s)
    lead["x"] -= 3.4 * np.sin(lead.yaw)
    lead["y"] += 3.4 * np.cos(lead.yaw)
    lead["vx"], lead["vy"] = np.gradient(lead.x, lead.t), np.gradient(lead.y, lead.t)
    lead = lead[round(200 * ahead_s) :][keep].reset_index(drop=True)
    lead["t"] = lead.t.round(9)
    ego = ego[: round(200 * seconds)][keep].reset_index(drop=True)
    parked = lead.assign(x=x[-1] + 9.0, y=y[-1] + 9.0, vx=0.0, vy=0.0)
    agents = pd.concat([lead.assign(id="7"), parked.assign(id="8")], ignore_index=True)
    return ego, agents.assign(length=4.5, width=1.8, kind="car")


def column(table: str, name: str, change: Callable[[pd.DataFrame], Any]) -> Fault:
    """A fault in one column of a table."""

    def wrong(ego: pd.DataFrame, agents: pd.DataFrame) -> Tables:
        tables = {"ego": ego, "agents": agents}
        tables[table] = tables[table].assign(**{name: change(tables[table])})
        return tables["ego"], tables["agents"]

    return wrong


def own_axes(left: float, forward: float = 1.0) -> Fault:
    """Velocities of the agents along and across their headings."""

    def wrong(ego: pd.DataFrame, agents: pd.DataFrame) -> Tables:
        c, s = np.cos(agents.yaw), np.sin(agents.yaw)
        along, across = c * agents.vx + s * agents.vy, c * agents.vy - s * agents.vx
        return ego, agents.assign(vx=forward * along, vy=left * across)

    return wrong


def swapped(ego: pd.DataFrame, agents: pd.DataFrame) -> Tables:
    return ego, agents.rename(columns={"length": "width", "width": "length"})


def ticks(per_s: float) -> Fault:
    """Both tables' times as whole numbers of another unit."""

    def wrong(ego: pd.DataFrame, agents: pd.DataFrame) -> Tables:
        return (
            ego.assign(t=np.round(ego.t * per_s).astype(np.int64)),
            agents.assign(t=np.round(agents.t * per_s).astype(np.int64)),
        )

    return wrong


def with_noise(ego: pd.DataFrame, agents: pd.DataFrame) -> Tables:
    rng = np.random.default_rng(7)
    n = len(ego)
    noisy = ego.assign(
        x=ego.x + 0.02 * rng.normal(size=n),
        y=ego.y + 0.02 * rng.normal(size=n),
        yaw=ego.yaw + np.radians(3.0),
        v=1.05 * ego.v,
        a=ego.a + 0.3 * rng.normal(size=n),
        kappa=ego.kappa + 0.003 * rng.normal(size=n),
        steer=1.1 * ego.steer,
    )
    lost = (agents.t > 5.0) & (agents.t < 7.0)
    return noisy, agents[~lost]


MENDED: dict[str, tuple[Fault, str]] = {
    "speed with the other sign": (column("ego", "v", lambda e: -e.v), "with the other sign"),
    "speed in km/h": (column("ego", "v", lambda e: 3.6 * e.v), "in km/h"),
    "speed in mph": (column("ego", "v", lambda e: e.v / 0.44704), "in mph"),
    "speed in knots": (column("ego", "v", lambda e: e.v * 3600 / 1852), "in kn"),
    "speed in cm/s": (column("ego", "v", lambda e: 100.0 * e.v), "in cm/s"),
    "speed of 0": (column("ego", "v", lambda e: 0.0 * e.v), "is not used"),
    "acceleration with the other sign": (column("ego", "a", lambda e: -e.a), "other sign"),
    "acceleration in g": (column("ego", "a", lambda e: e.a / 9.80665), "in g"),
    "acceleration of 0": (column("ego", "a", lambda e: 0.0 * e.a), "is not used"),
    "curvature with the other sign": (column("ego", "kappa", lambda e: -e.kappa), "other sign"),
    "radius": (
        column("ego", "kappa", lambda e: np.where(e.kappa == 0, 0, 1 / e.kappa.replace(0, 1))),
        "as the radius",
    ),
    "curvature in degrees": (column("ego", "kappa", lambda e: np.degrees(e.kappa)), "in degrees"),
    "yaw rate": (column("ego", "kappa", lambda e: e.kappa * e.v), "as the yaw rate"),
    "steering with the other sign": (column("ego", "steer", lambda e: -e.steer), "other sign"),
    "steering in degrees": (column("ego", "steer", lambda e: np.degrees(e.steer)), "in degrees"),
    "steering wheel": (column("ego", "steer", lambda e: 16.0 * e.steer), "16 times as large"),
    "sides of boxes": (swapped, "Length and width of the vehicles are exchanged"),
    "velocities in own axes": (own_axes(1.0), "in own axes"),
    "velocities forward and right": (own_axes(-1.0), "axes and are rotated"),
    "velocities backward": (own_axes(1.0, -1.0), "axes and are rotated"),
    "velocities with y down": (column("agents", "vy", lambda a: -a.vy), "world, y reversed"),
    "velocities in km/h": (
        lambda ego, agents: (ego, agents.assign(vx=3.6 * agents.vx, vy=3.6 * agents.vy)),
        "world, in km/h",
    ),
    "agents on GPS time": (column("agents", "t", lambda a: a.t + 18.0), "as GPS time"),
    "ego on TAI": (column("agents", "t", lambda a: a.t - 37.0), "as TAI"),
    "agents in another time zone": (
        column("agents", "t", lambda a: a.t + 5.5 * 3600.0),
        "a time zone of +5.5 h",
    ),
    "times in ms": (ticks(1e3), "taken for ms"),
    "times in us": (ticks(1e6), "taken for us"),
    "times in ns": (ticks(1e9), "taken for ns"),
}
"""Faults that are mended, and words of the note."""
TOLD_BY_A_BEND = ("curvature", "radius", "yaw rate", "steering", "velocities forward")


def saved(folder: Path, tables: Tables) -> Path:
    folder.mkdir()
    for name, table in zip(("ego", "agents"), tables, strict=True):
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def assert_same(read: Scenario, right: Scenario) -> None:
    """Positions and speeds are equal; what is derived is within the error of differences."""
    np.testing.assert_allclose(read.ego.x, right.ego.x, atol=1e-6)
    np.testing.assert_allclose(read.ego.yaw, right.ego.yaw, atol=1e-6)
    np.testing.assert_allclose(read.ego.v, right.ego.v, atol=0.5)
    np.testing.assert_allclose(read.ego.a[1:], right.ego.a[1:], atol=0.5)
    assert np.median(np.abs(read.ego.kappa - right.ego.kappa)) < 0.005
    assert read.tracks.ids == right.tracks.ids
    np.testing.assert_allclose(read.tracks.t, right.tracks.t, atol=1e-6)
    np.testing.assert_allclose(read.tracks.x, right.tracks.x, atol=1e-6)
    np.testing.assert_allclose(read.tracks.length, right.tracks.length)
    for name in ("vx", "vy"):
        np.testing.assert_allclose(
            getattr(read.tracks, name), getattr(right.tracks, name), atol=0.05
        )
    if read.controls is not None and right.controls is not None:
        np.testing.assert_allclose(read.controls.steer, right.controls.steer, atol=1e-6)


@pytest.mark.parametrize("rate", [5.0, 10.0, 50.0])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fault", MENDED)
def test_a_contradiction_is_mended_with_a_note(
    fault: str, shape: str, rate: float, tmp_path: Path
) -> None:
    right = drive(shape, rate)
    wrong, words = MENDED[fault]
    read = read_log(saved(tmp_path / "wrong", wrong(*right)))
    whole = read_log(saved(tmp_path / "right", right))
    assert any(words in note for note in read.notes), read.notes
    assert_same(read, whole)


@pytest.mark.parametrize("rate", [2.0, 10.0, 100.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_small_errors_are_no_contradictions(shape: str, rate: float, tmp_path: Path) -> None:
    tables = with_noise(*drive(shape, rate))
    read = read_log(saved(tmp_path / "log", tables))
    assert not [
        note
        for note in read.notes
        if re.search(r"contradict|exchanged|axes|clock|taken for|not used|left out", note)
    ]
    np.testing.assert_array_equal(read.ego.v, tables[0].v)


REFUSED: dict[str, tuple[Fault, str]] = {
    "ego in degrees": (column("ego", "yaw", lambda e: np.degrees(e.yaw)), "look like degrees"),
    "ego in degrees from north": (
        column("ego", "yaw", lambda e: 90.0 - np.degrees(e.yaw)),
        "look like degrees clockwise from north",
    ),
    "ego in rad from north": (
        column("ego", "yaw", lambda e: 0.5 * np.pi - e.yaw),
        "look like rad clockwise from north",
    ),
    "ego mirrored": (column("ego", "yaw", lambda e: -e.yaw), "look like rad clockwise from x"),
    "agents in degrees": (
        column("agents", "yaw", lambda a: np.degrees(a.yaw)),
        "look like degrees",
    ),
    "agents in degrees from north": (
        column("agents", "yaw", lambda a: 90.0 - np.degrees(a.yaw)),
        "look like degrees clockwise from north",
    ),
    "agents 7.3 s late": (column("agents", "t", lambda a: a.t + 7.3), "another clock"),
    "words that are not known": (
        column("agents", "kind", lambda a: "quad"),
        "an agent is a 'quad'",
    ),
}
"""Faults that are refused, and words of the refusal."""


def settings_of(remedy: str) -> LogSettings:
    """The settings that a remedy names: what stands behind "in [log]: ", up to the first "or"."""
    stated = remedy.partition("in [log]: ")[2]
    first = re.split(r"; |, or | or ", stated)[0]
    return strict(LogSettings, tomllib.loads(first))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fault", REFUSED)
def test_a_remedy_that_is_followed_to_the_letter_works(
    fault: str, shape: str, tmp_path: Path
) -> None:
    right = drive(shape, 10.0)
    wrong, words = REFUSED[fault]
    path = saved(tmp_path / "wrong", wrong(*right))
    with pytest.raises(LogError, match=words) as refused:
        read_log(path)
    assert refused.value.remedy is not None
    assert_same(
        read_log(path, settings_of(refused.value.remedy)),
        read_log(saved(tmp_path / "right", right)),
    )


@pytest.mark.parametrize("rate", [10.0, 50.0])
@pytest.mark.parametrize("yaw", [0.0, 1.2])
def test_headings_across_a_straight_drive_are_refused_and_can_be_left_out(
    yaw: float, rate: float, tmp_path: Path
) -> None:
    t = np.arange(0.0, 12.0, 1.0 / rate)
    ego = pd.DataFrame({"t": t, "x": 9.0 * t * np.cos(yaw), "y": 9.0 * t * np.sin(yaw), "v": 9.0})
    agents = ego.rename(columns={"v": "speed"}).assign(id="7", x=ego.x + 20.0, yaw=yaw)
    path = saved(tmp_path / "log", (ego.assign(yaw=yaw + 0.5 * np.pi), agents))
    with pytest.raises(LogError, match=r"1\.57 rad off the direction of motion") as refused:
        read_log(path)
    assert refused.value.remedy is not None
    left_out = refused.value.remedy.rpartition("a table: ")[2].removesuffix(" in [log])")
    read = read_log(path, strict(LogSettings, tomllib.loads(left_out.replace("'", ""))))
    np.testing.assert_allclose(read.ego.yaw, yaw, atol=1e-6)
    assert any("no headings of the ego" in note for note in read.notes)


def test_settings_that_take_the_log_as_it_is(tmp_path: Path) -> None:
    right = drive("bend", 10.0, seconds=40.0)
    own = saved(tmp_path / "own", own_axes(1.0)(*right))
    as_it_is = read_log(own, LogSettings(agents_axes="world"))
    np.testing.assert_allclose(as_it_is.tracks.vy, own_axes(1.0)(*right)[1].vy, atol=1e-9)
    stated = read_log(own, LogSettings(agents_axes="own"))
    np.testing.assert_allclose(stated.tracks.vx, right[1].vx, atol=1e-9)
    late = column("agents", "t", lambda a: a.t + 18.0)(*right)
    gps = saved(tmp_path / "gps", late)
    assert read_log(gps, LogSettings(clock_ahead_s=0.0)).tracks.t[0] == pytest.approx(18.0)
    assert read_log(gps, LogSettings(clock_ahead_s=17.0)).tracks.t[0] == pytest.approx(1.0)


@pytest.mark.parametrize("point", ["centre", "front", "rear"])
def test_the_point_of_positions_is_stated(point: str, tmp_path: Path) -> None:
    ego, agents = drive("bend", 10.0)
    right = read_log(saved(tmp_path / "right", (ego, agents)))
    car = right.vehicle
    ahead = {"centre": car.axle_to_center, "front": car.axle_to_front, "rear": -car.rear_overhang}
    half = {"centre": 0.0, "front": 2.25, "rear": -2.25}[point]
    moved = ego.assign(
        x=ego.x + ahead[point] * np.cos(ego.yaw), y=ego.y + ahead[point] * np.sin(ego.yaw)
    )
    others = agents.assign(
        x=agents.x + half * np.cos(agents.yaw), y=agents.y + half * np.sin(agents.yaw)
    )
    path = saved(tmp_path / "moved", (moved, others))
    read = read_log(path, LogSettings(ego_point=point, agents_point=point))
    ego_place = np.column_stack([read.ego.x, read.ego.y]) + read.origin
    np.testing.assert_allclose(ego_place, ego[["x", "y"]], atol=1e-6)
    np.testing.assert_allclose(
        np.column_stack([read.tracks.x, read.tracks.y]) + read.origin,
        agents[["x", "y"]],
        atol=1e-6,
    )


def test_every_row_has_a_test() -> None:
    own = Path(__file__).read_text(encoding="utf-8")
    elsewhere = "".join(
        (Path(__file__).parent / name).read_text(encoding="utf-8")
        for name in ("test_conventions.py", "test_heights.py", "readers/ros/test_ros.py")
    )
    words = {
        "times of a table without a unit": "times in ms",
        "velocity of an odometry": "test_the_twist_of_an_odometry",
        "heights of road users": "test_a_bridge",
        "times of the road users": "agents on GPS time",
        "positions": "test_degrees_of_latitude",
        "headings": "ego in degrees",
        "steering angle": "steering wheel",
        "places of a road user": "is the ego itself",
        "length and width of vehicles": "sides of boxes",
        "velocities of road users": "velocities in own axes",
    }
    assert {row.subject for row in COMPARISONS} == set(words)
    assert all(word in own + elsewhere for word in words.values())


@pytest.mark.nightly
def test_recorded_logs_state_nothing_twice_in_contradiction(shared_data: Path) -> None:
    """Every recorded log that is not an example of a contradiction reads without such a note."""
    words = re.compile(
        r"contradict|are exchanged|axes and are|fits the poses|shifted by|not used \("
    )
    noted = {}
    for path, reader in logs_in(shared_data):
        if reader is None or path.is_relative_to(shared_data / "users"):
            continue
        try:
            notes = read_log(path).notes
        except LogError:
            continue
        noted[path] = [note for note in notes if words.search(note)]
    assert len(noted) > 100
    assert not {path: notes for path, notes in noted.items() if notes}


def test_sizes_of_a_vehicle_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    log = saved(tmp_path / "log", drive("bend", 10.0))
    with pytest.raises(LogError, match=r"a wheelbase of 6 m does not fit a length of 4\.2 m"):
        read_log(log, LogSettings(car={"length": 4.2, "wheelbase": 6.0}))
    sizes = {"length": 9.4, "wheelbase": 5.5, "rear_overhang": 2.4}
    assert read_log(log, LogSettings(car=sizes)).vehicle.wheelbase == 5.5
