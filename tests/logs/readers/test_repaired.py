"""`[log] repair` on native logs: raw ones, clean ones, parts of both.

And the command that does it.
"""

import csv
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from command_line import replan
from crowd import street, street_ego
from differences import differences
from rich_scenario import repaired_scenario, rich_scenario

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.catalogue.detector import detected
from replan.logs.complete import passed_width
from replan.logs.edit.cut import DETECTED_S, HISTORY_S, cut
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, read_log, with_tracks
from replan.logs.repair.detections import Detections
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks

EGO = street_ego()


@cache
def raw() -> Scenario:
    """What a detector sees of a street, and no tracks."""
    road = Road.along(np.column_stack([EGO.x, EGO.y]), speed_limit=10.0)
    return Scenario(
        "raw",
        EGO,
        Tracks.empty(),
        road,
        20.0,
        detections=detected(street(), EGO, 3),
        start_ns=10**18,
    )


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("raw") / "raw.mcap"
    write_scenario(path, raw())
    return path


@pytest.fixture(scope="module")
def made(log: Path) -> Scenario:
    return read_log(log)


def drivers(*offsets: float, turn: float = 0.0) -> Tracks:
    """Cars that go along x, those on the left against it, turned about the origin.

    One more crosses, one parks.
    """
    t = np.arange(0.0, 4.0, 0.1)
    ways = [(10.0 + 5.0 * np.sign(-y) * t, y + 0.0 * t, 5.0 * np.sign(-y), 0.0) for y in offsets]
    ways += [(30.0 + 0.0 * t, 4.0 * t - 8.0, 0.0, 4.0), (20.0 + 0.0 * t, 2.5 + 0.0 * t, 0.0, 0.0)]
    n, c, s = len(ways), np.cos(turn), np.sin(turn)
    x, y = (np.concatenate([way[i] for way in ways]) for i in (0, 1))
    vx, vy = (np.repeat([way[i] for way in ways], len(t)) for i in (2, 3))
    size = np.full(n, 4.5), np.full(n, 1.8), np.zeros(n, np.bool_), len(t) * np.arange(n + 1)
    place = (
        c * x - s * y,
        s * x + c * y,
        np.full(n * len(t), turn),
        c * vx - s * vy,
        s * vx + c * vy,
    )
    return Tracks(tuple(map(str, range(n))), (AgentKind.CAR,) * n, *size, np.tile(t, n), *place)


@pytest.mark.parametrize(
    ("offsets", "width"),
    [
        ((3.1, 3.3, -3.2), 3.2),
        ((3.2, -3.2), 3.5),
        ((3.2, -3.2, 0.3, 7.0), 3.5),
        ((5.0, 5.1, 5.2), 4.0),
    ],
)
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_a_lane_is_as_wide_as_the_next_one_is_away(
    offsets: tuple[float, ...], width: float, turn: float
) -> None:
    ahead, notes = np.array([np.cos(turn), np.sin(turn)]), list[str]()
    road = Road.along(np.outer(np.arange(40.0), ahead), speed_limit=10.0)
    (lane,) = passed_width(road, drivers(*offsets, turn=turn), notes).lanes.values()
    assert np.hypot(*(lane.left - lane.right).T) == pytest.approx(width)
    assert 0.5 * (lane.left + lane.right) @ [-ahead[1], ahead[0]] == pytest.approx(0.0, abs=1e-9)
    assert ("width is assumed" in " ".join(notes)) == (width != 3.5)


def first(seconds: float) -> Detections:
    """The detections of the first seconds of it."""
    found = raw().detections
    assert found is not None
    return found.between(0.0, seconds)


def test_a_raw_log_is_repaired_as_it_is_read(log: Path, made: Scenario) -> None:
    assert differences(read_scenario(log), raw()) == [], "the file holds the detections alone"
    assert made.repair is not None and made.detections is None and 6 <= len(made.tracks) <= 12
    assert differences(with_tracks(raw(), LogSettings()).tracks, made.tracks) == []
    off = read_log(log, LogSettings(repair="off"))
    assert off.repair is None and off.detections is None and len(off.tracks) == 0


