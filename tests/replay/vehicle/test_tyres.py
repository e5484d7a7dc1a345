"""Tyres: symmetry, the friction circle, initial slope, peak, load.

Slip and friction of motions that are known.
"""

from dataclasses import replace
from math import atan, hypot, radians, tan

import numpy as np
import pytest
from handmade import drive
from hypothesis import example, given, strategies as st

from replan.logs.states import Controls
from replan.logs.vehicle import VehicleParameters, vehicle_parameters
from replan.replay.vehicle.tyres import (
    GRAVITY,
    SLOWEST_MPS,
    TYRES,
    Tyre,
    axle_force,
    axle_tyres,
    grip_and_peak,
    lateral_force,
    slip_for,
    tyre_use,
)

CAR = VehicleParameters()
KINDS = sorted(TYRES)
LIMITED = ["fiala", "pacejka"]
SLIP = st.floats(-50.0, 50.0)
LOAD = st.floats(0.0, 12_000.0)


def tyre(kind: str, **changes: float) -> Tyre:
    return axle_tyres(replace(CAR, **changes), kind, 1.0)[0]


@given(
    st.sampled_from(LIMITED),
    SLIP,
    LOAD,
    st.floats(-3e4, 3e4),
    st.floats(0.1, 1.2),
    st.floats(0.0, 0.3),
)
def test_the_friction_circle(
    kind: str, slip: float, load: float, wanted: float, mu: float, sensitivity: float
) -> None:
    axle = tyre(kind, tyre_friction=mu, tyre_load_sensitivity=sensitivity)
    fx, fy = axle_force(slip, load, wanted, axle)
    assert hypot(fx, fy) <= grip_and_peak(load, axle)[1] * (1.0 + 1e-12)
    if sensitivity == 0.0:
        assert hypot(fx, fy) <= mu * load * (1.0 + 1e-12)
    assert abs(fx) <= abs(wanted)


@given(st.sampled_from(KINDS), SLIP, LOAD, st.floats(-1e4, 1e4))
def test_it_is_symmetric_and_takes_energy(
    kind: str, slip: float, load: float, wanted: float
) -> None:
    axle = tyre(kind)
    fx, fy = axle_force(slip, load, wanted, axle)
    assert axle_force(-slip, load, wanted, axle) == (fx, -fy)
    assert fy * slip <= 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_slope_at_no_slip_is_the_cornering_stiffness(kind: str) -> None:
    axle = tyre(kind)
    assert -lateral_force(1e-7, axle.load, axle) / 1e-7 == pytest.approx(
        CAR.cornering_front, rel=1e-5
    )
    assert -lateral_force(1e-7, 0.5 * axle.load, axle) / 1e-7 == pytest.approx(
        0.5 * CAR.cornering_front, rel=1e-5
    )


@pytest.mark.parametrize("kind", LIMITED)
def test_the_peak_is_friction_times_load(kind: str) -> None:
    axle = tyre(kind, tyre_friction=0.4)
    forces = [
        lateral_force(tan(radians(angle)), 3000.0, axle) for angle in np.linspace(0.0, 60.0, 2001)
    ]
    assert max(np.abs(forces)) == pytest.approx(0.4 * 3000.0, rel=1e-4)


def test_load_sensitivity_takes_friction_and_stiffness() -> None:
    axle = tyre("pacejka", tyre_load_sensitivity=0.1)
    stiffness, peak = grip_and_peak(1.5 * axle.load, axle)
    assert peak == pytest.approx(0.95 * 1.5 * axle.load * CAR.tyre_friction)
    assert stiffness == pytest.approx(0.95 * 1.5 * CAR.cornering_front)


def test_braking_leaves_what_the_circle_leaves() -> None:
    axle = tyre("fiala")
    peak = grip_and_peak(axle.load, axle)[1]
    fx, fy = axle_force(-10.0, axle.load, -0.6 * peak, axle)
    assert (fx, fy) == (pytest.approx(-0.6 * peak), pytest.approx(0.8 * peak))


@given(st.sampled_from(KINDS), st.floats(-6000.0, 6000.0), st.floats(3000.0, 9000.0))
@example("pacejka", 5e-324, 5000.0)
def test_slip_for_is_the_inverse(kind: str, force: float, load: float) -> None:
    axle = tyre(kind)
    reachable = (
        force
        if kind == "linear"
        else np.clip(force, *(0.95 * grip_and_peak(load, axle)[1] * np.array([-1, 1])))
    )
    assert lateral_force(slip_for(force, load, axle), load, axle) == pytest.approx(
        reachable, abs=1e-3
    )


def test_the_magic_formula_is_that_of_commonroad() -> None:
    theirs = pytest.importorskip(
        "vehiclemodels.utils.tire_model", reason="needs commonroad-vehicle-models"
    )
    setup = pytest.importorskip("vehiclemodels.vehicle_parameters").setup_vehicle_parameters
    front, _ = axle_tyres(vehicle_parameters("bmw_320i"), "pacejka", 1.0)
    package = setup(vehicle_id=2).tire
    for slip in np.linspace(-1.0, 1.0, 41):
        for load in (1000.0, 6000.0, 9000.0):
            expected = theirs.formula_lateral(atan(slip), 0.0, load, package)[0]
            assert lateral_force(float(slip), load, front) == pytest.approx(
                expected, rel=1e-5, abs=1e-9
            )


def steered(t: np.ndarray, angle: float) -> Controls:
    return Controls(t, np.full(len(t), angle), 0.0 * t, 0.0 * t)


@given(st.floats(-0.05, 0.05), st.floats(3.0, 15.0))
def test_a_circle_rolls_without_slip_and_uses_what_it_takes_across(kappa: float, v: float) -> None:
    ego = drive(lambda s: np.full_like(s, kappa), v, 2.0, 0.01)
    use = tyre_use(ego, steered(ego.t, float(np.arctan(CAR.wheelbase * kappa))), CAR)
    assert np.abs(use.rear[1:-1]).max() < 1e-4 and np.abs(use.front[1:-1]).max() < 1e-4
    assert use.friction == pytest.approx(
        v * v * abs(kappa) / (CAR.tyre_friction * GRAVITY), abs=1e-6
    )


def test_a_body_at_an_angle_to_its_course_slips_by_that_and_standing_says_nothing() -> None:
    ego = drive(lambda s: 0.0 * s, 10.0, 1.0, 0.01)
    use = tyre_use(replace(ego, yaw=ego.yaw - 0.05), steered(ego.t, 0.02), CAR)
    assert use.rear == pytest.approx(0.05) and use.front == pytest.approx(0.03)
    slow = drive(lambda s: 0.0 * s, 0.5 * SLOWEST_MPS, 1.0, 0.01)
    assert np.isnan(tyre_use(slow, steered(slow.t, 0.0), CAR).rear).all()
