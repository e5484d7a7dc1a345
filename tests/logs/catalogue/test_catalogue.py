"""The catalogue: plausible careful drives, and what each family shows."""

import json
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from differences import differences
from hypothesis import given, settings, strategies as st

from replan.core.errors import ConfigError
from replan.logs.catalogue import CATALOGUE, SEPARATING, groups
from replan.logs.catalogue.family import touches
from replan.logs.catalogue.family_parts import MAX_ACCEL, MAX_BRAKE, MAX_JERK, Ahead, drive
from replan.logs.catalogue.pedestrians import Leg, strolled
from replan.logs.catalogue.roads import curve, weaving
from replan.logs.plan import DecisionKind
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance

BUILT = CATALOGUE | {family.name: family for family in groups()[SEPARATING]}
SCENARIOS = {name: family.scenario() for name, family in BUILT.items()}
everywhere = pytest.mark.parametrize("name", list(BUILT))


@everywhere
def test_the_logged_drive_is_consistent(name: str) -> None:
    """Poses, speed, acceleration and curvature tell one story, with bounded acceleration and
    jerk.
    """
    ego = SCENARIOS[name].ego
    dt = np.diff(ego.t)
    np.testing.assert_allclose(dt, 0.1, atol=1e-9)
    mean_v = 0.5 * (ego.v[1:] + ego.v[:-1])
    np.testing.assert_allclose(np.hypot(np.diff(ego.x), np.diff(ego.y)), mean_v * dt, atol=2e-3)
    np.testing.assert_allclose(np.diff(ego.v), 0.5 * (ego.a[1:] + ego.a[:-1]) * dt, atol=6e-3)
    turn = 0.5 * (ego.kappa[1:] * ego.v[1:] + ego.kappa[:-1] * ego.v[:-1]) * dt
    np.testing.assert_allclose(np.diff(ego.yaw), turn, atol=1e-3)
    middle = 0.5 * (ego.yaw[1:] + ego.yaw[:-1])
    sideways = -np.sin(middle) * np.diff(ego.x) + np.cos(middle) * np.diff(ego.y)
    np.testing.assert_allclose(sideways, 0.0, atol=1e-3)
    assert ego.a.min() >= -MAX_BRAKE - 1e-9
    assert ego.a.max() <= MAX_ACCEL + 1e-9
    assert np.abs(np.diff(ego.a) / dt).max() <= MAX_JERK + 1e-6
    lateral = ego.v**2 * ego.kappa
    assert np.abs(lateral).max() <= 3.0
    assert np.abs(np.diff(lateral) / dt).max() <= 2.0


@everywhere
def test_the_logged_drive_has_no_contact_stays_on_the_road_and_arrives(name: str) -> None:
    scenario = SCENARIOS[name]
    ego, car = scenario.ego, scenario.vehicle
    assert touches(scenario) is None
    x, y = (
        ego.x + car.axle_to_center * np.cos(ego.yaw),
        ego.y + car.axle_to_center * np.sin(ego.yaw),
    )
    for along in (-0.5 * car.length, 0.5 * car.length):
        for left in (-0.5 * car.width, 0.5 * car.width):
            px = x + along * np.cos(ego.yaw) - left * np.sin(ego.yaw)
            py = y + along * np.sin(ego.yaw) + left * np.cos(ego.yaw)
            assert all(scenario.road.is_drivable(*p) for p in zip(px, py, strict=True))
    assert scenario.goal is not None
    assert scenario.goal.reached(
        float(ego.t[-1]), float(x[-1]), float(y[-1]), float(ego.yaw[-1]), float(ego.v[-1])
    )
    assert not scenario.goal.holds_place(float(x[0]), float(y[0]))
    there = [
        scenario.goal.holds_place(*place) for place in zip(x.tolist(), y.tolist(), strict=True)
    ]
    # A detector's log has no spare
    arrives = ego.t[-1] if scenario.detections is None else ego.t[there.index(True)]
    assert scenario.duration >= arrives + 9.99
    assert all(scenario.road.limit(1) >= ego.v - 1e-9)


