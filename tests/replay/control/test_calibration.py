"""The calibration table is the power train's exact inverse at its nodes, and near it between them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs import VehicleParameters
from replay.control.calibration import Calibration
from replay.control.pedals import HYSTERESIS_MPS2, Pedals
from replay.vehicle.drivetrain import Drivetrain

TRAIN = Drivetrain(VehicleParameters())
TABLE = Calibration.of(TRAIN)


@given(st.floats(0.5, 40.0), st.floats(-8.0, 1.0))
def test_the_table_is_near_the_exact_inverse(v: float, acceleration: float) -> None:
    beyond = acceleration - TRAIN.coasting(v)
    if abs(beyond) <= HYSTERESIS_MPS2:
        return
    pedals = Pedals(TRAIN).press(acceleration, v)
    looked_up = TABLE.at(acceleration, v)
    if not np.isnan(looked_up).any():
        assert looked_up == pytest.approx(pedals, abs=0.02)


def test_what_the_vehicle_cannot_do_has_no_pedal() -> None:
    assert np.isnan(TABLE.at(5.0, 45.0)).all()
    reachable = TABLE.pedal[np.isfinite(TABLE.pedal)]
    assert np.abs(reachable).max() <= 1.0
    assert (np.diff(TABLE.pedal, axis=0)[np.isfinite(np.diff(TABLE.pedal, axis=0))] > 0.0).all()


def test_it_is_written_and_drawn(tmp_path: Path) -> None:
    TABLE.save(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows) == 1 + len(TABLE.acceleration) and len(rows[0]) == 1 + len(TABLE.speed)
    read = np.array([[float(value or "nan") for value in row[1:]] for row in rows[1:]])
    np.testing.assert_allclose(read, TABLE.pedal, atol=1e-6)
    pytest.importorskip("matplotlib")
    TABLE.plot(tmp_path / "table.png")
    assert (tmp_path / "table.png").stat().st_size > 1000
