"""The codec of the nouns: what is read is what was written, and the fields of messages on the wire
stay.
"""

import msgspec
import numpy as np
import pytest
from differences import differences
from hypothesis import given, strategies as st
from rich_scenario import rich_scenario

from replan.logs.codec import array_as_bytes, array_of, message_of, noun_of
from replan.logs.frame import PlannerContext
from replan.logs.lane_route import lane_route
from replan.logs.mcap import native, plan_messages
from replan.logs.plan import Corridor, GridCost
from replan.logs.road import Goal, Road
from replan.logs.rules import StopLine
from replan.logs.states import Trajectory
from replan.replay.planner_process import messages

FIELDS = {
    "Context": "road goal vehicle period start horizon origin route light_lanes start_ns",
    "Road": "lanes source drives_on_right default_speed_limit stop_lines crosswalks",
    "lanes": (
        "id left right successors left_neighbour right_neighbour left_opposite speed_limit "
        "drivable left_crossable right_crossable kind right_opposite yields_to group line"
    ),
    "stop_lines": "id lane points light must_stop towards",
    "crosswalks": "id polygon",
    "goal": "regions t v yaw alternatives way",
    "start": "t x y yaw v a kappa steer yaw_rate v_lat",
}
"""Of a context in messages of version 1, in their order."""


def context() -> PlannerContext:
    log = rich_scenario()
    start = log.ego.state(0)
    return PlannerContext(
        log.road,
        log.goal,
        log.vehicle,
        0.1,
        start,
        route=lane_route(log.road, start, log.goal, log.ego),
        light_lanes={7: (3, 4), 9: ()},
        start_ns=5,
    )


@pytest.mark.parametrize(
    ("message", "noun"), [(native.Road, Road), (messages.Road, Road), (native.Goal, Goal)]
)
def test_a_noun_comes_back_from_its_message(message: type, noun: type) -> None:
    log = rich_scenario()
    one = log.road if noun is Road else log.goal
    assert differences(one, noun_of(noun, message_of(message, one))) == []


def test_a_context_is_the_same_on_the_other_side_and_its_fields_stay() -> None:
    sent = messages.encode(messages.context_message(context()))
    again = messages.context_of(messages.decode(sent, messages.Context), print)
    for name in FIELDS["Context"].split():
        assert differences(getattr(context(), name), getattr(again, name)) == []
    plain = msgspec.msgpack.decode(sent, strict=False)
    assert list(plain) == FIELDS["Context"].split()
    assert plain["light_lanes"] == {7: [3, 4], 9: []}
    assert list(plain["road"]) == FIELDS["Road"].split()
    for name in ("lanes", "stop_lines", "crosswalks"):
        assert list(plain["road"][name][0]) == FIELDS[name].split()
    for name in ("goal", "start"):
        assert list(plain[name]) == FIELDS[name].split()
    assert plain["road"]["lanes"][0]["left"] == context().road.lanes[3].left.astype("<f8").tobytes()


@given(st.lists(st.floats(allow_nan=False, width=64), max_size=5))
def test_arrays_as_bytes_are_the_same_to_the_bit(values: list[float]) -> None:
    array = np.array(values)
    sent = msgspec.msgpack.decode(msgspec.msgpack.encode(array, enc_hook=array_as_bytes))
    assert array_of(np.ndarray, sent).tobytes() == array.tobytes()


def test_null_in_graphs_is_not_reached_and_free() -> None:
    grid = noun_of(GridCost, plan_messages.Grid([0.0], [0.0, 1.0], [[None, 2.0]], [1]))
    corridor = noun_of(Corridor, plan_messages.Corridor([0.0], [None], [None]))
    assert (grid.cost.tolist(), corridor.lower[0], corridor.upper[0]) == (
        [[np.inf, 2.0]],
        -np.inf,
        np.inf,
    )


def test_columns_that_do_not_fit_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="stop line 7 has 1 x_m and 2 y_m"):
        noun_of(StopLine, native.StopLine(7, 1, [8.0], [1.0, -1.0]))
    with pytest.raises(ValueError, match="x has shape"):
        noun_of(
            Trajectory,
            plan_messages.TrajectoryColumns([0.0], [], [0.0], [0.0], [0.0], [0.0], [0.0]),
        )
