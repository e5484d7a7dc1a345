"""replan's surrogate safety metrics beside those of commonroad-crime, on CommonRoad logs and on a
scene made by hand.

commonroad-crime (PyPI, 0.4.5) is no dependency: it has an environment of its own, whose Python runs
the steps 1 and 3.

    python3.11 -m venv crime && crime/bin/pip install commonroad-crime==0.4.5
    crime/bin/python benchmarks/crime.py scene FOLDER_FOR_SCENES
    python benchmarks/crime.py replan FILES_AND_SCENES --out ours.csv
    crime/bin/python benchmarks/crime.py crime ours.csv --out theirs.csv
    python benchmarks/crime.py compare theirs.csv

`scene` writes one straight lane, ego 15 m/s, lead 10 m/s, 30 m between their bumpers, turned by six
angles; and the same with a lead that opens the gap. `replan` takes the vehicles of each file in
turn as the ego, and writes a row per lead and second, and one per crossing. `crime` asks
commonroad-crime for the same pair at the same step, twice: as the file is, and turned so that the
ego heads nearly along x, where its use of the lane's heading in the world does no harm. "Mended"
are its formulae with its own distances, speeds and accelerations, the sign of the lead's
acceleration kept. `compare` counts the agreements. The outcome is in benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

EVERY_S = 1.0
VEHICLES = 4
ANGLES = (0, 30, 60, 89, 120, 180)
NEARLY_ALONG_X = 0.02
"""Heading of the ego where it is turned, rad: of exactly 0 commonroad-crime thinks that there is
none.
"""
EQUAL = {"thw": 0.15, "pet": 0.25}
"""Relative difference up to which two values agree, else 0.05; THW and PET are counted in samples
there.
"""


def scenes(folder: Path) -> None:
    """The straight scene, turned, and one with a lead that opens the gap."""
    from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
    from commonroad.planning.planning_problem import PlanningProblemSet

    folder.mkdir(parents=True, exist_ok=True)
    for name, speed in (("closing", 10.0), ("opening", 20.0)):
        for angle in ANGLES:
            made = _scene(f"ZAM_{name.capitalize()}{angle}-1_1_T-1", speed, math.radians(angle))
            writer = CommonRoadFileWriter(made, PlanningProblemSet(), "replan", "", "", set())
            path = str(folder / f"{name}_{angle:03d}.xml")
            writer.write_to_file(path, OverwriteExistingFile.ALWAYS)


def _scene(name: str, lead: float, angle: float) -> Any:
    from commonroad.scenario.lanelet import Lanelet, LaneletNetwork
    from commonroad.scenario.scenario import Scenario, ScenarioID

    x = np.linspace(-50.0, 450.0, 101)
    left, middle, right = (np.column_stack([x, np.full(101, y)]) for y in (1.75, 0.0, -1.75))
    made = Scenario(0.1, ScenarioID.from_benchmark_id(name, "2020a"))
    made.add_objects(LaneletNetwork.create_from_lanelet_list([Lanelet(left, middle, right, 1)]))
    for number, start, speed in ((10, 0.0, 15.0), (11, 34.5, lead)):
        made.add_objects(_vehicle(number, start, speed))
    made.translate_rotate(np.zeros(2), angle if angle < math.pi else math.pi - 1e-9)
    return made


def _vehicle(number: int, start: float, speed: float) -> Any:
    from commonroad.geometry.shape import Rectangle
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
    from commonroad.scenario.state import InitialState, KSState
    from commonroad.scenario.trajectory import Trajectory

    shape, states = Rectangle(4.5, 1.8), []
    for k in range(1, 41):
        place = np.array([start + 0.1 * k * speed, 0.0])
        states.append(
            KSState(
                time_step=k, position=place, orientation=0.0, velocity=speed, steering_angle=0.0
            )
        )
    first = InitialState(
        time_step=0,
        position=np.array([start, 0.0]),
        orientation=0.0,
        velocity=speed,
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )
    drive = TrajectoryPrediction(Trajectory(1, states), shape)
    return DynamicObstacle(number, ObstacleType.CAR, shape, first, drive)


def ours(files: list[Path]) -> pd.DataFrame:
    """A row per file, ego, step and lead; and one per crossing."""
    from replan.logs.readers.commonroad import read_commonroad
    from replan.logs.readers.commonroad.document import parse

    rows: list[dict[str, object]] = []
    for path in files:
        document = parse(path)
        vehicles = [
            o for o in document.obstacles if not o.static and o.type in ("car", "truck", "bus")
        ]
        egos = [
            str(o.id)
            for o in vehicles
            if len(o.states) > 2.0 / document.dt and o.states[0, 4] > 2.0
        ]
        for ego in egos[:VEHICLES]:
            scenario = read_commonroad(path, ego=ego)
            rows += [{"file": str(path), "ego": ego, **row} for row in _rows(scenario, document.dt)]
    return pd.DataFrame(rows)


def _rows(scenario: Any, dt: float) -> Iterator[dict[str, object]]:
    from replan.logs.trace import EndReason, Mode, Trace
    from replan.metrics import METRICS
    from replan.metrics.lead import ahead_of

    trace = Trace(
        scenario.name,
        "log",
        Mode.CLOSED,
        True,
        scenario.ego,
        scenario.tracks,
        frames=(),
        end=EndReason.END_OF_LOG,
    )
    ahead, names = (
        ahead_of(trace, scenario),
        ("thw", "drac", "required_decel", "ttc_accelerated", "headway"),
    )
    found = {name: METRICS[name].measure(trace, scenario) for name in names}
    start = scenario.start_ns / 1e9 / dt
    for k in np.flatnonzero(ahead.agent >= 0):
        if abs(ahead.t[k] / EVERY_S - round(ahead.t[k] / EVERY_S)) > 1e-6:
            continue
        other = scenario.tracks.ids[ahead.agent[k]]
        step = round(ahead.t[k] / dt + start)
        values = {name: series.value[k] for name, series in found.items()}
        if found["ttc_accelerated"].labels[k].split()[-1:] != [other]:
            values["ttc_accelerated"] = np.nan  # it is about someone else than the lead
        closing = ahead.v[k] - ahead.u[k]
        ttc = ahead.gap[k] / closing if closing > 0.0 else np.nan
        yield {
            "kind": "lead",
            "step": step,
            "other": other,
            "ttc": ttc,
            "yaw": scenario.ego.at(ahead.t[k]).yaw,
            **values,
        }
    pet = METRICS["pet"].measure(trace, scenario)["crossing"]
    crossed: dict[str, float] = {}
    for k in pet.known.nonzero()[0]:
        other = pet.labels[k].split()[1]
        crossed[other] = min(crossed.get(other, math.inf), float(pet.value[k]))
    for other, value in crossed.items():
        yield {"kind": "crossing", "step": 0, "other": other, "pet": value, "yaw": 0.0}


def theirs(asked: pd.DataFrame) -> pd.DataFrame:
    """commonroad-crime's values for the pairs of `asked`: as the file is, and turned so that the
    ego heads along x.
    """
    logging.disable(logging.CRITICAL)
    asked = asked.copy()
    for i, row in asked.iterrows():
        for suffix, turn in (("", 0.0), ("_turned", NEARLY_ALONG_X - float(row["yaw"]))):
            if row["kind"] == "crossing" and suffix:
                continue
            for name, value in _asked(Path(row["file"]), int(row["ego"]), row, turn).items():
                asked.loc[i, f"crime_{name}" + ("" if name.endswith("_mended") else suffix)] = value
    return asked


def _asked(path: Path, ego: int, row: pd.Series, turn: float) -> dict[str, float]:
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.scenario.lanelet import LaneletNetwork
    from commonroad_crime.data_structure.configuration import CriMeConfiguration
    from commonroad_crime.measure import HW, PET, THW, TTC, ALongReq

    measures = (
        {"pet": PET}
        if row["kind"] == "crossing"
        else {"headway": HW, "thw": THW, "ttc": TTC, "drac": ALongReq}
    )
    scenario, _ = CommonRoadFileReader(str(path)).open()
    pair = (ego, int(row["other"]))
    scenario.remove_obstacle([o for o in scenario.obstacles if o.obstacle_id not in pair])
    if turn:
        scenario.translate_rotate(np.zeros(2), math.atan2(math.sin(turn), math.cos(turn)))
        # Its index did not turn
        lanes = LaneletNetwork.create_from_lanelet_list(scenario.lanelet_network.lanelets)
        scenario.replace_lanelet_network(lanes)
    scenario.assign_obstacles_to_lanelets()
    found: dict[str, float] = {}
    for name, measure in measures.items():
        config = CriMeConfiguration()
        config.vehicle.ego_id = ego
        config.update(sce=scenario)
        try:
            value = measure(config).compute(int(row["other"]), int(row["step"]), verbose=False)
        # What it raises is not documented: projections, lanelets that are not there
        except Exception:
            value = None
        found[name] = math.nan if value is None else abs(float(value))
        if turn and name == "headway" and math.isfinite(found[name]) and found[name] > 0.0:
            found |= _mended(
                float(value), *_motion(measure(config), int(row["other"]), int(row["step"]))
            )
    return found


def _motion(measure: Any, other: int, step: int) -> tuple[float, float, float]:
    """Closing speed, m/s, and the accelerations of ego and other, m/s2, as commonroad-crime has
    them.
    """
    measure.validate_update_states_log(other, step, False)
    ego, lead = measure.ego_vehicle.state_at_time(step), measure.other_vehicle.state_at_time(step)
    return ego.velocity - lead.velocity, ego.acceleration, lead.acceleration


def _mended(gap: float, closing: float, ego_accel: float, lead_accel: float) -> dict[str, float]:
    """Its formulae with its own numbers, the lead's acceleration with its sign, an opening gap
    asking for nothing.
    """
    nearing = ego_accel - lead_accel
    square = closing**2 + 2.0 * gap * nearing
    accelerated = math.nan
    if abs(nearing) <= 0.1 or square < 0.0:
        accelerated = gap / closing if closing > 0.0 and abs(nearing) <= 0.1 else math.nan
    elif closing > 0.0 or nearing > 0.0:
        accelerated = (-closing + math.sqrt(square)) / nearing
    ttc = gap / closing if closing > 0.0 else math.nan
    return {
        "ttc_mended": ttc,
        "drac_mended": max(closing, 0.0) ** 2 / (2.0 * gap),
        "ttc_accelerated_mended": accelerated,
    }


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """Per quantity: pairs, both finite, agreeing, as filed and turned."""
    out = []
    made = rows["file"].str.contains("closing_|opening_")
    for group, part in (("real logs", rows[~made]), ("the straight scene", rows[made])):
        for name in ("headway", "thw", "ttc", "ttc_accelerated", "drac", "pet"):
            for suffix in ("", "_turned", "_mended"):
                theirs_name = (
                    name if suffix == "_mended" else {"ttc_accelerated": "ttc"}.get(name, name)
                )
                column = f"crime_{theirs_name}{suffix}"
                if column not in part or not len(part):
                    continue
                kind = part[part["kind"] == ("crossing" if name == "pet" else "lead")]
                mine, other = kind[name].to_numpy(), kind[column].to_numpy()
                both = np.isfinite(mine) & np.isfinite(other)
                near = np.abs(mine - other) <= np.maximum(
                    EQUAL.get(theirs_name, 0.05) * np.abs(mine), 0.05
                )
                gap = np.median(np.abs(mine - other)[both]) if both.any() else math.nan
                none = int(np.sum(np.isfinite(mine) & ~np.isfinite(other)))
                out.append(
                    (
                        group,
                        name,
                        suffix[1:] or "as filed",
                        len(kind),
                        int(both.sum()),
                        int((near & both).sum()),
                        gap,
                        none,
                        int(np.sum(~np.isfinite(mine) & np.isfinite(other))),
                    )
                )
    names = [
        "where",
        "quantity",
        "frame",
        "pairs",
        "both",
        "agree",
        "median_difference",
        "only_replan",
        "only_crime",
    ]
    return pd.DataFrame(out, columns=names)


def main() -> None:
    """One step of the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("scene", "replan", "crime", "compare"))
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.step == "scene":
        scenes(options.paths[0])
    elif options.step == "replan":
        ours(options.paths).to_csv(options.out, index=False)
    elif options.step == "crime":
        theirs(pd.read_csv(options.paths[0])).to_csv(options.out, index=False)
    else:
        print(compared(pd.read_csv(options.paths[0])).to_string(index=False))


if __name__ == "__main__":
    main()
