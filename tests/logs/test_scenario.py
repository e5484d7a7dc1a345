from dataclasses import replace
from math import pi

import numpy as np
import pytest
from differences import differences
from hypothesis import given, strategies as st

from replan.logs.agents import OLDEST_S, AgentKind
from replan.logs.observed import MAX_AGE_S, MAX_GAP_S
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.metrics.boxes import others_at
from replan.replay.loop.contacts import contact
from replan.replay.world import World

CAR = VehicleParameters()

COLUMNS = ("t", "x", "y", "yaw", "vx", "vy")


def ragged(seed: int) -> Tracks:
    """A handful of tracks of random lengths and rates.

    Some velocities are not known, one obstacle is static.
    """
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 12, 5)
    t = [rng.uniform(-0.5, 2.0) + np.cumsum(rng.uniform(0.05, 0.45, n)) for n in counts]
    m = int(counts.sum())
    vx, vy = (np.where(rng.random(m) < 0.4, np.nan, rng.normal(0, 5, m)) for _ in range(2))
    static = np.array([False] * 4 + [True])
    return Tracks(
        tuple(f"a{i}" for i in range(5)),
        (AgentKind.CAR,) * 4 + (AgentKind.OBJECT,),
        rng.uniform(1, 5, 5),
        rng.uniform(0.5, 2, 5),
        static,
        np.r_[0, np.cumsum(counts)],
        np.concatenate(t),
        rng.normal(0, 20, m),
        rng.normal(0, 20, m),
        rng.uniform(-3, 3, m),
        vx,
        vy,
    )


def one_car(t: list[float], x: list[float], /, **changes: object) -> Tracks:
    n = len(t)
    fields = {
        "ids": ("car",),
        "kinds": (AgentKind.CAR,),
        "length": [4.0],
        "width": [2.0],
        "static": [False],
        "offsets": [0, n],
        "t": t,
        "x": x,
        "y": np.zeros(n),
        "yaw": np.zeros(n),
        "vx": np.full(n, np.nan),
        "vy": np.full(n, np.nan),
    } | changes
    return Tracks(**fields)  # type: ignore[arg-type]


def truncated(tracks: Tracks, time: float) -> Tracks:
    """Without the samples later than `time`.

    Static obstacles, known from the start, keep their first sample.
    """
    keep = tracks.t <= time
    keep[tracks.offsets[:-1][tracks.static]] = True
    return tracks.taken(keep)


@given(st.integers(0, 200), st.floats(-1.0, 8.0))
def test_no_later_sample_changes_what_is_perceived(seed: int, time: float) -> None:
    tracks = ragged(seed)
    assert not differences(tracks.perceived(time), truncated(tracks, time).perceived(time))


@given(st.integers(0, 200), st.floats(-1.0, 8.0))
def test_perceived_are_the_recent_and_the_static(seed: int, time: float) -> None:
    tracks = ragged(seed)
    for i, name in enumerate(tracks.ids):
        past = [t for t in tracks.t[tracks.samples(i)] if t <= time]
        there = name in tracks.perceived(time).ids
        assert there or not (tracks.static[i] or (past and time - past[-1] <= MAX_AGE_S))
        assert not there or tracks.static[i] or (past and time - past[-1] <= MAX_GAP_S)


def at_intervals(*intervals: float) -> Tracks:
    """A car at 10 m/s, seen at these intervals, beside one that is seen every 0.1 s."""
    t = np.r_[1.0, 1.0 + np.cumsum(intervals)]
    often = np.round(np.arange(0.0, 20.0, 0.1), 9)
    return one_car(
        np.r_[t, often].tolist(),
        np.r_[10.0 * t, 10.0 * often].tolist(),
        ids=("rare", "often"),
        kinds=(AgentKind.CAR,) * 2,
        length=[4.0] * 2,
        width=[2.0] * 2,
        static=[False] * 2,
        offsets=[0, len(t), len(t) + len(often)],
    )


@given(st.lists(st.floats(0.6, 1.0), min_size=5, max_size=15))
def test_rarely_sampled_agents_do_not_flicker(intervals: list[float]) -> None:
    alone = one_car(np.r_[0.0, np.cumsum(intervals)].tolist(), [0.0] * (len(intervals) + 1))
    both = at_intervals(*intervals)
    for t in np.arange(0.0, sum(intervals), 0.1):
        assert alone.perceived(t).ids == alone.truth(t).ids == ("car",)
        # Beside others who are seen often, it is known to be rare from its second sample on
        if t >= intervals[0]:
            assert "rare" in both.perceived(1.0 + t).ids
            assert t < intervals[0] + 1e-9 or "rare" in both.truth(1.0 + t).ids


