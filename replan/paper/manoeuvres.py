"""Compares controllers: each vehicle model follows manoeuvres that are given as plans, without a
planner.

    python -m replan.paper.manoeuvres [--vehicle NAME ...] [--controller NAME ...] [--roads 50] [--robustness]
        [--car NAME] [--entry-speed] [--csv FILE]

Tracking only: the whole reference is one plan, known in advance; the vehicle starts on it. "roads"
are seeded roads of 15 s with up to 3 m/s2 of lateral acceleration, in one row: the RMS over all
roads, and the maxima of the worst one. A drive that is LOST_M off its path is lost and ends there;
its errors are those until then.

The path y(x) of the rear axle through the tracks of ISO 3888 (`replan.logs.catalogue.iso3888`)
minimises the integral of y''^2 + W y'''^2 with the body between the cones:

(1) lower(x + d) + b / 2 <= y(x) + d y'(x) <= upper(x + d) - b / 2
        d from the rear to the front bumper
"""  # noqa: E501

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.interpolate import make_interp_spline

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.logs.catalogue import iso3888
from replan.logs.plan import Plan
from replan.logs.states import Command, Trajectory
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters
from replan.planners.solver import QPConfig, QuadraticProgram
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.parts import CONTROLLER, VEHICLE, Part
from replan.replay.vehicle import PlantTable, build_vehicle
from replan.replay.vehicle.plan_path import PlanPath

STEP_M = 0.5
BEFORE_M, AFTER_M = 60.0, 60.0
JERK_WEIGHT = 100.0
# Space between the path and the cones: the body does not point along the path where the tyres slip
SPARE_M = 0.1


def cones_hit(
    places: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, car: VehicleParameters
) -> int:
    """The number of cones that the vehicle's box touched, from the states of its rear axle
    `(m,)`.
    """
    dx, dy = places[:, 0, None] - x, places[:, 1, None] - y
    along, left = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
    inside = (
        (along >= -car.rear_overhang)
        & (along <= car.axle_to_front)
        & (np.abs(left) <= 0.5 * car.width)
    )
    return int(inside.any(axis=1).sum())


def cone_path(sections: tuple[iso3888.ConeLane, ...], car: VehicleParameters) -> FloatArray:
    """The path (1) `(n, 2)` of the rear axle, STEP_M apart in x.

    ConfigError if the vehicle does not fit between the cones.
    """
    x = np.arange(-BEFORE_M, sections[-1].end + AFTER_M + 0.5 * STEP_M, STEP_M)
    n = len(x)
    second, third = _differences(n, 2), _differences(n, 3)
    P = sparse.csc_matrix(second.T @ second) + sparse.csc_matrix(JERK_WEIGHT * (third.T @ third))
    slope = sparse.csc_matrix(np.gradient(np.eye(n), STEP_M, axis=0))
    rows, lower, upper = [], [], []
    for d in np.linspace(-car.rear_overhang, car.axle_to_front, 6):
        for section in sections:
            for i in np.flatnonzero(
                (x + d >= section.begin - STEP_M) & (x + d <= section.end + STEP_M)
            ):
                rows.append((i, d))
                room = 0.5 * (section.width - car.width) - SPARE_M
                lower.append(section.offset - room)
                upper.append(section.offset + room)
    index, ahead = (np.array(column) for column in zip(*rows, strict=True))
    eye = sparse.identity(n, format="csr")
    ends = sparse.vstack([eye[:4], eye[-4:]])
    A = sparse.vstack([ends, eye[index] + sparse.diags(ahead) @ slope.tocsr()[index]]).tocsc()
    zero = np.zeros(8)
    program = QuadraticProgram(
        "iso3888", sparse.csc_matrix(P), A, equalities=8, config=QPConfig(tolerance=1e-3)
    )
    result = program.solve(np.zeros(n), np.r_[zero, lower], np.r_[zero, upper], fresh=True)
    if not result.report.solved:
        raise ConfigError(
            f"no path between the cones for a vehicle {car.width} m wide: {result.report.status}"
        )
    return np.column_stack([x, result.x])


