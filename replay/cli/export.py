"""Traces in the formats of other projects.

CommonRoad solution: the ego's states at the scenario's time steps, of the kinematic single track model KS, in which the
position is the centre of gravity, b behind it the rear axle (commonroad-vehicle-models):

(1) p = r + b (cos yaw, sin yaw),   b = wheelbase - cog_to_front,   r the rear axle in the world
(2) A drive that reaches the goal between two steps is extended to the next one with the last acceleration and
    steering angle: s = v h + a h^2 / 2, yaw' = yaw + s tan(steer) / wheelbase

CommonRoad's checker integrates the model between the states: it accepts what such a vehicle drove, so the drive must be
one of `--vehicle kinematic_bicycle` with the numbers of one of CommonRoad's vehicles.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from logs.errors import LogError
from logs.mcap import read_scenario
from logs.scenario import Scenario
from logs.states import TRAJECTORY_COLUMNS, Trajectory
from logs.trace import EndReason
from logs.vehicle import vehicle_parameters
from replay.draw.drawn_results import load
from replay.results.tables import safe_names

TYPES = {"bmw_320i": 2, "vw_vanagon": 3}  # Vehicle type in a benchmark id, by the vehicle's name in replan
COSTS = ("JB1", "SA1", "WX1", "SM1", "SM2", "SM3", "MW1", "TR1")
"""Cost functions of CommonRoad: the file only names them, and CommonRoad computes the cost."""
VERSION = "2020a"


def commonroad_solution(trace: Path, cost: str = COSTS[0]) -> str:
    """The solution file of a closed drive over a CommonRoad scenario, XML.

    Args:
        trace: `closed.mcap` of a result folder.
        cost: The cost function that the benchmark id names.

    Raises:
        LogError: The file is not such a trace, or its vehicle is not one of CommonRoad's.
    """
    try:
        scenario = read_scenario(trace)
        return _solution(scenario, cost)
    except LogError as error:
        raise error if error.file is not None else error.at(trace) from None


def solutions(run: Path, cost: str = COSTS[0]) -> tuple[dict[str, str], list[str]]:
    """The solution files of the closed drives of a run by name, and why other closed drives have none.

    ConfigError if the path is not a result folder.
    """
    results, found, skipped = load(run), dict[str, str](), list[str]()
    closed = results.drives.loc[results.drives["mode"] == "closed", ["log", "planner"]]
    several = closed["planner"].nunique() > 1
    labels = {key: ".".join(key if several else key[:1]) for key in closed.itertuples(index=False, name=None)}
    names = safe_names(labels.values())
    for (log, planner), label in labels.items():
        try:
            drive = results.drive(log, planner, "closed")
            found[f"{names[label]}.xml"] = commonroad_solution(drive.trace_file, cost)
        except LogError as error:
            skipped.append(str(error))
    return found, skipped


def _solution(scenario: Scenario, cost: str) -> str:
    facts = scenario.metadata
    if "benchmark" not in facts or facts.get("trace_mode") != "closed" or scenario.controls is None:
        remedy = "name closed.mcap of a CommonRoad scenario in a result folder"
        raise LogError("no closed drive over a CommonRoad scenario", remedy=remedy)
    car, dt = scenario.vehicle, float(facts["time_step_s"])
    sizes = ((vehicle_parameters(name), number) for name, number in TYPES.items())
    size = (car.length, car.width, car.wheelbase)
    kind = next((number for one, number in sizes if (one.length, one.width, one.wheelbase) == size), None)
    if kind is None:
        remedy = f"drive with --vehicle kinematic_bicycle --car {' or '.join(TYPES)}"
        raise LogError("the vehicle is not one of CommonRoad's", topic="/vehicle", remedy=remedy)
    first = round(scenario.start_ns / 1e9 / dt)
    driven = _carried_on(scenario, dt) if facts.get("trace_end") == EndReason.GOAL.name.lower() else scenario.ego
    steps = np.arange(int(driven.t[-1] / dt + 1e-6) + 1)
    ego = driven.resampled(np.minimum(dt * steps, driven.t[-1]))
    steer = np.interp(dt * steps, scenario.controls.t, np.nan_to_num(scenario.controls.steer))
    behind = car.wheelbase - car.cog_to_front
    x = ego.x + behind * np.cos(ego.yaw) + scenario.origin[0]  # (1)
    y = ego.y + behind * np.sin(ego.yaw) + scenario.origin[1]
    root = ET.Element("CommonRoadSolution", benchmark_id=f"KS{kind}:{cost}:{facts['benchmark']}:{VERSION}")
    path = ET.SubElement(root, "ksTrajectory", planningProblem=facts["planning_problem"])
    for k in steps:
        state = ET.SubElement(path, "ksState")
        values = {"x": x[k], "y": y[k], "steeringAngle": steer[k], "velocity": ego.v[k], "orientation": ego.yaw[k]}
        for name, value in values.items():
            ET.SubElement(state, name).text = repr(float(value))
        ET.SubElement(state, "time").text = str(first + int(k))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _carried_on(scenario: Scenario, dt: float) -> Trajectory:
    """The drive, extended to the next time step (2)."""
    ego, last = scenario.ego, scenario.ego.state(-1)
    left = dt * np.ceil(last.t / dt - 1e-6) - last.t
    if left < 1e-6:
        return ego
    s = max(last.v * left + 0.5 * last.a * left**2, 0.0)
    yaw = last.yaw + s * last.kappa
    middle = 0.5 * (last.yaw + yaw)
    state = (
        last.t + left, last.x + s * np.cos(middle), last.y + s * np.sin(middle), yaw, max(last.v + last.a * left, 0.0),
        last.a, last.kappa,
    )  # fmt: skip
    return Trajectory(*(np.r_[getattr(ego, name), x] for name, x in zip(TRAJECTORY_COLUMNS, state, strict=True)))
