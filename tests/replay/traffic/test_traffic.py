"""Traffic: the log where nobody disturbs it, nobody drives through the ego, and encounters by the
ego's position.
"""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import moved as moved_world
from handmade import drive, scenario, straight, track, tracks
from hypothesis import given, settings, strategies as st
from roads import along_x, lanes, strip

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.catalogue.roads import junction
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.road import Road
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.tracks import Tracks
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.contacts import contact
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import TRAFFIC
from replan.replay.traffic import Reactive
from replan.replay.traffic.leaders import (
    ACCEL_MPS2,
    HARDEST_MPS2,
    STANDSTILL_M,
    TIME_GAP_S,
    enhanced_idm,
)
from replan.replay.traffic.phase_replay import PERIOD_S, PhaseReplay
from replan.replay.world import World, logged_ego

T = np.round(np.arange(0.0, 12.01, 0.1), 9)
Egos = list[EgoState]
REACT = ("give_way", "reactive")
ROAD = lanes(along_x(-100.0, 500.0), 2)


def run(log: Scenario, mode: str, egos: Egos) -> Tracks:
    traffic = TRAFFIC.builtin[mode](log)
    found = [traffic.step(ego) for ego in egos]
    return found[-1].whole


def logged(log: Scenario, until: float = 12.0) -> Egos:
    return [logged_ego(log.ego, log.vehicle, float(t)) for t in T if t <= until]


def at_speed(v: Callable[[float], float], y: float = 0.0) -> Egos:
    """An ego along x with speed v(t)."""
    x, egos = 0.0, []
    for t in T:
        egos.append(
            EgoState(float(t), x, y, 0.0, v(float(t)), (v(float(t) + 1e-3) - v(float(t))) / 1e-3)
        )
        x += 0.1 * 0.5 * (v(float(t)) + v(float(t) + 0.1))
    return egos


def far_away(log: Scenario) -> Egos:
    return [replace(ego, x=1e4, y=1e4, v=0.0) for ego in logged(log)]


def car(name: str, x: float, y: float = 0.0, v: float = 10.0, **more: object) -> dict[str, object]:
    return track(name, T, x + v * T, np.full(len(T), y), **more)


def made(*agents: dict[str, object], v: float = 10.0) -> Scenario:
    return scenario(drive(straight, v, 12.0), agents=tracks(*agents), road=ROAD, duration=12.0)


def lit(
    log: Scenario, x: float, *shown: tuple[float, Colour], towards: tuple[int, ...] = ()
) -> Scenario:
    """With stop lines across both lanes at `x`, slanted, and one light."""
    lines = tuple(
        StopLine(
            i,
            i,
            np.array([[x + 0.2, 3.5 * i - 1.75], [x - 0.2, 3.5 * i + 1.75]]),
            light=7,
            towards=towards,
        )
        for i in (0, 1)
    )
    light = TrafficLight(7, np.array([t for t, _ in shown]), tuple(colour for _, colour in shown))
    return replace(log, road=replace(log.road, stop_lines=lines), lights=(light,))


def busy(seed: int) -> Scenario:
    """Cars along both lanes, one that stops for a while, a pedestrian, a parked car, a light."""
    rng = np.random.default_rng(seed)
    agents = []
    for i, (x, y) in enumerate(
        [(-40.0, 0.0), (-20.0, 0.0), (30.0, 0.0), (-30.0, 3.5), (10.0, 3.5)]
    ):
        wish = np.clip(10.0 + np.cumsum(rng.normal(0.0, 0.3, len(T))), 3.0, 14.0)
        wish[40 : 40 + rng.integers(0, 20)] = 0.0 if i == 0 else wish[40]
        agents.append(track(f"c{i}", T, x + np.cumsum(0.1 * wish), np.full(len(T), y)))
    agents.append(
        track(
            "p",
            T,
            np.full(len(T), 60.0),
            8.0 - 1.2 * T,
            kind=AgentKind.PEDESTRIAN,
            length=0.5,
            width=0.5,
        )
    )
    agents.append(track("parked", [0.0], [80.0], [-4.0], static=True))
    agents.append(track("late", T[50:], 20.01 + 9.0 * (T[50:] - 5.0), np.zeros(len(T[50:]))))
    return lit(
        made(*agents),
        20.0,
        (0.0, Colour.GREEN),
        (3.0, Colour.YELLOW),
        (4.5, Colour.RED),
        (9.0, Colour.GREEN),
    )