def _differences(n: int, order: int) -> FloatArray:
    """Derivatives of an order by differences, `(n - order, n)`."""
    return np.diff(np.eye(n), order, axis=0) / STEP_M**order


PERIOD_S = 0.01
SAMPLE_S = 0.1
# Number of control periods over which the jerk is averaged, because gear shifts and pedals are
# steps
JERK_OVER = 10
ALAT_MPS2 = 3.0
LOST_M = 5.0
FASTEST_KMH = 90
DEFAULT_CAR = VehicleParameters()
MODELS = ("kinematic_bicycle", "single_track", "multibody")


@dataclass(frozen=True, eq=False)
class Manoeuvre:
    """A reference to follow."""

    name: str
    reference: Trajectory
    # Places `(n, 2)` that must not be touched, m
    cones: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    # Plant parameters that are hidden from the controller, such as the road's friction
    plant: PlantTable = field(default_factory=dict)


def along_curvature(
    kappa: Callable[[FloatArray], FloatArray],
    v: Callable[[FloatArray], FloatArray],
    duration: float,
) -> Trajectory:
    """The drive from the origin with curvature `kappa(station)` and speed `v(time)`, integrated
    finely.
    """
    fine = 100
    t = np.arange(round(duration / SAMPLE_S) * fine + 1) * SAMPLE_S / fine
    speed = v(t)
    s = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (speed[1:] + speed[:-1]))]
    bend = kappa(s)
    yaw = np.r_[0.0, np.cumsum(0.5 * np.diff(s) * (bend[1:] + bend[:-1]))]
    mean = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.r_[0.0, np.cumsum(np.diff(s) * turn(mean))] for turn in (np.cos, np.sin))
    return Trajectory(
        *(column[::fine] for column in (t, x, y, yaw, speed, np.gradient(speed, t), bend))
    )


def along_arcs(stations: FloatArray, kappa: FloatArray, v: float, after: float) -> Trajectory:
    """The drive at `v` m/s with curvatures `(n,)`, linear between stations `(n,)`, until `after` m
    behind the last.
    """
    return along_curvature(
        lambda s: np.interp(s, stations, kappa),
        lambda t: np.full_like(t, v),
        round((stations[-1] + after) / v, 1),
    )


def along_points(points: FloatArray, speed: float, slowing: float, ahead: float) -> Trajectory:
    """The drive along a path y(x) `(n, 2)` that is `ahead` m long at `speed` m/s and then slows
    down, m/s2.
    """
    spline = make_interp_spline(points[:, 0], points[:, 1], k=5)
    x = np.linspace(points[0, 0], points[-1, 0], 20 * len(points))
    slope, bend = spline(x, 1), spline(x, 2)
    s = np.r_[
        0.0, np.cumsum(0.5 * np.diff(x) * (np.hypot(1.0, slope)[1:] + np.hypot(1.0, slope)[:-1]))
    ]
    kappa = bend / np.hypot(1.0, slope) ** 3
    length, since = s[-1] - 1.0, ahead / speed
    t = np.arange(int(3600.0 / SAMPLE_S)) * SAMPLE_S
    late = np.clip(t - since, 0.0, 0.8 * speed / slowing if slowing else np.inf)
    travelled = speed * t - slowing * (0.5 * late**2 + late * np.maximum(t - since - late, 0.0))
    t = t[travelled < length]
    v, travelled = speed - slowing * late[: len(t)], travelled[: len(t)]
    a = np.where((t >= since) & (late[: len(t)] == t - since), -slowing, 0.0)
    x_at = np.interp(travelled, s, x)
    return Trajectory(
        t, x_at, spline(x_at), np.arctan(spline(x_at, 1)), v, a, np.interp(travelled, s, kappa)
    )


