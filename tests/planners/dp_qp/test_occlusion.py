"""Speed beside hidden ground: who steps out of it is avoided, wherever the ego is then."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import CAR, Other, agents, along_x, limit_of, path_of, reference, scene, view

from logs import Decision, EgoState, Visibility
from logs.catalogue import CATALOGUE
from planners.dp_qp.speed.caps import (
    LEAST_MPS,
    PERSON_M,
    REACTION_S,
    CautionConfig,
    Hidden,
    avoidable_speed,
    hidden_beside,
    hidden_ground_caps,
    stopping_speed,
)
from replay.config import LoopConfig
from replay.drive import Drive
from replay.loop.closed_loop import run_closed_loop

WALK_MPS = CautionConfig().walk_mps
DECEL = 6.0
S = np.arange(0.0, 120.0, 0.5)
STRAIGHT = path_of(np.zeros(len(S)), 0.5)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = reference(along_x())


def seen(*shadows: list[tuple[float, float]], reach: float = 100.0) -> Visibility:
    return Visibility(CAR.axle_to_center, 0.0, 0.0, reach, 2.0 * pi, np.array(shadows).reshape(-1, 4, 2))


def strip(x0: float, x1: float, y0: float, y1: float) -> list[tuple[float, float]]:
    """A hidden rectangle, near side first as the sensor gives it."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def limit_at(visibility: Visibility | None, *others: Other) -> tuple[np.ndarray, tuple[Decision, ...]]:
    found = limit_of(view(scene(ROAD, EGO, others, seen=visibility), STRAIGHT, hard_mps2=DECEL), hidden_ground_caps)
    return found.v, found.decisions


@given(st.floats(0.05, 3.4), st.floats(0.0, 60.0), st.floats(0.0, 1.0))
def test_who_steps_out_is_passed_or_stopped_for(d: float, x: float, share: float) -> None:
    """At no place of the front does the ego, not faster than (5), hit them."""
    (hidden,) = [one for one in hidden_beside_strip(d) if one.s > 0.0][:1]
    fastest = speed_beside(hidden)
    v = share * fastest
    if fastest <= LEAST_MPS or v == 0.0:
        return  # it creeps past
    passes = x / v <= (hidden.d - PERSON_M) / WALK_MPS
    stops = v * REACTION_S + v * v / (2.0 * DECEL) <= x
    assert passes or stops


def hidden_beside_strip(d: float) -> list[Hidden]:
    y = 0.5 * CAR.width + d
    return hidden_beside(STRAIGHT, seen(strip(20.0, 40.0, y, y + 5.0)), agents(()), CAR, 60.0, WALK_MPS)


def speed_beside(hidden: Hidden) -> float:
    return avoidable_speed(hidden.d - PERSON_M, WALK_MPS, DECEL)


@given(st.floats(0.1, 3.0), st.floats(0.0, 3.0))
def test_ground_further_beside_lowers_the_speed_less(near: float, more: float) -> None:
    first, second = ([speed_beside(one) for one in hidden_beside_strip(d)] for d in (near, near + more))
    assert all(a <= b for a, b in zip(first, second, strict=False))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_limit_falls_before_the_ground_and_nowhere_else(side: float) -> None:
    y = 0.5 * CAR.width + 1.2
    corners = strip(30.0, 33.0, y, y + 4.0)
    out, (decision,) = limit_at(seen([(a, side * b) for a, b in corners]))
    low = S[out < 15.0]
    assert low.min() == pytest.approx(30.0 - CAR.axle_to_front, abs=1.1)
    assert low.max() == pytest.approx(33.0 - CAR.axle_to_front, abs=1.6)
    assert decision.agent == "hidden ground" and "beside" in decision.reason


def test_without_a_sensor_nothing_changes() -> None:
    out, decisions = limit_at(None)
    assert not decisions
    np.testing.assert_array_equal(out, 15.0)


def test_the_range_limits_the_speed() -> None:
    out, _ = limit_at(seen(reach=20.0))
    v = out[0]
    assert v == pytest.approx(stopping_speed(20.0, DECEL))
    assert v * REACTION_S + v * v / (2.0 * DECEL) == pytest.approx(20.0)


def test_no_one_walks_out_of_the_wake_of_a_moving_car_or_out_of_a_box() -> None:
    y = 0.5 * CAR.width + 1.0
    shadow = seen(strip(30.0, 40.0, y, y + 4.0))
    parked = Other("it", lambda t: (30.0, y + 2.0, 0.0, 0.0, 0.0), length=4.5, width=4.0)
    driving = Other("it", lambda t: (30.0, y + 2.0, 0.0, 12.0, 0.0), length=4.5, width=4.0)
    assert limit_at(shadow, parked)[1]
    assert not limit_at(shadow, driving)[1]
    inside = Other("it", lambda t: (35.0, y + 2.0, 0.0, 0.0, 0.0), length=11.0, width=5.0)
    assert not limit_at(shadow, inside)[1]


def test_what_is_beyond_the_first_in_the_way_is_theirs_to_see() -> None:
    y = 0.5 * CAR.width + 1.0
    shadow, lead = seen(strip(30.0, 40.0, y, y + 4.0)), Other("lead", lambda t: (25.0, 0.0, 0.0, 0.0, 0.0))
    assert limit_at(shadow)[1] and not limit_at(shadow, lead)[1]


def drive(perception: str) -> Drive:
    scenario = CATALOGUE["paper/static_obstacles"].scenario()
    return run_closed_loop(scenario, "dp_qp", config=LoopConfig(perception=perception))


@pytest.mark.slow
def test_a_drive_past_parked_cars_is_slower_with_a_sensor_and_says_why() -> None:
    known, sensed = drive("ground_truth"), drive("sensor")
    assert sensed.trace.ego.v.min() < known.trace.ego.v.min() - 2.0
    reasons = [
        decision.reason
        for planned in sensed.trace.frames
        for decision in planned.plan.internals
        if isinstance(decision, Decision) and decision.agent == "hidden ground"
    ]
    assert reasons and "could be avoided at" in reasons[0]
    assert sensed.trace.end.value == "goal reached"