@everywhere
def test_agents_last_to_the_end_and_their_velocities_fit(name: str) -> None:
    scenario = SCENARIOS[name]
    tracks = scenario.tracks
    for i in range(len(tracks)):
        own = tracks.samples(i)
        assert scenario.road.lanes_at(tracks.x[own][-1], tracks.y[own][-1]) or tracks.static[i]
        if tracks.static[i]:
            continue
        assert tracks.t[own][-1] == pytest.approx(scenario.duration)
        for p, v in ((tracks.x[own], tracks.vx[own]), (tracks.y[own], tracks.vy[own])):
            np.testing.assert_allclose(np.diff(p), 0.05 * (v[1:] + v[:-1]), atol=0.026)  # 5 m/s2


@everywhere
def test_building_is_deterministic_and_parameters_are_in_the_metadata(name: str) -> None:
    one, two = BUILT[name].scenario(), BUILT[name].scenario()
    assert differences(one, two) == []
    assert one.metadata["generator_version"]
    for parameter, value in BUILT[name].parameters.items():
        assert float(one.metadata[f"parameter.{parameter}"]) == value
    rebuilt = BUILT[name].scenario(
        **{
            key.removeprefix("parameter."): float(v)
            for key, v in one.metadata.items()
            if key.startswith("parameter.")
        }
    )
    assert differences(one, replace(rebuilt, name=one.name)) == []


@everywhere
def test_expected_decisions_name_agents_and_decisions(name: str) -> None:
    scenario = SCENARIOS[name]
    wanted = json.loads(scenario.metadata.get("expected_decisions", "{}"))
    there = {*scenario.tracks.ids, *(f"stop line {line.id}" for line in scenario.road.stop_lines)}
    assert set(wanted) <= there
    assert bool(wanted) is bool(there)
    assert {kind for kinds in wanted.values() for kind in kinds} <= {
        kind.value for kind in DecisionKind
    }


@settings(max_examples=10)
@given(v=st.floats(0.0, 20.0), cruise=st.floats(3.0, 20.0), gap=st.floats(40.0, 120.0))
def test_the_careful_driver_is_smooth_and_stops_at_the_line(
    v: float, cruise: float, gap: float
) -> None:
    path = curve((2000.0, 0.0, 0.0))
    if v * v / 4.0 > gap - 1.5 * v - 5.0:
        return  # no careful driver can
    ego = drive(
        path,
        start=0.0,
        speed=v,
        cruise=cruise,
        duration=40.0,
        ahead=lambda t, s: Ahead(gap - s, stop=True),
    )
    assert ego.x[-1] <= gap + 1.0
    assert ego.v.min() >= 0.0
    assert np.abs(np.diff(ego.a)).max() <= 0.1 * MAX_JERK + 1e-6
    free = drive(path, start=0.0, speed=v, cruise=cruise, duration=40.0)
    assert free.v[-1] == pytest.approx(cruise, abs=0.05)


def test_curves_close() -> None:
    """Four quarter circles come home, and a clothoid's end has the turn (k0 + k1) / 2 L."""
    circle = curve((2.0 * pi * 50.0, 0.02, 0.02))
    assert circle.x[-1] == pytest.approx(0.0, abs=1e-6)
    assert circle.yaw[-1] == pytest.approx(2.0 * pi)
    assert curve((20.0, 0.0, 0.02)).yaw[-1] == pytest.approx(0.2)
    shift = weaving(100.0, [(20.0, 60.0, 1.5)])
    assert (shift.y[0], shift.y[-1]) == (0.0, pytest.approx(1.5))
    assert np.abs(np.gradient(shift.yaw, shift.s) - shift.kappa)[2:-2].max() < 1e-4


@pytest.mark.parametrize("width", [1.61, 1.9])
def test_static_obstacles_leave_room_on_the_right_side_only(width: float) -> None:
    """Beside each obstacle there is a way with 0.5 m to it; at the second one only on its right."""
    scenario = SCENARIOS["paper/static_obstacles"]
    tracks = scenario.tracks
    low, high = tracks.y - 0.5 * tracks.width, tracks.y + 0.5 * tracks.width
    by_id = {name: (low[i], high[i]) for i, name in enumerate(tracks.ids)}
    assert 5.25 - by_id["right_1"][1] > width + 0.5
    assert by_id["right_1"][1] > -0.8
    assert by_id["left"][0] - (-1.75) > width + 0.5
    assert by_id["left_outer"][0] - by_id["left"][1] < width
    assert 5.25 - by_id["left_outer"][1] < width
    # Who stays in the middle does not pass with clearance
    assert by_id["left"][0] < 0.5 * width + 0.3