def assert_same_motion(one: Tracks, two: Tracks, atol: float = 1e-9, until: float = 12.0) -> None:
    for t in T[: round(10.0 * until) + 1]:
        a, b = one.truth(float(t)), two.truth(float(t))
        assert a.ids == b.ids, t
        for name in ("x", "y", "yaw"):
            np.testing.assert_allclose(
                getattr(a, name), getattr(b, name), atol=atol, err_msg=f"{name} at {t}"
            )


def gap_behind(moved: Tracks, name: str, egos: Egos) -> FloatArray:
    """From an agent's front to the ego's rear bumper along x, m."""
    i = moved.ids.index(name)
    span = moved.samples(i)
    front = np.interp(T, moved.t[span], moved.x[span]) + 0.5 * moved.length[i]
    return np.array([ego.x for ego in egos]) - 0.9 - front


# --- where nothing differs from the log, nobody does


def assert_same_samples(one: Tracks, two: Tracks) -> None:
    assert one.ids == two.ids
    for name in ("offsets", "t", "x", "y", "yaw", "vx", "vy"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


@pytest.mark.parametrize("mode", REACT)
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=6)
def test_without_the_ego_the_traffic_that_reacts_is_the_log_to_the_bit(
    mode: str, seed: int
) -> None:
    log = busy(seed)
    assert_same_samples(run(log, mode, far_away(log)), log.tracks)


@pytest.mark.parametrize("mode", REACT)
@pytest.mark.parametrize("seed", [1, 5])
def test_around_the_logged_drive_all_drive_as_logged_to_the_bit(mode: str, seed: int) -> None:
    config = LoopConfig(traffic=mode, vehicle="perfect")
    log = busy(seed)
    trace = run_closed_loop(log, "logged", config=config).trace
    assert_same_samples(trace.agents, log.tracks)
    assert not any("not as in the log" in note for note in trace.notes)


