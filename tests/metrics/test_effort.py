from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, controls, drive, grid, plans, scenario
from hypothesis import given, strategies as st

from replan.logs.plan import Plan, PlanStatus, SolverReport
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics import evaluate

LOG = scenario(along(grid(5.0, 0.1), 10.0))
T = LOG.ego.t


def judged(**changes: object) -> pd.DataFrame:
    return evaluate(drive(LOG, **changes), LOG).set_index("metric")


def report(stage: str, iterations: int, *, solved: bool = True) -> SolverReport:
    return SolverReport(
        stage, solved, "solved" if solved else "max iterations", iterations, 0.0, 0.0
    )


def planned(*internals: tuple[SolverReport, ...]) -> tuple[PlannedFrame, ...]:
    frames = plans(LOG.ego, grid(5.0, 0.1)[: len(internals)], 2.0)
    return tuple(
        replace(frame, plan=replace(frame.plan, internals=reports))
        for frame, reports in zip(frames, internals, strict=True)
    )


@given(st.lists(st.sampled_from("TBc"), min_size=2, max_size=51))
def test_pedals(word: list[str]) -> None:
    pedals = ("".join(word) + "c" * 51)[:51]
    throttle, brake = (np.array([float(p == which) for p in pedals]) for which in "TB")
    table = judged(commands=controls(T, 0.4 * throttle, 0.2 * brake))["value"]
    assert table["throttle.mean"] == pytest.approx(0.4 * throttle.mean())
    assert table["brake.max"] == 0.2 * brake.max()
    assert table["pedals_together.count"] == 0
    pressed = pedals.replace("c", "")
    assert table["pedal_switches.count"] == pressed.count("TB") + pressed.count("BT")


def test_pedals_together_are_counted_and_timed() -> None:
    brake = np.zeros(51)
    brake[[20, 21]] = 0.1
    table = judged(commands=controls(T, np.full(51, 0.3), brake))
    assert table.loc["pedals_together.count", "value"] == 2
    assert table.loc["pedals_together.count", "time_s"] == pytest.approx(2.0)


def test_pedals_are_judged_as_commanded_and_steering_as_actuated() -> None:
    commands = controls(T, np.ones(51), np.zeros(51), np.zeros(51))
    actuation = controls(T, np.ones(51), np.ones(51), 0.3 * T)
    table = judged(commands=commands, actuation=actuation)["value"]
    assert table["pedals_together.count"] == 0
    assert table["steer_rate.max_abs"] == pytest.approx(0.3)


def test_without_commands() -> None:
    table = judged()
    for name in (
        "throttle.mean",
        "pedals_together.count",
        "pedal_switches.count",
        "steer_rate.p95",
    ):
        assert table.loc[name, "reason"] == "the drive has no commands"


@pytest.mark.parametrize("mode", Mode)
def test_solver_iterations_by_stage(mode: Mode) -> None:
    frames = planned(
        (report("path", 25), report("speed", 50)),
        (report("path", 75), report("path", 100)),
        (report("path", 25), report("speed", 4000, solved=False)),
        (),
    )
    table = judged(mode=mode, frames=frames)
    assert table.loc["qp_iterations.path.mean", "value"] == pytest.approx(50.0)
    assert table.loc["qp_iterations.path.max", "time_s"] == pytest.approx(0.1)
    assert table.loc["qp_iterations.speed.max", "value"] == 4000
    assert table.loc["solver_unsolved.count", "value"] == 1
    assert table.loc["solver_unsolved.count", "time_s"] == pytest.approx(0.2)
    assert table.loc["solver_unsolved.count", "reason"] == "speed: max iterations"


def test_without_solver_reports_the_effort_is_unavailable() -> None:
    table = judged(frames=planned((), ()))
    for name in ("qp_iterations.max", "solver_unsolved.count"):
        assert table.loc[name, "reason"] == "the plans hold no solver reports"


def test_fallbacks() -> None:
    frames = list(planned((), (), (), ()))
    stop = Plan(
        frames[2].plan.trajectory, PlanStatus.COMFORTABLE_STOP, "the speed QP is infeasible"
    )
    frames[2] = PlannedFrame(frames[2].t, stop)
    table = judged(frames=tuple(frames))
    assert table.loc["fallback.rate", "value"] == 0.25
    assert table.loc["fallback.rate", "time_s"] == pytest.approx(0.2)
    assert table.loc["fallback.rate", "reason"].endswith(
        "along the last path: the speed QP is infeasible"
    )
    assert judged().loc["fallback.rate", "reason"] == "the drive has no plans"
