"""Perturbed drives: the way there and back, what is counted, and a planner that does depend on the
compass.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import write_scenario
from replan.run.log_source import LogSource
from studies.invariance import COLUMNS, PERTURBATIONS, Job, compare, counted, main, parted


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_drives_in_a_transformed_world_are_mapped_back(name: str) -> None:
    log, world = CATALOGUE["everyday/cut_in"].scenario(), PERTURBATIONS[name]
    near = 0.02 if name == "5_hz" else 1e-8  # linear between samples: a d^2 / 8
    assert parted(log.ego, world.back(world.there(log).ego)) < near
    assert world.there(log).name == log.name


def test_flips_and_partings_are_counted_against_the_unperturbed_drive() -> None:
    rows = [
        ("a", "p", "none", "goal reached", "", 9.0, 1.0, 0.0, 2.0, "", "ttc", 9, 0.0),
        ("b", "p", "none", "end of the log", "", 9.0, np.nan, 0.0, 2.0, "gap.min", "", 9, 0.0),
        ("a", "p", "mirror", "goal reached", "", 9.0, 1.0, 0.0, 2.0, "gap.min ttc", "", 9, 0.05),
        ("b", "p", "mirror", "collision", "car 1", 7.0, np.nan, 0.0, 0.0, "gap.min", "", 8, 0.5),
        ("c", "", "none", "cannot be read", "", np.nan, np.nan, np.nan, np.nan, "", "", 0, np.nan),
    ]
    found = counted(pd.DataFrame(rows, columns=list(COLUMNS))).set_index("perturbation")
    assert found.loc["none", "logs":].tolist() == [2, 0, 18, 0, 0, 0, 0]
    assert found.loc["mirror", "logs":].tolist() == [2, 1, 17, 2, 1, 2, 1]


@pytest.mark.slow
def test_a_planner_that_follows_the_compass_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "compass_planner.py").write_text(
        "from dataclasses import replace\nfrom replan.planners.constant_speed import "
        "ConstantSpeed\nclass Compass(ConstantSpeed):\n    def plan(self, frame):\n        return "
        "super().plan(replace(frame, ego=replace(frame.ego, yaw=0.0)))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    planners, names = ("constant_speed", "compass_planner:Compass"), ("turn_30", "clock")
    log = CATALOGUE["paper/free_road"].scenario()
    file = tmp_path / "short.mcap"
    write_scenario(file, replace(log, ego=log.ego.between(0.0, 2.0), duration=2.0))
    job = Job(LogSource("short", file), planners, names, "time")
    table = compare([job], tmp_path / "out", workers=0, say=lambda line: None)
    far = table.set_index(["planner", "perturbation"])["parted_m"]
    assert far["constant_speed", "turn_30"] < 1e-6 and far["constant_speed", "clock"] == 0.0
    assert far[planners[1], "turn_30"] > 1.0 and far[planners[1], "clock"] == 0.0
    assert len(pd.read_csv(tmp_path / "out" / "invariance.csv")) == len(table) == 6
    with pytest.raises(SystemExit):
        main([str(tmp_path / "nothing"), "-o", str(tmp_path / "out")])
    assert "no such file or folder" in capsys.readouterr().err