@pytest.mark.parametrize("mode", ["give_way", "reactive", "ego_position"])
def test_those_around_now_are_as_all_have_them(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replan.logs.nearby_tracks.BACK_S", 3.0)
    monkeypatch.setattr("replan.replay.traffic.phase_replay.BACK_S", 3.0)
    log, fewer = busy(3), 0
    traffic = TRAFFIC.builtin[mode](log)
    for ego in at_speed(lambda t: max(10.0 - 2.0 * t, 1.0)):
        now = traffic.step(ego)
        one, two = now.perceived(ego.t), now.whole.perceived(ego.t)
        assert one.ids == two.ids
        for name in ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel"):
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
        fewer += len(now.t) < len(now.whole.t)
    assert fewer > 50, "they never were fewer than all"


@pytest.mark.parametrize("mode", TRAFFIC.builtin)
def test_what_is_perceived_begins_as_in_the_log(mode: str) -> None:
    log = busy(4)
    one, two = (some.perceived(0.0) for some in (run(log, mode, logged(log)[:1]), log.tracks))
    assert set(one.ids) == set(two.ids)
    for name in ("x", "y", "yaw"):
        order = [np.argsort(some.ids) for some in (one, two)]
        np.testing.assert_allclose(
            getattr(one, name)[order[0]], getattr(two, name)[order[1]], atol=1e-9
        )


@pytest.mark.parametrize("mode", TRAFFIC.builtin)
@given(st.integers(0, 2**32 - 1), st.integers(10, 100))
@settings(max_examples=3)
def test_what_the_ego_does_later_changes_nothing_before(mode: str, seed: int, k: int) -> None:
    log = busy(seed)
    egos = at_speed(lambda t: max(10.0 - 3.0 * t, 0.0))
    others = egos[: k + 1] + [replace(ego, v=0.0, x=egos[k].x) for ego in egos[k + 1 :]]
    one, two = (run(log, mode, some) for some in (egos, others))
    assert_same_motion(one, two, until=float(T[k]))
    again = run(log, mode, egos)
    np.testing.assert_array_equal(one.x, again.x)


@given(st.integers(0, 2**32 - 1), st.floats(-3.0, 3.0), st.booleans())
@settings(max_examples=3)
@pytest.mark.parametrize("mode", TRAFFIC.builtin)
def test_traffic_turns_moves_and_mirrors_with_the_world(
    mode: str, seed: int, turn: float, mirror: bool
) -> None:
    log = busy(seed)
    other = moved_world(log, turn, 30.0, -20.0, mirror=mirror)
    egos = at_speed(lambda t: max(10.0 - 2.0 * t, 2.0))
    sign, c, s = (-1.0 if mirror else 1.0), np.cos(turn), np.sin(turn)

    def place(x: float, y: float) -> tuple[float, float]:
        return c * x - s * sign * y + 30.0, s * x + c * sign * y - 20.0

    turned = [
        replace(e, x=place(e.x, e.y)[0], y=place(e.x, e.y)[1], yaw=sign * e.yaw + turn)
        for e in egos
    ]
    here, there = run(log, mode, egos), run(other, mode, turned)
    np.testing.assert_array_equal(here.offsets, there.offsets)
    x, y = place(here.x, here.y)  # type: ignore[arg-type]
    np.testing.assert_allclose(there.x, x, atol=1e-5)
    np.testing.assert_allclose(there.y, y, atol=1e-5)


# --- reactive, and what it has in common with give_way


@pytest.mark.parametrize("mode", REACT)
@given(st.floats(5.0, 15.0), st.floats(8.0, 40.0), st.floats(1.0, 6.0))
@settings(max_examples=10)
def test_nobody_drives_into_an_ego_that_brakes(
    mode: str, v: float, behind: float, decel: float
) -> None:
    """Someone with a gap from which braking within the limits is possible follows, and stops
    behind.
    """
    gap = behind - 4.5 / 2 - 0.9
    stops_in = v * 0.2 + v**2 / (2 * 0.9 * HARDEST_MPS2) - v**2 / (2 * decel)
    log = made(car("b", -behind, v=v), v=v)
    egos = at_speed(lambda t: max(v - decel * t, 0.0))
    moved = run(log, mode, egos)
    if gap > stops_in + 1.0:
        assert gap_behind(moved, "b", egos).min() > 0.2
    hits = [contact(World(ego, log.tracks), log.vehicle) >= 0 for ego in egos]
    assert any(hits) or v * 12.0 - v**2 / (2 * decel) < behind + 1.0, (
        "replayed by time, he drives through"
    )


def test_the_follower_keeps_a_gap_to_a_slower_ego_and_so_does_the_next() -> None:
    log = made(car("b", -20.0), car("c", -35.0))
    egos = at_speed(lambda t: max(10.0 - 1.5 * t, 4.0))
    moved = run(log, "reactive", egos)
    assert gap_behind(moved, "b", egos).min() > STANDSTILL_M
    now = moved.perceived(12.0)
    b, c = now.ids.index("b"), now.ids.index("c")
    assert now.vx[b] == pytest.approx(4.0, abs=0.7)
    assert now.x[b] - now.x[c] - 4.5 > STANDSTILL_M


@pytest.mark.parametrize("mode", REACT)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 4.0))
@settings(max_examples=4)
def test_nobody_leaves_the_logged_path_or_is_ahead_of_it_or_faster(
    mode: str, seed: int, decel: float
) -> None:
    log = busy(seed)
    moved = run(log, mode, at_speed(lambda t: max(10.0 - decel * t, 0.0)))
    for i, name in enumerate(moved.ids):
        mine, theirs = moved.samples(i), log.tracks.samples(log.tracks.ids.index(name))
        if log.tracks.kinds[log.tracks.ids.index(name)] is AgentKind.PEDESTRIAN or moved.static[i]:
            continue
        y = log.tracks.y[theirs][0]
        np.testing.assert_allclose(moved.y[mine], y, atol=1e-9)
        x = moved.x[mine]
        assert (np.diff(x) > -1e-9).all()
        assert (
            x <= np.interp(moved.t[mine], log.tracks.t[theirs], log.tracks.x[theirs]) + 1e-6
        ).all()


def test_pedestrians_and_bicycles_are_replayed_by_time() -> None:
    log = made(
        car("bike", -12.0, kind=AgentKind.BICYCLE),
        car("walker", -8.0, v=2.0, kind=AgentKind.PEDESTRIAN),
    )
    assert_same_motion(run(log, "reactive", at_speed(lambda t: 0.0)), log.tracks)


@pytest.mark.parametrize("mode", REACT)
def test_the_lane_beside_is_not_held_up(mode: str) -> None:
    log = made(car("beside", -20.0, y=3.5))
    assert_same_motion(run(log, mode, at_speed(lambda t: 0.0)), log.tracks)


def test_who_comes_late_makes_up_while_his_log_stands() -> None:
    stand = np.where(T < 4.0, 10.0 * T, np.where(T < 10.0, 40.0, 40.0 + 10.0 * (T - 10.0)))
    log = made(track("b", T, stand - 20.0, np.zeros(len(T))))
    egos = at_speed(lambda t: 10.0 if t < 0.5 else 5.0 if t < 3.0 else 14.0)
    moved = run(log, "reactive", egos)
    truth, mine = log.tracks.truth(11.5), moved.truth(11.5)
    early = moved.truth(4.0).x[0] - log.tracks.truth(4.0).x[0]
    assert early < -2.0 and mine.x[0] == pytest.approx(truth.x[0], abs=1e-6)


