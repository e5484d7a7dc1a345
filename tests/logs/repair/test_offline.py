"""Raw detections to tracks: laws, then examples, then recordings made as bad as a detector is."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from crowd import street, street_ego
from hypothesis import given, settings, strategies as st
from track_score import repaired_score

from replan.core.arrays import FloatArray, IntArray
from replan.logs.agents import AgentKind, codes_of
from replan.logs.catalogue.detector import detected
from replan.logs.readers import read_log
from replan.logs.repair.detections import Detections, Repair
from replan.logs.repair.offline import detections_of, repair
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

VEHICLE = VehicleParameters()
EGO = street_ego()


@cache
def seen() -> Detections:
    return detected(street(), EGO, 1)


def fixed(found: Detections, ego: Trajectory = EGO) -> tuple[Tracks, Repair]:
    return repair(found, ego, VEHICLE)


@cache
def usual() -> tuple[Tracks, Repair]:
    return fixed(seen())


def turned(found: Detections, angle: float, mirror: bool) -> Detections:
    """The detections in a world that is mirrored at the x axis, then turned."""
    sign = -1.0 if mirror else 1.0
    x, y = turned_points(found.x, found.y, angle, mirror)
    return replace(found, x=x, y=y, yaw=sign * found.yaw + angle)


def turned_points(
    x: FloatArray, y: FloatArray, angle: float, mirror: bool
) -> tuple[FloatArray, FloatArray]:
    y = -y if mirror else y
    return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y


def turned_ego(angle: float, mirror: bool) -> Trajectory:
    x, y = turned_points(EGO.x, EGO.y, angle, mirror)
    return replace(EGO, x=x, y=y, yaw=(-1.0 if mirror else 1.0) * EGO.yaw + angle)


def by_place(tracks: Tracks, x: FloatArray, y: FloatArray) -> list[tuple[float, ...]]:
    """Each track as numbers that no naming changes."""
    rows = []
    for i in range(len(tracks)):
        part = tracks.samples(i)
        rows.append(
            (
                tracks.t[part][0],
                tracks.t[part][-1],
                tracks.length[i],
                x[part].mean(),
                y[part].mean(),
                x[part][-1],
            )
        )
    return sorted(tuple(np.round(row, 5)) for row in rows)


def measured(tracks: Tracks, done: Repair, i: int) -> IntArray:
    """The samples of track i that are not beyond sight."""
    part = tracks.samples(i)
    return np.arange(part.start, part.stop)[~done.extended[part]]


def test_clean_tracks_stay_as_they_are() -> None:
    clean = street()
    tracks, done = fixed(detections_of(clean))
    assert dict(zip(tracks.ids, tracks.kinds, strict=True)) == dict(
        zip(clean.ids, clean.kinds, strict=True)
    )
    assert len(done.removed) == 0
    assert {change.what for change in done.changes} <= {"extended"}
    for one in range(len(clean)):
        two, part = tracks.ids.index(clean.ids[one]), clean.samples(one)
        rows = measured(tracks, done, two)
        assert np.array_equal(tracks.t[rows], clean.t[part])
        assert np.hypot(tracks.x[rows] - clean.x[part], tracks.y[rows] - clean.y[part]).max() < 0.1
        off = np.hypot(tracks.vx[rows] - clean.vx[part], tracks.vy[rows] - clean.vy[part])
        assert np.sqrt(np.mean(off**2)) < 0.15
        assert off.max() < 0.5
        assert np.allclose(
            (tracks.length[two], tracks.width[two]), (clean.length[one], clean.width[one])
        )


def test_a_repair_of_what_was_repaired_changes_little() -> None:
    tracks, done = usual()
    again, twice = fixed(detections_of(tracks.taken(~done.extended)))
    assert dict(zip(again.ids, again.kinds, strict=True)) == dict(
        zip(tracks.ids, tracks.kinds, strict=True)
    )
    assert len(twice.removed) == 0
    for i in range(len(tracks)):
        one, two = tracks.samples(i), again.samples(i)
        rows = [
            np.arange(part.start, part.stop)[~extended[part]]
            for part, extended in ((one, done.extended), (two, twice.extended))
        ]
        apart = np.hypot(tracks.x[rows[0]] - again.x[rows[1]], tracks.y[rows[0]] - again.y[rows[1]])
        assert apart.max() < 0.2


@settings(max_examples=3)
@given(st.floats(-3.0, 3.0), st.booleans())
def test_turned_and_mirrored_worlds_are_alike(angle: float, mirror: bool) -> None:
    tracks, done = usual()
    others, same = fixed(turned(seen(), angle, mirror), turned_ego(angle, mirror))
    assert len(done.removed) == len(same.removed)
    x, y = turned_points(tracks.x, tracks.y, angle, mirror)
    assert np.allclose(by_place(tracks, x, y), by_place(others, others.x, others.y), atol=1e-4)


@settings(max_examples=2)
@given(st.integers(0, 100))
def test_the_order_within_a_frame_does_not_count(seed: int) -> None:
    found = seen()
    mixed = np.random.default_rng(seed).permutation(len(found))
    mixed = mixed[np.argsort(found.t[mixed], kind="stable")]
    names = ("t", "codes", "x", "y", "yaw", "length", "width", "vx", "vy", "score")
    other = replace(
        found,
        ids=tuple(found.ids[i] for i in mixed),
        **{name: getattr(found, name)[mixed] for name in names},
    )
    one, two = usual()[0], fixed(other)[0]
    assert one.ids == two.ids
    for name in ("t", "x", "y", "yaw", "vx", "vy", "length", "width"):
        assert np.array_equal(getattr(one, name), getattr(two, name))


def test_two_halves_show_the_same_road_users() -> None:
    found = seen()
    whole, done = usual()
    for half in (found.t < 10.0, found.t >= 10.0):
        part, cut = fixed(found.taken(half))
        at = ~done.extended & (np.abs(whole.t - 10.0) > 1.0) & ((whole.t < 10.0) == half[0])
        t, x, y = part.t[~cut.extended], part.x[~cut.extended], part.y[~cut.extended]
        apart = [
            np.hypot(x[t == time] - px, y[t == time] - py).min(initial=np.inf)
            for time, px, py in zip(whole.t[at], whole.x[at], whole.y[at], strict=True)
        ]
        assert np.mean(np.array(apart) < 0.5) > 0.95


def test_a_street_is_found_again() -> None:
    scenario = Scenario("street", EGO, street(), road=None, duration=20.0)  # type: ignore[arg-type]
    found = repaired_score(scenario, 3)
    assert found.hota > 0.85
    assert found.lost == 0
    assert found.ghosts <= 1
    assert found.still < 0.1
    assert found.moving < 0.4


def box(
    t: FloatArray, x: float, y: float, kind: AgentKind, score: float = 0.6, length: float = 4.5
) -> Detections:
    """One object that stands, detected at t."""
    n = len(t)
    full = np.full(n, 1.0)
    return Detections(
        t=t,
        frames=EGO.t,
        ids=("",) * n,
        codes=np.repeat(codes_of((kind,)), n),
        x=x * full,
        y=y * full,
        yaw=0.0 * full,
        length=length * full,
        width=1.8 * full,
        vx=np.nan * full,
        vy=np.nan * full,
        score=score * full,
    )


def test_nothing_stood_where_the_ego_drove() -> None:
    tracks, done = fixed(box(EGO.t[:100], 30.0, 0.5, AgentKind.CAR))
    assert len(tracks) == 0
    assert len(done.removed) == 1
    assert "The ego drove through it" in done.changes[0].why


def test_a_box_that_grazes_the_ego_is_smaller() -> None:
    tracks, done = fixed(box(EGO.t[:100], 30.0, 0.5 * (VEHICLE.width + 1.8) - 0.2, AgentKind.CAR))
    assert tracks.width[0] == pytest.approx(1.8 - 2.0 * (0.2 + 0.2)), (
        "the driver kept 0.2 m from it"
    )
    assert any(change.what == "shrunk" and "0.20 m" in change.why for change in done.changes)


def test_who_stands_where_sight_ends_stood_there_before() -> None:
    tracks, done = fixed(box(EGO.t[100:180], 4.0 * 10.0 + 48.0, 4.0, AgentKind.CAR))
    assert done.extended.sum() == 100
    assert tracks.t[0] == 0.0
    assert not tracks.vx.any()
    change = next(change for change in done.changes if change.what == "extended")
    assert (change.samples, change.begin, change.end) == (100, 0.0, 9.9)


def test_a_few_weak_boxes_are_no_evidence() -> None:
    for found in (
        box(EGO.t[:4], 20.0, 6.0, AgentKind.CAR, 0.9),
        box(EGO.t[:8], 20.0, 6.0, AgentKind.CAR, 0.2),
    ):
        tracks, done = fixed(found)
        assert len(tracks) == 0
        assert done.summary() == (f"Repair removed {len(found)} detections with 1 tracks.",)


def test_few_boxes_are_evidence_of_who_goes_fast_along_a_line() -> None:
    few = EGO.t[[50, 51, 53, 54]]
    passing = replace(box(few, 0.0, 6.0, AgentKind.CAR), x=40.0 - 12.0 * few)
    tracks, _ = fixed(passing)
    assert tracks.ids == ("1",)
    assert np.allclose(tracks.vx, -12.0, atol=0.5)
    for apart in (
        replace(passing, x=passing.x + 12.0 * np.abs(few - few[2])),
        replace(passing, x=40.0 - 4.0 * few),
    ):
        assert len(fixed(apart)[0]) == 0


def test_a_bus_that_is_seen_as_two_is_one() -> None:
    whole, part = np.arange(0, 60, 2), np.r_[31:60:2, 60:120]
    places = (whole, 30.0, 12.0), (part, 31.0, 3.0)
    both = [box(EGO.t[rows], x, 9.0, AgentKind.BUS, length=length) for rows, x, length in places]
    order = np.argsort(np.concatenate([each.t for each in both]), kind="stable")
    names = ("t", "codes", "x", "y", "yaw", "length", "width", "vx", "vy", "score")
    columns = {
        name: np.concatenate([getattr(each, name) for each in both])[order] for name in names
    }
    tracks, done = fixed(replace(both[0], ids=("",) * len(order), **columns))
    assert len(tracks) == 1
    assert (tracks.t[0], tracks.t[-1]) == (0.0, pytest.approx(11.9))
    removed = [change for change in done.changes if change.what == "removed"]
    assert [change.why for change in removed] == [
        "In the place of another bus that is seen better."
    ]


def test_no_detections_are_no_tracks() -> None:
    tracks, done = fixed(box(np.empty(0), 0.0, 0.0, AgentKind.CAR))
    assert len(tracks) == 0
    assert done.changes == ()


def test_every_detection_is_accounted_for() -> None:
    found = seen()
    tracks, done = usual()
    counted = sum(change.samples for change in done.changes if change.what in ("joined", "removed"))
    of_removed = [
        c.agent for c in done.changes if c.what == "removed" and c.agent in done.removed.ids
    ]
    assert len(of_removed) == len(done.removed)
    assert not set(tracks.ids) & set(done.removed.ids)
    assert len(found) - counted <= 0.03 * len(found)  # twins of what was removed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "least"),
    [
        ("argoverse2/3b*", 0.87),
        ("argoverse2/7f*", 0.87),
        ("commonroad/C-DEU_MONAWest-2_1440_T-1519.xml", 0.87),
    ],
)
def test_recordings_seen_by_a_detector_are_repaired(
    shared_data: Path, pattern: str, least: float
) -> None:
    scenario = read_log(next(shared_data.glob(pattern)))
    scores = [repaired_score(scenario, seed) for seed in (1, 2)]
    assert np.mean([each.hota for each in scores]) > least
    assert np.mean([each.ghosts for each in scores]) <= 1.5
    assert not any(each.missed_near for each in scores)
    assert np.mean([each.still for each in scores]) < 0.15
    assert np.mean([each.moving for each in scores]) < 0.4


def test_who_stands_is_not_the_one_who_stands_in_the_lane_beside() -> None:
    """One car of a queue is seen for a second, and three seconds later the one beside it."""
    frames = np.round(0.1 * np.arange(61), 6)
    t = np.r_[frames[:11], frames[41:]]
    y = np.where(t < 2.0, 0.0, 3.3)
    nothing, same = np.full(len(t), np.nan), np.ones(len(t))
    codes = codes_of((AgentKind.CAR,) * len(t))
    found = Detections(
        t,
        frames,
        ("0",) * len(t),
        codes,
        40.0 * same,
        y,
        0.0 * same,
        4.5 * same,
        1.8 * same,
        nothing,
        nothing,
        0.7 * same,
    )
    tracks, _ = fixed(found, replace(EGO, x=0.0 * EGO.x, v=0.0 * EGO.v))
    assert len(tracks) == 2
    assert sorted(tracks.y[tracks.offsets[:-1]].round(1).tolist()) == [0.0, 3.3]


DRIVES = (
    "bot_garden",
    "kaubamaja_sfa_2",
    "raekoda",
    *(
        f"pedestrian_crossing_{number}"
        for number in ("01", "02", "05", "06", "07", "09", "10", "13", "14", "15")
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_the_driver_of_the_log_meets_no_track(shared_data: Path, name: str) -> None:
    scenario = read_log(shared_data / "tartu" / "ros2" / name)
    done, ego, vehicle = scenario.repair, scenario.ego, scenario.vehicle
    assert done is not None
    assert len(done.tracks) < 0.1 * len(done.detections)
    assert len(done.removed) > len(done.tracks)
    for t in np.arange(ego.t[0], ego.t[-1], 0.1):
        own, agents = ego.at(t), scenario.tracks.truth(t)
        x, y = (
            own.x + vehicle.axle_to_center * np.cos(own.yaw),
            own.y + vehicle.axle_to_center * np.sin(own.yaw),
        )
        for box in zip(agents.x, agents.y, agents.yaw, agents.length, agents.width, strict=True):
            assert not overlap(x, y, own.yaw, vehicle.length, vehicle.width, *box), t


@given(
    st.floats(0.01, 0.6),
    st.sampled_from([(4.5, 1.8), (0.5, 0.5), (2.4, 0.8)]),
    st.sampled_from([-1.0, 1.0]),
)
@settings(max_examples=20)
def test_what_stands_leaves_the_recorded_driver_room_and_stays(
    gap: float, size: tuple[float, float], side: float
) -> None:
    y = side * (0.5 * VEHICLE.width + gap + 0.5 * size[1])
    found = box(EGO.t[:100], 30.0, y, AgentKind.OBJECT)
    tracks, done = fixed(
        replace(found, length=0.0 * found.x + size[0], width=0.0 * found.x + size[1])
    )
    assert len(tracks) == 1 and not len(done.removed)
    assert tracks.width[0] >= 0.5 * size[1] - 1e-9 and tracks.length[0] >= 0.5 * size[0] - 1e-9
    left = abs(y) - 0.5 * VEHICLE.width - 0.5 * tracks.width[0]
    assert left >= 0.2 - 1e-6 or tracks.width[0] == pytest.approx(size[1] - 0.5 * min(size))
    if gap >= 0.2:
        assert tracks.width[0] == pytest.approx(size[1])


@pytest.mark.parametrize("speed", [5.0, 12.0])
def test_a_cluster_that_rides_heads_along_its_way(speed: float) -> None:
    found = box(EGO.t[:60], 0.0, 8.0, AgentKind.OBJECT)
    tracks, _ = fixed(replace(found, x=speed * found.t, yaw=found.yaw + 0.37))
    assert len(tracks) == 1
    assert np.abs(tracks.yaw).max() < 0.02
