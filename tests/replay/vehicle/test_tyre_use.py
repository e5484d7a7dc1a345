"""Slip and friction of motions that are known: a circle rolls, a body at an angle to its course slips by that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import drive
from hypothesis import given
from hypothesis import strategies as st

from logs import Controls
from logs.vehicle import VehicleParameters
from replay.vehicle.tyre_use import SLOWEST_MPS, tyre_use
from replay.vehicle.tyres import GRAVITY

CAR = VehicleParameters()


def steered(t: np.ndarray, angle: float) -> Controls:
    return Controls(t, np.full(len(t), angle), 0.0 * t, 0.0 * t)


@given(st.floats(-0.05, 0.05), st.floats(3.0, 15.0))
def test_a_circle_rolls_without_slip_and_uses_what_it_takes_across(kappa: float, v: float) -> None:
    ego = drive(lambda s: np.full_like(s, kappa), v, 2.0, 0.01)
    use = tyre_use(ego, steered(ego.t, float(np.arctan(CAR.wheelbase * kappa))), CAR)
    assert np.abs(use.rear[1:-1]).max() < 1e-4 and np.abs(use.front[1:-1]).max() < 1e-4
    assert use.friction == pytest.approx(v * v * abs(kappa) / (CAR.tyre_friction * GRAVITY), abs=1e-6)


def test_a_body_at_an_angle_to_its_course_slips_by_that_and_standing_says_nothing() -> None:
    ego = drive(lambda s: 0.0 * s, 10.0, 1.0, 0.01)
    use = tyre_use(replace(ego, yaw=ego.yaw - 0.05), steered(ego.t, 0.02), CAR)
    assert use.rear == pytest.approx(0.05) and use.front == pytest.approx(0.03)
    slow = drive(lambda s: 0.0 * s, 0.5 * SLOWEST_MPS, 1.0, 0.01)
    assert np.isnan(tyre_use(slow, steered(slow.t, 0.0), CAR).rear).all()
