"""What could be known by t: no future, the same twice, births after evidence, velocities with their deviation."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from crowd import street, street_ego
from hypothesis import given, settings, strategies as st
from mcap_cases import differences
from track_score import near_ego, reported, score, tracked_points, true_points

from logs import Scenario
from logs.agents import OLDEST_S
from logs.catalogue.detector import detected, sight
from logs.readers import read_log
from logs.repair.detections import Detections
from logs.repair.offline import detections_of
from logs.repair.tracker import Tracked

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
    parked = np.array([[truth.x[truth.offsets[i]], truth.y[truth.offsets[i]]] for i in (3, 4, 5, 7)])
    still = []
    for t, speed in zip(np.arange(5.0, 20.0, 0.5), speeds, strict=True):
        agents = known().at(t)
        near = np.hypot(agents.x[:, None] - parked[:, 0], agents.y[:, None] - parked[:, 1]).min(axis=1) < 1.0
        still += speed[near].tolist()
    assert len(still) > 40
    assert np.mean(np.array(still) == 0.0) > 0.9


def one_car(frames: np.ndarray, at: np.ndarray) -> Detections:
    """A car that drives 5 m/s, detected in the frames `at`."""
    t = frames[at]
    full = np.ones(len(t))
    return Detections(
        t=t, frames=frames, ids=("",) * len(t), codes=np.zeros(len(t), np.int64), x=5.0 * t, y=0.0 * t, yaw=0.0 * t,
        length=4.5 * full, width=1.8 * full, vx=np.nan * full, vy=np.nan * full, score=0.7 * full,
    )  # fmt: skip


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