@pytest.mark.parametrize("mode", REACT)
def test_a_late_agent_leaves_with_the_others_where_the_recording_ends(mode: str) -> None:
    short = T[T <= 5.0]
    others = [
        track(f"o{i}", short, 100.0 + 20.0 * i + 10.0 * short, np.full(len(short), 3.5))
        for i in range(3)
    ]
    log = made(
        track("b", short, -12.0 + 10.0 * short, np.zeros(len(short)), vx=10.0, vy=0.0), *others
    )
    found = run(log, mode, at_speed(lambda t: max(10.0 - 4.0 * t, 3.0)))
    late = found.ids.index("b")
    assert found.x[found.samples(late)][-1] < log.tracks.x[log.tracks.samples(0)][-1] - 1.0
    assert found.t.max() <= 5.0 + 1e-9


def test_who_is_late_drives_on_along_the_lane_where_his_log_ends() -> None:
    short = T[T <= 5.0]
    log = made(track("b", short, -20.0 + 10.0 * short, np.zeros(len(short)), vx=10.0, vy=0.0))
    log = replace(log, traffic=((0.0, 12.0),))
    slow = run(log, "reactive", at_speed(lambda t: max(10.0 - 2.0 * t, 5.0)))
    assert slow.t[-1] > 8.0 and slow.x.max() > log.tracks.x.max() + 10.0
    in_time = run(log, "reactive", far_away(log))
    assert in_time.t[-1] == pytest.approx(5.0)
    nowhere = replace(log, road=replace(log.road, lanes={}))
    assert (
        run(nowhere, "reactive", at_speed(lambda t: max(10.0 - 2.0 * t, 5.0))).x.max()
        <= log.tracks.x.max() + 1e-6
    )


@pytest.mark.parametrize("mode", REACT)
def test_who_enters_where_the_ego_is_waits_and_enters_slowly_behind_it(mode: str) -> None:
    entry = T[T >= 3.0]
    log = made(track("new", entry, 10.0 + 10.0 * (entry - 3.0), np.zeros(len(entry))))
    there = at_speed(lambda t: 4.0 if t > 5.0 else 0.0)
    egos = [replace(ego, x=ego.x + 9.0) for ego in there]
    moved = run(log, mode, egos)
    assert "new" in moved.ids and moved.t[0] > 5.0
    traffic = TRAFFIC.builtin[mode](log)
    assert all(contact(World(ego, traffic.step(ego)), log.vehicle) < 0 for ego in egos)


@given(st.floats(0.0, 30.0), st.floats(0.05, 200.0), st.floats(0.0, 30.0), st.floats(-8.0, 4.0))
def test_enhanced_idm_is_bounded_and_prefers_more_room(
    v: float, gap: float, v_lead: float, a_lead: float
) -> None:
    here, more = enhanced_idm(v, gap, v_lead, a_lead), enhanced_idm(v, gap + 5.0, v_lead, a_lead)
    assert -HARDEST_MPS2 <= here <= ACCEL_MPS2
    if a_lead == 0.0:
        assert more >= here - 1e-6


@given(st.floats(1.0, 30.0))
def test_enhanced_idm_rests_at_its_desired_gap(v: float) -> None:
    assert enhanced_idm(v, STANDSTILL_M + TIME_GAP_S * v, v, 0.0) == pytest.approx(0.0, abs=1e-9)


# --- give way


def beside_then_before(at: float, x: float, v: float, *, swerve_s: float = 0.6) -> Egos:
    """An ego in the left lane that changes at `at` into the right lane, where its centre would then
    be `x` at t = 0.
    """
    egos = []
    for t in T:
        u = min(max((t - at) / swerve_s, 0.0), 1.0)
        slope = 3.5 / swerve_s if 0.0 < u < 1.0 else 0.0
        yaw = -np.arctan2(slope, v) if slope else 0.0
        egos.append(EgoState(float(t), x + v * t - 1.4, 3.5 - 3.5 * u, float(yaw), v))
    return egos


def speeds(moved: Tracks, name: str) -> FloatArray:
    span = moved.samples(moved.ids.index(name))
    return np.hypot(np.diff(moved.x[span]), np.diff(moved.y[span])) / np.diff(moved.t[span])


