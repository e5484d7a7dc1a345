"""Argoverse 2 as published: sensor logs and motion-forecasting scenarios, whole, without parts, and
damaged.
"""

from pathlib import Path

import numpy as np
import pytest
from any_bytes import goes_round, read_or_refused, spoiled
from hypothesis import HealthCheck, given, settings, strategies as st
from recorded_cases import write_av2, write_forecasting

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.readers import LogSettings, logs_in, read_log, reader_of
from replan.logs.readers.argoverse2 import POSES, READER
from replan.logs.road import RoadSource

LOGS = ("3b3570b4-7b0b-3268-a571-b0889dbf40b6", "7fab2350-7eaf-3b7e-a39d-6937a4c1bede")


def test_a_sensor_log_arrives(tmp_path: Path) -> None:
    folder = write_av2(tmp_path / "log")
    assert (
        READER.claims(folder)
        and reader_of(folder / POSES) is READER
        and not READER.claims(tmp_path)
    )
    scenario = read_log(folder)
    ego, tracks, road = scenario.ego, scenario.tracks, scenario.road
    assert (
        scenario.start_ns == 10**17 + 150_000_000
        and len(ego) == 29
        and scenario.origin == (50.0, 201.0)
    )
    assert ego.y + 201.0 == pytest.approx(201.2 + 8.0 * ego.t) and ego.x == pytest.approx(0.0)
    assert (
        ego.yaw == pytest.approx(np.pi / 2)
        and ego.v == pytest.approx(8.0)
        and ego.a == pytest.approx(0.0, abs=1e-6)
    )
    assert (tracks.ids, tracks.kinds) == (("a",), (AgentKind.BUS,))  # not the ego's own box
    bus = tracks.samples(0)
    assert tracks.x[bus] + 50.0 == pytest.approx(46.5) and tracks.y[bus] == pytest.approx(
        0.2 + 20.0 + 8.0 * tracks.t[bus]
    )
    assert tracks.yaw[bus] == pytest.approx(np.pi / 2) and np.isnan(tracks.vx).all()
    assert tracks.perceived(0.0).vy == pytest.approx(8.0)  # known at the start
    one = road.lanes[1]
    assert (
        one.left_opposite
        and one.left_neighbour is None
        and one.successors == (7,)
        and len(one.left) == len(one.right) == 3
    )
    assert not one.left_crossable and one.right_crossable and road.drives_on_right
    (walk,) = road.crosswalks
    assert walk.polygon + scenario.origin == pytest.approx(
        np.array([[44.0, 240.0], [52.0, 240.0], [52.0, 243.0], [44.0, 243.0]])
    )
    assert [path.name for path in READER.files(folder)] == [
        POSES,
        "annotations.feather",
        "log_map_archive_x.json",
    ]
    assert {topic.topic: topic.messages for topic in READER.contents(folder).topics} == {
        POSES: 300,
        "annotations.feather": 60,
    }


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    folder = write_av2(tmp_path / "log")
    (folder / "annotations.feather").unlink()
    (folder / "map" / "log_map_archive_x.json").unlink()
    scenario = read_log(folder)
    assert not len(scenario.tracks) and scenario.road.source is RoadSource.DRIVEN_PATH
    assert len(scenario.ego) == pytest.approx(29, abs=1) and any(
        "no annotations" in note for note in scenario.notes
    )
    (folder / POSES).write_bytes(b"no table")
    with pytest.raises(LogError, match=rf"{POSES}: cannot be read: .*copy the log again"):
        read_log(folder)


def test_a_forecasting_scenario_arrives(tmp_path: Path) -> None:
    folder = write_forecasting(tmp_path / "abc")
    assert [reader for _, reader in logs_in(tmp_path)] == [READER]
    assert reader_of(folder / "scenario_abc.parquet") is READER
    scenario = read_log(folder)
    ego, tracks = scenario.ego, scenario.tracks
    back = scenario.vehicle.axle_to_center
    assert (scenario.name, len(ego), scenario.duration) == (
        "scenario_abc",
        110,
        pytest.approx(10.9),
    )
    assert ego.v == pytest.approx(8.0) and ego.y + 200.0 == pytest.approx(
        200.0 - back + 8.0 * ego.t
    )
    assert set(tracks.ids) == {"17", "b"}
    bus = tracks.ids.index("17")
    assert (
        tracks.kinds[bus] is AgentKind.BUS
        and tracks.length[bus] == 12.0
        and tracks.vy[tracks.samples(bus)][0] == 6.0
    )
    assert tracks.static[tracks.ids.index("b")] and set(scenario.road.lanes) == {1, 2}
    other = read_log(folder, LogSettings(ego="17"))
    assert other.ego.v == pytest.approx(6.0) and set(other.tracks.ids) == {"AV", "b"}
    with pytest.raises(
        LogError, match=r"there is no track '99'; name the ego; there are AV, 17, b"
    ):
        read_log(folder, LogSettings(ego="99"))
    assert READER.contents(folder).topics[0].messages == 330
    write_forecasting(tmp_path / "abd", 20)
    for path in (tmp_path / "abd").iterdir():  # two in one folder: each is a log, with its own map
        path.rename(folder / path.name)
    assert [path.name for path, _ in logs_in(folder)] == [
        "scenario_abc.parquet",
        "scenario_abd.parquet",
    ]
    assert READER.files(folder / "scenario_abd.parquet")[1].name == "log_map_archive_abd.json"


@pytest.mark.parametrize("write", [write_av2, write_forecasting])
def test_round_trip(tmp_path: Path, write: object) -> None:
    goes_round(read_log(write(tmp_path / "log")), tmp_path)  # type: ignore[operator]


@pytest.mark.parametrize("name", LOGS)
def test_real_logs(shared_data: Path, tmp_path: Path, name: str) -> None:
    """On their lanes all the time, at a plausible speed; and round."""
    scenario = read_log(shared_data / "argoverse2" / name)
    ego, road = scenario.ego, scenario.road
    assert (
        150 < len(ego) < 160
        and ego.v.min() >= -0.01
        and ego.v.max() < 13.0
        and np.abs(ego.a).max() < 4.0
    )
    assert all(road.is_drivable(x, y) for x, y in zip(ego.x, ego.y, strict=True))
    way = np.hypot(np.diff(ego.x), np.diff(ego.y)).sum()
    assert np.sum(np.diff(ego.t) * 0.5 * (ego.v[1:] + ego.v[:-1])) == pytest.approx(way, rel=0.02)
    goes_round(scenario, tmp_path)


MUTATIONS = 200
SECONDS = 2.0


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, bytes]:
    root = tmp_path_factory.mktemp("fuzz")
    found = [
        *READER.files(write_av2(root / "sensor", 6)),
        *READER.files(write_forecasting(root / "forecast", 12)),
    ]
    read_log(root / "sensor"), read_log(root / "forecast")
    return {path: path.read_bytes() for path in found}


@given(st.integers(0, 4), st.data())
@settings(max_examples=MUTATIONS, deadline=None, suppress_health_check=list(HealthCheck))
def test_damage_is_an_error_that_names_the_log(
    damaged: dict[Path, bytes], which: int, data: st.DataObject
) -> None:
    """200 mutated files: a scenario or a LogError, each within 2 s."""
    path = list(damaged)[which]
    path.write_bytes(spoiled(damaged[path], data))
    folder = path.parent.parent if path.parent.name == "map" else path.parent
    try:
        read_or_refused(folder, SECONDS)
        READER.contents(folder), READER.files(folder)
    finally:
        path.write_bytes(damaged[path])
