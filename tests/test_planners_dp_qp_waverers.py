"""Who came to the path and stands beside it is passed at a speed from which the ego could stop for him."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from worlds import CAR, Other, frame

from logs import AgentKind, Decision, EgoState, Frame
from planners.dp_qp.scene.hesitant_pedestrians import WAVERS_S, HesitantPedestrians
from planners.dp_qp.scene.occlusion import LEAST_MPS, REACTION_S, WALK_MPS
from planners.frenet.path import Path
from planners.frenet.st_boundaries import StGraphConfig, st_boundaries

DECEL, SIZE = 6.0, 0.5
S = np.arange(0.0, 120.0, 0.5)
STRAIGHT = Path(S, S, np.zeros(len(S)), np.zeros(len(S)), np.zeros(len(S)), S)
ROAD = np.full(len(S), 15.0)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0)


def walker(x: float, y: float, vy: float, kind: AgentKind = AgentKind.PEDESTRIAN) -> Other:
    return Other("w", lambda t: (x, y + vy * t, np.pi / 2.0, 0.0, vy), kind, SIZE, SIZE)


def looked(who: HesitantPedestrians, found: Frame, *, fresh: bool = False) -> tuple[np.ndarray, tuple[Decision, ...]]:
    blocks = st_boundaries(
        STRAIGHT, found, CAR, np.zeros(len(found.agents), bool), frozenset(), StGraphConfig(margin_m=0.3)
    )
    return who.limit(STRAIGHT, ROAD, found, CAR, blocks, DECEL, fresh=fresh)


def after(who: HesitantPedestrians, x: float, d: float, t: float, kind: AgentKind = AgentKind.PEDESTRIAN) -> np.ndarray:
    """The limit `t` s after he walked towards the path, when he stands `d` m beside the ego's side."""
    y = -(0.5 * CAR.width + d + 0.5 * SIZE)
    looked(who, frame(EGO, [walker(x, y - 0.5, 1.2, kind)]), fresh=True)
    return looked(who, replace(frame(EGO, [walker(x, y, 0.0, kind)]), t=t))[0]


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 40.0))
def test_the_ego_passes_first_or_could_stop(x: float, d: float, gap: float) -> None:
    limit = after(HesitantPedestrians(), x, d, 1.0)
    v = float(limit.min())
    if v >= ROAD[0] or v <= LEAST_MPS:
        return
    assert gap / v <= d / WALK_MPS + 1e-9 or v * REACTION_S + v * v / (2.0 * DECEL) <= gap + 0.5 * (S[1] - S[0])
    lowered = S[limit < ROAD]
    assert np.abs(lowered + CAR.axle_to_front - x).max() <= 1.5


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 2.0))
def test_who_stands_farther_away_lowers_the_speed_less(x: float, d: float, more: float) -> None:
    near, far = (after(HesitantPedestrians(), x, beside, 1.0).min() for beside in (d, d + more))
    assert far >= near


def test_only_who_came_a_moment_ago_and_on_foot_is_meant() -> None:
    who = HesitantPedestrians()
    assert after(who, 30.0, 0.8, 1.0).min() < 10.0
    np.testing.assert_array_equal(after(who, 30.0, 0.8, WAVERS_S + 0.2), ROAD)
    np.testing.assert_array_equal(after(who, 30.0, 0.8, 1.0, AgentKind.CAR), ROAD)
    standing = frame(EGO, [walker(30.0, -2.0, 0.0)])
    np.testing.assert_array_equal(looked(HesitantPedestrians(), standing)[0], ROAD)
    after(who, 30.0, 0.8, 1.0)
    np.testing.assert_array_equal(looked(who, standing, fresh=True)[0], ROAD)


def test_it_says_why() -> None:
    who, y = HesitantPedestrians(), -(0.5 * CAR.width + 0.8 + 0.5 * SIZE)
    after(who, 30.0, 0.8, 1.0)
    (why,) = looked(who, replace(frame(EGO, [walker(30.0, y, 0.0)]), t=1.1))[1]
    assert why.agent == "w" and "stands 0.8 m beside it" in why.reason