def hits(log: Scenario, mode: str, egos: Egos) -> int:
    traffic = TRAFFIC.builtin[mode](log)
    return sum(contact(World(ego, traffic.step(ego)), log.vehicle) >= 0 for ego in egos)


def test_who_follows_closely_but_would_not_run_into_the_ego_drives_as_logged() -> None:
    """At 0.3 s the car-following model would fall back at once."""
    log = made(car("b", -9.0))
    egos = [replace(ego, x=ego.x - 1.5) for ego in logged(log)]
    assert_same_samples(run(log, "give_way", egos), log.tracks)
    assert speeds(run(log, "reactive", egos), "b").min() < 9.0


@given(st.floats(9.0, 25.0), st.floats(0.0, 0.8))
@settings(max_examples=6)
def test_nobody_brakes_harder_than_a_careful_driver_and_those_behind_give_way_too(
    room: float, share: float
) -> None:
    log = made(car("b", -room), car("c", -2.0 * room), car("far", -80.0))
    egos = at_speed(lambda t: max(10.0 - 6.0 * t, 10.0 * share))
    moved = run(log, "give_way", egos)
    for name in ("b", "c"):
        assert np.diff(speeds(moved, name)).min() >= -0.1 * HARDEST_MPS2 - 1e-6
    assert speeds(moved, "b").min() < 10.0 - 1e-3
    b, c = (moved.samples(moved.ids.index(name)) for name in "bc")
    apart = np.interp(T, moved.t[b], moved.x[b]) - np.interp(T, moved.t[c], moved.x[c])
    assert apart.min() > 4.5


def test_who_cuts_in_with_room_is_let_in_and_who_does_not_leave_a_careful_driver_time_is_hit() -> (
    None
):
    """The ego is 4 m/s slower.

    With the reaction of 0.75 s and 0.774 g a driver needs 3.0 m + 1.1 m.
    """
    log = made(car("b", 0.0))
    with_room, close = (
        beside_then_before(3.0, 12.0 + room + 4.5 / 2 + 4.5 / 2, 6.0) for room in (9.0, 1.5)
    )
    assert hits(log, "time", with_room) > 0 and hits(log, "give_way", with_room) == 0
    assert hits(log, "give_way", close) > 0
    before = run(log, "give_way", with_room[:31]).x
    np.testing.assert_array_equal(before, log.tracks.x)


def oncoming(log: Scenario) -> Egos:
    return [EgoState(float(t), 60.0 - 5.0 * t, 0.0, np.pi, 5.0) for t in T]


def from_the_side(log: Scenario) -> Egos:
    return [EgoState(float(t), 45.0, 40.0 - 8.0 * t, -0.5 * np.pi, 8.0) for t in T]


def swerving(log: Scenario) -> Egos:
    return beside_then_before(2.0, 0.5, 10.0)


@pytest.mark.parametrize("way", [oncoming, from_the_side, swerving])
def test_who_drives_head_on_or_without_right_of_way_is_hit_as_in_the_log(
    way: Callable[[Scenario], Egos],
) -> None:
    log = made(car("b", 0.0))
    egos = way(log)
    assert hits(log, "time", egos) > 0
    first = next(
        k for k, ego in enumerate(egos) if contact(World(ego, log.tracks), log.vehicle) >= 0
    )
    assert_same_samples(run(log, "give_way", egos[: first + 1]), log.tracks)


@pytest.mark.parametrize(
    ("kind", "spared"), [(AgentKind.BICYCLE, True), (AgentKind.PEDESTRIAN, False)]
)
def test_riders_give_way_and_pedestrians_are_replayed(kind: AgentKind, *, spared: bool) -> None:
    log = made(car("b", -15.0, v=6.0, kind=kind, length=1.8, width=0.6), v=6.0)
    egos = at_speed(lambda t: max(6.0 - 2.0 * t, 0.0))
    assert (hits(log, "give_way", egos) == 0) == spared


def test_the_drive_says_who_gave_way_since_when_and_how_hard_they_braked() -> None:
    log = made(car("b", -12.0), v=10.0)
    traffic = TRAFFIC.builtin["give_way"](log)
    egos = at_speed(lambda t: 10.0 if t < 2.0 else max(10.0 - 4.0 * (t - 2.0), 2.0))
    assert isinstance(traffic, Reactive) and traffic.notes == ()
    for ego in egos:
        moved = traffic.step(ego).whole
    (said,) = traffic.notes
    since = float(said.split("car b from ")[1].split(" s")[0])
    hardest = float(said.split(" s, ")[1].split(" m/s2")[0])
    assert 2.0 <= since <= 4.0 and hardest == pytest.approx(
        -np.diff(speeds(moved, "b")).min() / 0.1, abs=0.06
    )
    later = moved.t > since - 1e-9
    np.testing.assert_array_equal(moved.x[~later], log.tracks.x[: (~later).sum()])


