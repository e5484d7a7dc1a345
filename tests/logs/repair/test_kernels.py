"""The smoother is the least squares that it says.

Shared areas, twins; the tracker on a street of known drives.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from crowd import street, street_ego
from differences import differences
from hypothesis import given, settings, strategies as st
from track_score import near_ego, reported, score, tracked_points, true_points

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.agents import OLDEST_S, AgentKind, codes_of
from replan.logs.catalogue import CATALOGUE
from replan.logs.catalogue.detector import detected, sight
from replan.logs.readers import read_log
from replan.logs.repair.detected_boxes import Boxes, shared_area, stronger_twins
from replan.logs.repair.detections import Detections, needs_repair
from replan.logs.repair.offline import detections_of
from replan.logs.repair.tracker import FIRST_MPS, STAND_MPS, Tracked, smoothed
from replan.logs.scenario import Scenario

Q = 1.6


def least_squares(t: FloatArray, z: FloatArray, r: FloatArray, stands: BoolArray) -> FloatArray:
    """The most likely positions and velocities `(n, 2)` of one axis, by one large system of
    equations.
    """
    n = len(t)
    rows, values = [], []

    def ask(weight: float, value: float, **at: float) -> None:
        row = np.zeros(2 * n)
        for name, factor in at.items():
            row[2 * int(name[1:]) + "pv".index(name[0])] = factor
        rows.append(weight * row)
        values.append(weight * value)

    ask(1.0 / np.sqrt(r[0]), z[0], p0=1.0)
    ask(1.0 / FIRST_MPS, 0.0, v0=1.0)
    for i in range(n):
        if np.isfinite(z[i]):
            ask(1.0 / np.sqrt(r[i]), z[i], **{f"p{i}": 1.0})
        if stands[i]:
            ask(1.0 / STAND_MPS, 0.0, **{f"v{i}": 1.0})
        if i:
            d = t[i] - t[i - 1]
            noise = Q * np.array([[d**3 / 3.0, d**2 / 2.0], [d**2 / 2.0, d]])
            for part in np.linalg.inv(np.linalg.cholesky(noise)):
                whole = {f"p{i}": part[0], f"v{i}": part[1]}
                ask(
                    1.0,
                    0.0,
                    **whole,
                    **{f"p{i - 1}": -part[0], f"v{i - 1}": -part[0] * d - part[1]},
                )
    return np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0].reshape(n, 2)


@given(st.integers(0, 10_000))
def test_the_smoother_solves_the_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 12))
    t = np.cumsum(rng.uniform(0.05, 0.5, n))
    z, r = rng.normal(0.0, 2.0, (n, 2)), rng.uniform(0.01, 0.2, n)
    z[1:][rng.random(n - 1) < 0.3] = np.nan
    stands = rng.random(n) < 0.2
    found = smoothed(t, z, r, Q, stands)
    for axis in range(2):
        assert np.allclose(
            found[:, [axis, 2 + axis]], least_squares(t, z[:, axis], r, stands), atol=1e-4
        )


BOX = st.tuples(*(st.floats(*each) for each in ((-3, 3), (-3, 3), (-4, 4), (0.3, 6.0), (0.3, 3.0))))


@given(BOX, BOX)
def test_shared_areas_are_symmetric_and_no_larger_than_a_box(
    one: tuple[float, ...], two: tuple[float, ...]
) -> None:
    area = shared_area(np.array(one), np.array(two))
    assert area == pytest.approx(shared_area(np.array(two), np.array(one)), abs=1e-9)
    assert 0.0 <= area <= min(one[3] * one[4], two[3] * two[4]) + 1e-9
    assert shared_area(np.array(one), np.array(one)) == pytest.approx(one[3] * one[4])


@settings(max_examples=10)
@given(BOX, BOX)
def test_shared_areas_are_those_of_many_points(
    one: tuple[float, ...], two: tuple[float, ...]
) -> None:
    u = (np.arange(100) + 0.5) / 100 - 0.5
    a, b = np.meshgrid(u * one[3], u * one[4])
    x, y = (
        one[0] + np.cos(one[2]) * a - np.sin(one[2]) * b,
        one[1] + np.sin(one[2]) * a + np.cos(one[2]) * b,
    )
    dx, dy = x - two[0], y - two[1]
    ahead, aside = (
        np.cos(two[2]) * dx + np.sin(two[2]) * dy,
        np.cos(two[2]) * dy - np.sin(two[2]) * dx,
    )
    area = shared_area(np.array(one), np.array(two))
    inside = (np.abs(ahead) < 0.5 * two[3]) & (np.abs(aside) < 0.5 * two[4])
    assert area == pytest.approx(inside.mean() * one[3] * one[4], abs=0.03 * one[3] * one[4] + 0.02)


def frame(*rows: tuple[AgentKind, float, float, float, float, float]) -> Boxes:
    """Boxes of one frame: kind, x, y, length, width, score."""
    kinds, x, y, length, width, score = zip(*rows, strict=True)
    nothing, n = np.full(len(rows), np.nan), len(rows)
    return Detections(
        t=np.zeros(n),
        frames=np.zeros(1),
        ids=("",) * n,
        codes=codes_of(kinds),
        x=np.array(x),
        y=np.array(y),
        yaw=np.zeros(n),
        length=np.array(length),
        width=np.array(width),
        vx=nothing,
        vy=nothing,
        score=np.array(score),
    ).boxes


@pytest.mark.parametrize(
    ("other", "stays"),
    [
        ((AgentKind.CAR, 1.0, 0.3, 4.5, 1.8, 0.4), 1),
        ((AgentKind.OBJECT, 1.0, 0.3, 2.0, 1.8, np.nan), 1),
        ((AgentKind.CAR, 0.0, 2.2, 4.5, 1.8, 0.4), 2),
        ((AgentKind.PEDESTRIAN, 0.0, 1.0, 0.6, 0.6, 0.4), 2),
        ((AgentKind.PEDESTRIAN, 0.0, 0.3, 0.6, 0.6, 0.4), 1),
    ],
)
def test_twins_are_boxes_of_one_object(
    other: tuple[AgentKind, float, float, float, float, float], stays: int
) -> None:
    boxes = frame((AgentKind.CAR, 0.0, 0.0, 4.5, 1.8, 0.6), other)
    left = np.flatnonzero(stronger_twins(boxes) < 0)
    assert len(left) == stays
    assert 0.6 in boxes.score[left]


def test_people_walk_close_together() -> None:
    pair = (
        (AgentKind.PEDESTRIAN, 0.0, 0.0, 0.6, 0.6, 0.6),
        (AgentKind.PEDESTRIAN, 0.0, 0.4, 0.6, 0.6, 0.5),
    )
    assert (stronger_twins(frame(*pair)) < 0).all()


def test_what_a_detector_reports_needs_repair() -> None:
    found = detected(street(), street_ego(), 1)
    assert "no identities" in (needs_repair(found) or "")
    assert "no ids" in (needs_repair(replace(found, ids=("",) * len(found))) or "")
    clean = detections_of(street())
    flicker = replace(
        clean,
        ids=tuple(f"{name}-{int(t / 0.4)}" for name, t in zip(clean.ids, clean.t, strict=True)),
    )
    assert "flicker" in (needs_repair(flicker) or "")


def test_tracks_need_no_repair() -> None:
    assert needs_repair(detections_of(street())) is None
    assert needs_repair(detections_of(street().only(()))) is None


@pytest.mark.slow
def test_clean_recordings_and_the_catalogue_need_no_repair(shared_data: Path) -> None:
    places = (
        "commonroad/*.xml",
        "argoverse2/*-*-*",
        "osi/*.mcap",
        "comma2k19/segment*",
        "py123d/*/logs/*/*",
    )
    paths = [path for place in places for path in sorted(shared_data.glob(place))]
    assert len(paths) > 60
    found = {path.name: needs_repair(detections_of(read_log(path).tracks)) for path in paths}
    found |= {
        name: needs_repair(detections_of(CATALOGUE[name].scenario().tracks)) for name in CATALOGUE
    }
    assert {name: why for name, why in found.items() if why} == {}


EGO = street_ego()


@cache
def seen() -> Detections:
    return detected(street(), EGO, 1)


@cache
def known() -> Tracked:
    return seen().tracked


def until(found: Detections, t: float) -> Detections:
    return replace(found.taken(found.t <= t), frames=found.frames[found.frames <= t])


@settings(max_examples=10)
@given(st.floats(0.0, 20.0), st.floats(0.0, 1.0))
def test_what_comes_later_changes_nothing(end: float, share: float) -> None:
    cut = until(seen(), end).tracked
    for t in (end, share * end):
        assert not differences(cut.at(t), known().at(t))


def test_the_order_within_a_frame_does_not_count() -> None:
    found = seen()
    mixed = np.random.default_rng(0).permutation(len(found))
    mixed = mixed[np.argsort(found.t[mixed], kind="stable")]
    names = ("t", "codes", "x", "y", "yaw", "length", "width", "vx", "vy", "score")
    columns = {name: getattr(found, name)[mixed] for name in names}
    other = replace(found, ids=tuple(found.ids[i] for i in mixed), **columns).tracked
    assert not any(differences(other.at(t), known().at(t)) for t in (1.0, 5.0, 12.3, 20.0))


def test_exact_boxes_are_followed() -> None:
    truth, found = street(), detections_of(street()).tracked
    for t in (3.0, 11.0, 19.0):
        agents, true = found.at(t), truth.truth(t)
        assert len(agents) == len(true)
        for i in range(len(true)):
            k = int(np.hypot(agents.x - true.x[i], agents.y - true.y[i]).argmin())
            assert np.hypot(agents.x[k] - true.x[i], agents.y[k] - true.y[i]) < 0.3
            assert np.hypot(agents.vx[k] - true.vx[i], agents.vy[k] - true.vy[i]) < 0.7
            assert agents.kinds[k] is true.kinds[i]
            assert abs(agents.length[k] - true.length[i]) < 1e-6
            turned = np.angle(np.exp(1j * (agents.yaw[k] - true.yaw[i])))
            assert abs(turned) < 0.3


def test_standing_road_users_stand() -> None:
    speeds = [known().at(t).speed for t in np.arange(5.0, 20.0, 0.5)]
    truth = street()
    parked = np.array(
        [[truth.x[truth.offsets[i]], truth.y[truth.offsets[i]]] for i in (3, 4, 5, 7)]
    )
    still = []
    for t, speed in zip(np.arange(5.0, 20.0, 0.5), speeds, strict=True):
        agents = known().at(t)
        near = (
            np.hypot(agents.x[:, None] - parked[:, 0], agents.y[:, None] - parked[:, 1]).min(axis=1)
            < 1.0
        )
        still += speed[near].tolist()
    assert len(still) > 40
    assert np.mean(np.array(still) == 0.0) > 0.9


def one_car(frames: np.ndarray, at: np.ndarray) -> Detections:
    """A car that drives 5 m/s, detected in the frames `at`."""
    t = frames[at]
    full = np.ones(len(t))
    return Detections(
        t=t,
        frames=frames,
        ids=("",) * len(t),
        codes=np.zeros(len(t), np.int64),
        x=5.0 * t,
        y=0.0 * t,
        yaw=0.0 * t,
        length=4.5 * full,
        width=1.8 * full,
        vx=np.nan * full,
        vy=np.nan * full,
        score=0.7 * full,
    )


def test_age_unseen_and_deviation_say_how_well_somebody_is_known() -> None:
    frames = np.round(0.1 * np.arange(60), 6)
    found = one_car(frames, np.arange(10, 40)).tracked
    assert len(found.at(1.1)) == 0  # two detections are no evidence
    young, old = found.at(1.2), found.at(3.9)
    assert (young.age[0], old.age[0]) == (pytest.approx(0.2), pytest.approx(2.9))
    assert young.velocity_sigma[0] > 2.0 * old.velocity_sigma[0]
    assert abs(old.vx[0] - 5.0) < 0.1
    lost = found.at(4.55)
    assert lost.unseen[0] == pytest.approx(0.65)
    assert lost.velocity_sigma[0] > old.velocity_sigma[0]
    assert lost.x[0] == pytest.approx(5.0 * 4.55, abs=0.2)
    assert len(found.at(4.8)) == 0
    there = one_car(frames, np.arange(40)).tracked.at(3.0)
    assert np.isnan(there.age[0])
    assert there.age.shape == there.unseen.shape == (1,)
    assert old.age[0] <= OLDEST_S


@pytest.mark.slow
@pytest.mark.parametrize("pattern", ["argoverse2/3b*", "argoverse2/7f*"])
def test_recordings_are_followed_as_a_detector_sees_them(shared_data: Path, pattern: str) -> None:
    scenario: Scenario = read_log(next(shared_data.glob(pattern)))
    around = sight(scenario.tracks, scenario.ego)
    true, other = true_points(scenario, around)
    boxes = detected(scenario.tracks, scenario.ego, 1)
    found = tracked_points(boxes.tracked, around.frames, true, other)
    numbers = score(true, found, near_ego(true, scenario.ego), reported(true, boxes))
    assert numbers.hota > 0.7
    assert numbers.idf1 > 0.82
    assert numbers.still < 0.25
    assert numbers.moving < 0.8
