"""Who came to the path and stands beside it is passed at a speed from which the ego could stop for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from worlds import CAR, Other, along_x, limit_of, path_of, reference, scene, view

from logs import AgentKind, EgoState
from planners.dp_qp.speed.caps import (
    LEAST_MPS,
    REACTION_S,
    CautionConfig,
    LoweredLimit,
    came_to_path,
    hesitation_caps,
)

CAUTION = CautionConfig()
DECEL, SIZE = 6.0, 0.5
S = np.arange(0.0, 120.0, 0.5)
STRAIGHT = path_of(np.zeros(len(S)), 0.5)
LIMIT = np.full(len(S), 15.0)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = reference(along_x())
Came = Mapping[str, float]


def walker(x: float, y: float, vy: float, kind: AgentKind = AgentKind.PEDESTRIAN) -> Other:
    return Other("w", lambda t: (x, y + vy * t, np.pi / 2.0, 0.0, vy), kind, SIZE, SIZE)


def looked(who: Other, t: float = 0.0, came: Came = MappingProxyType({})) -> tuple[LoweredLimit, Came]:
    """The limit, and who came to the path when."""
    found = view(scene(ROAD, EGO, [who], t=t), STRAIGHT, hard_mps2=DECEL)
    after = came_to_path(found.scene, found.taken, came, CAUTION.hesitates_s)
    return limit_of(replace(found, came=after), hesitation_caps), after


def after(
    x: float, d: float, t: float, kind: AgentKind = AgentKind.PEDESTRIAN, *, remembers: bool = True
) -> LoweredLimit:
    """The limit `t` s after they walked towards the path, when they stand `d` m beside the ego's side."""
    y = -(0.5 * CAR.width + d + 0.5 * SIZE)
    _, came = looked(walker(x, y - 0.5, 1.2, kind))
    return looked(walker(x, y, 0.0, kind), t, came if remembers else {})[0]


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 40.0))
def test_the_ego_passes_first_or_could_stop(x: float, d: float, gap: float) -> None:
    limit = after(x, d, 1.0).v
    v = float(limit.min())
    if v >= LIMIT[0] or v <= LEAST_MPS:
        return
    assert gap / v <= d / CAUTION.walk_mps + 1e-9 or v * REACTION_S + v * v / (2.0 * DECEL) <= gap + 0.5 * (S[1] - S[0])
    lowered = S[limit < LIMIT]
    assert np.abs(lowered + CAR.axle_to_front - x).max() <= 1.5


@given(st.floats(8.0, 60.0), st.floats(0.7, 3.0), st.floats(0.0, 2.0))
def test_who_stands_farther_away_lowers_the_speed_less(x: float, d: float, more: float) -> None:
    near, far = (after(x, beside, 1.0).v.min() for beside in (d, d + more))
    assert far >= near


def test_only_who_came_a_moment_ago_and_on_foot_is_meant() -> None:
    assert after(30.0, 0.8, 1.0).v.min() < 10.0
    for other in (
        after(30.0, 0.8, CAUTION.hesitates_s + 0.2),
        after(30.0, 0.8, 1.0, AgentKind.CAR),
        after(30.0, 0.8, 1.0, remembers=False),
    ):
        np.testing.assert_array_equal(other.v, LIMIT)


def test_it_says_why_and_the_limit_is_kept_exactly() -> None:
    found = after(30.0, 0.8, 0.1)
    (why,) = found.decisions
    assert why.agent == "w" and "stands 0.8 m beside it" in why.reason
    np.testing.assert_array_equal(found.is_bound, found.v < LIMIT)
    assert f"at {found.v.min():.1f} m/s" in why.reason