def test_agents_are_absent_in_a_gap_of_their_track() -> None:
    t = np.r_[np.arange(0.0, 2.05, 0.1), np.arange(6.0, 8.05, 0.1)]
    car = one_car(t.tolist(), (10.0 * t).tolist())
    for time, shown, true in (
        (1.55, 1, 1),
        (2.0, 1, 1),
        (2.3, 1, 0),
        (2.6, 0, 0),
        (5.9, 0, 0),
        (6.0, 1, 1),
        (6.55, 1, 1),
    ):
        assert (len(car.perceived(time)), len(car.truth(time))) == (shown, true), time
        assert others_at(car, np.array([time])).there.sum() == true
        ego = EgoState(time, 10.0 * time - CAR.axle_to_center, 0.0, 0.0, 10.0)
        assert contact(World(ego, car), CAR) == true - 1
    assert car.motion.vx == pytest.approx(10.0, abs=1e-6), "nothing is differenced over the gap"


@given(st.integers(0, 100), st.floats(0.0, 1.0), st.integers(0, 3))
def test_truth_lies_between_its_samples(seed: int, share: float, index: int) -> None:
    tracks = ragged(seed)
    span = tracks.samples(index)
    t = tracks.t[span]
    time = float(t[0] + share * (t[-1] - t[0]))
    found = tracks.truth(time)
    at = found.ids.index(f"a{index}")
    for name in ("x", "y", "yaw"):
        assert getattr(found, name)[at] == pytest.approx(
            np.interp(time, t, getattr(tracks, name)[span]), abs=1e-6
        )


def test_velocity_is_logged_or_a_backward_difference() -> None:
    car = one_car([0.0, 0.1, 0.2], [0.0, 1.0, 4.0])
    assert car.perceived(0.0).vx == [0.0]
    assert car.perceived(0.15).vx == pytest.approx([10.0])
    assert car.perceived(0.15).x == pytest.approx([1.5])
    assert car.perceived(0.2).vx == pytest.approx([30.0])
    logged = one_car([0.0, 0.1], [0.0, 1.0], vx=[3.0, 5.0], vy=[0.0, -1.0])
    assert (logged.perceived(0.3).x, logged.perceived(0.3).y) == (
        pytest.approx([2.0]),
        pytest.approx([-0.2]),
    )


def test_how_long_an_agent_has_been_seen_and_how_long_not() -> None:
    late = one_car([1.0, 1.1, 1.4], [0.0, 1.0, 4.0])
    for time, age, unseen in ((1.0, 0.0, 0.0), (1.25, 0.25, 0.15), (1.4, 0.4, 0.0)):
        seen = late.perceived(time)
        assert (seen.age, seen.unseen) == (pytest.approx([age]), pytest.approx([unseen])), time
        assert np.isnan(seen.velocity_sigma).all()
    t = np.arange(0.0, 20.0, 0.1)
    first = one_car(list(t), list(t))
    assert np.isnan(first.perceived(OLDEST_S - 0.1).age).all(), (
        "it was there when the scenario began"
    )
    assert (
        first.perceived(OLDEST_S + 5.0).age
        == first.shifted(1.0).perceived(OLDEST_S + 5.0).age
        == [OLDEST_S]
    )
    still = replace(late, static=[True]).perceived(1.25)
    assert np.isnan([still.age, still.unseen]).all() and np.isnan(late.truth(1.1).age).all()


def test_truth_turns_the_short_way_across_pi() -> None:
    car = one_car([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], yaw=[3.0, -3.0, 3.1 - 4 * pi])
    assert np.abs(np.diff(car.yaw)).max() < 0.3
    assert car.truth(0.5).yaw == pytest.approx([pi])
    assert car.perceived(1.0).yaw == pytest.approx([2 * pi - 3.0])


@given(st.integers(0, 50))
def test_yaw_is_continuous_within_each_track_and_the_same_direction(seed: int) -> None:
    old = ragged(seed)
    rng = np.random.default_rng(seed)
    new = replace(old, yaw=old.yaw + 2 * pi * rng.integers(-2, 3, len(old.yaw)))
    assert np.allclose(np.cos(new.yaw - old.yaw), 1.0)
    for i in range(len(new)):
        assert (np.abs(np.diff(new.yaw[new.samples(i)])) <= pi + 1e-9).all()