def _gap(scenario: Scenario, t: float, k: int = 0) -> float:
    ego, car, other = scenario.ego.at(t), scenario.vehicle, scenario.tracks.truth(t)
    x, y = (
        ego.x + car.axle_to_center * np.cos(ego.yaw),
        ego.y + car.axle_to_center * np.sin(ego.yaw),
    )
    boxes = (other.x[k], other.y[k], other.yaw[k], other.length[k], other.width[k])
    return distance(x, y, ego.yaw, car.length, car.width, *(float(value) for value in boxes))


def test_crossing_pedestrian_brakes_for_about_four_seconds_then_drives_on() -> None:
    scenario = SCENARIOS["paper/crossing_pedestrian"]
    ego, tracks = scenario.ego, scenario.tracks
    braking = ego.t[ego.a < -0.5]
    assert 3.5 <= braking[-1] - braking[0] <= 5.0
    assert min(_gap(scenario, t) for t in ego.t) >= 2.0
    off = float(scenario.metadata["pedestrian_off_lane_s"])
    later = tracks.truth(off)
    assert later.y[0] - 0.3 >= 1.75
    rest = tracks.truth(scenario.duration)
    assert rest.speed[0] < 1e-9
    assert 2.0 <= rest.y[0] - 1.75 <= 3.0
    assert np.hypot(tracks.vx, tracks.vy).max() == pytest.approx(0.85, abs=0.01)
    assert ego.a[np.searchsorted(ego.t, off + 1.0)] > 0.0
    assert ego.v[-1] == pytest.approx(10.0, abs=0.1)
    assert 30.0 / 3.6 <= ego.v[0] <= 40.0 / 3.6
    assert scenario.duration >= 25.0


def test_cut_in_comes_from_the_neighbour_lane_with_its_gap() -> None:
    scenario = SCENARIOS["everyday/cut_in"]
    entered = float(scenario.metadata["entered_lane_s"])
    assert scenario.tracks.y[0] == -3.5
    assert scenario.tracks.y[-1] == 0.0
    assert scenario.road.lanes[1].right_neighbour == 2
    assert _gap(scenario, entered) == pytest.approx(25.0, abs=0.1)
    assert scenario.tracks.vx[0] - scenario.ego.v[0] == pytest.approx(-5.0)
    assert min(_gap(scenario, t) for t in scenario.ego.t) > 10.0


@pytest.mark.parametrize("intrusion", [0.4, 0.7, 1.0])
def test_nudge_leaves_its_clearance(intrusion: float) -> None:
    scenario = CATALOGUE["everyday/nudge"].scenario(intrusion_m=intrusion)
    assert scenario.name == f"everyday/nudge@intrusion_m={intrusion:g}"
    assert min(_gap(scenario, t) for t in scenario.ego.t) == pytest.approx(0.6, abs=0.02)
    assert scenario.tracks.y[0] + 0.9 == pytest.approx(intrusion - 1.75)


def front(scenario: Scenario) -> np.ndarray:
    """Stations of the front bumper on a straight road along x."""
    return scenario.ego.x + scenario.vehicle.axle_to_front


@pytest.mark.parametrize("green", [0.0, 6.0, 12.0, 25.0])
@pytest.mark.parametrize(("distance", "speed"), [(60.0, 8.3), (120.0, 13.9)])
def test_at_the_light_the_driver_waits_for_green(
    green: float, distance: float, speed: float
) -> None:
    scenario = CATALOGUE["everyday/traffic_light"].scenario(
        green_s=green, distance_m=distance, ego_speed_mps=speed, duration_s=50.0
    )
    (line,), (light,) = scenario.road.stop_lines, scenario.lights
    assert line.light == light.id and line.lane == 1 and scenario.road.lanes[1].successors == (2,)
    assert line.points[0, 0] - front(scenario)[0] == pytest.approx(distance)
    crossed = scenario.ego.t[np.argmax(front(scenario) > line.points[0, 0])]
    assert light.at(float(crossed)) is Colour.GREEN and light.at(green + 0.01) is Colour.GREEN
    assert light.at(green - 0.5) is (Colour.OFF if green == 0.0 else Colour.RED_YELLOW)
    if green == 25.0:
        waiting = scenario.ego.v < 0.1
        assert waiting.any() and 0.5 <= line.points[0, 0] - front(scenario)[waiting].max() <= 2.0
    assert scenario.ego.v[-1] == pytest.approx(speed, abs=0.1)


