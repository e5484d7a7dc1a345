"""What tests of the command line share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from handmade import drive, lanes_along, scenario, square, straight, track, tracks

from logs import Goal
from logs.mcap import write_scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of not quite three seconds: nobody there, and a car parked where a careful driver still stops."""
    out = tmp_path_factory.mktemp("logs")
    ego = drive(straight, 8.0, 2.9)
    free = scenario(ego, road=lanes_along(ego), goal=Goal((square(27.0, 0.0, 4.0),)))
    blocked = replace(free, tracks=tracks(track("wall", [0.0], [24.0], [0.0], static=True)))
    write_scenario(out / "free.mcap", replace(free, name="test/free"))
    write_scenario(out / "blocked.mcap", replace(blocked, name="test/blocked"))
    return out
