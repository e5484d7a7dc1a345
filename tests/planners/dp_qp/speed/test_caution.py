"""Speed beside hidden ground, and beside who came to the path and stands: who steps out is
avoided.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import pi
from types import MappingProxyType

import numpy as np
import pytest
from cap_views import limit_of, view
from hypothesis import given, strategies as st
from roads import along_x
from scenes import CAR, Other, agents, path_of, reference, scene

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Visibility
from replan.logs.plan import Decision
from replan.logs.states import EgoState
from replan.planners.dp_qp.speed.caps import (
    LEAST_MPS,
    PERSON_M,
    REACTION_S,
    CautionConfig,
    Hidden,
    LoweredLimit,
    avoidable_speed,
    came_to_path,
    hesitation_caps,
    hidden_beside,
    hidden_ground_caps,
)
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

CAUTION = CautionConfig()
WALK_MPS, DECEL, SIZE = CAUTION.walk_mps, 6.0, 0.5
S = np.arange(0.0, 120.0, 0.5)
STRAIGHT, LIMIT = path_of(np.zeros(len(S)), 0.5), np.full(len(S), 15.0)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = reference(along_x())


def seen(*shadows: list[tuple[float, float]], reach: float = 100.0) -> Visibility:
    return Visibility(
        CAR.axle_to_center, 0.0, 0.0, reach, 2.0 * pi, np.array(shadows).reshape(-1, 4, 2)
    )


def strip(x0: float, x1: float, y0: float, y1: float) -> list[tuple[float, float]]:
    """A hidden rectangle, near side first as the sensor gives it."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def limit_at(
    visibility: Visibility | None, *others: Other
) -> tuple[np.ndarray, tuple[Decision, ...]]:
    found = limit_of(
        view(scene(ROAD, EGO, others, seen=visibility), STRAIGHT, hard_mps2=DECEL),
        hidden_ground_caps,
    )
    return found.v, found.decisions


@given(st.floats(0.05, 3.4), st.floats(0.0, 60.0), st.floats(0.0, 1.0))
def test_a_pedestrian_who_steps_out_is_passed_or_stopped_for(
    d: float, x: float, share: float
) -> None:
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
    return hidden_beside(
        STRAIGHT, seen(strip(20.0, 40.0, y, y + 5.0)), agents(()), CAR, 60.0, WALK_MPS
    )


def speed_beside(hidden: Hidden) -> float:
    return avoidable_speed(hidden.d - PERSON_M, WALK_MPS, DECEL)


@given(st.floats(0.1, 3.0), st.floats(0.0, 3.0))
def test_ground_further_beside_lowers_the_speed_less(near: float, more: float) -> None:
    first, second = (
        [speed_beside(one) for one in hidden_beside_strip(d)] for d in (near, near + more)
    )
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


def test_ground_behind_moving_cars_and_inside_boxes_hides_no_pedestrian() -> None:
    y = 0.5 * CAR.width + 1.0
    shadow = seen(strip(30.0, 40.0, y, y + 4.0))
    parked = Other("it", lambda t: (30.0, y + 2.0, 0.0, 0.0, 0.0), length=4.5, width=4.0)
    driving = Other("it", lambda t: (30.0, y + 2.0, 0.0, 12.0, 0.0), length=4.5, width=4.0)
    assert limit_at(shadow, parked)[1]
    assert not limit_at(shadow, driving)[1]
    inside = Other("it", lambda t: (35.0, y + 2.0, 0.0, 0.0, 0.0), length=11.0, width=5.0)
    assert not limit_at(shadow, inside)[1]


def test_ground_beyond_the_first_agent_in_the_way_is_ignored() -> None:
    y = 0.5 * CAR.width + 1.0
    shadow, lead = (
        seen(strip(30.0, 40.0, y, y + 4.0)),
        Other("lead", lambda t: (25.0, 0.0, 0.0, 0.0, 0.0)),
    )
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


Came = Mapping[str, float]


def walker(x: float, y: float, vy: float, kind: AgentKind = AgentKind.PEDESTRIAN) -> Other:
    return Other("w", lambda t: (x, y + vy * t, np.pi / 2.0, 0.0, vy), kind, SIZE, SIZE)


def looked(
    who: Other, t: float = 0.0, came: Came = MappingProxyType({})
) -> tuple[LoweredLimit, Came]:
    """The limit, and who came to the path when."""
    found = view(scene(ROAD, EGO, [who], t=t), STRAIGHT, hard_mps2=DECEL)
    after = came_to_path(found.scene, found.taken, came, CAUTION.hesitates_s)
    return limit_of(replace(found, came=after), hesitation_caps), after


def after(
    x: float, d: float, t: float, kind: AgentKind = AgentKind.PEDESTRIAN, *, remembers: bool = True
) -> LoweredLimit:
    """The limit `t` s after they walked towards the path, when they stand `d` m beside the ego's
    side.
    """
    y = -(0.5 * CAR.width + d + 0.5 * SIZE)
    _, came = looked(walker(x, y - 0.5, 1.2, kind))
    return looked(walker(x, y, 0.0, kind), t, came if remembers else {})[0]


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 40.0))
def test_the_ego_passes_first_or_could_stop(x: float, d: float, gap: float) -> None:
    limit = after(x, d, 1.0).v
    v = float(limit.min())
    if v >= LIMIT[0] or v <= LEAST_MPS:
        return
    assert gap / v <= d / WALK_MPS + 1e-9 or v * REACTION_S + v * v / (2.0 * DECEL) <= gap + 0.5 * (
        S[1] - S[0]
    )
    lowered = S[limit < LIMIT]
    assert np.abs(lowered + CAR.axle_to_front - x).max() <= 1.5


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 2.0))
def test_a_pedestrian_farther_away_lowers_the_speed_less(x: float, d: float, more: float) -> None:
    near, far = (after(x, beside, 1.0).v.min() for beside in (d, d + more))
    assert far >= near


def test_only_pedestrians_who_came_a_moment_ago_lower_the_speed() -> None:
    assert after(30.0, 0.8, 1.0).v.min() < 10.0
    for other in (
        after(30.0, 0.8, CAUTION.hesitates_s + 0.2),
        after(30.0, 0.8, 1.0, AgentKind.CAR),
        after(30.0, 0.8, 1.0, remembers=False),
    ):
        np.testing.assert_array_equal(other.v, LIMIT)
