"""CommonRoad traffic rules: lights against independent arithmetic, who goes first, stop lines,
recorded files.
"""

from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
from commonroad_files import lanelet, points, problem, state, straight, written
from hypothesis import HealthCheck, given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.readers.commonroad.document import COLOURS
from replan.logs.readers.commonroad.lanelet_priority import meet
from replan.logs.rules import Colour, StopLine
from replan.logs.scenario import Scenario

LEFT, STRAIGHT, RIGHT = 1, 2, 3
few = settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def light(name: int, cycle: list[tuple[str, int]], offset: int = 0, more: str = "") -> str:
    parts = "".join(
        f"<cycleElement><duration>{n}</duration><color>{c}</color></cycleElement>" for c, n in cycle
    )
    return (
        "<trafficLight "
        f'id="{name}"><cycle>{parts}<timeOffset>{offset}</timeOffset></cycle>{more}</trafficLight>'
    )


def sign(name: int, kind: str) -> str:
    element = f"<trafficSignElement><trafficSignID>{kind}</trafficSignID></trafficSignElement>"
    return f'<trafficSign id="{name}">{element}</trafficSign>'


def see(light: int = 0, sign: int = 0) -> str:
    refs = (("trafficLightRef", light), ("trafficSignRef", sign))
    return "".join(f'<{tag} ref="{i}"/>' for tag, i in refs if i)


def strip(name: int, line: np.ndarray, inner: str = "", *, width: float = 3.0) -> str:
    along = np.gradient(line, axis=0)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    sides = (points(*map(tuple, line + sign * 0.5 * width * normal)) for sign in (1.0, -1.0))
    return lanelet(name, *sides, inner)