def s_curve(radius: float, v: float, name: str, plant: PlantTable | None = None) -> Manoeuvre:
    """The paper's scenario 1: left and right arcs of 60 degrees with clothoids of 20 m."""
    clothoid, arc = 20.0, radius * pi / 3.0 - 20.0
    stations = np.cumsum([30.0, clothoid, arc, clothoid, clothoid, arc, clothoid])
    bend = np.array([0.0, 1.0, 1.0, 0.0, -1.0, -1.0, 0.0]) / radius
    return Manoeuvre(name, along_arcs(stations, bend, v, 30.0), plant=plant or {})


def turn(radius: float, v: float) -> Manoeuvre:
    """A quarter of a circle with clothoids of 10 m."""
    stations = np.cumsum([20.0, 10.0, radius * pi / 2.0 - 10.0, 10.0])
    bend = np.array([0.0, 1.0, 1.0, 0.0]) / radius
    return Manoeuvre(f"turn_{radius:g}m_{v:g}mps", along_arcs(stations, bend, v, 20.0))


def stop_and_start(v: float) -> Manoeuvre:
    """In a wide curve: from `v` to a stop in 6 s, 3 s of standing, up again in 8 s.

    Smooth accelerations.
    """

    def speed(t: FloatArray) -> FloatArray:
        down, up = np.clip((t - 2.0) / 6.0, 0.0, 1.0), np.clip((t - 11.0) / 8.0, 0.0, 1.0)
        return 0.5 * v * (1.0 + np.cos(pi * down)) + 0.5 * v * (1.0 - np.cos(pi * up))

    return Manoeuvre(
        "stop_and_start",
        along_curvature(lambda s: np.interp(s, [10.0, 30.0], [0.0, 0.01]), speed, 21.0),
    )


def double_lane_change(car: VehicleParameters, kmh: float = 80.0) -> Manoeuvre:
    """ISO 3888-1 at constant speed."""
    sections = iso3888.double_lane_change(car.width)
    reference = along_points(cone_path(sections, car), kmh / 3.6, 0.0, 0.0)
    return Manoeuvre(f"iso3888-1_{kmh:g}kmh", reference, iso3888.cones(sections))


def obstacle_avoidance(car: VehicleParameters, kmh: float = 50.0) -> Manoeuvre:
    """ISO 3888-2: the throttle is released 2 m behind the entry (0.3 m/s2)."""
    sections = iso3888.obstacle_avoidance(car.width)
    reference = along_points(cone_path(sections, car), kmh / 3.6, 0.3, BEFORE_M + 2.0)
    return Manoeuvre(f"iso3888-2_{kmh:g}kmh", reference, iso3888.cones(sections))


def road(seed: int) -> Manoeuvre:
    """A road of arcs with up to ALAT_MPS2 laterally, joined by clothoids of 1 to 2 s, at a speed
    that wavers.
    """
    rng = np.random.default_rng(seed)
    v, swing = rng.uniform(6.0, 25.0), rng.uniform(0.0, 0.1)
    fastest = v * (1.0 + swing)
    stations, bend, s = [0.0], [0.0], rng.uniform(0.5, 1.5) * v
    while s < 15.0 * fastest:
        kappa = rng.uniform(-1.0, 1.0) * ALAT_MPS2 / fastest**2
        s_on = s + rng.uniform(1.0, 2.0) * v
        stations, bend = [*stations, s, s_on], [*bend, bend[-1], kappa]
        s = s_on + rng.uniform(0.5, 3.0) * v
    reference = along_curvature(
        lambda x: np.interp(x, stations, bend),
        lambda t: v * (1.0 + swing * np.sin(2.0 * pi * t / 10.0)),
        15.0,
    )
    return Manoeuvre(f"road_{seed}", reference)