# --- right of way

MAIN = junction(60.0, 60.0, 80.0, turn=0, speed_limit=13.9).road
CROSS = np.array([70.75, 0.0])
"""Where the way of the catalogue's ego meets the main road from the right."""


def from_the_side_road(arrives: float, v: float = 8.0, road: Road = MAIN) -> Scenario:
    """Someone drives across the main road, over its middle at `arrives`.

    The logged ego is far away.
    """
    return replace(made(car("s", CROSS[0] - v * arrives, v=v)), road=road)


def on_the_main_road(arrives: float, v: float = 10.0) -> Egos:
    return [EgoState(float(t), CROSS[0], v * (t - arrives), 0.5 * np.pi, v) for t in T]


@given(st.floats(-0.6, 0.6), st.floats(5.0, 10.0), st.floats(7.0, 13.0))
@settings(max_examples=4)
def test_who_comes_from_a_lane_that_yields_lets_the_ego_pass_and_drives_on(
    later: float, v: float, fast: float
) -> None:
    egos = on_the_main_road(5.5, fast)
    log = from_the_side_road(5.5 + later, v)
    moved = run(log, "give_way", egos)
    assert hits(log, "give_way", egos) == 0
    assert np.diff(speeds(moved, "s")).min() >= -0.1 * HARDEST_MPS2 - 1e-6
    assert moved.x[moved.samples(0)][-1] > CROSS[0] + 2.0
    equal = {i: replace(lane, yields_to=()) for i, lane in MAIN.lanes.items()}
    assert_same_samples(
        run(from_the_side_road(5.5 + later, v, replace(MAIN, lanes=equal)), "give_way", egos),
        log.tracks,
    )


@pytest.mark.parametrize("arrives", [2.5, 9.0])
def test_who_passes_well_before_or_after_the_ego_does_not_wait(arrives: float) -> None:
    log = from_the_side_road(arrives)
    assert_same_samples(run(log, "give_way", on_the_main_road(5.5)), log.tracks)


def test_whoever_would_have_to_brake_harder_than_he_can_drives_on() -> None:
    """The ego appears on the main road when it is too late to stop before it."""
    log = from_the_side_road(5.5, 12.0)
    egos = [ego if ego.t > 4.9 else replace(ego, y=-1e3) for ego in on_the_main_road(5.5)]
    assert_same_samples(run(log, "give_way", egos), log.tracks)


# --- reactive, at traffic lights

LINE = 40.0


def delayed(t: float) -> float:
    """The speed of an ego that holds up who is behind it, and leaves the scene before a light
    does.
    """
    return 5.0 if t < 2.5 else 16.0


def fronts(moved: Tracks, name: str = "b") -> FloatArray:
    i = moved.ids.index(name)
    span = moved.samples(i)
    return np.asarray(np.interp(T, moved.t[span], moved.x[span]) + 0.5 * moved.length[i])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=4)