def axes(turn: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors from the middle to a side, and to the left of that."""
    angle = turn + 0.5 * pi * side
    return np.array([cos(angle), sin(angle)]), np.array([-sin(angle), cos(angle)])


def crossing(
    turn: float = 0.0,
    shown: dict[int, str] | None = None,
    *,
    sides: tuple[int, ...] = (0, 1, 2, 3),
    pieces: int = 1,
) -> tuple[str, ...]:
    """Roads of one lane each way that meet; whoever comes from side k has side k + 1 on his right.

    Lanelets: 10 + k leads in from side k, 20 + k leads out to it; the inner one is 100 + 10 k + (1
    left, 2 straight, 3 right), in `pieces` pieces, of which the later ones are 1000, 2000, ...
    more; `shown` is put into lanelet 10 + k.
    """
    parts, incomings = [], []
    words = {LEFT: "Left", STRAIGHT: "Straight", RIGHT: "Right"}
    for k in sides:
        out, left = axes(turn, k)
        exits = {turned: (k + 4 - turned) % 4 for turned in words if (k + 4 - turned) % 4 in sides}
        follow = "".join(f'<successor ref="{100 + 10 * k + turned}"/>' for turned in exits)
        incoming = np.array([60.0 * out + 1.75 * left, 12.0 * out + 1.75 * left])
        parts.append(strip(10 + k, incoming, follow + (shown or {}).get(k, "")))
        parts.append(strip(20 + k, np.array([12.0 * out - 1.75 * left, 60.0 * out - 1.75 * left])))
        for turned, side in exits.items():
            there, its_left = axes(turn, side)
            u = np.linspace(0.0, 1.0, 12 * pieces + 1)[:, None]
            end = 12.0 * there - 1.75 * its_left
            curve = (1 - u) ** 3 * incoming[1] + 3 * u * (1 - u) ** 2 * (incoming[1] - 8.0 * out)
            curve = curve + 3 * u**2 * (1 - u) * (end - 8.0 * there) + u**3 * end
            for piece in range(pieces):
                name = 100 + 10 * k + turned + 1000 * piece
                after = name + 1000 if piece < pieces - 1 else 20 + side
                parts.append(
                    strip(name, curve[12 * piece : 12 * piece + 13], f'<successor ref="{after}"/>')
                )
        lists = "".join(
            f'<successors{words[turned]} ref="{100 + 10 * k + turned}"/>' for turned in exits
        )
        incomings.append(
            f'<incoming id="{900 + k}"><incomingLanelet ref="{10 + k}"/>{lists}</incoming>'
        )
    parts.append(f'<intersection id="990">{"".join(incomings)}</intersection>')
    out, left = axes(turn, 0)
    x, y = (40.0 * out + 1.75 * left).tolist()
    time = "<time><intervalStart>20</intervalStart><intervalEnd>30</intervalEnd></time>"
    start = state(0, x, y, turn + pi, 5.0, tag="initialState")
    return (
        *parts,
        f'<planningProblem id="5">{start}<goalState>{time}</goalState></planningProblem>',
    )


def waits(scenario: Scenario) -> dict[int, set[int]]:
    return {i: set(lane.yields_to) for i, lane in scenario.road.lanes.items() if lane.yields_to}


def inner(k: int, *turned: int) -> set[int]:
    return {100 + 10 * (k % 4) + t for t in turned}


@few
@given(
    cycle=st.lists(
        st.tuples(st.sampled_from(sorted(COLOURS)), st.integers(1, 40)), min_size=1, max_size=6
    ),
    offset=st.integers(-500, 500),
    first=st.integers(0, 300),
)
def test_a_light_shows_its_cycle(
    tmp_path: Path, cycle: list[tuple[str, int]], offset: int, first: int
) -> None:
    """Against the rule in the format's own words: the cycle is written out step by step, and begins
    at its offset.
    """
    written_out = [colour for colour, steps in cycle for _ in range(steps)]
    file = written(
        tmp_path,
        straight(1, inner=see(7)),
        light(7, cycle, offset),
        problem(5, 0.0, 0.0, 5.0, step=first),
    )
    (shown,) = read_commonroad(file).lights
    for step in range(first, 31):
        assert (
            shown.at(0.1 * (step - first))
            is COLOURS[written_out[(step - offset) % len(written_out)]]
        ), step


@few
@given(turn=st.floats(-pi, pi), pieces=st.sampled_from([1, 3]))
def test_right_before_left_whichever_way_the_map_is_turned(
    tmp_path: Path, turn: float, pieces: int
) -> None:
    scenario = read_commonroad(written(tmp_path, *crossing(turn, pieces=pieces)))
    found: dict[int, set[int]] = {}
    for lane, others in waits(scenario).items():
        found.setdefault(lane % 1000, set()).update(i % 1000 for i in others)
    for k in range(4):
        right, opposite = k + 1, k + 2
        assert found[100 + 10 * k + STRAIGHT] == inner(right, LEFT, STRAIGHT, RIGHT)
        assert found[100 + 10 * k + LEFT] >= inner(right, STRAIGHT) | inner(
            opposite, STRAIGHT, RIGHT
        )
        assert 100 + 10 * k + RIGHT not in found
    assert any("no sign and no light at 1 of 1" in note for note in scenario.notes)
    assert_no_two_wait_for_each_other(scenario)


def assert_no_two_wait_for_each_other(scenario: Scenario) -> None:
    found = waits(scenario)
    for lane, others in found.items():
        assert all(lane not in found.get(other, ()) for other in others)
        for other in others:
            assert meet(scenario.road.lanes[lane].center, scenario.road.lanes[other].center)


# right of way


@pytest.mark.parametrize(
    ("minor", "major"), [("205", ""), ("206", "306"), ("", "301"), ("R1-1", ""), ("R1-2", "")]
)
def test_signs_beat_sides(tmp_path: Path, minor: str, major: str) -> None:
    """The road of sides 0 and 2 goes first; among its own two directions only left turns wait."""
    signs = [sign(name, kind) for name, kind in ((31, minor), (32, major)) if kind]
    shown = {
        k: see(sign=name) for k in range(4) for name in (32 - k % 2,) if (minor if k % 2 else major)
    }
    scenario = read_commonroad(written(tmp_path, *crossing(shown=shown), *signs))
    found = waits(scenario)
    for k in (0, 2):
        assert found[100 + 10 * k + LEFT] == inner(k + 2, STRAIGHT, RIGHT)
        assert not found.keys() & inner(k, STRAIGHT, RIGHT)
    for k in (1, 3):
        assert found[100 + 10 * k + STRAIGHT] >= inner(k + 1, STRAIGHT, LEFT) | inner(
            k + 3, STRAIGHT, LEFT
        )
        assert found[100 + 10 * k + RIGHT] == inner(k + 3, STRAIGHT)
    assert not any("no sign and no light" in note for note in scenario.notes)
    assert_no_two_wait_for_each_other(scenario)


def test_where_all_are_lit_only_left_turns_wait(tmp_path: Path) -> None:
    lights = [light(50, [("red", 10), ("green", 10)])]
    scenario = read_commonroad(
        written(tmp_path, *crossing(shown={k: see(50) for k in range(4)}), *lights)
    )
    assert waits(scenario) == {100 + 10 * k + LEFT: inner(k + 2, STRAIGHT, RIGHT) for k in range(4)}
    off = [light(50, [("red", 10)], more="<active>false</active>")]
    dark = read_commonroad(written(tmp_path, *crossing(shown={k: see(50) for k in range(4)}), *off))
    assert waits(dark) == waits(read_commonroad(written(tmp_path, *crossing())))


def test_where_traffic_keeps_left_no_side_is_assumed(tmp_path: Path) -> None:
    scenario = read_commonroad(written(tmp_path, *crossing(), benchmark="GBR_Test-1"))
    # Turning across the oncoming, as the map is not mirrored
    assert all(i % 10 == RIGHT for i in waits(scenario))


def test_a_wider_road_goes_first_without_signs(tmp_path: Path) -> None:
    """Side 0 has a second lane: nobody on it waits for side 1, though that is on its right."""
    beside = straight(77, 300.0, '<adjacentLeft ref="10" drivingDir="same"/>')
    shown = {0: '<adjacentRight ref="77" drivingDir="same"/>'}
    found = waits(read_commonroad(written(tmp_path, *crossing(shown=shown), beside)))
    assert not found.get(100 + STRAIGHT)
    assert found[110 + STRAIGHT] >= inner(0, STRAIGHT) and found[130 + STRAIGHT] >= inner(
        0, STRAIGHT
    )


def test_lanes_meet_where_cars_would_touch() -> None:
    x = np.array([[-20.0, 0.0], [20.0, 0.0]])
    up, ahead = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    assert meet(x, x[:, ::-1]) and meet(x, x + 1.9 * up) and not meet(x, x + 2.1 * up)
    assert meet(x, np.array([[20.0, 0.0], [40.0, 9.0]])) and not meet(x, x + 43.0 * ahead)


# stop lines


def lines(scenario: Scenario) -> list[StopLine]:
    return list(scenario.road.stop_lines)


def test_a_stop_line_lies_where_it_says_else_at_the_end(tmp_path: Path) -> None:
    marking = "<lineMarking>solid</lineMarking>"
    there = f"<stopLine>{points((150.0, -2.0), (151.0, 2.0))}{marking}{see(7)}</stopLine>{see(7)}"
    parts = [
        straight(1, inner=there),
        straight(2, 9.0, f"<stopLine>{marking}</stopLine>"),
        straight(3, 18.0, see(7)),
    ]
    file = written(tmp_path, *parts, light(7, [("red", 5)]), problem(5, 101.0, 0.0, 5.0))
    scenario = read_commonroad(file)
    one, two, three = lines(scenario)
    assert one.points.tolist() == [[49.0, -2.0], [50.0, 2.0]]
    assert two.points.tolist() == [[99.0, 7.0], [99.0, 11.0]]
    assert [line.lane for line in (one, two, three)] == [1, 2, 3]
    assert [line.light for line in (one, two, three)] == [7, None, 7]
    assert not any(line.must_stop or line.towards for line in (one, two, three))


@pytest.mark.parametrize(
    ("kind", "must_stop"), [("206", True), ("R1-1", True), ("205", False), ("R1-2", False)]
)
def test_a_sign_to_give_way_has_a_line(tmp_path: Path, kind: str, must_stop: bool) -> None:
    file = written(
        tmp_path, straight(1, inner=see(sign=9)), sign(9, kind), problem(5, 0.0, 0.0, 5.0)
    )
    (line,) = lines(read_commonroad(file))
    assert (line.light, line.must_stop) == (None, must_stop)


def test_a_light_counts_more_than_a_stop_sign_while_it_is_lit(tmp_path: Path) -> None:
    for active, expected in (("true", [(7, False)]), ("false", [(7, False), (None, True)])):
        lamp = light(7, [("red", 5)], more=f"<active>{active}</active>")
        file = written(
            tmp_path, straight(1, inner=see(7, 9)), lamp, sign(9, "206"), problem(5, 0.0, 0.0, 5.0)
        )
        scenario = read_commonroad(file)
        assert [(line.light, line.must_stop) for line in lines(scenario)] == expected
        assert scenario.lights[0].at(0.0) is (Colour.RED if active == "true" else Colour.OFF)


def test_a_light_named_along_the_road_has_its_line_at_the_last_lanelet(tmp_path: Path) -> None:
    first = strip(1, np.array([[0.0, 0.0], [50.0, 0.0]]), f'<successor ref="2"/>{see(7, 9)}')
    last = strip(2, np.array([[50.0, 0.0], [90.0, 0.0]]), see(7, 9))
    file = written(
        tmp_path, first, last, light(7, [("red", 5)]), sign(9, "205"), problem(5, 1.0, 0.0, 5.0)
    )
    (line,) = lines(read_commonroad(file))
    assert line.lane == 2


def direction(word: str) -> str:
    return f"<direction>{word}</direction>"


def test_directions_become_lanes_and_a_dark_arrow_leaves_its_turn_to_the_others(
    tmp_path: Path,
) -> None:
    """The arrow to the right is lit from step 10 to 20; else the light for all counts there too."""
    parts = crossing(shown={0: see(50) + see(51) + see(52)})
    lights = [
        light(50, [("red", 100)], more=direction("all")),
        light(51, [("inactive", 10), ("green", 10), ("inactive", 80)], more=direction("right")),
        light(52, [("green", 100)], more=direction("left")),
    ]
    scenario = read_commonroad(written(tmp_path, *parts, *lights))
    assert {(line.light, line.towards) for line in lines(scenario)} == {
        (50, (102,)),
        (51, (103,)),
        (52, (101,)),
    }
    (arrow,) = (each for each in scenario.lights if each.id == 51)
    assert [arrow.at(t) for t in (0.0, 0.9, 1.0, 1.9, 2.0)] == [Colour.RED] * 2 + [
        Colour.GREEN
    ] * 2 + [Colour.RED]


def test_a_turn_that_no_intersection_tells_is_told_by_its_heading(tmp_path: Path) -> None:
    parts = [part for part in crossing(shown={0: see(50)}) if "<intersection" not in part]
    lamp = light(50, [("red", 10)], more=direction("straightRight"))
    (line,) = lines(read_commonroad(written(tmp_path, *parts, lamp)))
    assert sorted(line.towards) == [102, 103]


def test_crosswalks_are_lanelets_of_that_type_and_crossings(tmp_path: Path) -> None:
    zebra = straight(2, 9.0, "<laneletType>crosswalk</laneletType>")
    crossed = '<intersection id="9"><crossing><crossingLanelet ref="3"/></crossing></intersection>'
    walk = straight(4, 30.0, "<laneletType>sidewalk</laneletType>")
    file = written(
        tmp_path, straight(1), zebra, straight(3, 18.0), walk, crossed, problem(5, 0.0, 0.0, 5.0)
    )
    road = read_commonroad(file).road
    assert [each.id for each in road.crosswalks] == [2, 3]
    np.testing.assert_array_equal(road.crosswalks[0].polygon, road.lanes[2].polygon)
    assert not road.lanes[2].drivable


def test_lights_that_lead_nowhere_are_noted(tmp_path: Path) -> None:
    nothing = '<trafficLight id="8"><position/></trafficLight>'
    file = written(
        tmp_path,
        straight(1, inner=see(8) + see(4)),
        light(7, [("red", 5)]),
        nothing,
        problem(5, 0.0, 0.0, 5.0),
    )
    scenario = read_commonroad(file)
    assert {
        "traffic lights 7 are ignored: no lane that goes their way names them",
        "traffic lights 8 have no cycle: they are taken as off",
        "traffic lights 4 are named by lanelets, but are not in the file",
    } <= set(scenario.notes)
    assert [(each.id, each.colours) for each in scenario.lights] == [(8, (Colour.OFF,))]


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (light(7, [("pink", 5)]), ["trafficLight 7", "no colour 'pink'", "redYellow"]),
        (light(7, [("red", 0)]), ["trafficLight 7", "a duration of 0 steps"]),
        (
            light(7, [("red", 5)], more=direction("up")),
            ["trafficLight 7", "no direction 'up'", "straightRight"],
        ),
        (
            straight(2, inner=f"<stopLine>{points((1, 2))}</stopLine>"),
            ["lanelet 2/stopLine", "one point"],
        ),
        (
            straight(2, inner='<stopLine><trafficLightRef ref="x"/></stopLine>'),
            ["lanelet 2", "'x' is no number"],
        ),
        (
            '<intersection id="3"><incoming><incomingLanelet/></incoming></intersection>',
            ["intersection 3"],
        ),
    ],
)
def test_errors_name_the_element(tmp_path: Path, part: str, words: list[str]) -> None:
    with pytest.raises(LogError) as caught:
        read_commonroad(written(tmp_path, straight(1), part, problem(5, 0.0, 0.0, 5.0)))
    for word in ["test.xml", ";", *words]:
        assert word in str(caught.value)


def recorded(folder: Path, name: str) -> Scenario:
    file = folder / "commonroad" / name
    if not file.is_file():
        pytest.skip(f"{name} is not among the recorded data")
    return read_commonroad(file)


@pytest.mark.parametrize(
    ("name", "stop_lines", "lights"),
    [
        ("USA_Lanker-1_3_T-1.xml", 18, 8),
        ("USA_Peach-4_8_T-1.xml", 13, 4),
        ("DEU_Goeppingen-37_1_T-4.xml", 7, 3),
    ],
)
def test_lit_crossings(shared_data: Path, name: str, stop_lines: int, lights: int) -> None:
    scenario = recorded(shared_data, name)
    assert (len(scenario.road.stop_lines), len(scenario.lights)) == (stop_lines, lights)
    assert all(
        line.light in {each.id for each in scenario.lights} for line in scenario.road.stop_lines
    )
    assert not any("ignored" in note and "light" in note for note in scenario.notes)
    assert_no_two_wait_for_each_other(scenario)
    turning = [scenario.road.lanes[i] for i in waits(scenario)]
    assert all(each.drivable for each in turning)


@pytest.mark.slow
def test_nobody_waits_for_one_who_waits_for_him(shared_data: Path) -> None:
    for file in sorted((shared_data / "commonroad").glob("*.xml")):
        assert_no_two_wait_for_each_other(read_commonroad(file))
