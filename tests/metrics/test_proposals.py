"""Plans judged over their whole horizon (`replan.metrics.proposals`)."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, moving, plans, scenario, straight_road

from replan.logs.agents import AgentKind
from replan.logs.frame import PLAN_HORIZON_S
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics import METRICS, evaluate
from replan.metrics.judge.gates import load_gates
from replan.metrics.plans import SHORT_M

ASKED = {
    name: metric
    for name, metric in METRICS.items()
    if name.startswith("plan_") or name == "extended_comfort"
}
GATES = [gate for gate in load_gates(None).gates if gate.metric.partition(".")[0] in ASKED]
V, SECONDS = 10.0, 12.0
LOG = scenario(along(grid(SECONDS + 8.0, 0.1), V), road=straight_road(half=10.0))
Bend = Callable[[Trajectory], Trajectory]


def frames(
    period: float = 0.1, bend: Callable[[int], Bend | None] = lambda i: None
) -> tuple[PlannedFrame, ...]:
    """The log's next 5 s as the plans of 12 s, the plan of frame i bent by `bend(i)`."""
    return tuple(
        frame
        for i, t in enumerate(grid(SECONDS, period))
        for frame in plans(LOG.ego, [t], 5.0, bend(i))
    )


def judged(
    made: tuple[PlannedFrame, ...], log: Scenario = LOG, mode: Mode = Mode.CLOSED
) -> pd.DataFrame:
    return evaluate(drive(log, mode=mode, frames=made), log, metrics=ASKED).set_index("metric")


def broken(table: pd.DataFrame) -> set[str]:
    """The gates on plans that a table breaks."""
    value = table["value"]
    return {
        g.metric
        for g in GATES
        if value.get(g.metric, np.nan) == value.get(g.metric) and g.margin(value[g.metric]) < 0
    }


def aside(metres: float, after: float = 1.2) -> Bend:
    """The plan swings to the left from `after` s on, over 2 s."""

    def bend(plan: Trajectory) -> Trajectory:
        share = np.clip((plan.t - plan.t[0] - after) / 2.0, 0.0, 1.0)
        return replace(plan, y=plan.y + metres * share**2 * (3.0 - 2.0 * share))

    return bend


def stop(plan: Trajectory) -> Trajectory:
    """The plan brakes with 4 m/s2 from 1.5 s on."""
    late = np.clip(plan.t - plan.t[0] - 1.5, 0.0, V / 4.0)
    lost = V * np.clip(plan.t - plan.t[0] - 1.5, 0.0, None) - V * late + 2.0 * late**2
    return replace(plan, x=plan.x - lost, v=np.where(late > 0.0, V - 4.0 * late, V))


