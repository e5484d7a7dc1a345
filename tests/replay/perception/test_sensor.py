"""A sensor: without faults it shows the ground truth; range, occlusion, noise, drop-outs and
latency are as they are set.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from handmade import drive, straight, track
from hypothesis import given, settings, strategies as st
from perceived import COLUMNS, GRID, IDEAL, assert_same_agents, crowd, frames, sensed, with_agents

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.tracks import Tracks
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_a_sensor_without_faults_shows_the_ground_truth(seed: int) -> None:
    log = crowd(seed)
    for true, seen in zip(frames(log, LoopConfig(), GRID), sensed(log, IDEAL, GRID), strict=True):
        assert_same_agents(true.agents, seen.agents)
        assert_same_agents(true.agents, log.tracks.perceived(true.t))
        assert true.visibility is None and seen.visibility is not None


# range, field of view, occlusion


def pose(agents: Agents, i: int) -> tuple[float, ...]:
    return tuple(float(getattr(agents, name)[i]) for name in ("x", "y", "yaw", "length", "width"))


def box(name: str, x: float, y: float, **more: object) -> dict[str, object]:
    return track(name, [0.0], [x], [y], static=True, **more)


def test_agents_outside_of_range_and_field_of_view_are_not_seen_and_that_is_known() -> None:
    log = with_agents(box("near", 30.0, 0.0), box("far", 90.0, 10.0), box("behind", -30.0, 3.0))
    (near,) = sensed(log, replace(IDEAL, range_m=50.0), [0.0])
    (ahead,) = sensed(log, replace(IDEAL, field_of_view_deg=120.0), [0.0])
    assert near.agents.ids == ("near", "behind") and ahead.agents.ids == ("near", "far")
    assert near.visibility is not None and ahead.visibility is not None
    points = np.array([[40.0, 0.0], [60.0, 0.0], [-30.0, 0.0]])
    assert near.visibility.hides(points).tolist() == [False, True, False]
    assert ahead.visibility.hides(points).tolist() == [False, False, True]


def test_a_child_behind_a_van_is_hidden_until_it_steps_out() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    van = box("van", 30.0, -3.0, kind=AgentKind.TRUCK, length=6.0, width=2.4)
    child = track(
        "child", t, 35.0 + 0.0 * t, -5.0 + t, kind=AgentKind.PEDESTRIAN, length=0.4, width=0.5
    )
    sensor = replace(IDEAL, occlusion=True)
    standing = replace(drive(straight, 0.0, 6.0), x=np.zeros(61), y=np.zeros(61))
    log = replace(with_agents(van, child), ego=standing)
    shown = [frame.agents.ids for frame in sensed(log, sensor, t.tolist())]
    first = next(i for i, ids in enumerate(shown) if "child" in ids)
    assert 10 < first < 45, "hidden at first, seen before it is on the ego's way"
    assert all("child" in ids for ids in shown[first:])
    assert all("van" in ids for ids in shown)


def test_pedestrians_hide_no_other_road_user() -> None:
    row = (box(f"p{i}", 10.0 + 2.0 * i, 0.0, kind=AgentKind.PEDESTRIAN) for i in range(5))
    (frame,) = sensed(with_agents(*row), replace(IDEAL, occlusion=True), [0.0])
    assert len(frame.agents) == 5


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_a_pedestrian_outside_of_shadows_is_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cars = [
        box(
            f"c{i}",
            *rng.uniform(-40.0, 40.0, 2),
            yaw=rng.uniform(-3.0, 3.0),
            length=rng.uniform(2.0, 12.0),
        )
        for i in range(6)
    ]
    people = [
        box(
            f"p{i}",
            *rng.uniform(-50.0, 50.0, 2),
            kind=AgentKind.PEDESTRIAN,
            length=1e-3,
            width=1e-3,
        )
        for i in range(30)
    ]
    log = with_agents(*cars, *people)
    (frame,) = sensed(log, replace(IDEAL, occlusion=True, range_m=60.0), [0.0])
    assert frame.visibility is not None
    everyone = log.tracks.perceived(0.0)
    hidden = frame.visibility.hides(np.column_stack([everyone.x, everyone.y]))
    boxes = [pose(everyone, i) for i in range(len(everyone))]
    for i, name in enumerate(everyone.ids):
        in_a_car = any(overlap(*boxes[i], *car) for car in boxes[: len(cars)])
        if name.startswith("p") and name not in frame.agents.ids and not in_a_car:
            assert hidden[i], f"{name} is not seen, though the frame says that its place is visible"


# noise, drop-outs, latency


NOISY = replace(
    IDEAL, position_noise_m=0.2, yaw_noise_deg=5.0, velocity_noise_mps=0.3, dropout=0.3, coast_s=0.0
)


def chosen(log: Tracks, index: list[int]) -> Tracks:
    rows = np.concatenate([np.arange(log.offsets[i], log.offsets[i + 1]) for i in index])
    return Tracks(
        tuple(log.ids[i] for i in index),
        tuple(log.kinds[i] for i in index),
        log.length[index],
        log.width[index],
        log.static[index],
        np.r_[0, np.cumsum(np.diff(log.offsets)[index])],
        *(getattr(log, name)[rows] for name in ("t", "x", "y", "yaw", "vx", "vy")),
    )


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_the_draws_of_an_agent_do_not_depend_on_other_agents(seed: int) -> None:
    log = crowd(seed)
    pair = replace(log, tracks=chosen(log.tracks, [4, 2]))
    for whole, part in zip(sensed(log, NOISY, GRID), sensed(pair, NOISY, GRID), strict=True):
        in_whole = [i for i, name in enumerate(whole.agents.ids) if name in ("a2", "a4")]
        in_part = [part.agents.ids.index(whole.agents.ids[i]) for i in in_whole]
        assert len(in_whole) == len(part.agents)
        for name in COLUMNS:
            np.testing.assert_array_equal(
                getattr(whole.agents, name)[in_whole], getattr(part.agents, name)[in_part]
            )


def offsets(log: Scenario, seed: int) -> FloatArray:
    """The y of all agents in all frames."""
    sensor = replace(NOISY, dropout=0.0, seed=seed)
    return np.concatenate([frame.agents.y for frame in sensed(log, sensor, GRID)])


def test_noise_depends_on_the_seed_and_the_name_of_the_log_only() -> None:
    log, first = crowd(1), offsets(crowd(1), 0)
    np.testing.assert_array_equal(first, offsets(log, 0))
    assert (first != offsets(log, 1)).any()
    assert (first != offsets(replace(log, name="other"), 0)).any()


def test_noise_has_the_stated_spread_in_the_agents_own_axes() -> None:
    t = np.arange(0.0, 60.01, 0.1)
    log = with_agents(track("a", t, 30.0 + t, t, yaw=np.pi / 4, vx=1.0, vy=1.0), seconds=60.0)
    seen = sensed(log, replace(NOISY, dropout=0.0), t.tolist())
    true = np.array([[30.0 + f.t, f.t, np.pi / 4, 1.0, 1.0] for f in seen])
    off = np.array([[getattr(f.agents, name)[0] for name in COLUMNS[:5]] for f in seen]) - true
    spread = off.std(axis=0)
    np.testing.assert_allclose(spread, [0.2, 0.2, np.radians(5.0), 0.3, 0.3], rtol=0.15)
    assert np.abs(off.mean(axis=0)).max() < 0.05


def test_dropouts_come_as_often_as_stated_and_last_a_slot() -> None:
    t = np.arange(0.0, 200.01, 0.1)
    log = with_agents(track("a", t, 30.0 + 10.0 * t, 0.0 * t), seconds=200.0)
    sensor = replace(IDEAL, dropout=0.2, dropout_s=0.5)
    gone = np.array([len(frame.agents) == 0 for frame in sensed(log, sensor, t.tolist())])
    assert gone.mean() == pytest.approx(0.2, abs=0.06)
    edges = np.flatnonzero(np.diff(np.r_[False, gone, False].astype(int)))
    lengths = edges[1::2] - edges[::2]
    assert (lengths[1:-1] % 5 == 0).all()
    assert not any(len(f.agents) for f in sensed(log, replace(IDEAL, dropout=1.0), GRID))


def test_a_tracker_predicts_a_lost_agent_and_drops_it_in_the_end() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    van = box("van", 30.0, -3.0, kind=AgentKind.TRUCK, length=6.0, width=2.4)
    log = with_agents(
        van,
        track(
            "child",
            t,
            45.0 + 0.0 * t,
            2.5 - 1.5 * t,
            kind=AgentKind.PEDESTRIAN,
            length=0.4,
            width=0.5,
        ),
    )
    log = replace(log, ego=replace(drive(straight, 0.0, 6.0), x=np.zeros(61), y=np.zeros(61)))

    def lost(coast: float) -> int:
        sensor = replace(IDEAL, occlusion=True, coast_s=coast)
        return next(
            i for i, f in enumerate(sensed(log, sensor, t.tolist())) if "child" not in f.agents.ids
        )

    assert 0 < lost(0.0) < lost(0.5) == lost(0.0) + 5
    carried = sensed(log, replace(IDEAL, occlusion=True, coast_s=0.5), t.tolist())[
        lost(0.5) - 1
    ].agents
    child = carried.ids.index("child")
    assert carried.unseen[child] == pytest.approx(0.5) and carried.velocity_sigma[child] == 0.0
    assert np.isnan(carried.age).all(), "the child was there when the sensor began"
    assert carried.y[child] == pytest.approx(2.5 - 1.5 * 0.1 * (lost(0.5) - 1), abs=1e-6)


def test_with_latency_a_change_is_seen_later_and_steady_motion_on_time() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    log = with_agents(track("a", t, 30.0 + np.minimum(5.0 * t, 10.0), 0.0 * t))
    prompt, late = (sensed(log, replace(IDEAL, latency_s=lag), t.tolist()) for lag in (0.0, 0.3))
    for k in range(2, 20):
        assert late[k].agents.x[0] == pytest.approx(
            prompt[k].agents.x[0], abs=1.6 if k < 5 else 1e-9
        )
    assert [late[k].agents.vx[0] > 1.0 for k in (20, 22, 23, 24)] == [True, True, True, False]
    assert prompt[21].agents.vx[0] == pytest.approx(0.0, abs=1e-6)
    assert len(late[0].agents) == 1, "the sensor ran before the log began"


def test_a_sensor_counts_the_age_from_its_own_first_measurement() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    log = with_agents(
        track("a", t, 80.0 - 10.0 * t, 0.0 * t), track("b", t, 5.0 + 0.0 * t, 9.0 + 0.0 * t)
    )
    seen = sensed(log, replace(IDEAL, range_m=50.0), t.tolist())
    since = next(i for i, f in enumerate(seen) if "a" in f.agents.ids)
    ages = [float(f.agents.age[f.agents.ids.index("a")]) for f in seen[since : since + 4]]
    assert since > 0 and ages == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert all(np.isnan(f.agents.age[f.agents.ids.index("b")]) for f in seen if "b" in f.agents.ids)


# in the loops


@pytest.mark.parametrize("run", [run_open_loop, run_closed_loop])
def test_the_trace_has_the_agents_that_were_shown(run: Callable[..., Drive]) -> None:
    log = crowd(4)
    config = LoopConfig(perception="sensor", sensor=NOISY)
    trace = run(log, "constant_speed", config=config).trace
    assert trace.perceived is not None and any("through a sensor" in note for note in trace.notes)
    assert set(trace.perceived.t.round(6)) <= {round(f.t, 6) for f in trace.frames}
    assert 0 < len(trace.perceived.t) < sum(len(log.tracks.perceived(f.t)) for f in trace.frames)
    assert run(log, "constant_speed").trace.perceived is None