def manoeuvres(car: VehicleParameters) -> tuple[Manoeuvre, ...]:
    """The manoeuvres of the table, except the roads."""
    return (
        s_curve(50.0, 12.0, "paper_s_curve"),
        turn(30.0, 8.0),
        double_lane_change(car),
        obstacle_avoidance(car),
        stop_and_start(10.0),
        s_curve(50.0, 10.0, "s_curve_mu0.4", {"tyre_friction": 0.4}),
    )


@dataclass(frozen=True, eq=False)
class FollowedManoeuvre:
    """A followed manoeuvre, one row per control period."""

    # t, x, y, yaw, lateral, heading, speed, station error, a, wheel angle
    columns: Mapping[str, FloatArray]
    notes: tuple[str, ...]


COLUMNS = ("t", "x", "y", "yaw", "lateral", "heading", "speed", "station", "a", "steer")


def follow(
    manoeuvre: Manoeuvre,
    controller: str,
    vehicle: str,
    car: VehicleParameters,
    *,
    plant: PlantTable | None = None,
    delay_steps: int = 0,
) -> FollowedManoeuvre:
    """Follow a manoeuvre; commands arrive `delay_steps` control periods late."""
    table = {**manoeuvre.plant, **(plant or {})}
    start = manoeuvre.reference.state(0)
    model = Part(VEHICLE, vehicle)
    if vehicle == "kinematic_bicycle":
        table = {
            key: value
            for key, value in table.items()
            if key not in ("tyre_stiffness", "tyre_friction")
        }
    ego, believed = build_vehicle(model, car, start, table), build_vehicle(model, car, start, {})
    driver = controller_of(believed, car, Part(CONTROLLER, controller), PERIOD_S)
    plan, path, rows = Plan(manoeuvre.reference), PlanPath.of(manoeuvre.reference), []
    coming = delay_steps * [Command(ego.state.steer, ego.actuation.throttle, ego.actuation.brake)]
    for _ in range(round(float(manoeuvre.reference.t[-1]) / PERIOD_S)):
        state = ego.state
        off = path.deviation(state)
        rows.append((state.t, state.x, state.y, state.yaw, *off[:4], state.a, state.steer))
        if abs(off.lateral) > LOST_M:
            break
        coming.append(driver.control(state, plan))
        ego.step(coming.pop(0), PERIOD_S)
    columns = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    return FollowedManoeuvre(columns, driver.notes)


def judged(
    driven: Sequence[FollowedManoeuvre], manoeuvre: Manoeuvre, car: VehicleParameters
) -> dict[str, float]:
    """One row of the table: root mean squares over all samples, maxima of the worst drive."""

    def joined(name: str) -> FloatArray:
        return np.concatenate([drive.columns[name] for drive in driven])

    def steepest(name: str, over: int) -> float:
        changes = [drive.columns[name][over:] - drive.columns[name][:-over] for drive in driven]
        return max(float(np.abs(change).max()) for change in changes) / (over * PERIOD_S)

    x, y, yaw = (driven[0].columns[name] for name in ("x", "y", "yaw"))
    return {
        "lateral_rms_m": float(np.sqrt(np.mean(joined("lateral") ** 2))),
        "lateral_max_m": float(np.abs(joined("lateral")).max()),
        "heading_max_deg": float(np.degrees(np.abs(joined("heading")).max())),
        "speed_max_mps": float(np.abs(joined("speed")).max()),
        "station_max_m": float(np.abs(joined("station")).max()),
        "steer_rate_max_radps": steepest("steer", 1),
        "jerk_max_mps3": steepest("a", JERK_OVER),
        "cones_hit": float(cones_hit(manoeuvre.cones, x, y, yaw, car))
        if len(manoeuvre.cones)
        else float("nan"),
        "lost": float(
            sum(bool(np.abs(drive.columns["lateral"]).max() > LOST_M) for drive in driven)
        ),
        "fell_back": float(sum(bool(drive.notes) for drive in driven)),
    }


