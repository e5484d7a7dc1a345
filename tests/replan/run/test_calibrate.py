"""Whose numbers are driven with: a known vehicle by option or by configuration, in a run and in the
calibration.
"""

import tomllib
from pathlib import Path

import pytest
from command_line import evaluate, replan
from handmade import drive, scenario, straight

from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.vehicle import vehicle_parameters
from replan.run.calibrate import calibrate

VAN = '[vehicle]\nset = "vw_vanagon"\nmax_decel = 5.0\n'


def test_the_table_is_that_of_the_vehicle_of_the_option_or_of_the_configuration(
    tmp_path: Path,
) -> None:
    config = tmp_path / "van.toml"
    config.write_text(VAN, encoding="utf-8")
    calibrate(tmp_path / "default")
    calibrate(tmp_path / "van", car="vw_vanagon")
    calibrate(tmp_path / "weak", config=config)
    calibrate(tmp_path / "weak_bmw", car="bmw_320i", config=config)
    names = ("default", "van", "weak", "weak_bmw")
    tables = [(tmp_path / name / "calibration.csv").read_text(encoding="utf-8") for name in names]
    assert len(set(tables)) == 4
    reach = [
        sum(not line.endswith(",") for line in one.splitlines() if line.startswith("-"))
        for one in tables
    ]
    assert reach[2] < reach[1], "the weak brakes of the configuration reach less"


@pytest.mark.slow
def test_a_run_drives_the_known_vehicle_and_its_configuration_says_so(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    write_scenario(log, scenario(drive(straight, 8.0, 1.0)))
    out = tmp_path / "out"
    words = "--car vw_vanagon --vehicle single_track --set loop.plant.mass=1900 --mode closed"
    result = evaluate(log, *words.split(), "--out", out)
    assert result.exit_code in (0, 1, 4), result.output
    said = tomllib.loads((out / "run.toml").read_text(encoding="utf-8"))
    assert said["vehicle"] == {"set": "vw_vanagon"} and said["loop"]["plant"] == {"mass": 1900.0}
    (closed,) = out.rglob("closed.mcap")
    assert read_scenario(closed).vehicle == vehicle_parameters("vw_vanagon")


@pytest.mark.parametrize(
    "words", [["evaluate", "--car", "lorry"], ["calibrate", "-o", "x", "--car", "lorry"]]
)
def test_an_unknown_vehicle_is_one_line_that_names_the_known_ones(words: list[str]) -> None:
    result = replan(*words)
    assert result.exit_code == 2
    assert (
        "no vehicle is called 'lorry'; known are: bmw_320i, city_bus, delivery_robot"
        in result.output
    )
