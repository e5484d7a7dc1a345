"""Every metric on drives that hardly are any: a value or a reason, never an exception (row 18)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import along, drive, grid, moving, plans, scenario, straight_road

from logs import AgentKind, EndReason, Goal, Mode, RoadSource, Scenario, Trace
from logs.kernel import FloatArray
from metrics import METRICS, evaluate, evaluate_with_series

T = grid(4.0, 0.1)
LOG = scenario(along(T, 10.0), duration=9.0)


def _priority() -> Scenario:
    lanes = straight_road(lanes=2, limit=13.0).lanes
    road = replace(straight_road(), lanes={**lanes, 0: replace(lanes[0], yields_to=(1,))})
    region: FloatArray = np.array([[30.0, -2.0], [40.0, -2.0], [40.0, 2.0], [30.0, 2.0]])
    return replace(LOG, road=road, goal=Goal((region,)))


LOGS = {
    "plain": LOG,
    "right of way": _priority(),
    "no lanes": replace(LOG, road=replace(straight_road(), source=RoadSource.DRIVEN_PATH)),
    "one logged state": replace(LOG, ego=along(T[:1], 10.0)),
    "stands": replace(LOG, ego=along(T, 0.0)),
}
STATES_AND_FRAMES = ((1, 0), (1, 1), (2, 1), (2, 2), (len(T), 0))
"""The third is a planner that fails at its second frame."""


def _drive(log: Scenario, mode: Mode, states: int, frames: int) -> Trace:
    ego = along(T[:states], 10.0)
    return drive(log, ego, mode=mode, frames=plans(along(T, 10.0), T[:frames], 2.0))


@pytest.mark.parametrize("mode", [Mode.OPEN, Mode.CLOSED])
@pytest.mark.parametrize("log", LOGS.values(), ids=LOGS.keys())
def test_all_metrics_of_a_drive_that_hardly_is_one_have_a_value_or_a_reason(log: Scenario, mode: Mode) -> None:
    metrics = [metric for metric in METRICS.values() if mode in metric.modes]
    for states, frames in STATES_AND_FRAMES:
        table, _ = evaluate_with_series(_drive(log, mode, states, frames), log)
        for metric in metrics:
            assert table["metric"].str.startswith(f"{metric.name}.").sum() >= len(metric.reductions)
        assert (table["available"] == np.isfinite(table["value"])).all()
        assert (table.loc[~table["available"], "reason"] != "").all()


def test_the_instant_of_contact_counts() -> None:
    """Row 20: at 30 m/s and 0.01 s only the last step, with which the drive ends, is nearer than 0.2 m."""
    ego = along(grid(1.0), 30.0)
    rear = float(ego.x[-1]) + LOG.vehicle.axle_to_front
    stands = ("7", AgentKind.CAR, (4.0, 1.8), moving(rear + 2.0 - 0.01, 0.0, 0.0, 0.0, 0.0))
    log = scenario(ego, [stands])
    table = evaluate(drive(log, end=EndReason.COLLISION), log, metrics={"gap": METRICS["gap"]}).set_index("metric")
    assert table.loc["gap.min", "value"] == 0.0
    assert table.loc["gap.time_below_20cm", "value"] == pytest.approx(0.005)


def test_right_of_way_of_one_state_says_why() -> None:
    log = LOGS["right of way"]
    table = evaluate(_drive(log, Mode.CLOSED, 1, 0), log).set_index("metric")
    assert table.loc["priority_gap.min", "reason"] == "the drive holds one ego state only"