@pytest.mark.parametrize("mode", Mode)
def test_driven_plans_break_no_bound(mode: Mode) -> None:
    value = judged(frames(), mode=mode)["value"]
    for row in ("plan_score.mean", "plan_score.min", "plan_progress.min"):
        assert value[row] == pytest.approx(1.0), row
    for row in (
        "plan_collision.rate",
        "plan_off_road.max",
        "plan_change.max",
        "plan_comfort.share_above_1",
    ):
        assert value[row] == pytest.approx(0.0, abs=1e-9), row
    assert mode is Mode.OPEN or value["plan_kept.max"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("period", [0.05, 0.1, 0.2])
def test_the_end_of_a_plan_is_judged_at_any_rate(period: float) -> None:
    found = judged(frames(period, lambda i: aside(8.0)))
    assert {"plan_kept_lateral.share_beyond_2m", "plan_kept.share_beyond_5m"} <= broken(found)
    assert found.loc["plan_kept_lateral.max", "value"] == pytest.approx(8.0)
    turns = judged(frames(period, lambda i: aside(3.0 if i % 2 else -3.0)))
    assert "plan_change_lateral.share_beyond_1m" in broken(turns)
    assert turns.loc["plan_change_lateral.max", "value"] == pytest.approx(6.0)
    stops = judged(frames(period, lambda i: stop if i % 2 else None))
    assert "plan_change.share_beyond_1m" in broken(stops)
    assert "plan_kept.share_beyond_5m" in broken(judged(frames(period, lambda i: stop)))


@pytest.mark.parametrize("mode", Mode)
def test_two_short_changes_of_plans_break_no_gate(mode: Mode) -> None:
    """The first 2 s of plans go straight on, then 1 s of them stop, then they go on: two changes in
    12 s.
    """
    assert not broken(judged(frames(bend=lambda i: stop if 20 <= i < 30 else None), mode=mode))


@pytest.mark.parametrize("mode", Mode)
def test_contact_is_charged_by_fault(mode: Mode) -> None:
    """A car stands 30 m ahead of a 10 m/s drive in the next lane; plans swing into it.

    Another comes from behind.
    """
    stands = (
        "7",
        AgentKind.CAR,
        (4.5, 1.8),
        lambda t: (0 * t + 30.0 + 0.0 * t, 0 * t + 4.0, 0 * t),
    )
    log = replace(LOG, tracks=scenario(LOG.ego, [stands]).tracks)
    table = judged(frames(bend=lambda i: aside(4.0)), log, mode)
    assert table.loc["plan_collision.rate", "value"] > 0.05
    assert table.loc["plan_collision.min", "reason"] == "car 7"
    assert table.loc["plan_ttc.min", "value"] == 0.0
    assert table.loc["plan_score.min", "value"] == 0.0
    behind = ("8", AgentKind.CAR, (4.5, 1.8), moving(-12.0, 0.0, 14.0, 0.0))
    log = replace(LOG, tracks=scenario(LOG.ego, [behind]).tracks)
    assert judged(frames(), log, mode).loc["plan_collision.rate", "value"] == 0.0


def test_a_plan_is_off_the_road_by_what_it_adds() -> None:
    narrow = replace(LOG, road=straight_road(half=1.75))
    assert "plan_off_road.share_beyond_30cm" in broken(
        judged(frames(bend=lambda i: aside(3.0)), narrow)
    )
    off = replace(LOG, road=straight_road(half=0.5))  # the ego drives 0.4 m off the lane already
    assert judged(frames(), off).loc["plan_off_road.max", "value"] == 0.0


def test_a_plan_is_not_judged_beyond_the_drive() -> None:
    short = replace(LOG, ego=LOG.ego.between(0.0, 2.9))
    made = tuple(frame for frame in frames(bend=lambda i: aside(8.0)) if frame.t <= 2.9)
    table = judged(made, short)
    assert (
        table.loc["plan_kept.max", "reason"]
        == "no plan of more than 5 m is followed by 3 s of driving"
    )
    assert table.loc["plan_kept.share_beyond_5m", "value"] == 0.0
    # What it lacks here is what its page says that it needs
    for name in ("plan_kept", "plan_kept_lateral"):
        assert (
            f"{SHORT_M:g} m" in METRICS[name].needs
            and f"{PLAN_HORIZON_S:g} s" in METRICS[name].needs
        )
    still = scenario(along(grid(10.0, 0.1), 0.0))
    assert (
        judged(plans(still.ego, grid(5.0, 0.1), 5.0), still).loc["plan_progress.min", "value"]
        == 1.0
    )


@pytest.mark.parametrize("mirror", [False, True])
def test_plans_may_be_turned_and_mirrored(mirror: bool) -> None:
    stands = ("7", AgentKind.CAR, (4.5, 1.8), moving(60.0, 5.0, -3.0, 0.2))
    log = replace(LOG, tracks=scenario(LOG.ego, [stands]).tracks)
    made = frames(bend=lambda i: aside(4.0 if i % 3 else -1.0))
    there = tuple(
        replace(
            f,
            plan=replace(
                f.plan, trajectory=moved_ego(f.plan.trajectory, 0.7, 9.0, -5.0, mirror=mirror)
            ),
        )
        for f in made
    )
    one, two = (
        judged(made, log)["value"],
        judged(there, moved(log, 0.7, 9.0, -5.0, mirror=mirror))["value"],
    )
    assert two.to_numpy() == pytest.approx(one.to_numpy(), abs=1e-6, nan_ok=True)
