"""S-T boundaries: swept boxes = brute force, margins and uncertain times only add, stops are
rows.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from roads import along_x
from scenes import CAR, Other, driving, path_of, reference, scene, standing

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.plan import DecisionKind
from replan.logs.shapes import overlap
from replan.logs.states import EgoState
from replan.planners.dp_qp.speed.qp import BARE, TOUCHING
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import STANDING_MPS, Occupancy, Scene, behind
from replan.planners.frenet.st_boundaries import (
    ONCOMING_RAD,
    StBoundaries,
    StGraphConfig,
    decide_speed,
    st_boundaries,
)

AS_PREDICTED = StGraphConfig(early_s=0.0, late_s=0.0)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)


def turning(radius: float, angle: float = 2.0, spacing: float = 0.4) -> Path:
    """Straight for 15 m, a turn by `angle` rad or 40 m long, straight again."""
    turn = min(radius * angle, 40.0)
    s = np.arange(0.0, 15.0 + turn + 30.0, spacing)
    return path_of(np.where((s > 15.0) & (s < 15.0 + turn), 1.0 / radius, 0.0), spacing)


STRAIGHT = path_of(np.zeros(301), 0.4)
ROAD = reference(along_x())


def blocks_of(
    path: Path, other: Other, config: StGraphConfig = AS_PREDICTED, *, passed: bool = False
) -> StBoundaries:
    names = frozenset({other.id} if passed else ())
    return st_boundaries(scene(ROAD, EGO, [other]), path, np.zeros(1, np.bool_), names, config)


def margin_of(other: Other) -> float:
    """The margin to a vehicle: an oncoming one has that of what is passed."""
    _, _, yaw, vx, vy = other.at(0.0)
    comes = abs(yaw) > ONCOMING_RAD and np.hypot(vx, vy) >= STANDING_MPS
    return AS_PREDICTED.passed_margin_m if comes else AS_PREDICTED.margin_m


def met(path: Path, other: Other, t: float, margin: float) -> FloatArray:
    """The stations of the path's points at which the ego's box, widened, overlaps the other's at
    time t.
    """
    x, y, yaw, _, _ = other.at(t)
    reach = CAR.axle_to_center
    found = [
        sigma
        for sigma, px, py, a in zip(path.sigma, path.x, path.y, path.yaw, strict=True)
        if overlap(
            px + reach * np.cos(a),
            py + reach * np.sin(a),
            a,
            CAR.length,
            CAR.width + 2.0 * margin,
            x,
            y,
            yaw,
            other.length,
            other.width,
        )
    ]
    return np.array(found)


@st.composite
def crossings(draw: st.DrawFn) -> tuple[Path, Other]:
    """A path with a turn of any tightness, and an agent who passes near it at some time."""
    path = turning(draw(st.sampled_from([4.0, 8.0, 15.0, 40.0, 1e6])), draw(st.floats(0.5, 3.0)))
    i = draw(st.integers(0, len(path.sigma) - 1))
    yaw, speed = draw(st.floats(-np.pi, np.pi)), draw(st.floats(0.0, 20.0))
    when = draw(st.floats(0.0, 8.0))
    vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
    x, y = (
        path.x[i] + draw(st.floats(-6.0, 6.0)) - when * vx,
        path.y[i] + draw(st.floats(-6.0, 6.0)) - when * vy,
    )
    length, width = draw(st.sampled_from([(4.5, 1.8), (0.5, 0.6), (14.0, 2.5)]))
    return path, Other(
        "it", lambda t: (x + vx * t, y + vy * t, yaw, vx, vy), length=length, width=width
    )


@given(crossings())
@settings(max_examples=40)
def test_blocked_intervals_are_where_the_boxes_overlap(crossing: tuple[Path, Other]) -> None:
    path, other = crossing
    blocks = blocks_of(path, other)
    for k, t in enumerate(0.1 * np.arange(81)):
        stations = met(path, other, float(t), margin_of(other))
        if not len(stations):
            assert not len(blocks) or np.isnan(blocks.lower[0, k])
            continue
        assert max(stations[0] - 0.4, 0.0) - 1e-9 <= blocks.lower[0, k] <= stations[0]
        assert stations[-1] <= blocks.upper[0, k] <= min(stations[-1] + 0.4, path.length) + 1e-9


@given(crossings(), st.floats(0.0, 0.5), st.floats(0.0, 0.5))
@settings(max_examples=30)
def test_a_wider_margin_blocks_more(
    crossing: tuple[Path, Other], first: float, more: float
) -> None:
    path, other = crossing
    narrow, wide = (
        blocks_of(path, other, StGraphConfig(margin_m=margin, early_s=0.0, late_s=0.0))
        for margin in (first, first + more)
    )
    assert len(narrow) <= len(wide)
    if len(narrow):
        blocked = np.isfinite(narrow.lower[0])
        assert (wide.lower[0, blocked] <= narrow.lower[0, blocked]).all()
        assert (wide.upper[0, blocked] >= narrow.upper[0, blocked]).all()


@given(crossings())
@settings(max_examples=30)
def test_uncertain_times_only_add_to_a_block(crossing: tuple[Path, Other]) -> None:
    sure, drawn = blocks_of(*crossing), blocks_of(*crossing, StGraphConfig())
    assert len(sure) == len(drawn)
    if len(sure):
        blocked = np.isfinite(sure.lower)
        np.testing.assert_array_equal(drawn.lower[blocked], sure.lower[blocked])
        extra = drawn.t[np.isfinite(drawn.lower[0]) & ~blocked[0]]
        times = sure.t[blocked[0]]
        assert ((extra > times[0] - 0.4 - 1e-9) & (extra < times[-1] + 0.6 + 1e-9)).all()


def test_margins_depend_on_the_agents_kind() -> None:
    beside = 0.5 * CAR.width + 0.9
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.29))) == 1
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.31))) == 0
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.11), passed=True)) == 0
    walker = Other("ped", lambda t: (30.0, beside + 0.59, 0.0, 0.0, 0.0), AgentKind.PEDESTRIAN)
    assert len(blocks_of(STRAIGHT, walker)) == 1
    # Braking gives an oncoming car no room
    for v, width, blocks in ((8.0, 0.29, 1), (-8.0, 0.11, 0), (-8.0, 0.09, 1)):
        assert len(blocks_of(STRAIGHT, driving("car", 30.0, beside + width, v))) == blocks


def test_the_speed_along_the_path_is_the_projection_of_the_velocity() -> None:
    assert blocks_of(STRAIGHT, driving("lead", 20.0, 0.0, 5.0)).speed[0] == pytest.approx(5.0)
    assert blocks_of(STRAIGHT, driving("oncoming", 70.0, 0.0, -5.0)).speed[0] == pytest.approx(-5.0)
    assert blocks_of(STRAIGHT, driving("crossing", 20.0, -6.0, 0.0, 3.0)).speed[0] == pytest.approx(
        0.0, abs=1e-9
    )


def test_a_following_agent_is_not_in_the_way() -> None:
    others = [
        driving("follower", -12.0, 0.0, 9.0),
        driving("beside, behind", -12.0, 3.5, 9.0),
        driving("lead", 12.0, 0.0, 5.0),
        driving("oncoming from behind", -12.0, 0.0, -1.0),
    ]
    for keeps_track, expected in (
        (True, [True, True, False, False]),
        (False, [True, False, False, False]),
    ):
        assert (
            behind(scene(reference(along_x(), 2), EGO, others), keeps_track=keeps_track).tolist()
            == expected
        )


def decided(other: Other, profile: FloatArray) -> DecisionKind:
    blocks = blocks_of(STRAIGHT, other)
    return decide_speed(
        blocks, scene(ROAD, EGO, [other]), np.interp(blocks.t, [0.0, 8.0], profile)
    )[0].kind


def test_each_boundary_has_a_decision_with_its_interval() -> None:
    slow, quick = np.array([0.0, 10.0]), np.array([0.0, 110.0])
    assert decided(standing("it", 40.0, 0.0), slow) is DecisionKind.STOP
    assert decided(driving("it", 20.0, 0.0, 5.0), slow) is DecisionKind.FOLLOW
    assert decided(driving("it", 40.0, -6.0, 0.0, 1.5), slow) is DecisionKind.YIELD
    assert decided(driving("it", 40.0, -9.0, 0.0, 1.5), quick) is DecisionKind.OVERTAKE


CROWDS = st.lists(
    st.tuples(
        st.floats(0.0, 70.0),
        st.floats(-9.0, 9.0),
        st.floats(-8.0, 8.0),
        st.floats(-4.0, 4.0),
        st.booleans(),
    ),
    max_size=6,
)


def crowd(rows: list[tuple[float, float, float, float, bool]]) -> Scene:
    """Cars and pedestrians at (x, y) with velocities."""
    kinds = (AgentKind.PEDESTRIAN, 0.5, 0.6), (AgentKind.CAR, 4.5, 1.8)
    return scene(
        ROAD,
        EGO,
        [
            replace(driving(f"it{i}", x, y, vx, vy, length=length, width=width), kind=kind)
            for i, (x, y, vx, vy, drives) in enumerate(rows)
            for kind, length, width in (kinds[drives],)
        ],
    )


@given(CROWDS, st.sampled_from([TOUCHING, BARE]), st.booleans())
@settings(max_examples=40)
def test_narrower_margins_meet_no_further_agents(
    rows: list[tuple[float, float, float, float, bool]], narrow: StGraphConfig, passed: bool
) -> None:
    """So that with narrower margins only those are swept again who were found: the same rows, bit
    by bit.
    """
    now, none = crowd(rows), np.zeros(len(rows), np.bool_)
    names = frozenset(now.frame.agents.ids[:2]) if passed else frozenset()
    found = st_boundaries(now, STRAIGHT, none, names, StGraphConfig())
    others = none.copy()
    others[np.setdiff1d(np.arange(len(rows)), found.agent)] = True
    every, again = (st_boundaries(now, STRAIGHT, skip, names, narrow) for skip in (none, others))
    for column in ("t", "agent", "lower", "upper", "speed", "probability"):
        np.testing.assert_array_equal(getattr(again, column), getattr(every, column))


STOPS = st.lists(st.tuples(st.floats(0.0, 80.0), st.sampled_from([2.05, 4.0, np.inf])), max_size=3)


@given(CROWDS, STOPS, st.floats(0.0, 12.0), st.floats(-1.5, 1.5))
@settings(max_examples=40)
def test_a_stop_is_a_row_that_must_not_be_passed_while_it_lasts(
    rows: list[tuple[float, float, float, float, bool]],
    stops: list[tuple[float, float]],
    v: float,
    a: float,
) -> None:
    agents = st_boundaries(
        crowd(rows), STRAIGHT, np.zeros(len(rows), np.bool_), frozenset(), AS_PREDICTED
    )
    whole = agents.with_stops(
        [Occupancy(f"stop {i}", s, until=until) for i, (s, until) in enumerate(stops)]
    )
    assert len(whole) == len(agents) + len(stops) and (whole.agent[len(agents) :] == -1).all()
    only = whole.only(np.arange(len(whole)) < len(agents))
    for column in ("agent", "lower", "upper", "speed", "probability"):
        np.testing.assert_array_equal(getattr(only, column), getattr(agents, column))
    t = whole.t
    s = np.maximum.accumulate(np.maximum(v * t + 0.5 * a * t * t, 0.0))
    passes = any((s[t < until] > stop).any() for stop, until in stops)
    assert whole.meets(t, s) == (agents.meets(t, s) or passes)
    assert whole.leave(t, s, 0.0) == (agents.leave(t, s, 0.0) and not passes)
    assert whole.first == min([agents.first, *(stop for stop, _ in stops)])
    np.testing.assert_array_equal(agents.with_stops(()).lower, agents.lower)
