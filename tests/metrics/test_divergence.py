"""Divergence: by hand, and laws: none for the log's own drive, turned worlds, and nothing before it parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, moving, scenario
from hypothesis import given
from hypothesis import strategies as st

from logs import AgentKind, Scenario, Trace, Tracks, Trajectory
from metrics import METRICS, evaluate

NAMES = ("divergence", "divergence_weak", "displaced")
T = grid(10.0)
CAR = (4.5, 1.8)


def table(trace: Trace, log: Scenario) -> pd.DataFrame:
    return evaluate(trace, log, metrics={name: METRICS[name] for name in NAMES}).set_index("metric")


def shifted(tracks: Tracks, who: str, since: float, by: float) -> Tracks:
    """One agent is `by` behind along x from `since` on."""
    span = tracks.samples(tracks.ids.index(who))
    x = tracks.x.copy()
    x[span] -= np.where(tracks.t[span] >= since, by, 0.0)
    return replace(tracks, x=x)


LOG = scenario(
    along(T, 10.0),
    [("a", AgentKind.CAR, CAR, moving(30.0, 0.0, 10.0, 0.0)), ("b", AgentKind.CAR, CAR, moving(-30, 0, 10, 0))],
)


def test_the_logs_own_drive_never_parts() -> None:
    rows = table(drive(LOG), LOG)
    assert rows.loc["divergence.max", "value"] == 0.0
    assert rows.loc["divergence_weak.share", "value"] == 0.0 and rows.loc["displaced.count", "value"] == 0.0
    assert not rows.loc["divergence_weak.from", "available"]
    assert rows.loc["divergence_weak.from", "reason"] == "the drive never parts from the log"


@pytest.mark.parametrize(("v", "from_s"), [(8.0, 5.0), (12.0, 5.0), (9.0, 10.0)])
def test_a_second_of_way_along_is_too_far(v: float, from_s: float) -> None:
    """The log drives at 10 m/s: 10 m ahead or behind."""
    rows = table(drive(LOG, along(T, v)), LOG)
    assert rows.loc["divergence.max", "value"] == pytest.approx(abs(v - 10.0) * 10.0)
    if from_s == 10.0:
        assert not rows.loc["divergence_weak.from", "available"]
        return
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(from_s, abs=0.011)
    assert rows.loc["divergence_weak.from", "reason"] == "the ego along its way"
    assert rows.loc["divergence_weak.share", "value"] == pytest.approx(0.5, abs=0.002)


def test_at_low_speed_a_cars_length_is_and_across_a_lanes_width() -> None:
    log = scenario(along(T, 1.0))
    rows = table(drive(log, along(T, 2.0)), log)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(5.0, abs=0.011)
    aside = replace(log.ego, y=np.where(T >= 4.0, 3.6, 3.4))
    rows = table(drive(log, aside), log)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(4.0)
    assert rows.loc["divergence_weak.from", "reason"] == "the ego across its way"


def test_who_is_not_where_the_log_has_them_makes_it_weak_and_is_counted() -> None:
    slow, back = shifted(LOG.tracks, "b", 3.0, 0.6), replace(drive(LOG), agents=shifted(LOG.tracks, "b", 3.0, 0.4))
    rows = table(replace(drive(LOG), agents=slow), LOG)
    assert rows.loc["divergence_weak.from", "value"] == pytest.approx(3.0, abs=0.011)
    assert (rows.loc["divergence_weak.from", "reason"], rows.loc["displaced.count", "reason"]) == ("car b", "car b")
    assert rows.loc["displaced.count", "value"] == 1.0 and rows.loc["displaced.count", "time_s"] == pytest.approx(
        3.0, abs=0.011
    )
    assert table(back, LOG).loc["displaced.count", "value"] == 0.0
    gone = replace(drive(LOG), agents=Tracks.empty())
    assert table(gone, LOG).loc["displaced.count", "value"] == 2.0


def test_a_log_of_a_start_state_alone_has_nothing_to_part_from() -> None:
    start = replace(
        LOG, ego=Trajectory(*(getattr(LOG.ego, name)[:1] for name in ("t", "x", "y", "yaw", "v", "a", "kappa")))
    )
    rows = table(drive(LOG, along(T, 3.0)), start)
    for name in ("divergence.max", "divergence_weak.from", "divergence_weak.share"):
        assert not rows.loc[name, "available"] and "one ego state only" in rows.loc[name, "reason"]
    assert rows.loc["displaced.count", "available"]


def test_after_the_logs_drive_nothing_is_said_of_the_ego() -> None:
    short = replace(LOG, ego=along(grid(4.0), 10.0))
    rows = table(drive(LOG, along(T, 8.0)), short)
    assert (
        rows.loc["divergence.max", "value"] == pytest.approx(8.0) and not rows.loc["divergence_weak.from", "available"]
    )


@given(st.floats(-3.1, 3.1), st.floats(6.0, 14.0), st.booleans())
def test_turned_and_mirrored_worlds_part_alike(turn: float, v: float, mirror: bool) -> None:
    trace = replace(drive(LOG, along(T, v)), agents=shifted(LOG.tracks, "a", 7.0, 1.0))
    other = moved(LOG, turn, 50.0, -20.0, mirror=mirror)
    there = replace(
        drive(other, moved_ego(trace.ego, turn, 50.0, -20.0, mirror=mirror)),
        agents=moved(replace(LOG, tracks=trace.agents), turn, 50.0, -20.0, mirror=mirror).tracks,
    )
    one, two = table(trace, LOG), table(there, other)
    np.testing.assert_allclose(one["value"], two["value"], atol=1e-6)
    assert list(one["reason"]) == list(two["reason"])
