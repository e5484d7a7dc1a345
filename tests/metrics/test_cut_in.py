"""Lane entries before a follower: the bound of UN R157, and who is not to blame."""

from dataclasses import replace

import numpy as np
import pytest
from drives import changing, drive, grid, moved, moved_ego, scenario, straight_road
from hypothesis import assume, given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import METRICS
from replan.metrics.collisions import ContactKind, contacts
from replan.metrics.cut_in import BRAKE_MPS2, REACT_S, entries, forced_braking
from replan.metrics.metric import Series

LENGTH, WIDTH = 4.5, 1.8


def follower(x: float, v: float, y: float = 3.5, name: str = "7") -> tuple:
    return (name, AgentKind.CAR, (LENGTH, WIDTH), lambda t: (x + v * t, y + 0.0 * t, 0.0 * t))


def log_of(ego: Trajectory, *agents: tuple, mapped: bool = True) -> Scenario:
    road = straight_road(lanes=2)
    return scenario(
        ego, agents, road=road if mapped else replace(road, source=RoadSource.DRIVEN_PATH)
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(-12.0, -7.0), st.floats(2.0, 8.0), st.booleans())
def test_a_hit_after_a_lane_entry_is_judged_by_the_bound_of_r157(
    x: float, faster: float, mapped: bool
) -> None:
    log = log_of(
        changing(grid(12.0, 0.05), 10.0, 1.0),
        follower(x - 2.0 * faster, 10.0 + faster),
        mapped=mapped,
    )
    found = entries(log.ego, log.tracks, log)
    assume(found)
    (entry,) = found
    rear = (
        float(np.interp(entry.t, log.ego.t, log.ego.x))
        + log.vehicle.axle_to_center
        - 0.5 * log.vehicle.length
    )
    gap = rear - (x - 2.0 * faster + (10.0 + faster) * entry.t + 0.5 * LENGTH)
    bound = faster**2 / (2.0 * BRAKE_MPS2) + faster * REACT_S
    assume(abs(gap - bound) > 0.5)
    hits = [
        contact for contact in contacts(drive(log), log) if contact.kind is not ContactKind.LATERAL
    ]
    for contact in hits:
        assert contact.at_fault == (gap < bound), (gap, bound)
        assert contact.kind is (ContactKind.CUT_IN if gap < bound else ContactKind.ACTIVE_REAR)


def cut_in(hz: float, mapped: bool) -> Scenario:
    """An entry 3 m before a follower that is 5 m/s faster."""
    return log_of(changing(grid(8.0, 1.0 / hz), 10.0, 1.0), follower(-15.4, 15.0), mapped=mapped)


@pytest.mark.parametrize("mapped", [True, False])
@pytest.mark.parametrize("hz", [5.0, 10.0, 20.0])
def test_a_close_cut_in_is_at_fault_at_any_rate_turned_and_mirrored(
    hz: float, mapped: bool
) -> None:
    log = cut_in(hz, mapped)
    for mirror in (False, True):
        world = moved(log, 1.0, 300.0, -40.0, mirror=mirror)
        (contact,) = contacts(
            drive(world, moved_ego(log.ego, 1.0, 300.0, -40.0, mirror=mirror)), world
        )
        assert (contact.kind, contact.at_fault) == (ContactKind.CUT_IN, True)


def hit(log: Scenario) -> tuple[ContactKind, bool]:
    found = contacts(drive(log), log)
    return found[0].kind, found[0].at_fault


@pytest.mark.parametrize("mapped", [True, False])
def test_an_ego_that_was_ahead_all_along_is_not_at_fault(mapped: bool) -> None:
    ego = changing(grid(8.0, 0.1), np.maximum(12.0 - 3.0 * grid(8.0, 0.1), 1.0), 1.0, to=0.0)
    log = log_of(ego, follower(-20.0, 12.0, y=0.0), mapped=mapped)
    assert hit(log) == (ContactKind.ACTIVE_REAR, False)
    assert not entries(log.ego, log.tracks, log)


