"""What the planner is shown: nothing of later, all of it with ground truth, and what a sensor
leaves of it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from handmade import drive, scenario, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.contract.planner_rules import until
from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, LogError
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Frame
from replan.logs.repair.detections import Detections, Repair, named_as_tracked
from replan.logs.repair.offline import detections_of
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.tracks import Tracks
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig, SensorConfig
from replan.replay.parts import PERCEPTION, PREDICTION
from replan.replay.perception import Perception
from replan.replay.world import World, logged_ego

COLUMNS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel")
IDEAL = SensorConfig(
    range_m=1e5,
    occlusion=False,
    position_noise_m=0.0,
    yaw_noise_deg=0.0,
    velocity_noise_mps=0.0,
    latency_s=0.0,
    dropout=0.0,
    coast_s=0.0,
)


def made(*agents: dict[str, object], seconds: float = 6.0) -> Scenario:
    return scenario(drive(straight, 10.0, seconds), agents=tracks(*agents))


def crowd(seed: int) -> Scenario:
    """Six road users that wander about, two of them standing."""
    rng = np.random.default_rng(seed)
    found = []
    kinds = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
    for i in range(6):
        t = np.arange(rng.integers(0, 10), rng.integers(20, 61)) * 0.1
        v = rng.uniform(0.0, 12.0) if i > 1 else 0.0
        yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rng.normal(0.0, 0.02, len(t)))
        x, y = rng.uniform(-20.0, 60.0), rng.uniform(-15.0, 15.0)
        x, y = x + np.cumsum(0.1 * v * np.cos(yaw)), y + np.cumsum(0.1 * v * np.sin(yaw))
        found.append(track(f"a{i}", t, x, y, yaw=yaw, kind=kinds[rng.integers(4)]))
    return made(*found)


def frames(
    log: Scenario, config: LoopConfig, times: Sequence[float], seen: Tracks | None = None
) -> list[Frame]:
    perception = Perception(log, config)
    shown = log.tracks if seen is None else seen
    return [
        perception.frame(World(logged_ego(log.ego, log.vehicle, t), shown), None) for t in times
    ]


def detected(log: Scenario, found: Detections | None = None) -> Scenario:
    """As if its tracks were made of their own samples, or of those `found`."""
    found = detections_of(log.tracks) if found is None else found
    repair = Repair(found, Tracks.empty(), np.zeros(len(log.tracks.t), np.bool_), (), log.tracks)
    return replace(log, repair=repair)


def sensed(log: Scenario, sensor: SensorConfig, times: Sequence[float]) -> list[Frame]:
    return frames(log, LoopConfig(perception="sensor", sensor=sensor), times)


def assert_same_agents(one: Agents, two: Agents) -> None:
    assert one.ids == two.ids and one.kinds == two.kinds
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


GRID = [round(0.1 * k, 1) for k in range(31)]


# --- no future


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


def test_the_oracle_alone_knows_what_comes_and_says_so() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    log = made(track("a", t, 30.0 + 0.0 * t, np.maximum(t - 2.0, 0.0)))
    config = LoopConfig(prediction="oracle", prediction_horizon_s=3.0, traffic="time")
    future = frames(log, config, [1.0])[0].predictions
    np.testing.assert_allclose(future.y[0], np.maximum(future.t - 2.0, 0.0), atol=1e-9)
    assert future.method == "oracle"
    beyond = frames(log, config, [5.0])[0].predictions
    np.testing.assert_allclose(beyond.y[0], beyond.t - 2.0, atol=1e-9)
    for run in (run_open_loop, run_closed_loop):
        trace = run(log, "constant_speed", config=config).trace
        assert trace.oracle and any("log's own future" in note for note in trace.notes)
        assert not run(log, "constant_speed").trace.oracle
    for kind in ("give_way", "reactive"):
        with pytest.raises(ConfigError, match=r"take traffic 'time' \(--traffic time\)"):
            LoopConfig(prediction="oracle", traffic=kind)
    with pytest.raises(ConfigError, match="traffic 'give_way'"):
        LoopConfig(prediction="oracle")


# --- recorded: what a tracker knew of the log's detections


T = np.arange(0.0, 6.01, 0.1)


def passing() -> Scenario:
    """Two cars beside each other's lanes, and one that is only in the detections, for two
    seconds.
    """
    log = made(
        track("1", T, 20.0 + 8.0 * T, 0.0 * T + 3.5), track("2", T, 60.0 - 5.0 * T, 0.0 * T - 3.5)
    )
    ghost = track("9", T[20:40], 30.0 + 0.0 * T[20:40], 0.0 * T[20:40] + 20.0)
    names = "t", "x", "y", "yaw", "vx", "vy", "score", "length", "width", "codes"
    one, two = detections_of(log.tracks), detections_of(made(ghost).tracks)
    order = np.argsort(np.r_[one.t, two.t], kind="stable")
    columns = {name: np.r_[getattr(one, name), getattr(two, name)][order] for name in names}
    return detected(log, Detections(frames=T, ids=("",) * len(order), **columns))


def at(frame: Frame, x: float, y: float) -> int:
    """Who is shown there."""
    away = np.hypot(frame.agents.x - x, frame.agents.y - y)
    assert away.min() < 0.7, (frame.agents.x, frame.agents.y)
    return int(np.argmin(away))


def test_recorded_shows_what_the_detections_told_by_then() -> None:
    shown = frames(passing(), LoopConfig(perception="recorded"), T.tolist())
    assert len(shown[0].agents) == 0, "nobody is known from one box"
    assert [len(frame.agents) for frame in (shown[15], shown[30], shown[-1])] == [2, 3, 2]
    for k in (15, 30, 60):
        i = at(shown[k], 20.0 + 8.0 * T[k], 3.5)
        assert shown[k].agents.vx[i] == pytest.approx(8.0, abs=0.5)
    at(shown[30], 30.0, 20.0)  # a false alarm


def test_recorded_follows_the_world_where_it_is_driven_otherwise() -> None:
    log = passing()
    late = made(
        track("1", T, 20.0 + 4.0 * T, 0.0 * T + 3.5),
        track("walker", T, 0.0 * T + 9.0, 0.0 * T - 9.0),
    ).tracks
    (frame,) = frames(log, LoopConfig(perception="recorded"), T[:41].tolist(), late)[-1:]
    assert "walker" in frame.agents.ids, "no detection tells of them"
    at(frame, 30.0, 20.0)  # the false alarm is as it was, and car 2 is not there
    assert len(frame.agents) == 3
    i = at(frame, 20.0 + 4.0 * T[40], 3.5)
    assert frame.agents.vx[i] == pytest.approx(4.0, abs=0.5)
    gone = frames(log, LoopConfig(perception="recorded"), T[:16].tolist(), Tracks.empty())[-1]
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
        run_open_loop(made(), "constant_speed", config=LoopConfig(perception="recorded"))


def test_a_repaired_track_is_called_as_the_tracker_calls_it() -> None:
    log = passing()
    assert log.repair is not None
    named = named_as_tracked(log.repair)
    assert named.tracks.ids == named_as_tracked(named).tracks.ids
    renamed = replace(log, repair=named, tracks=named.tracks)
    for frame in frames(renamed, LoopConfig(perception="recorded"), T[10:].tolist()):
        for name, x, y in zip(frame.agents.ids, frame.agents.x, frame.agents.y, strict=True):
            if y < 10.0:
                truth = renamed.tracks.truth(frame.t)
                i = truth.ids.index(name)
                assert np.hypot(truth.x[i] - x, truth.y[i] - y) < 0.7
            else:
                assert name not in renamed.tracks.ids


# --- ground truth, and a sensor without faults


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_a_sensor_without_faults_shows_the_ground_truth(seed: int) -> None:
    log = crowd(seed)
    for true, seen in zip(frames(log, LoopConfig(), GRID), sensed(log, IDEAL, GRID), strict=True):
        assert_same_agents(true.agents, seen.agents)
        assert_same_agents(true.agents, log.tracks.perceived(true.t))
        assert true.visibility is None and seen.visibility is not None


# --- range, field of view, occlusion


def pose(agents: Agents, i: int) -> tuple[float, ...]:
    return tuple(float(getattr(agents, name)[i]) for name in ("x", "y", "yaw", "length", "width"))


def box(name: str, x: float, y: float, **more: object) -> dict[str, object]:
    return track(name, [0.0], [x], [y], static=True, **more)


def test_range_and_field_of_view() -> None:
    log = made(box("near", 30.0, 0.0), box("far", 90.0, 10.0), box("behind", -30.0, 3.0))
    (near,) = sensed(log, replace(IDEAL, range_m=50.0), [0.0])
    (ahead,) = sensed(log, replace(IDEAL, field_of_view_deg=120.0), [0.0])
    assert near.agents.ids == ("near", "behind") and ahead.agents.ids == ("near", "far")
    assert near.visibility is not None and ahead.visibility is not None
    points = np.array([[40.0, 0.0], [60.0, 0.0], [-30.0, 0.0]])
    assert near.visibility.hides(points).tolist() == [False, True, False]
    assert ahead.visibility.hides(points).tolist() == [False, False, True]


def test_who_walks_behind_a_van_is_hidden_until_he_steps_out_and_hides_nobody_himself() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    van = box("van", 30.0, -3.0, kind=AgentKind.TRUCK, length=6.0, width=2.4)
    child = track(
        "child", t, 35.0 + 0.0 * t, -5.0 + t, kind=AgentKind.PEDESTRIAN, length=0.4, width=0.5
    )
    sensor = replace(IDEAL, occlusion=True)
    standing = replace(drive(straight, 0.0, 6.0), x=np.zeros(61), y=np.zeros(61))
    log = replace(made(van, child), ego=standing)
    shown = [frame.agents.ids for frame in sensed(log, sensor, t.tolist())]
    out = next(i for i, ids in enumerate(shown) if "child" in ids)
    assert 10 < out < 45, "hidden at first, seen before he is on the ego's way"
    assert all("child" in ids for ids in shown[out:]) and all("van" in ids for ids in shown)
    row = replace(
        log,
        tracks=tracks(
            *(box(f"p{i}", 10.0 + 2.0 * i, 0.0, kind=AgentKind.PEDESTRIAN) for i in range(5))
        ),
    )
    assert len(sensed(row, sensor, [0.0])[0].agents) == 5


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_who_is_hidden_stands_in_a_shadow_and_who_stands_in_none_is_seen(seed: int) -> None:
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
    log = made(*cars, *people)
    (frame,) = sensed(log, replace(IDEAL, occlusion=True, range_m=60.0), [0.0])
    assert frame.visibility is not None
    everybody = log.tracks.perceived(0.0)
    hidden = frame.visibility.hides(np.column_stack([everybody.x, everybody.y]))
    boxes = [pose(everybody, i) for i in range(len(everybody))]
    for i, name in enumerate(everybody.ids):
        in_a_car = any(overlap(*boxes[i], *car) for car in boxes[: len(cars)])
        if name.startswith("p") and name not in frame.agents.ids and not in_a_car:
            assert hidden[i], f"{name} is not seen, so it must be known that one cannot see there"


# --- noise, drop-outs, latency


NOISY = replace(
    IDEAL, position_noise_m=0.2, yaw_noise_deg=5.0, velocity_noise_mps=0.3, dropout=0.3, coast_s=0.0
)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_the_draws_of_an_agent_do_not_depend_on_who_else_is_there(seed: int) -> None:
    log = crowd(seed)
    some = replace(log, tracks=chosen(log.tracks, [4, 2]))
    for all_, few in zip(sensed(log, NOISY, GRID), sensed(some, NOISY, GRID), strict=True):
        mine = [i for i, name in enumerate(all_.agents.ids) if name in ("a2", "a4")]
        theirs = [few.agents.ids.index(all_.agents.ids[i]) for i in mine]
        assert len(mine) == len(few.agents)
        for name in COLUMNS:
            np.testing.assert_array_equal(
                getattr(all_.agents, name)[mine], getattr(few.agents, name)[theirs]
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


def test_the_same_twice_and_something_else_with_another_seed_or_name() -> None:
    log = crowd(1)

    def ys(some: Scenario, seed: int) -> FloatArray:
        return np.concatenate(
            [f.agents.y for f in sensed(some, replace(NOISY, dropout=0.0, seed=seed), GRID)]
        )

    np.testing.assert_array_equal(ys(log, 0), ys(log, 0))
    assert (ys(log, 0) != ys(log, 1)).any() and (
        ys(log, 0) != ys(replace(log, name="other"), 0)
    ).any()


def test_noise_has_the_stated_spread_in_the_agents_own_axes() -> None:
    t = np.arange(0.0, 60.01, 0.1)
    log = made(track("a", t, 30.0 + t, t, yaw=np.pi / 4, vx=1.0, vy=1.0), seconds=60.0)
    seen = sensed(log, replace(NOISY, dropout=0.0), t.tolist())
    true = np.array([[30.0 + f.t, f.t, np.pi / 4, 1.0, 1.0] for f in seen])
    off = np.array([[getattr(f.agents, name)[0] for name in COLUMNS[:5]] for f in seen]) - true
    spread = off.std(axis=0)
    np.testing.assert_allclose(spread, [0.2, 0.2, np.radians(5.0), 0.3, 0.3], rtol=0.15)
    assert np.abs(off.mean(axis=0)).max() < 0.05


def test_dropouts_come_as_often_as_stated_and_last_a_slot() -> None:
    t = np.arange(0.0, 200.01, 0.1)
    log = made(track("a", t, 30.0 + 10.0 * t, 0.0 * t), seconds=200.0)
    gone = np.array(
        [
            len(f.agents) == 0
            for f in sensed(log, replace(IDEAL, dropout=0.2, dropout_s=0.5), t.tolist())
        ]
    )
    assert gone.mean() == pytest.approx(0.2, abs=0.06)
    edges = np.flatnonzero(np.diff(np.r_[False, gone, False].astype(int)))
    lengths = edges[1::2] - edges[::2]
    assert (lengths[1:-1] % 5 == 0).all()
    assert not any(len(f.agents) for f in sensed(log, replace(IDEAL, dropout=1.0), GRID))


def test_a_tracker_carries_on_who_drops_out_and_forgets_him_in_the_end() -> None:
    t = np.arange(0.0, 6.01, 0.1)
    van = box("van", 30.0, -3.0, kind=AgentKind.TRUCK, length=6.0, width=2.4)
    log = made(
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
    log = made(track("a", t, 30.0 + np.minimum(5.0 * t, 10.0), 0.0 * t))
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
    log = made(track("a", t, 80.0 - 10.0 * t, 0.0 * t), track("b", t, 5.0 + 0.0 * t, 9.0 + 0.0 * t))
    seen = sensed(log, replace(IDEAL, range_m=50.0), t.tolist())
    since = next(i for i, f in enumerate(seen) if "a" in f.agents.ids)
    ages = [float(f.agents.age[f.agents.ids.index("a")]) for f in seen[since : since + 4]]
    assert since > 0 and ages == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert all(np.isnan(f.agents.age[f.agents.ids.index("b")]) for f in seen if "b" in f.agents.ids)


# --- in the loops


@pytest.mark.parametrize("run", [run_open_loop, run_closed_loop])
def test_the_trace_keeps_what_was_shown(run: object) -> None:
    log = crowd(4)
    config = LoopConfig(perception="sensor", sensor=NOISY)
    trace = run(log, "constant_speed", config=config).trace  # type: ignore[operator]
    assert trace.perceived is not None and any("through a sensor" in note for note in trace.notes)
    assert set(trace.perceived.t.round(6)) <= {round(f.t, 6) for f in trace.frames}
    assert 0 < len(trace.perceived.t) < sum(len(log.tracks.perceived(f.t)) for f in trace.frames)
    assert run(log, "constant_speed").trace.perceived is None  # type: ignore[operator]