def test_a_part_of_a_repaired_log_is_the_wholes(made: Scenario, tmp_path: Path) -> None:
    write_scenario(tmp_path / "made.mcap", made)
    part, asked = (
        cut(made, 12.0, 15.0),
        read_log(tmp_path / "made.mcap", LogSettings(begin=12.0, end=15.0)),
    )
    assert part.repair is not None and asked.repair is not None
    for name in ("t", "x", "y", "yaw", "vx"):
        np.testing.assert_allclose(
            getattr(asked.tracks, name), getattr(part.tracks, name), atol=1e-9
        )
    assert part.repair.tracks is part.tracks and part.repair.extended.shape == part.tracks.t.shape
    frames = part.repair.detections.frames
    assert frames[0] == pytest.approx(-DETECTED_S) and frames[-1] <= 3.0 + HISTORY_S
    assert all(
        change.begin <= 3.0 + HISTORY_S and change.end >= -DETECTED_S
        for change in part.repair.changes
    )
    both = cut(repaired_scenario(), 1.0, 2.0).repair
    assert both is not None and both.extended.sum() == 4 and both.removed.t.max() < 0.0


def test_a_clean_log_is_repaired_on_demand_only(tmp_path: Path) -> None:
    write_scenario(tmp_path / "rich.mcap", rich_scenario())
    clean = read_log(tmp_path / "rich.mcap")
    assert clean.repair is None
    assert differences(clean, read_log(tmp_path / "rich.mcap", LogSettings(repair="off"))) == []
    asked = read_log(tmp_path / "rich.mcap", LogSettings(repair="on"))
    assert asked.repair is not None and "It was asked for." in asked.notes[-1]
    assert "post" in asked.tracks.ids, "who never moves stays as they are"
    assert asked.tracks.static[asked.tracks.ids.index("post")]
    with pytest.raises(ValueError, match="auto, on or off"):
        LogSettings(repair="yes")


def test_detections_beyond_the_limits_are_left_out_and_noted() -> None:
    found = first(4.0)
    far, fast = found.x.copy(), found.vx.copy()
    far[:3] = 1e9
    fast[5] = 1e6
    ids = ("a\nb", *found.ids[1:])
    length = np.where(np.arange(len(found)) == 7, 1e9, found.length)
    made = with_tracks(
        replace(raw(), detections=replace(found, x=far, vx=fast, ids=ids, length=length)),
        LogSettings(),
    )
    assert made.repair is not None and len(made.repair.detections) == len(found) - 3
    assert np.nanmax(np.abs(made.repair.detections.vx), initial=0.0) < 200.0
    assert np.nanmax(made.repair.detections.length) < 100.0
    assert any("3 detections beyond the limits" in note for note in made.notes)


def test_frames_within_a_nanosecond_are_one(tmp_path: Path) -> None:
    found = first(2.0)
    late = np.where(np.arange(len(found)) % 2, found.t, found.t + 1e-11)
    late = np.where(found.t >= 1.0, np.sort(late), found.t)
    frames = np.unique(np.r_[found.frames, late])
    assert len(frames) > len(found.frames)
    split = replace(raw(), detections=replace(found, t=late, frames=frames))
    made = with_tracks(split, LogSettings()).repair
    assert made is not None and np.array_equal(made.detections.frames, found.frames)
    with pytest.raises(LogError, match="two frames of detections on one nanosecond"):
        write_scenario(tmp_path / "split.mcap", split)


def test_the_command_writes_the_log_and_its_table(
    log: Path, made: Scenario, tmp_path: Path
) -> None:
    out, table = tmp_path / "deep" / "out.mcap", tmp_path / "changes.csv"
    result = replan("repair", log, "-o", out, "--table", table)
    assert result.exit_code == 0 and str(out) in result.stdout
    written = read_scenario(out)
    assert made.repair is not None and differences(written.repair, made.repair) == []
    rows = list(csv.DictReader(StringIO(table.read_text(encoding="utf-8"))))
    assert [row["agent"] for row in rows] == [change.agent for change in made.repair.changes]
    assert list(rows[0]) == ["what", "agent", "t_from_s", "t_to_s", "samples", "why", "sources"]
    again = replan("repair", out, "-o", tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == out.read_bytes() and "joined" in again.stdout
    write_scenario(tmp_path / "rich.mcap", rich_scenario())
    assert (
        "not repaired"
        in replan("repair", tmp_path / "rich.mcap", "-o", tmp_path / "same.mcap").stdout
    )