@pytest.mark.parametrize("mapped", [True, False])
def test_one_behind_which_another_changes_lanes_is_not_at_fault(mapped: bool) -> None:
    def over(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u = np.clip((t - 1.0) / 2.5, 0.0, 1.0)
        x, y = -30.0 + 16.0 * t, 3.5 * (1.0 - u * u * (3.0 - 2.0 * u))
        return x, y, np.arctan2(np.gradient(y, t), 16.0)

    log = log_of(
        changing(grid(8.0, 0.1), 8.0, 1.0, to=0.0),
        ("7", AgentKind.CAR, (LENGTH, WIDTH), over),
        mapped=mapped,
    )
    assert hit(log) == (ContactKind.ACTIVE_REAR, False)


def test_an_entry_long_before_a_hit_excuses_the_ego() -> None:
    t = grid(14.0, 0.1)
    ego = changing(t, np.where(t < 8.0, 15.0, np.maximum(15.0 - 5.0 * (t - 8.0), 1.0)), 1.0)
    assert hit(log_of(ego, follower(-15.0, 15.0))) == (ContactKind.ACTIVE_REAR, False)


def test_a_cut_in_that_brakes_at_once_is_at_fault() -> None:
    t = grid(8.0, 0.1)
    ego = changing(t, np.where(t < 2.0, 15.0, np.maximum(15.0 - 7.0 * (t - 2.0), 1.0)), 1.0)
    assert hit(log_of(ego, follower(-8.0, 15.0))) == (ContactKind.CUT_IN, True)


def test_forced_braking_is_the_least_that_the_follower_needs() -> None:
    ego = changing(grid(12.0, 0.05), 10.0, 1.0)
    log = log_of(ego, follower(-16.0, 15.0))
    found = forced_braking.measure(drive(log), log)
    assert isinstance(found, Series)
    (k,) = np.flatnonzero(found.known)
    t = float(found.t[k])
    rear = float(np.interp(t, ego.t, ego.x)) + log.vehicle.axle_to_center - 0.5 * log.vehicle.length
    gap = rear - (-16.0 + 15.0 * t + 0.5 * LENGTH) - 5.0 * REACT_S
    assert found.value[k] == pytest.approx(5.0**2 / (2.0 * gap), rel=0.05)
    assert found.labels[k] == "car 7: the ego entered its path"
    alone = log_of(changing(grid(12.0, 0.05), 10.0, 1.0, to=0.0), follower(-16.0, 15.0))
    gap_kept = METRICS["gap_kept"].measured(drive(alone), alone)["gap_kept"]
    assert isinstance(gap_kept, Series)
    assert gap_kept.missing == "no other road user beside or ahead of an ego that drives"
    assert not forced_braking.measure(drive(alone), alone).known.any()  # type: ignore[union-attr]


@given(st.floats(-2.0, 5.0), st.floats(0.0, 3.0))
def test_braking_of_a_follower_in_the_log_is_not_forced(logged: float, more: float) -> None:
    def behind(x: float, decel: float) -> tuple:
        def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            u = np.clip(t - 4.0, 0.0, 1.0)
            return (
                x + 9.0 * t - decel * (0.5 * u**2 + u * np.maximum(t - 5.0, 0.0)),
                3.5 + 0.0 * t,
                0.0 * t,
            )

        return ("7", AgentKind.CAR, (LENGTH, WIDTH), motion)

    ego = changing(grid(8.0, 0.05), 10.0, 1.0)
    log, later = (
        log_of(ego, behind(-20.0, logged)),
        log_of(ego, behind(-21.0, max(logged, 0.0) + more)),
    )
    found = forced_braking.measure(drive(later), log)
    assert isinstance(found, Series)
    assert found.value[found.known] == pytest.approx([more], abs=0.1)
