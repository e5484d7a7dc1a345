"""Drives as a detector sees them: what their logs hold, how well they are repaired, the same drive
in each form.
"""

from pathlib import Path

import numpy as np
import pytest
from track_score import repaired_score

from replan.cli.synth import ROS2, synthesise
from replan.logs.catalogue import CATALOGUE, FAMILIES, raw
from replan.logs.readers import read_log
from replan.logs.repair.detections import Detections, needs_repair
from replan.logs.scenario import Scenario
from replan.run.log_source import LogSource


def detections(name: str, **parameters: float) -> Detections:
    found = FAMILIES[name].scenario(**parameters).detections
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["raw/crossing", "raw/queue", "raw/parked", "raw/rider"])
def test_a_log_holds_detections_and_no_true_tracks(name: str) -> None:
    made = FAMILIES[name].scenario()
    assert made.detections is not None
    assert len(made.tracks) == 0
    assert made.repair is None
    assert "no identities" in (needs_repair(made.detections) or "")
    assert made.ego.t[-1] == made.duration == made.detections.frames[-1]


@pytest.mark.parametrize(
    "name",
    [
        "raw/crossing",
        *(
            pytest.param(f"raw/{name}", marks=pytest.mark.slow)
            for name in ("queue", "parked", "rider")
        ),
    ],
)
def test_a_repair_finds_the_road_users_again(name: str) -> None:
    found = repaired_score(raw.TRUE[name](FAMILIES[name].parameters), 1)
    assert found.hota > 0.9
    assert found.idf1 > 0.95
    assert found.lost == 0
    assert found.ghosts <= 4  # false boxes that last for seconds
    assert found.still < 0.2


def alike(one: Scenario, two: Scenario, within: float) -> None:
    assert (one.tracks.ids, one.tracks.kinds) == (two.tracks.ids, two.tracks.kinds)
    for name in ("t", "x", "y", "yaw", "vx", "vy", "length", "width"):
        np.testing.assert_allclose(
            getattr(one.tracks, name), getattr(two.tracks, name), atol=within, err_msg=name
        )


def test_the_raw_drive_of_the_suite_is_the_same_from_a_file(
    tmp_path: Path,
) -> None:
    assert [name for name in CATALOGUE if name.startswith("raw/")] == ["raw/crossing"]
    driven = LogSource("raw/crossing").read()
    assert driven.repair is not None
    assert any("Repair joined" in note for note in driven.notes)
    (path,) = synthesise([raw.crossing], tmp_path, {})
    read = read_log(path)
    assert read.repair is not None
    alike(driven, read, 1e-9)
    assert LogSource("raw/crossing").identity() == "catalogue raw/crossing"


def test_a_bag_holds_the_same_road_users(tmp_path: Path) -> None:
    short = {"duration_s": 17.0}
    one, two = (
        next(iter(synthesise([raw.crossing], tmp_path / name, short, ROS2)))
        for name in ("one", "two")
    )
    assert [each.read_bytes() for each in one.glob("*.mcap")] == [
        each.read_bytes() for each in two.glob("*.mcap")
    ]
    bag, made = read_log(one), detections("raw/crossing", **short)
    assert bag.repair is not None
    read = bag.repair.detections
    np.testing.assert_allclose(read.score, made.score, atol=1e-6)
    assert read.codes.tolist() == made.codes.tolist()
    origin = np.array(bag.origin)
    np.testing.assert_allclose(np.c_[read.x, read.y] + origin, np.c_[made.x, made.y], atol=1e-6)
    assert bag.goal is not None
    assert "synthetic" in bag.tags
