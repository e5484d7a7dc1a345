"""Vehicle parameters: the known vehicles, checks, and the way through a log."""

import tomllib
from dataclasses import asdict, fields, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters


@pytest.mark.parametrize("name", vehicle_names())
def test_a_vehicle_file_states_each_number_and_its_source(name: str) -> None:
    text = (files("replan.logs") / "vehicles" / f"{name}.toml").read_text(encoding="utf-8")
    assert set(tomllib.loads(text)) == {item.name for item in fields(VehicleParameters)}
    assert "measured" in text


@pytest.mark.parametrize("name", vehicle_names())
def test_limits_for_controllers_are_those_of_the_motor(name: str) -> None:
    p = vehicle_parameters(name)
    force = np.array(p.motor_torque) * p.gears[0] * p.drive_efficiency / (p.wheel_radius * p.mass)
    power = np.array(p.motor_torque) * np.array(p.motor_speed) * p.drive_efficiency / p.mass
    assert 0.95 * force.max() <= p.max_accel <= force.max()
    assert p.max_power == pytest.approx(power.max(), rel=0.05)
    assert p.max_decel < 9.81 * p.tyre_friction


@pytest.mark.parametrize(("name", "number"), [("bmw_320i", 2), ("vw_vanagon", 3)])
def test_the_numbers_are_those_of_commonroad(name: str, number: int) -> None:
    package = pytest.importorskip(
        "vehiclemodels.vehicle_parameters", reason="needs commonroad-vehicle-models"
    )
    q, p = package.setup_vehicle_parameters(vehicle_id=number), vehicle_parameters(name)
    ours = (
        p.length,
        p.width,
        p.mass,
        p.yaw_inertia,
        p.cog_to_front,
        p.cog_to_rear,
        p.cog_height,
        p.wheel_radius,
    )
    assert ours == pytest.approx((q.l, q.w, q.m, q.I_z, q.a, q.b, q.h_cg, q.R_w))
    assert (p.tyre_friction, p.tyre_shape, p.tyre_curvature) == (
        q.tire.p_dy1,
        q.tire.p_cy1,
        q.tire.p_ey1,
    )
    weight = q.m * 9.81 / (q.a + q.b) * -q.tire.p_ky1
    assert (p.cornering_front, p.cornering_rear) == pytest.approx(
        (weight * q.b, weight * q.a), rel=1e-5
    )


@pytest.mark.parametrize("name", ["", *vehicle_names()])
def test_a_log_keeps_its_vehicle(name: str, tmp_path: Path) -> None:
    vehicle = vehicle_parameters(name) if name else VehicleParameters()
    scenario = replace(CATALOGUE["everyday/follow"].scenario(), vehicle=vehicle)
    write_scenario(tmp_path / "log.mcap", scenario)
    assert asdict(read_scenario(tmp_path / "log.mcap").vehicle) == asdict(vehicle)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gears": (3.0,)}, "all of them or none"),
        ({"motor_torque": (100.0, 90.0)}, "all of them or none"),
        (
            {
                "gears": (3.0,),
                "motor_speed": (5.0, 4.0),
                "motor_torque": (1.0, 1.0),
                "motor_overrun": (0.0, 0.0),
            },
            "increas",
        ),
        (
            {
                "gears": (3.0,),
                "motor_speed": (5.0, 6.0),
                "motor_torque": (1.0, -1.0),
                "motor_overrun": (0.0, 0.0),
            },
            "not neg",
        ),
        ({"tyre_friction": 0.0}, "tyre_friction must be positive"),
        ({"wheelbase": 1e-12}, "wheelbase must lie between 0.01 and 100 m, got 1e-12"),
        ({"length": 1e300}, "length must lie between"),
    ],
)
def test_numbers_that_make_no_vehicle_are_refused(
    change: dict[str, tuple[float, ...]], words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        replace(VehicleParameters(), **change)
