"""Raw bags of city drives: what the repair makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.readers import read_log
from logs.shapes import overlap

DRIVES = (
    "bot_garden", "kaubamaja_sfa_2", "raekoda",
    *(f"pedestrian_crossing_{number}" for number in ("01", "02", "05", "06", "07", "09", "10", "13", "14", "15")),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_the_driver_of_the_log_meets_no_track(shared_data: Path, name: str) -> None:
    scenario = read_log(shared_data / "tartu" / "ros2" / name)
    done, ego, vehicle = scenario.repair, scenario.ego, scenario.vehicle
    assert done is not None
    assert len(done.tracks) < 0.1 * len(done.detections)
    assert len(done.removed) > len(done.tracks)
    for t in np.arange(ego.t[0], ego.t[-1], 0.1):
        own, agents = ego.at(t), scenario.tracks.truth(t)
        x, y = own.x + vehicle.axle_to_center * np.cos(own.yaw), own.y + vehicle.axle_to_center * np.sin(own.yaw)
        for box in zip(agents.x, agents.y, agents.yaw, agents.length, agents.width, strict=True):
            assert not overlap(x, y, own.yaw, vehicle.length, vehicle.width, *box), t