@given(seed=st.integers(0, 50), keep=st.sets(st.integers(0, 5)))
def test_a_selection_by_name_keeps_all_samples(seed: int, keep: set[int]) -> None:
    tracks = ragged(seed)
    names = [name for i, name in enumerate(tracks.ids) if i in keep]
    some = tracks.only([*names, "no one"])
    assert list(some.ids) == names
    for i, name in enumerate(names):
        mine, theirs = some.samples(i), tracks.samples(tracks.ids.index(name))
        assert np.array_equal(some.t[mine], tracks.t[theirs]) and np.array_equal(
            some.x[mine], tracks.x[theirs]
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"offsets": [0, 1]}, "offsets disagree"),
        ({"offsets": [1, 2]}, "offsets disagree"),
        ({"offsets": [0, 0, 2]}, "offsets disagree"),
        ({"length": [4.0, 4.0]}, "offsets disagree"),
        ({"kinds": ()}, "offsets disagree"),
        ({"x": [0.0]}, "x has a wrong length"),
        ({"x": [0.0, np.nan]}, "x has a wrong length or is not finite"),
        ({"yaw": [np.inf, 0.0]}, "yaw has a wrong length or is not finite"),
        ({"t": [0.0, np.nan]}, "t has a wrong length or is not finite"),
        ({"t": [0.0, 0.0]}, "time does not increase"),
        ({"t": [0.1, 0.0]}, "time does not increase"),
        ({"vx": [0.0]}, "vx has a wrong length"),
        ({"vy": [0.0, np.inf]}, "vy has a wrong length or is infinite"),
        ({"length": [0.0]}, "must be positive"),
        ({"width": [np.nan]}, "must be positive"),
    ],
)
def test_bad_tracks_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        one_car([0.0, 0.1], [0.0, 1.0], **changes)


def test_ids_must_differ_and_times_may_restart_between_tracks() -> None:
    two = {
        "kinds": (AgentKind.CAR,) * 2,
        "length": [4.0] * 2,
        "width": [2.0] * 2,
        "static": [False] * 2,
    }
    fine = one_car([0.0, 0.1, 0.0], [0.0] * 3, ids=("a", "b"), offsets=[0, 2, 3], **two)
    assert len(fine) == 2
    with pytest.raises(ValueError, match="same id"):
        replace(fine, ids=("a", "a"))


def test_a_scenario_lasts_as_long_as_its_ego_and_keeps_its_metadata() -> None:
    t = np.arange(3.0)
    ego = Trajectory(t, 5 * t, 0 * t, 0 * t, 5 + 0 * t, 0 * t, 0 * t)
    road = Road.along(np.column_stack([ego.x, ego.y]), speed_limit=10.0)
    metadata = {"generator": "hand"}
    log = Scenario("log", ego, Tracks.empty(), road, 2.0, metadata=metadata)
    metadata["generator"] = "other"
    assert log.metadata["generator"] == "hand"
    with pytest.raises(TypeError):
        log.metadata["generator"] = "other"  # type: ignore[index]
    with pytest.raises(ValueError, match=r"lasts 1.5 s, shorter than its ego log \(2.0 s\)"):
        replace(log, duration=1.5)


@given(st.integers(0, 50), st.integers(0, 40))
def test_nor_does_it_at_the_very_time_of_a_sample(seed: int, index: int) -> None:
    tracks = ragged(seed)
    time = float(tracks.t[index % len(tracks.t)])
    assert not differences(tracks.perceived(time), truncated(tracks, time).perceived(time))


@given(st.integers(0, 200), st.floats(-1.0, 8.0), st.floats(0.0, 5.0))
def test_later_samples_may_say_anything(seed: int, time: float, jump: float) -> None:
    tracks = ragged(seed)
    later = tracks.t > time
    later[tracks.offsets[:-1][tracks.static]] = False
    noise = np.where(later, jump + 1.0, 0.0)
    other = replace(
        tracks, x=tracks.x + noise, y=tracks.y - noise, vx=np.where(later, 7.0, tracks.vx)
    )
    assert not differences(tracks.perceived(time), other.perceived(time))


@given(st.integers(0, 100))
def test_truth_at_a_sample_is_the_sample(seed: int) -> None:
    tracks = ragged(seed)
    for i in range(4):
        span = tracks.samples(i)
        for k in range(span.start, span.stop):
            found = tracks.truth(float(tracks.t[k]))
            at = found.ids.index(tracks.ids[i])
            assert found.x[at] == pytest.approx(tracks.x[k], abs=1e-6)
