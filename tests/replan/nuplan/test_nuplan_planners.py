"""Planners of nuPlan's interface: without the devkit, and, where it is installed, whole drives."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import replan.nuplan as nuplan
from replan.core.errors import ConfigError, PlannerError
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.cut import cut
from replan.logs.trace import EndReason, Mode, Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import DEFAULT_LOOP
from replan.replay.planner_process.connection import describe_planner

SUPPORT = Path(__file__).parents[2] / "support"
SPEC = "nuplan:nuplan_planner:GoesStraight"
devkit = pytest.mark.skipif(find_spec("nuplan") is None, reason="nuPlan's devkit is not installed")

hydra = pytest.mark.skipif(find_spec("hydra") is None, reason="hydra is not installed")


@pytest.fixture
def _support(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner's process finds the planner of these tests, and what this one finds."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(SUPPORT), *sys.path]))


def driven(
    name: str, table: dict[str, object], mode: Mode = Mode.CLOSED, until_s: float = 4.0
) -> Trace:
    run = run_closed_loop if mode is Mode.CLOSED else run_open_loop
    scenario = cut(CATALOGUE[name].scenario(), 0.5)
    return run(scenario, SPEC, planner_config=table, config=DEFAULT_LOOP, until_s=until_s).trace


@pytest.mark.parametrize("spec", ["nuplan:", "nuplan:module", "nuplan::Class", "nuplan:a:b:c"])
def test_a_name_that_is_no_module_and_class_is_refused(spec: str) -> None:
    with pytest.raises(ConfigError, match="nuplan:MODULE:CLASS"):
        describe_planner(spec, {}, DEFAULT_LOOP.apart)


def test_an_interpreter_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigError, match="no interpreter"):
        describe_planner(SPEC, {"python": "/nowhere/python"}, DEFAULT_LOOP.apart)


def test_the_command_has_the_interpreter_of_the_table() -> None:
    assert nuplan.nuplan_command(SPEC, {})[0] == sys.executable
    command = nuplan.nuplan_command(SPEC, {"python": "python3.9"})
    assert command == ["python3.9", str(nuplan.START), "nuplan_planner:GoesStraight"]
    assert nuplan.START.is_file()


def test_the_command_has_the_folders_of_the_path(tmp_path: Path) -> None:
    table = {"path": [str(tmp_path)]}
    assert nuplan.nuplan_command(SPEC, table)[2:] == ["nuplan_planner:GoesStraight", str(tmp_path)]


@pytest.mark.parametrize("folders", ["devkit", ["nowhere"], [1]])
def test_a_path_that_is_no_list_of_folders_is_refused(folders: object) -> None:
    with pytest.raises(ConfigError, match="path"):
        describe_planner(SPEC, {"path": folders}, DEFAULT_LOOP.apart)


def test_the_side_of_nuplan_imports_nothing_of_replan() -> None:
    files = [nuplan.START, *(nuplan.START.parent / "replan_nuplan").glob("*.py")]
    assert len(files) > 5
    for file in files:
        assert "import replan" not in file.read_text(encoding="utf-8")
        assert "from replan" not in file.read_text(encoding="utf-8")


@pytest.mark.skipif(find_spec("nuplan") is not None, reason="nuPlan's devkit is installed")
def test_an_interpreter_without_the_devkit_is_an_error_that_says_what_it_lacks() -> None:
    with pytest.raises(PlannerError, match=r"lacks (nuplan|msgpack|scipy)"):
        driven("everyday/cut_in", {})


@devkit
@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("name", ["everyday/cut_in", "everyday/junction", "everyday/traffic_light"])
@pytest.mark.usefixtures("_support")
def test_a_planner_is_driven_unchanged(name: str, mode: Mode) -> None:
    trace = driven(name, {}, mode)
    assert trace.end is not EndReason.PLANNER_FAILURE, trace.detail
    assert not any(frame.plan.status.is_fallback for frame in trace.frames)
    for frame in trace.frames:
        ego = trace.ego.at(frame.t)
        assert frame.plan.trajectory.x[0] == pytest.approx(ego.x, abs=1e-6)


@devkit
@pytest.mark.usefixtures("_support")
def test_the_ego_comes_to_a_path_that_begins_beside_it() -> None:
    trace = driven("everyday/cut_in", {"aside": 0.3})
    assert not any(frame.plan.status.is_fallback for frame in trace.frames)
    assert trace.ego.y[-1] - trace.ego.y[0] == pytest.approx(0.3, abs=0.05)
    assert np.ptp(trace.ego.y) < 0.4


@devkit
@pytest.mark.parametrize(
    ("call", "name"),
    [
        ("constructor", "its constructor"),
        ("initialize", "initialize"),
        ("compute", "compute_planner_trajectory"),
    ],
)
@pytest.mark.usefixtures("_support")
def test_an_error_names_the_call_and_its_line(call: str, name: str) -> None:
    try:
        detail = driven("everyday/cut_in", {"fails": call}).detail
    except PlannerError as error:
        detail = str(error)
    assert f"{name} raised ValueError" in detail
    assert "nuplan_planner.py:" in detail


@devkit
@pytest.mark.parametrize("is_hydra", [False, pytest.param(True, marks=hydra)])
@pytest.mark.usefixtures("_support")
def test_a_planner_that_requires_a_scenario_gets_one(is_hydra: bool, tmp_path: Path) -> None:
    file = tmp_path / "planner.yaml"
    file.write_text("planner: {_target_: nuplan_planner.NeedsScenario, _convert_: all}\n")
    run = run_closed_loop(
        cut(CATALOGUE["everyday/cut_in"].scenario(), 0.5),
        "nuplan:nuplan_planner:NeedsScenario",
        planner_config={"hydra": str(file)} if is_hydra else {},
        config=DEFAULT_LOOP,
        until_s=0.5,
    )
    assert run.trace.end is not EndReason.PLANNER_FAILURE, run.trace.detail


@devkit
@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.usefixtures("_support")
def test_a_fresh_planner_remembers_nothing_in_open_loop(mode: Mode) -> None:
    """It loses a tenth of its speed with each plan: with a fresh one per frame, always a tenth."""
    one_planner = driven("everyday/cut_in", {"tires": 0.1}, mode, until_s=1.0)
    copies = driven("everyday/cut_in", {"tires": 0.1, "fresh": True}, mode, until_s=1.0)
    with_memory, fresh = (
        np.array([frame.plan.trajectory.v[40] / frame.plan.trajectory.v[0] for frame in run.frames])
        for run in (one_planner, copies)
    )
    assert with_memory[0] == fresh[0] == pytest.approx(0.9, abs=0.01)
    assert with_memory[-1] < 0.5
    if mode is Mode.OPEN:
        assert fresh == pytest.approx(np.full(len(fresh), 0.9), abs=0.01)
    else:
        assert fresh.tolist() == with_memory.tolist()
