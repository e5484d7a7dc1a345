"""Recorded perception (what a tracker knew of the log's detections), and what no perception and
prediction but the oracle knows: the future.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from handmade import track
from hypothesis import given, settings, strategies as st
from perceived import GRID, assert_same_agents, crowd, detected, frames, with_agents

from replan.contract.planner_rules import until
from replan.core.errors import ConfigError, LogError
from replan.logs.frame import Frame
from replan.logs.repair.detections import Detections, named_as_tracked
from replan.logs.repair.offline import detections_of
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import PERCEPTION, PREDICTION

TIMES = np.arange(0.0, 6.01, 0.1)


@pytest.mark.parametrize("perception", [name for name in PERCEPTION.builtin if name != "auto"])
@pytest.mark.parametrize("prediction", PREDICTION.causal)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
@settings(max_examples=5)
def test_no_later_sample_is_seen_or_predicted(
    perception: str, prediction: str, seed: int, k: int
) -> None:
    log, config = detected(crowd(seed)), LoopConfig(perception=perception, prediction=prediction)
    assert log.repair is not None
    known = log.repair.detections.between(-np.inf, GRID[k] + 1e-6)
    cut = detected(replace(log, tracks=until(log.tracks, GRID[k])), known)
    whole, truncated = (frames(some, config, GRID[: k + 1])[-1] for some in (log, cut))
    assert_same_agents(whole.agents, truncated.agents)
    for name in ("agent", "probability", "x", "y", "yaw"):
        np.testing.assert_array_equal(
            getattr(whole.predictions, name), getattr(truncated.predictions, name)
        )


# the oracle


def crossing_later() -> Scenario:
    """A road user that stands for two seconds, then crosses at 1 m/s."""
    return with_agents(track("a", TIMES, 30.0 + 0.0 * TIMES, np.maximum(TIMES - 2.0, 0.0)))


ORACLE = LoopConfig(prediction="oracle", prediction_horizon_s=3.0, traffic="time")


def test_the_oracle_predicts_the_logs_own_future_and_extends_it() -> None:
    future = frames(crossing_later(), ORACLE, [1.0])[0].predictions
    np.testing.assert_allclose(future.y[0], np.maximum(future.t - 2.0, 0.0), atol=1e-9)
    assert future.method == "oracle"
    beyond = frames(crossing_later(), ORACLE, [5.0])[0].predictions
    np.testing.assert_allclose(beyond.y[0], beyond.t - 2.0, atol=1e-9)


@pytest.mark.parametrize("run", [run_open_loop, run_closed_loop])
def test_a_drive_with_the_oracle_is_marked(run: Callable[..., Drive]) -> None:
    trace = run(crossing_later(), "constant_speed", config=ORACLE).trace
    assert trace.oracle
    assert any("log's own future" in note for note in trace.notes)
    assert not run(crossing_later(), "constant_speed").trace.oracle


@pytest.mark.parametrize("traffic", ["give_way", "reactive"])
def test_the_oracle_is_refused_with_traffic_that_leaves_the_log(traffic: str) -> None:
    with pytest.raises(ConfigError, match=r"take traffic 'time' \(--traffic time\)"):
        LoopConfig(prediction="oracle", traffic=traffic)


# recorded


def passing() -> Scenario:
    """Two cars beside each other's lanes, and one that is only in the detections, for two
    seconds.
    """
    log = with_agents(
        track("1", TIMES, 20.0 + 8.0 * TIMES, 0.0 * TIMES + 3.5),
        track("2", TIMES, 60.0 - 5.0 * TIMES, 0.0 * TIMES - 3.5),
    )
    ghost = track("9", TIMES[20:40], 30.0 + 0.0 * TIMES[20:40], 0.0 * TIMES[20:40] + 20.0)
    names = "t", "x", "y", "yaw", "vx", "vy", "score", "length", "width", "codes"
    cars, false_alarm = detections_of(log.tracks), detections_of(with_agents(ghost).tracks)
    order = np.argsort(np.r_[cars.t, false_alarm.t], kind="stable")
    columns = {
        name: np.r_[getattr(cars, name), getattr(false_alarm, name)][order] for name in names
    }
    return detected(log, Detections(frames=TIMES, ids=("",) * len(order), **columns))


def row_at(frame: Frame, x: float, y: float) -> int:
    """The row of the agent that is shown at a place."""
    away = np.hypot(frame.agents.x - x, frame.agents.y - y)
    assert away.min() < 0.7, (frame.agents.x, frame.agents.y)
    return int(np.argmin(away))


def test_recorded_shows_the_detections_until_then() -> None:
    shown = frames(passing(), LoopConfig(perception="recorded"), TIMES.tolist())
    assert len(shown[0].agents) == 0, "one box is not yet a track"
    assert [len(frame.agents) for frame in (shown[15], shown[30], shown[-1])] == [2, 3, 2]
    for k in (15, 30, 60):
        i = row_at(shown[k], 20.0 + 8.0 * TIMES[k], 3.5)
        assert shown[k].agents.vx[i] == pytest.approx(8.0, abs=0.5)
    row_at(shown[30], 30.0, 20.0)  # a false alarm


def test_recorded_follows_the_world_where_it_moves_otherwise_than_the_log() -> None:
    log = passing()
    late = with_agents(
        track("1", TIMES, 20.0 + 4.0 * TIMES, 0.0 * TIMES + 3.5),
        track("walker", TIMES, 0.0 * TIMES + 9.0, 0.0 * TIMES - 9.0),
    ).tracks
    (frame,) = frames(log, LoopConfig(perception="recorded"), TIMES[:41].tolist(), late)[-1:]
    assert "walker" in frame.agents.ids, "in no detection, but in the world"
    row_at(frame, 30.0, 20.0)  # the false alarm is as it was, and car 2 is not there
    assert len(frame.agents) == 3
    i = row_at(frame, 20.0 + 4.0 * TIMES[40], 3.5)
    assert frame.agents.vx[i] == pytest.approx(4.0, abs=0.5)
    gone = frames(log, LoopConfig(perception="recorded"), TIMES[:16].tolist(), Tracks.empty())[-1]
    assert len(gone.agents) == 0


def test_auto_is_recorded_where_tracks_are_made_of_detections() -> None:
    log = passing()
    for some, name in ((log, "recorded"), (replace(log, repair=None), "ground_truth")):
        for auto, asked in zip(
            *(frames(some, LoopConfig(perception=p), GRID) for p in ("auto", name)), strict=True
        ):
            assert_same_agents(auto.agents, asked.agents)
    trace = run_open_loop(log, "constant_speed", config=LoopConfig(perception="auto")).trace
    assert trace.perceived is not None and any("as recorded" in note for note in trace.notes)
    with pytest.raises(LogError, match="made of detections; take perception auto"):
        run_open_loop(with_agents(), "constant_speed", config=LoopConfig(perception="recorded"))


def test_a_repaired_track_is_called_as_the_tracker_calls_it() -> None:
    log = passing()
    assert log.repair is not None
    named = named_as_tracked(log.repair)
    assert named.tracks.ids == named_as_tracked(named).tracks.ids
    renamed = replace(log, repair=named, tracks=named.tracks)
    for frame in frames(renamed, LoopConfig(perception="recorded"), TIMES[10:].tolist()):
        for name, x, y in zip(frame.agents.ids, frame.agents.x, frame.agents.y, strict=True):
            if y < 10.0:
                truth = renamed.tracks.truth(frame.t)
                i = truth.ids.index(name)
                assert np.hypot(truth.x[i] - x, truth.y[i] - y) < 0.7
            else:
                assert name not in renamed.tracks.ids