def test_at_the_crosswalk_the_pedestrian_goes_first() -> None:
    scenario = SCENARIOS["everyday/crosswalk"]
    (zebra,), ego, tracks = scenario.road.crosswalks, scenario.ego, scenario.tracks
    near, far = zebra.polygon[:, 0].min(), zebra.polygon[:, 0].max()
    assert near < tracks.x[0] < far and tracks.y[0] == pytest.approx(-1.75 - 0.6)
    assert tracks.truth(5.9).speed[0] < 0.01  # waits, so that it can be seen from afar
    there = front(scenario)[ego.t <= float(scenario.metadata["pedestrian_off_lane_s"])]
    assert 0.5 <= near - there.max() <= 8.0
    assert 0.5 <= ego.v.min() <= 4.0 and ego.x[-1] > far


@pytest.mark.parametrize("turn", [1, 0, -1])
def test_at_the_junction_the_main_road_goes_first(turn: int) -> None:
    scenario = CATALOGUE["everyday/junction"].scenario(turn=turn)
    road, ego = scenario.road, scenario.ego
    own = {1: 18, 0: 13, -1: 16}[turn]
    assert set(road.lanes[1].successors) == {13, own}
    assert {56} <= set(road.lanes[own].yields_to) <= {42, 56, 78}
    assert not road.lanes[56].yields_to and not road.lanes[78].yields_to
    line = next(line for line in road.stop_lines if line.lane == 1)
    entered = float(ego.t[np.argmax(front(scenario) > line.points[0, 0])])
    assert entered > float(scenario.metadata["last_passes_s"])
    assert ego.yaw[-1] == pytest.approx(0.5 * pi * turn, abs=1e-3)
    for lane in road.lanes.values():
        for after in lane.successors:
            np.testing.assert_allclose(lane.center[-1], road.lanes[after].center[0], atol=0.01)
    middle = [scenario.tracks.truth(6.0 + 2.5 * k) for k in range(4)]
    assert [
        float(np.hypot(each.x[k] - 72.6, each.y[k] - 1.75)) for k, each in enumerate(middle)
    ] == pytest.approx([1.75] * 4, abs=0.05)


PEDESTRIANS = [name for name in CATALOGUE if name.startswith("pedestrian/")]