def test_who_is_as_logged_runs_the_red_that_he_ran(seed: int) -> None:
    red, never = (lit(busy(seed), 40.0, (0.0, shown)) for shown in (Colour.RED, Colour.GREEN))
    one, two = (run(log, "reactive", far_away(log)) for log in (red, never))
    assert_same_motion(one, red.tracks)
    for name in ("t", "x", "y", "yaw", "vx", "vy"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    held_up = lit(made(car("b", -20.0), car("beside", -20.0, y=3.5)), LINE, (0.0, Colour.RED))
    moved = run(held_up, "reactive", at_speed(delayed))
    np.testing.assert_allclose(fronts(moved, "beside"), -17.75 + 10.0 * T, atol=1e-9)


@given(
    st.floats(2.5, 6.5),
    st.floats(1.0, 2.5),
    st.sampled_from([Colour.RED, Colour.RED_YELLOW, Colour.YELLOW]),
)
@settings(max_examples=10)
def test_who_is_late_waits_before_the_line_until_it_opens(
    closes: float, seconds: float, shown: Colour
) -> None:
    log = made(car("b", -20.0))
    free = fronts(run(log, "reactive", at_speed(delayed)))
    opens = closes + seconds
    moved = run(
        lit(log, LINE, (0.0, Colour.GREEN), (closes, shown), (opens, Colour.GREEN)),
        "reactive",
        at_speed(delayed),
    )
    held = fronts(moved)
    k, last = int(np.searchsorted(T, closes)), int(np.searchsorted(T, opens))
    gap, v = LINE - free[k], (free[k] - free[k - 1]) / 0.1
    able = (
        gap > 0.0 and v * v <= 2.0 * gap * (3.0 if shown is Colour.YELLOW else HARDEST_MPS2) * 0.98
    )
    if able:
        assert held[: last + 1].max() <= LINE
    elif gap < 0.0 or v * v > 2.0 * gap * (3.0 if shown is Colour.YELLOW else HARDEST_MPS2) * 1.02:
        np.testing.assert_array_equal(held, free)
    assert (np.diff(held) > -1e-9).all() and (held <= free + 1e-9).all()
    assert held[-1] > LINE + 2.0 or opens > 7.0


@pytest.mark.parametrize(
    ("v", "need", "stops"),
    [
        (10.0, 2.0, True),
        (10.0, 2.9, True),
        (28.0, 2.9, True),
        (10.0, 3.2, False),
        (10.0, 6.0, False),
    ],
)
def test_at_yellow_they_stop_if_that_is_comfortable_and_keep_to_it(
    v: float, need: float, *, stops: bool
) -> None:
    """`need`: the deceleration that it takes. It is red before he is over the line."""
    log, egos, line = (
        made(car("b", -1.4 * v, v=v), v=v),
        at_speed(lambda t: 0.8 * v if t < 0.8 else 1.2 * v),
        6.0 * v,
    )
    free = fronts(run(log, "reactive", egos))
    takes = np.gradient(free, T)[free < line] ** 2 / (2.0 * (line - free[free < line]))
    at = float(np.interp(need, takes, T[free < line]))
    shown = (0.0, Colour.GREEN), (at, Colour.YELLOW), (at + (3.0 if stops else 0.5), Colour.RED)
    moved = fronts(run(lit(log, line, *shown), "reactive", egos))
    if stops:
        assert moved.max() < line and -np.diff(moved, 2).min() / 0.01 < 1.8 * need
    else:
        np.testing.assert_array_equal(moved, free)


def test_where_his_log_waited_he_waits_too_and_is_in_time_again() -> None:
    x = np.where(T < 5.0, 10.0 * T, np.where(T < 10.0, 50.0, 50.0 + 10.0 * (T - 10.0))) - 20.0
    line = 30.0 + 2.25 + 0.5
    log = lit(
        made(track("b", T, x, np.zeros(len(T)))), line, (0.0, Colour.RED), (9.5, Colour.GREEN)
    )
    moved = run(log, "reactive", at_speed(delayed))
    assert fronts(moved)[45] < x[45] + 1.0
    np.testing.assert_allclose(fronts(moved)[T > 8.0] - 2.25, x[T > 8.0], atol=1e-6)


@pytest.mark.parametrize(("towards", "stops"), [((), True), ((1,), True), ((2,), False)])
def test_a_line_for_another_way_does_not_hold_him(towards: tuple[int, ...], stops: bool) -> None:
    left = np.column_stack([np.full(20, LINE + 2.0), np.linspace(2.0, 60.0, 20)])
    road = Road(
        {
            0: strip(0, along_x(-100.0, LINE), successors=(1, 2)),
            1: strip(1, along_x(LINE, 500.0)),
            2: strip(2, left),
        }
    )
    log = replace(made(car("b", -20.0)), road=road)
    moved = fronts(
        run(lit(log, LINE, (0.0, Colour.RED), towards=towards), "reactive", at_speed(delayed))
    )
    assert (moved.max() < LINE) == stops


# --- by ego position


@given(st.floats(4.0, 16.0))
@settings(max_examples=10)
def test_an_encounter_is_kept_whatever_the_speed(v: float) -> None:
    """Someone crosses 60 m ahead as the logged ego comes to 50 m: so he does for a slower or faster
    one.
    """
    log = made(track("x", T, np.full(len(T), 60.0), 10.0 - 2.0 * T, kind=AgentKind.PEDESTRIAN))
    egos = at_speed(lambda t: v)
    moved = run(log, "ego_position", egos)
    for ego in egos:
        if 1.0 < ego.x < 110.0 and ego.t <= moved.t[-1]:
            assert moved.truth(ego.t).y[0] == pytest.approx(10.0 - 2.0 * ego.x / 10.0, abs=0.05)
    speeds = moved.perceived(2.0)
    assert speeds.speed[0] == pytest.approx(2.0 * v / 10.0, abs=0.02)


def test_the_world_stands_with_the_ego_until_it_is_stuck_and_then_goes_on_without_touching_it() -> (
    None
):
    log = made(track("x", T, np.full(len(T), 60.0), 10.0 - 2.0 * T, kind=AgentKind.PEDESTRIAN))
    egos = at_speed(lambda t: 10.0 if t < 2.0 else 0.0 if t < 8.0 else 10.0)
    moved = run(log, "ego_position", egos)
    y = np.array([moved.truth(float(t)).y[0] for t in T[:-1]])
    held, released, after = (
        y[(T[:-1] > 2.3) & (T[:-1] < 4.0)],
        y[(T[:-1] > 4.4) & (T[:-1] < 8.0)],
        y[T[:-1] > 8.5],
    )
    assert np.ptp(held) < 0.05
    np.testing.assert_allclose(np.diff(released), -0.2, atol=1e-6)
    np.testing.assert_allclose(
        np.diff(after), -0.2, atol=0.03, err_msg="a freeze or a jump when the ego drives on"
    )


def test_where_the_log_waits_the_world_catches_up_without_a_leap() -> None:
    waiting = drive(straight, lambda t: np.where((t > 3.0) & (t < 6.0), 0.0, 10.0), 12.0)
    log = replace(made(car("x", 5.0, y=3.5)), ego=waiting)
    moved = run(log, "ego_position", at_speed(lambda t: 10.0))
    assert np.hypot(np.diff(moved.x), np.diff(moved.y)).max() <= 2.0 * 1.0 + 1e-6


def test_an_ego_that_never_moved_tells_no_time() -> None:
    log = replace(made(car("x", 5.0)), ego=drive(straight, 0.0, 12.0))
    with pytest.raises(LogError, match="take traffic 'time' or 'reactive'"):
        TRAFFIC.builtin["ego_position"](log)


# --- in the loop, and on recorded traffic


@pytest.mark.parametrize("mode", TRAFFIC.builtin)
def test_the_closed_loop_keeps_what_happened(mode: str) -> None:
    log = busy(2)
    one, two = (
        run_closed_loop(log, "constant_speed", config=LoopConfig(traffic=mode)).trace
        for _ in range(2)
    )
    assert one.agents.t.max() >= one.ego.t[-1]
    assert any("the others" in note for note in one.notes) == (mode in ("reactive", "ego_position"))
    np.testing.assert_array_equal(one.agents.x, two.agents.x)
    np.testing.assert_array_equal(one.ego.x, two.ego.x)


def test_recorded_traffic_is_reproduced_and_spares_a_braking_ego(shared_data: Path) -> None:
    log = read_commonroad(shared_data / "commonroad" / "C-DEU_MONAEast-2_240_T-319.xml")
    egos = [replace(logged_ego(log.ego, log.vehicle, 0.0), t=float(t), x=1e5) for t in T]
    assert_same_motion(run(log, "reactive", egos), log.tracks, atol=1e-6)
    start = logged_ego(log.ego, log.vehicle, 0.0)
    traffic, by_time = TRAFFIC.builtin["reactive"](log), 0
    for t in T:
        v = max(start.v - 3.0 * t, 0.0)
        way = (start.v**2 - v**2) / 6.0
        ego = replace(
            start,
            t=float(t),
            v=v,
            x=start.x + way * np.cos(start.yaw),
            y=start.y + way * np.sin(start.yaw),
        )
        assert contact(World(ego, traffic.step(ego)), log.vehicle) < 0
        by_time += contact(World(ego, log.tracks), log.vehicle) >= 0
    assert by_time > 0


# --- what a replay keeps of the tracks that it plays


@pytest.mark.slow
def test_memory_is_that_of_who_is_late_and_not_of_all_at_all_times() -> None:
    """100 cars over 600 samples are 2.4 MB of poses.

    With one late car less than 0.3 MB are held.
    """
    t = np.arange(0.0, 60.5, 0.5)
    log = tracks(*(track(str(i), t, t, np.full(121, 10.0 * i)) for i in range(100)))
    replay, since, everybody = PhaseReplay(log), np.r_[1.0, np.full(99, np.inf)], np.arange(100)
    rows = [PERIOD_S * k for k in range(600)]
    replay.add(rows[0], everybody, np.zeros(100), np.ones(100))
    replay.tracks(since)
    tracemalloc.start()
    for now in rows[1:]:
        replay.add(now, everybody, np.full(100, now), np.ones(100))
        seen = replay.tracks(since)
    sizes = np.diff(seen.whole.offsets).tolist()
    del seen
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert sizes == [2 + 590, *[121] * 99]
    assert held < 300_000
