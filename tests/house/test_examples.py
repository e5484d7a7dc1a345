"""The metric measures what it says.

The notebook runs, shows what it says, and is kept without outputs.
"""

import ast
import importlib
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
import yaml
from drives import along, drive, grid, moving, scenario

from replan.logs.agents import AgentKind
from replan.metrics import Unavailable

NOTEBOOK_FILE = Path(__file__).parents[2] / "examples" / "results.ipynb"
NOTEBOOK = json.loads(NOTEBOOK_FILE.read_text(encoding="utf-8"))


def shown(source: str, names: dict[str, Any]) -> Any:
    """Run a cell as Jupyter does; the value of its last line, where that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return (
        None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    )  # type: ignore[attr-defined]


def test_the_notebook_is_a_notebook_without_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    for cell in NOTEBOOK["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == (
            [],
            None,
        )


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with mpl.rc_context({"backend": "agg"}):
        cells = [
            shown("".join(cell["source"]), names)
            for cell in NOTEBOOK["cells"]
            if cell["cell_type"] == "code"
        ]
        import matplotlib.pyplot as plt

        plt.close("all")
    assert all(cell is not None for cell in cells)
    drives, metrics, _, pairs, worst, _, _, decisions = cells
    assert len(drives) == 6
    assert metrics.shape == (5, 6)
    assert pairs["dp_qp - idm"].notna().any()
    gaps = names["result"].metrics.query(
        "metric == 'gap.min' and planner == 'dp_qp' and mode == 'closed'"
    )
    assert worst["value"] == gaps["value"].min()
    assert [obstacle.agent for obstacle in names["graph"].obstacles] == ["pedestrian"]
    assert ("pedestrian", "yield") in decisions.index


def test_the_metric_is_the_speed_beside_someone_on_foot(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 8 m/s along x; someone stands 2 m beside the path, then farther off than is looked."""
    monkeypatch.syspath_prepend(str(NOTEBOOK_FILE.parent))
    metric = importlib.import_module("passing_speed").passing_speed
    ego = along(grid(10.0), 8.0)
    for kind, y, value in (("pedestrian", 2.0, 8.0), ("pedestrian", 3.5, None), ("car", 2.0, None)):
        log = scenario(
            ego, [("other", AgentKind(kind), (0.5, 0.5), moving(40.0, y, 0.0, 0.0, yaw=0.0))]
        )
        measured = metric.measure(drive(log), log)
        if value is None:
            assert isinstance(measured, Unavailable) or not measured.known.any()
        else:
            steps = measured.value[measured.known]
            assert np.all(steps == value)
            body = log.vehicle.length / value
            assert abs(0.1 * len(steps) - body) <= 0.1 + 1e-9  # seconds beside the body
            assert {label for label in measured.labels if label} == {"other"}


def test_the_workflow_of_the_ci_repository_uses_inputs_that_exist_and_files_that_are_there() -> (
    None
):
    folder = NOTEBOOK_FILE.parent / "ci_repository"
    action = yaml.safe_load(
        (NOTEBOOK_FILE.parents[1] / "ci" / "github" / "action.yml").read_text(encoding="utf-8")
    )
    flow = yaml.safe_load(
        (folder / ".github" / "workflows" / "planner.yml").read_text(encoding="utf-8")
    )
    asked = flow["jobs"]["replan"]["steps"][-1]["with"]
    assert set(asked) <= set(action["inputs"])
    assert (folder / asked["gates"]).exists()
    assert (
        (folder / asked["planner"].partition(":")[0].replace(".", "/")).with_suffix(".py").exists()
    )