def way(scenario: Scenario, k: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, x, y and speed of a road user."""
    tracks, own = scenario.tracks, scenario.tracks.samples(k)
    return tracks.t[own], tracks.x[own], tracks.y[own], np.hypot(tracks.vx[own], tracks.vy[own])


@given(
    distances=st.lists(st.floats(1.0, 8.0), min_size=1, max_size=4),
    speeds=st.lists(st.floats(0.5, 2.4), min_size=4, max_size=4),
    pauses=st.lists(st.floats(0.0, 3.0), min_size=4, max_size=4),
    flowing=st.booleans(),
)
def test_a_walk_goes_its_legs_with_ramps(
    distances: list[float], speeds: list[float], pauses: list[float], *, flowing: bool
) -> None:
    """It ends after all its legs, is never faster than the fastest, and changes its speed within
    0.4 s.
    """
    legs: list[Leg] = []
    for length, speed, pause in zip(distances, speeds, pauses, strict=False):
        begin = (legs[-1].slows if flowing else legs[-1].end + pause) if legs else 1.0
        legs.append(Leg(begin, length, speed))
    t = np.arange(0.0, legs[-1].end + 1.0, 0.01)
    s = strolled(t, legs)
    v = np.diff(s) / 0.01
    assert s[0] == 0.0 and s[-1] == pytest.approx(sum(distances))
    assert v.min() >= -1e-9 and v.max() <= max(speeds) + 1e-9
    assert np.abs(np.diff(v)).max() <= 0.01 * max(speeds) / 0.4 + 1e-9
    if flowing:  # no stop between the legs
        walking = (t[:-1] > legs[0].begin + 0.4) & (t[1:] < legs[-1].slows)
        assert v[walking].min() >= min(speeds) - 1e-9


@pytest.mark.parametrize("name", PEDESTRIANS)
def test_without_braking_a_pedestrian_would_be_hit_and_the_driver_waits_for_the_last(
    name: str,
) -> None:
    scenario = SCENARIOS[name]
    ego, off = scenario.ego, float(scenario.metadata["pedestrian_off_lane_s"])
    straight = drive(
        curve((600.0, 0.0, 0.0)),
        start=10.0,
        speed=ego.v[0],
        cruise=ego.v[0],
        duration=float(ego.t[-1]),
    )
    assert touches(replace(scenario, ego=straight)) in scenario.tracks.ids
    assert 20.0 <= ego.t[-1] <= 25.0
    assert ego.v.min() < 0.3 * ego.v[0] and ego.v[-1] == pytest.approx(ego.v[0], abs=0.1)
    # Until the brake is released
    assert ego.t[np.argmin(ego.v)] <= off + MAX_BRAKE / MAX_JERK + 0.1
    for k in range(len(scenario.tracks)):
        t, _, y, _ = way(scenario, k)
        assert scenario.tracks.static[k] or (np.abs(y[t >= off]) >= 1.75 + 0.25).all()


@pytest.mark.parametrize(
    ("dwell", "lateral", "back"), [(1.0, -0.5, 1.2), (2.5, 0.0, 1.5), (4.0, 0.5, 1.8)]
)
def test_a_pedestrian_who_turns_back_stands_on_the_lane_first(
    dwell: float, lateral: float, back: float
) -> None:
    scenario = CATALOGUE["pedestrian/turns_back"].scenario(
        dwell_s=dwell, stop_lateral_m=lateral, return_speed_mps=back
    )
    t, _, y, v = way(scenario)
    stands = (np.abs(y - lateral) < 1e-9) & (v < 0.05)
    assert t[stands][-1] - t[stands][0] == pytest.approx(dwell, abs=0.21)
    assert y.max() == pytest.approx(lateral) and y[-1] == pytest.approx(y[0])
    assert v[t > t[stands][-1]].max() == pytest.approx(back)


def test_the_child_runs_out_from_behind_the_cars_of_cpnco() -> None:
    scenario = SCENARIOS["pedestrian/runs_out"]
    tracks, car = scenario.tracks, scenario.vehicle
    boxes = {name: k for k, name in enumerate(tracks.ids)}
    (_, x, y, v), small, large = way(scenario), boxes["small_car"], boxes["large_car"]
    sx, sy, lx = (float(way(scenario, k)[c][0]) for k, c in ((small, 1), (small, 2), (large, 1)))
    assert x[0] - (sx + 0.5 * tracks.length[small]) == pytest.approx(1.0)
    assert (sx - lx) - 0.5 * (tracks.length[small] + tracks.length[large]) == pytest.approx(1.0)
    assert -0.5 * car.width - (sy + 0.5 * tracks.width[small]) == pytest.approx(1.0)
    assert y[0] == -4.0 and v.max() == pytest.approx(5.0 / 3.6, abs=0.01)
    beside = front(scenario) > lx - 0.5 * tracks.length[large]
    assert scenario.ego.v[beside][0] <= 4.3


@pytest.mark.parametrize("angle", [30.0, 60.0, 150.0])
def test_the_jaywalker_crosses_diagonally_and_hurries(angle: float) -> None:
    scenario = CATALOGUE["pedestrian/jaywalker"].scenario(angle_deg=angle, distance_m=45.0)
    _, x, y, v = way(scenario)
    assert np.rad2deg(np.arctan2(y[-1] - y[0], x[-1] - x[0])) == pytest.approx(angle)
    inside = np.abs(y) < 1.6
    assert v[inside & (y < -0.8)] == pytest.approx(1.4)
    assert v[inside & (y > 0.5)] == pytest.approx(2.2)
    assert v[inside].min() >= 1.4 - 1e-9


def test_pedestrians_who_do_not_cross_are_refused() -> None:
    with pytest.raises(ConfigError, match="angle_deg is 0: between the lane and the walk"):
        CATALOGUE["pedestrian/jaywalker"].scenario(angle_deg=0.0)
    with pytest.raises(ConfigError, match="does not come onto the lane, or does not leave it"):
        CATALOGUE["pedestrian/turns_back"].scenario(kerb_distance_m=3.0, stop_lateral_m=-2.5)
    with pytest.raises(ConfigError, match="too short for its speed"):
        CATALOGUE["pedestrian/hesitates"].scenario(approach_m=0.1)
