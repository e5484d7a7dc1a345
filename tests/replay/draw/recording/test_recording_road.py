"""The road in a recording: stop lines, crosswalks, and lights that change their colour when the log says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from logs import Colour, Crosswalk, Scenario, StopLine, TrafficLight
from logs.catalogue import CATALOGUE
from replay.draw.recording import write_log_recording
from replay.draw.recording.road import LIGHTS, dashes


def recorded(path: Path, scenario: Scenario) -> dict[str, list[tuple[bool, Any]]]:
    """Record batches by entity: whether static, and the batch."""
    write_log_recording(path / "log.rrd", scenario)
    found: dict[str, list[tuple[bool, Any]]] = {}
    for chunk in RrdReader(path / "log.rrd").stream().to_chunks():
        found.setdefault(chunk.entity_path, []).append((chunk.is_static, chunk.to_record_batch()))
    return found


def colours_over_time(chunks: list[tuple[bool, Any]]) -> dict[float, list[int]]:
    shown: dict[float, list[int]] = {}
    for static, batch in chunks:
        if not static:
            times = np.asarray(batch.column("sim_time").cast("int64")) / 1e9
            rows = batch.column("Points3D:colors").to_pylist()
            shown.update(zip(times.tolist(), rows, strict=True))
    return shown


def test_a_light_changes_when_the_log_says_so(tmp_path: Path) -> None:
    scenario = CATALOGUE["everyday/traffic_light"].scenario(green_s=6.0, duration_s=20.0)
    chunks = recorded(tmp_path, scenario)
    assert colours_over_time(chunks["/world/lights"]) == {
        0.0: [LIGHTS[Colour.RED]],
        5.0: [LIGHTS[Colour.RED_YELLOW]],
        6.0: [LIGHTS[Colour.GREEN]],
    }
    (_, batch) = next(each for each in chunks["/world/lights"] if not each[0])
    (x, y, z) = np.asarray(batch.column("Points3D:positions")[0].values.to_pylist()).reshape(3)
    np.testing.assert_allclose([x, y], scenario.road.stop_lines[0].points.mean(axis=0), atol=1e-4)
    assert z > 0.0


def test_a_light_that_is_not_known_is_grey_and_lines_have_their_colours(tmp_path: Path) -> None:
    made = CATALOGUE["everyday/traffic_light"].scenario(duration_s=2.0)
    (line,) = made.road.stop_lines
    signed = replace(line, id=2, light=None, must_stop=True, points=line.points + 5.0)
    unknown = StopLine(3, 1, line.points + 9.0, light=77)
    road = replace(made.road, stop_lines=(line, signed, unknown))
    dark = TrafficLight(1, np.array([0.0]), (Colour.GREEN,))
    chunks = recorded(tmp_path, replace(made, road=road, lights=(dark,)))
    assert colours_over_time(chunks["/world/lights"]) == {0.0: [LIGHTS[Colour.GREEN], LIGHTS[Colour.OFF]]}
    for entity, count in (("stop_lines", 2), ("stop_signs", 1)):
        ((static, batch),) = chunks[f"/world/road/{entity}"]
        assert static and len(batch.column("LineStrips3D:strips")[0]) == count


@pytest.mark.parametrize("along", [0.0, 900.0])
def test_a_crosswalk_is_hatched_wherever_others_are(tmp_path: Path, along: float) -> None:
    made = CATALOGUE["everyday/crosswalk"].scenario(duration_s=2.0)
    (zebra,) = made.road.crosswalks
    others = (zebra, Crosswalk(9, zebra.polygon + np.array([along, 0.0]))) if along else (zebra,)
    chunks = recorded(tmp_path, replace(made, road=replace(made.road, crosswalks=others)))
    ((_, batch),) = chunks["/world/road/crosswalks/fill"]
    assert len(batch.column("LineStrips3D:strips")[0]) == 6 * len(others)


def test_a_log_without_rules_draws_none(tmp_path: Path) -> None:
    chunks = recorded(tmp_path, CATALOGUE["paper/free_road"].scenario())
    assert not any("stop" in entity or "lights" in entity or "crosswalk" in entity for entity in chunks)


def test_dashes_are_three_metres_of_nine() -> None:
    pieces = dashes(np.array([[0.0, 0.0], [20.0, 0.0]]))
    assert [(piece[0, 0], piece[-1, 0]) for piece in pieces] == [(0.0, 3.0), (9.0, 12.0), (18.0, 20.0)]
