from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, grid, moving, scenario, straight_road
from gate_rows import row, table
from hypothesis import given, strategies as st

from logs import AgentKind, RoadSource
from metrics.judge import judge, worst
from metrics.judge.aggregate import LogLabels
from metrics.judge.discrimination import BLIND, BLIND_FAILS, PARKED, PARKED_FAILS, with_discrimination
from metrics.judge.gates import Gate, Gates, Outcome
from replay.loop.reference_drives import discriminate

PROGRESS, CRASH = Gate("route_progress.final", min=0.5), Gate("collision_at_fault.count", max=0.0)
EASY = Gate(PARKED_FAILS, mode="closed", min=1, optional=True, broken="inconclusive")
RULES = Gates((PROGRESS, CRASH, EASY), "test")


def made(progress: float, **bad: float) -> pd.DataFrame:
    """A drive of dp_qp with this progress, and the reference drives: progress of the parked, contacts of the blind."""
    of = {PARKED: PROGRESS.metric, BLIND: CRASH.metric}
    references = (
        row("a", value, planner=planner, mode="reference", oracle=True, metric=of[planner])
        for planner, value in bad.items()
    )
    names = row("a", np.nan, metric=PARKED_FAILS), row("a", np.nan, metric=BLIND_FAILS)
    mine = row("a", progress, metric=PROGRESS.metric), row("a", 0.0, metric=CRASH.metric)
    return with_discrimination(table(*mine, *names, *references), RULES, {"a": LogLabels()})


def value(rows: pd.DataFrame, metric: str) -> float:
    return float(rows.loc[(rows["metric"] == metric) & (rows["mode"] == "closed"), "value"].iloc[0])


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 2))
def test_a_log_that_a_parked_driver_passes_makes_a_pass_inconclusive_and_leaves_a_failure(
    progress: float, parked: float, contacts: int
) -> None:
    rows = made(progress, parked=parked, blind=float(contacts))
    assert value(rows, PARKED_FAILS) == float(parked < 0.5)
    assert value(rows, BLIND_FAILS) == float(contacts > 0)
    outcome = worst(verdict.logs[0].outcome for verdict in judge(RULES, rows, {"a": LogLabels()}))
    if progress < 0.5:
        assert outcome is Outcome.FAIL
    else:
        assert outcome is (Outcome.PASS if parked < 0.5 else Outcome.INCONCLUSIVE)


def test_a_share_of_logs_with_an_interaction_can_be_asked_for() -> None:
    share = Gate(BLIND_FAILS, min=1, over="pass_share", min_share=0.5)
    for contacts, outcome in ((1.0, Outcome.PASS), (0.0, Outcome.FAIL)):
        rows = made(1.0, parked=0.0, blind=contacts)
        (verdict,) = judge(Gates((share,), "test"), rows, {"a": LogLabels()})
        assert verdict.outcome is outcome


def test_without_reference_drives_the_gate_is_not_asked() -> None:
    rows = made(1.0)
    assert np.isnan(value(rows, PARKED_FAILS))
    assert worst(verdict.outcome for verdict in judge(RULES, rows, {"a": LogLabels()})) is Outcome.PASS


@pytest.mark.parametrize("ahead", [None, 60.0])
def test_a_standing_car_is_an_interaction_and_a_free_road_is_none(ahead: float | None) -> None:
    t = grid(12.0)
    agents = [("1", AgentKind.CAR, (4.5, 1.8), moving(ahead, 0.0, 0.0, 0.0, yaw=0.0))] if ahead else []
    log = scenario(along(t, 10.0), agents, road=straight_road(limit=13.9))
    found = {one.driver: one.breaks for one in discriminate(log)}
    assert found[PARKED] is not None
    assert (found[BLIND] is not None) is (ahead is not None)


@pytest.mark.parametrize("seconds", [0.02, 0.12])
def test_a_log_too_short_for_the_reference_drives_has_none(seconds: float) -> None:
    log = scenario(along(grid(seconds), 5.0), [], road=straight_road(limit=13.9))
    assert discriminate(log) == ()


def test_a_log_that_only_reverses_tells_nothing() -> None:
    t = grid(10.0, 0.1)
    log = scenario(along(t, -2.0), [], road=replace(straight_road(), source=RoadSource.DRIVEN_PATH))
    assert discriminate(log) == ()


def test_a_log_in_which_the_driver_stands_does_not_tell_drivers_apart() -> None:
    log = scenario(along(grid(6.0), 0.0), [], road=straight_road(limit=13.9))
    found = {one.driver: one.breaks for one in discriminate(replace(log, goal=None))}
    assert found[PARKED] is None or found[PARKED].metric == "needless_standing.worst_episode"
