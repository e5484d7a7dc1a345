"""What plans used against what perception showed: outlines, faults of a drive, and their table."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import replan
from hypothesis import given, strategies as st

from replan.config import RunConfig
from replan.explain.input_faults import LEAST, describe_input, input_faults
from replan.explain.input_outlines import MISSED_M, SLICES, Slices
from replan.explain.input_use import InputUse
from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Scenario
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig, SensorConfig
from replan.results.schema import names_of
from replan.run import evaluate_logs

TRUSTED = LoopConfig(apart=PlannerProcessConfig(trust=True))
SENSOR = LoopConfig(
    perception="sensor", sensor=SensorConfig(latency_s=0.5, position_noise_m=0.4, dropout=0.1)
)


@cache
def log(name: str, end: float) -> Scenario:
    whole = CATALOGUE[name].scenario()
    return replace(whole, ego=whole.ego.between(0.0, end), duration=end)


def use_of(name: str, planner: str, loop: LoopConfig, end: float = 9.0) -> InputUse:
    scenario = log(name, end)
    return InputUse.of(run_closed_loop(scenario, planner, config=loop).trace, scenario, loop)


def outline(lower: float, speed: float, length: float = 5.0) -> Slices:
    t = np.array([0.0, 8.0])
    low = np.column_stack([t, lower + speed * t])
    return Slices.of(np.vstack([low, low[::-1] + np.array([0.0, length])]))


@given(st.floats(0.0, 50.0), st.floats(0.0, 15.0), st.floats(0.0, 3.0))
def test_a_margin_on_both_sides_is_no_difference(lower: float, speed: float, margin: float) -> None:
    drawn = outline(lower - margin, speed, 5.0 + 2.0 * margin)
    assert drawn.difference(outline(lower, speed), speed) == pytest.approx(0.0, abs=1e-6)


@given(st.floats(0.0, 50.0), st.floats(2.0, 15.0), st.floats(-3.0, 3.0))
def test_a_shift_is_the_difference_and_an_age(lower: float, speed: float, shift: float) -> None:
    drawn, shown = outline(lower + shift, speed), outline(lower, speed)
    assert drawn.difference(shown, speed) == pytest.approx(abs(shift), abs=0.01)
    motion = drawn.motion(shown)
    assert motion["age_s"] == pytest.approx(-shift / speed, abs=1e-6)
    assert motion["share"] == pytest.approx(1.0)


def test_an_outline_where_nothing_was_shown_is_off_by_the_most() -> None:
    nothing = Slices(np.full(len(SLICES), np.nan), np.full(len(SLICES), np.nan))
    assert outline(10.0, 5.0).difference(nothing, 5.0) == MISSED_M
    assert nothing.difference(nothing, 5.0) == 0.0


@pytest.mark.parametrize(
    ("planner", "name", "claim"),
    [
        ("Stale", "everyday/follow", "agents and predictions 0.80 s older than shown"),
        ("Sluggish", "everyday/follow", "0.40 of the predicted displacements"),
        ("Aside", "everyday/nudge", "agents -1.2 m across the ego's heading"),
        ("Braking", "paper/crossing_pedestrian", "0.70 of the ego's speed, and no previous plan"),
        ("Unseeing", "everyday/follow", "no agents that take its way soon"),
        ("AllGreen", "everyday/traffic_light", "no red light at stop line 1"),
    ],
)
def test_the_fault_is_named_with_its_size(planner: str, name: str, claim: str) -> None:
    faults = input_faults(use_of(name, f"misled:{planner}", TRUSTED))
    assert any(fault.claim.startswith(claim) for fault in faults), faults
    assert all(LEAST <= fault.count <= fault.of for fault in faults)


@pytest.mark.parametrize(
    ("planner", "loop"),
    [("idm", LoopConfig()), ("pdm", LoopConfig()), ("dp_qp", SENSOR), ("lattice", SENSOR)],
)
def test_settings_of_perception_are_no_fault(planner: str, loop: LoopConfig) -> None:
    """A delay of 0.5 s, noise and dropouts are what the planner was shown."""
    use = use_of("paper/crossing_pedestrian", planner, loop)
    assert use.agents
    assert not use.is_blind
    assert describe_input(use) == []


def test_a_planner_without_artefacts_is_said_to_be_blind() -> None:
    use = use_of("paper/crossing_pedestrian", "constant_speed", LoopConfig(), 3.0)
    assert use.is_blind
    assert describe_input(use) == [
        "Its plans have no S-T graph: what they used of the agents is not known."
    ]


def test_explain_says_the_fault_first_and_writes_the_table(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    write_scenario(tmp_path / "logs" / "follow.mcap", log("everyday/follow", 9.0))
    run = RunConfig(planners=("misled:Stale",), mode="closed", recording=False, loop=TRUSTED)
    evaluate_logs([tmp_path / "logs"], run, tmp_path / "run", workers=0)
    first, second, *_ = replan("explain", tmp_path / "run").stdout.splitlines()
    assert "end of the log" in first or "goal" in first
    assert second.startswith("The planner used agents and predictions 0.80 s older than shown")
    table = tmp_path / "use.parquet"
    replan("explain", tmp_path / "run", "--table", table)
    rows: pd.DataFrame = pd.read_parquet(table)
    assert list(rows.columns) == names_of("input_use.parquet")
    late = rows[(rows["agent"] == "lead") & (rows["t_s"] > 1.0)]
    assert late["age_s"].median() == pytest.approx(0.8, abs=0.1)
    assert late["share"].median() == pytest.approx(1.0, abs=0.1)
