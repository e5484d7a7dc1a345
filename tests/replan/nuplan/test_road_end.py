"""The road beyond its end, as planners of nuPlan get it."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from replan.nuplan.replan_nuplan.nuplan_channel import points
from replan.nuplan.replan_nuplan.road_end import BEYOND_M, with_road_beyond


def row(name: int, y: float, turn: float = 0.0, **more: Any) -> dict[str, Any]:
    """A lane of `hello`, 20 m long and 3 m wide, in a direction, rad."""
    ahead, aside = np.array([cos(turn), sin(turn)]), np.array([-sin(turn), cos(turn)])
    line = np.outer([0.0, 10.0, 20.0], ahead) + y * aside
    sides = {"left": line + 1.5 * aside, "right": line - 1.5 * aside}
    columns = {side: data.astype("<f8").tobytes() for side, data in sides.items()}
    lane = {"id": name, "successors": [], "left_neighbour": None, "right_neighbour": None}
    words = {"group": 1, "kind": "urban", "drivable": True, "speed_limit": 13.9, "line": b""}
    return lane | words | columns | more


def context(*rows: dict[str, Any], route: tuple[int, ...] = (1,)) -> dict[str, Any]:
    road = {"lanes": list(rows), "assumed_limits": [1]}
    return {"road": road, "route": {"lanes": list(route)}, "goal": None}


@given(turn=st.floats(-3.0, 3.0))
def test_lanes_of_the_last_group_go_on_straight(turn: float) -> None:
    given_lanes = context(row(1, 3.0, turn, right_neighbour=2), row(2, 0.0, turn, left_neighbour=1))
    longer = with_road_beyond(given_lanes)
    first, second, third, fourth = longer["road"]["lanes"]
    assert (first["successors"], second["successors"]) == ([3], [4])
    assert (third["right_neighbour"], fourth["left_neighbour"]) == (4, 3)
    assert third["group"] == fourth["group"] != first["group"]
    assert longer["route"]["lanes"] == [1, 3]
    assert set(longer["road"]["assumed_limits"]) == {1, 3}
    for before, after in ((first, third), (second, fourth)):
        for side in ("left", "right"):
            begin, end = points(after[side])
            assert begin == pytest.approx(points(before[side])[-1])
            assert end - begin == pytest.approx(BEYOND_M * np.array([cos(turn), sin(turn)]))


def test_a_lane_that_leads_on_is_left_as_it_is() -> None:
    leads_on = context(row(1, 0.0, successors=[2]), row(2, 0.0, group=2))
    assert with_road_beyond(leads_on) is leads_on
    elsewhere = with_road_beyond(
        context(row(1, 3.0), row(2, 0.0, successors=[3]), row(3, 0.0, group=2))
    )
    assert [lane["successors"] for lane in elsewhere["road"]["lanes"]] == [[4], [3], [], []]


def test_a_route_that_is_empty_is_left_as_it_is() -> None:
    no_route = context(row(1, 0.0), route=())
    assert with_road_beyond(no_route) is no_route


def test_the_given_context_is_not_changed() -> None:
    before = context(row(1, 0.0))
    with_road_beyond(before)
    assert before == context(row(1, 0.0))
