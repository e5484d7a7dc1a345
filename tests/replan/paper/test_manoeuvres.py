"""The manoeuvres: tracks that a car fits through, references that are what they say, and the aims
of the table.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from replan.core.errors import ConfigError
from replan.logs.catalogue import iso3888
from replan.logs.catalogue.iso3888 import ConeLane
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters
from replan.paper.manoeuvres import (
    ALAT_MPS2,
    STEP_M,
    VARIANTS,
    along_points,
    compare,
    cone_path,
    cones_hit,
    double_lane_change,
    follow,
    judged,
    main,
    manoeuvres,
    obstacle_avoidance,
    road,
    s_curve,
)

CAR = VehicleParameters()
TRACKS = (iso3888.double_lane_change, iso3888.obstacle_avoidance)
LATERAL_RMS_M = 0.03
LATERAL_MAX_M = 0.10
"""The aims for the lateral error."""


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("width", [1.61, 1.9])
def test_the_path_goes_between_the_cones(
    track: Callable[[float], tuple[ConeLane, ...]], width: float
) -> None:
    car, sections = replace(CAR, width=width), track(width)
    path = cone_path(sections, car)
    x = np.linspace(path[0, 0], path[-1, 0], 5000)
    y = np.interp(x, *path.T)
    yaw = np.interp(x, path[:, 0], np.arctan(np.gradient(path[:, 1], STEP_M)))
    assert cones_hit(iso3888.cones(sections), x, y, yaw, car) == 0
    assert cones_hit(iso3888.cones(sections), x, y + 0.5, yaw, car) > 0
    assert path[[0, -1], 1] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_the_tracks_have_the_lengths_of_the_standard() -> None:
    lanes, obstacle = iso3888.double_lane_change(2.0), iso3888.obstacle_avoidance(2.0)
    assert [(s.begin, s.end) for s in lanes] == [(0.0, 15.0), (45.0, 70.0), (95.0, 125.0)]
    assert [(s.begin, s.end) for s in obstacle] == [(0.0, 12.0), (25.5, 36.5), (49.0, 61.0)]
    assert lanes[1].offset == 3.5
    assert [s.width for s in lanes] == pytest.approx([2.45, 2.65, 2.85])
    entry, avoidance, _ = obstacle
    right_edge, left_edge = avoidance.offset - 0.5 * avoidance.width, 0.5 * entry.width
    assert right_edge - left_edge == pytest.approx(1.0)


def test_a_car_that_does_not_fit_is_refused() -> None:
    sections = iso3888.double_lane_change(1.0)
    with pytest.raises(ConfigError, match="no path between the cones"):
        cone_path(sections, CAR)


@pytest.mark.parametrize("k", range(len(manoeuvres(CAR)) + 5))
def test_positions_headings_speeds_and_curvatures_of_references_belong_together(k: int) -> None:
    """Of each manoeuvre, and of five roads."""
    known = manoeuvres(CAR)
    r = (known[k] if k < len(known) else road(k - len(known))).reference
    step = np.hypot(np.diff(r.x), np.diff(r.y))
    mean = 0.5 * (r.v[1:] + r.v[:-1])
    np.testing.assert_allclose(step, mean * np.diff(r.t), atol=2e-2)
    course = np.unwrap(np.arctan2(np.diff(r.y), np.diff(r.x)))
    moving = mean > 0.5
    np.testing.assert_allclose(course[moving], 0.5 * (r.yaw[1:] + r.yaw[:-1])[moving], atol=1.5e-2)
    turned = 0.5 * (r.kappa[1:] + r.kappa[:-1]) * mean * np.diff(r.t)
    np.testing.assert_allclose(np.diff(r.yaw), turned, atol=2e-2)


@pytest.mark.parametrize("seed", range(8))
def test_roads_stay_within_their_lateral_acceleration(seed: int) -> None:
    r = road(seed).reference
    assert np.abs(r.v**2 * r.kappa).max() <= ALAT_MPS2 + 1e-9
    np.testing.assert_array_equal(r.kappa, road(seed).reference.kappa)


def test_the_throttle_is_released_in_the_obstacle_avoidance() -> None:
    r = obstacle_avoidance(CAR, 50.0).reference
    assert r.v[0] == pytest.approx(50.0 / 3.6)
    assert r.v[-1] < r.v[0]
    released = slice(60, -2)  # from the gate on, without the end of the difference
    np.testing.assert_allclose(np.gradient(r.v, r.t)[released], -0.3, atol=0.02)
    steady = along_points(np.column_stack([np.linspace(0, 50, 51), np.zeros(51)]), 10.0, 0.0, 0.0)
    np.testing.assert_allclose(steady.x, 10.0 * steady.t, atol=1e-6)


def assert_aims(row: dict[str, Any]) -> None:
    assert row["lateral_rms_m"] < LATERAL_RMS_M
    assert row["lateral_max_m"] < LATERAL_MAX_M
    assert row["fell_back"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["dlqr_pid", "mpc"])
@pytest.mark.parametrize("vehicle", ["kinematic_bicycle", "single_track"])
def test_the_aim_is_met_on_the_papers_curve_and_the_double_lane_change(
    controller: str, vehicle: str
) -> None:
    """Also no cone is hit; the tuning is one for all. Roads have no cones (NaN)."""
    for manoeuvre in (s_curve(50.0, 12.0, "s"), double_lane_change(CAR), road(3)):
        row = judged([follow(manoeuvre, controller, vehicle, CAR)], manoeuvre, CAR)
        assert_aims(row)
        assert np.isnan(row["cones_hit"]) or row["cones_hit"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", vehicle_names())
def test_the_known_vehicles_follow_a_road_without_other_tuning(name: str) -> None:
    car = vehicle_parameters(name)
    row = judged([follow(road(3), "mpc", "single_track", car)], road(3), car)
    assert_aims(row)


def test_controllers_with_a_model_are_five_times_nearer_than_classical_ones() -> None:
    curve = s_curve(50.0, 12.0, "s")

    def rms_m(controller: str) -> float:
        driven = follow(curve, controller, "single_track", CAR)
        return float(judged([driven], curve, CAR)["lateral_rms_m"])

    with_model = max(map(rms_m, ("dlqr_pid", "mpc")))
    assert 5.0 * with_model < min(map(rms_m, ("pure_pursuit", "stanley", "pid")))


@pytest.mark.slow
def test_the_table_has_a_row_per_case_and_prints(capsys: pytest.CaptureFixture[str]) -> None:
    table = compare(["single_track"], ["dlqr_pid"], roads=1, robustness=True)
    assert list(table.variant.unique()) == ["nominal", *VARIANTS]
    assert len(table) == 4 * (len(manoeuvres(CAR)) + 1)
    assert (table.lateral_max_m < 0.6).all()
    main(["--vehicle", "kinematic_bicycle", "--controller", "stanley", "--roads", "0"])
    assert "paper_s_curve" in capsys.readouterr().out