VARIANTS: dict[str, tuple[Mapping[str, float], int]] = {
    "mass +20 %": ({"mass": 1.2}, 0),
    "tyre stiffness -30 %": ({"tyre_stiffness": 0.7}, 0),
    "delay +100 ms": ({}, 10),
}
"""Variants of the robustness table: factors on plant parameters, and the delay of commands in
control periods.
"""


def compare(
    vehicles: Sequence[str],
    controllers: Sequence[str],
    *,
    roads: int = 50,
    robustness: bool = False,
    car: VehicleParameters = DEFAULT_CAR,
) -> pd.DataFrame:
    """The table: a row per vehicle model, variant, manoeuvre and controller."""
    rows = []
    cases: dict[str, tuple[Mapping[str, float], int]] = {"nominal": ({}, 0)} | (
        VARIANTS if robustness else {}
    )
    groups = [[manoeuvre] for manoeuvre in manoeuvres(car)] + (
        [[road(seed) for seed in range(roads)]] if roads else []
    )
    for vehicle in vehicles:
        for variant, (factors, delay) in cases.items():
            plant = {
                key: factor * (car.mass if key == "mass" else 1.0)
                for key, factor in factors.items()
            }
            for group in groups:
                name = group[0].name if len(group) == 1 else f"{len(group)} roads"
                for controller in controllers:
                    driven = [
                        follow(manoeuvre, controller, vehicle, car, plant=plant, delay_steps=delay)
                        for manoeuvre in group
                    ]
                    row = {
                        "vehicle": vehicle,
                        "variant": variant,
                        "manoeuvre": name,
                        "controller": controller,
                    }
                    rows.append(row | judged(driven, group[0], car))
    return pd.DataFrame(rows)


def fastest_clean(controller: str, vehicle: str, car: VehicleParameters) -> float:
    """The highest entry speed of ISO 3888-2 up to which no cone is hit, km/h, in steps of 1 from 30
    to FASTEST_KMH.

    A lost drive is treated as a hit; NaN if there is a hit at 30 km/h.
    """
    for kmh in range(30, FASTEST_KMH + 1):
        trial = obstacle_avoidance(car, float(kmh))
        row = judged([follow(trial, controller, vehicle, car)], trial, car)
        if row["cones_hit"] or row["lost"]:
            return kmh - 1.0 if kmh > 30 else float("nan")
    return float(FASTEST_KMH)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m replan.paper.manoeuvres", description="Compare controllers."
    )
    parser.add_argument("--vehicle", action="append", choices=list(VEHICLE.builtin))
    parser.add_argument("--controller", action="append", choices=list(CONTROLLER.builtin))
    parser.add_argument(
        "--car", choices=vehicle_names(), help="parameters of logs/vehicles; else the default car"
    )
    parser.add_argument("--roads", type=int, default=50)
    parser.add_argument("--robustness", action="store_true")
    parser.add_argument(
        "--entry-speed", action="store_true", help="of ISO 3888-2 without a cone hit"
    )
    parser.add_argument("--csv", type=Path)
    chosen = parser.parse_args(arguments)
    vehicles, controllers = chosen.vehicle or MODELS, chosen.controller or list(CONTROLLER.builtin)
    car = vehicle_parameters(chosen.car) if chosen.car else DEFAULT_CAR
    table = compare(
        vehicles, controllers, roads=chosen.roads, robustness=chosen.robustness, car=car
    )
    if chosen.csv:
        table.to_csv(chosen.csv, index=False)
    with pd.option_context(
        "display.width", 220, "display.max_rows", None, "display.max_columns", None
    ):
        print(table.round(4).to_string(index=False))  # noqa: T201
    if chosen.entry_speed:
        for vehicle in vehicles:
            for controller in controllers:
                kmh = fastest_clean(controller, vehicle, car)
                print(f"ISO 3888-2 without a cone hit: {vehicle}, {controller}: up to {kmh:g} km/h")  # noqa: T201


if __name__ == "__main__":
    main()
