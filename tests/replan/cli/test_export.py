"""A closed drive as a CommonRoad solution: states at the scenario's steps, of a vehicle that
CommonRoad knows.
"""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from command_line import replan

from replan.cli.convert import commonroad_solution
from replan.core.errors import LogError
from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import read_scenario, write_scenario, write_trace
from replan.logs.scenario import CENTRE, EGO_POSE
from replan.logs.vehicle import vehicle_parameters
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

BMW = vehicle_parameters("bmw_320i")
STEP = 0.07
SAID = {
    "benchmark": "ZAM_Made-1_1_T-1",
    "time_step_s": str(STEP),
    "planning_problem": "100",
    EGO_POSE: CENTRE,
}


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive to the goal at a time between two steps of the scenario."""
    made = CATALOGUE["everyday/cut_in"].scenario()
    made = replace(
        made, metadata=SAID, origin=(100.0, -50.0), start_ns=round(3e9 * STEP)
    ).in_vehicle(BMW)
    drive = run_closed_loop(made, "constant_speed", config=LoopConfig(vehicle="kinematic_bicycle"))
    path = tmp_path_factory.mktemp("export") / "closed.mcap"
    write_trace(path, drive.trace, made)
    return path


def test_the_states_are_those_of_the_trace_at_the_steps(trace: Path) -> None:
    root = ET.fromstring(commonroad_solution(trace, "SA1"))
    assert root.attrib["benchmark_id"] == "KS2:SA1:ZAM_Made-1_1_T-1:2020a"
    (path,) = root
    assert path.tag == "ksTrajectory" and path.attrib == {"planningProblem": "100"}
    rows = np.array(
        [
            [float(state.find(name).text) for name in ("time", "x", "y", "velocity")]
            for state in path
        ]
    )  # type: ignore[union-attr, arg-type]
    assert rows[:, 0].tolist() == list(range(3, 3 + len(rows)))
    driven = read_scenario(trace)
    behind = BMW.wheelbase - BMW.cog_to_front
    for step, x, y, v in rows[:-1]:
        state = driven.ego.at((step - 3) * STEP)
        assert x == pytest.approx(state.x + behind * np.cos(state.yaw) + 100.0, abs=1e-9)
        assert y == pytest.approx(state.y + behind * np.sin(state.yaw) - 50.0, abs=1e-9)
        assert v == pytest.approx(state.v, abs=1e-9)
    last = (rows[-1, 0] - 3) * STEP
    assert driven.ego.t[-1] - STEP < last < driven.ego.t[-1] + STEP


def test_another_vehicle_keeps_the_box_where_the_log_has_it() -> None:
    log = replace(CATALOGUE["everyday/nudge"].scenario(), metadata=SAID)
    other = log.in_vehicle(vehicle_parameters("vw_vanagon"))
    for one, ahead in ((log, log.vehicle.axle_to_center), (other, other.vehicle.axle_to_center)):
        centre = one.ego.x + ahead * np.cos(one.ego.yaw)
        assert centre == pytest.approx(
            log.ego.x + log.vehicle.axle_to_center * np.cos(log.ego.yaw), abs=1e-9
        )
    plain = replace(log, metadata={}).in_vehicle(vehicle_parameters("vw_vanagon"))
    assert plain.ego.x.tolist() == log.ego.x.tolist()


def test_drives_without_solution_are_refused(trace: Path, tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", CATALOGUE["everyday/nudge"].scenario())
    with pytest.raises(
        LogError, match=r"no closed drive over a CommonRoad scenario; name closed\.mcap"
    ):
        commonroad_solution(tmp_path / "log.mcap")
    driven = read_scenario(trace)
    write_scenario(tmp_path / "other.mcap", replace(driven, vehicle=replace(BMW, length=4.0)))
    with pytest.raises(
        LogError, match="not one of CommonRoad's; drive with --vehicle kinematic_bicycle"
    ):
        commonroad_solution(tmp_path / "other.mcap")


def test_the_file_is_written_where_it_is_asked_for_or_the_place_is_named(
    trace: Path, tmp_path: Path
) -> None:
    words = ["export", "commonroad-solution", str(trace), "-o"]
    assert replan(*words, tmp_path / "new" / "solution.xml").exit_code == 0
    assert (tmp_path / "new" / "solution.xml").read_text(encoding="utf-8").startswith("<?xml")
    (tmp_path / "file").touch()
    result = replan(*words, tmp_path / "file" / "solution.xml")
    assert result.exit_code == 3
    assert "solution.xml: cannot be written" in result.stderr


def test_a_run_is_written_whole_and_other_logs_are_named(tmp_path: Path) -> None:
    made = CATALOGUE["everyday/cut_in"].scenario()
    write_scenario(
        tmp_path / "a.mcap", replace(made, name="ZAM_Made-1_1_T-1", metadata=SAID).in_vehicle(BMW)
    )
    write_scenario(
        tmp_path / "b.mcap", replace(CATALOGUE["paper/free_road"].scenario(), name="mine")
    )
    words = [
        "-p",
        "constant_speed",
        "--no-recording",
        "--no-report",
        "--workers",
        "0",
        "-o",
        str(tmp_path / "run"),
    ]
    replan("evaluate", tmp_path / "a.mcap", tmp_path / "b.mcap", *words)
    said = replan("export", "commonroad-solution", tmp_path / "run", "-o", tmp_path / "new")
    assert said.exit_code == 0 and "skipped" in said.stderr and "mine" in said.stderr
    (file,) = (tmp_path / "new").iterdir()
    assert file.name == "ZAM_Made-1_1_T-1.xml" and "KS2:JB1:ZAM_Made" in file.read_text(
        encoding="utf-8"
    )
