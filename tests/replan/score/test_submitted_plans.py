"""Tables of submitted trajectories: which column is the time, which log a row names."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from replan.core.errors import ConfigError
from replan.logs.catalogue import scenario as catalogue
from replan.logs.scenario import Scenario
from replan.score.submitted_plans import plans_of_table


def logs_called(*names: str) -> dict[str, Scenario]:
    log = catalogue("everyday/cut_in")
    return {name: replace(log, name=name) for name in names}


def written(folder: Path, log: str, **columns: float) -> Path:
    """A file with one window of `log`, whose ego stands at its begin."""
    ego = catalogue("everyday/cut_in").ego.state(0)
    row = {"log": log, "x": ego.x, "y": ego.y, "yaw": ego.yaw, **columns}
    pd.DataFrame([row] * 8).to_csv(folder / "plans.csv", index=False)
    return folder / "plans.csv"


@pytest.mark.parametrize(
    "columns", [{"t": 0.5, "time": 9.0}, {"time": 9.0, "t_s": 0.5}, {"time": 0.5}]
)
def test_the_first_time_column_counts(tmp_path: Path, columns: dict[str, float]) -> None:
    path = written(tmp_path, "a", **columns)
    (plan,) = plans_of_table(path, logs_called("a"), relative=False)
    assert plan.t == 0.5


@pytest.mark.parametrize(
    ("named", "log"), [("a", "a"), ("x/a", "x/a"), ("x_a", "x/a"), ("b", "y/b")]
)
def test_a_whole_name_comes_before_a_file_name(tmp_path: Path, named: str, log: str) -> None:
    path = written(tmp_path, named, t_s=0.5)
    for names in (("a", "x/a", "y/b"), ("y/b", "x/a", "a")):
        (plan,) = plans_of_table(path, logs_called(*names), relative=False)
        assert plan.log == log


def test_a_file_name_of_two_logs_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "a", t_s=0.5)
    with pytest.raises(ConfigError, match="x/a or y/a"):
        plans_of_table(path, logs_called("x/a", "y/a"), relative=False)
