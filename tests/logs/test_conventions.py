"""Units and frames of a log: refused, or chosen with a note, at any rate.

A right log is not touched.
"""

from dataclasses import replace

import handmade
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.chords import Chords
from replan.logs.comparisons import COMPARISONS
from replan.logs.log_checks import passed
from replan.logs.log_settings import HEADINGS
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory

RATES = st.sampled_from([1.0, 2.0, 5.0, 10.0, 50.0, 200.0])
ROAD = Road.along(np.array([[0.0, 0.0], [100.0, 0.0]]), speed_limit=14.0)


def arc(
    rate: float, yaw0: float = 0.9, turn: float = 0.05, v: float = 10.0, duration: float = 12.0
) -> Trajectory:
    """A drive along an arc (of radius v / turn)."""
    t = np.arange(0.0, duration, 1.0 / rate)
    yaw = yaw0 + turn * t
    x, y = v / turn * (np.sin(yaw) - np.sin(yaw0)), -v / turn * (np.cos(yaw) - np.cos(yaw0))
    return Trajectory(t, x, y, yaw, np.full(len(t), v), 0.0 * t, np.full(len(t), turn / v))


def made(ego: Trajectory, *agents: dict[str, object], **more: object) -> Scenario:
    tracks = handmade.tracks(*agents)
    return Scenario("made", ego, tracks, ROAD, float(ego.t[-1]), tags=("recorded",), **more)  # type: ignore[arg-type]


def along(
    ego: Trajectory, ahead: float, left: float = 0.0, name: str = "7", **more: object
) -> dict[str, object]:
    """A road user at a place in the ego's frame (rear axle), with the ego's heading."""
    c, s = np.cos(ego.yaw), np.sin(ego.yaw)
    x, y = ego.x + ahead * c - left * s, ego.y + ahead * s + left * c
    return handmade.track(name, ego.t, x, y, **({"yaw": ego.yaw} | more))  # type: ignore[arg-type]


@given(RATES, st.floats(-3.0, 3.0), st.floats(0.02, 0.3), st.floats(0.0, 0.02))
@settings(max_examples=20, deadline=None)
def test_a_consistent_log_is_not_changed(
    rate: float, yaw0: float, turn: float, noise: float
) -> None:
    ego, rng = arc(rate, yaw0, turn), np.random.default_rng(1)
    shaken = replace(
        ego,
        x=ego.x + noise * rng.normal(size=len(ego)),
        y=ego.y + noise * rng.normal(size=len(ego)),
    )
    backward = replace(shaken, yaw=shaken.yaw + np.pi, v=-ego.v)
    world = {"vx": ego.v * np.cos(ego.yaw), "vy": ego.v * np.sin(ego.yaw)}
    walker = along(ego, 9.0, 6.0, "walker", yaw=ego.yaw + 1.5, kind=AgentKind.PEDESTRIAN)
    for driven in (shaken, backward):
        whole = made(driven, along(ego, 12.0, **world), along(ego, -6.0, name="8"), walker)
        assert passed(whole, COMPARISONS) is whole
    assert np.abs(Chords.of_ego(ego).off(ego.yaw)).max() < 1e-6, (
        "on an arc, the mean heading is the chord's direction"
    )


@given(RATES, st.sampled_from(sorted(HEADINGS)), st.booleans(), st.floats(0.3, 1.2))
@settings(max_examples=30, deadline=None)
def test_headings_in_another_convention_are_refused(
    rate: float, name: str, of_ego: bool, yaw0: float
) -> None:
    ego = arc(rate, yaw0)
    factor, offset = HEADINGS[name]
    other = (ego.yaw - offset) / factor
    wrong = made(replace(ego, yaw=other)) if of_ego else made(ego, along(ego, 0.0, 20.0, yaw=other))
    with pytest.raises(LogError, match=f"look like {name}:") as refused:
        passed(wrong, COMPARISONS)
    assert refused.value.topic == ("ego" if of_ego else "agents")


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0])
def test_small_headings_in_degrees_are_refused_and_small_errors_are_not(rate: float) -> None:
    straight = arc(rate, 0.0, 1e-6)
    ego = arc(rate, -0.06, 0.01)
    with pytest.raises(LogError, match="look like degrees"):
        passed(made(replace(ego, yaw=np.degrees(ego.yaw))), COMPARISONS)
    for drive in (straight, ego):
        for error in (0.3, 0.6, np.pi):
            assert passed(made(replace(drive, yaw=drive.yaw + error)), COMPARISONS).ego.yaw[
                0
            ] == pytest.approx(drive.yaw[0] + error)


def places(ego: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Longitude and latitude, degrees, of a drive."""
    north = 48.1 + ego.y / 111_320.0
    return 11.5 + ego.x / 111_320.0 / np.cos(np.radians(48.1)), north


@given(RATES, st.booleans(), st.booleans())
@settings(max_examples=20, deadline=None)
def test_degrees_of_latitude_are_no_metres(rate: float, with_speed: bool, swapped: bool) -> None:
    ego, north_first = arc(rate), swapped and with_speed
    x, y = reversed(places(ego)) if north_first else places(ego)
    derived = np.gradient(np.hypot(x - x[0], y - y[0]), ego.t)
    origin = float(np.round(x[0])), float(np.round(y[0]))
    moved = replace(ego, x=x - origin[0], y=y - origin[1], v=ego.v if with_speed else derived)
    with pytest.raises(LogError, match="degrees of latitude and longitude"):
        passed(made(moved, origin=origin), COMPARISONS)
    agents = handmade.track(
        "7", ego.t, x, y, yaw=ego.yaw, vx=ego.v * np.cos(ego.yaw), vy=ego.v * np.sin(ego.yaw)
    )
    with pytest.raises(LogError, match="topic agents: the positions are degrees"):
        passed(made(ego, agents), COMPARISONS)


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2])
def test_an_ego_that_stands_is_not_in_degrees(noise: float) -> None:
    ego, rng = arc(10.0), np.random.default_rng(2)
    x, y = noise * rng.normal(size=(2, len(ego)))
    still = made(replace(ego, x=x, y=y, v=0.0 * ego.v), origin=(48.0, 11.0))
    assert passed(still, COMPARISONS) is still


@given(RATES, st.floats(0.6, 2.0), st.floats(0.0, 0.1))
@settings(max_examples=20, deadline=None)
def test_velocities_in_own_axes_are_rotated_and_noted(
    rate: float, yaw0: float, noise: float
) -> None:
    ego, rng = arc(rate, yaw0, 0.02), np.random.default_rng(3)
    forward = ego.v + noise * rng.normal(size=len(ego))
    own = made(ego, along(ego, 15.0, vx=forward, vy=0.0 * forward), along(ego, -15.0, name="8"))
    found = passed(own, COMPARISONS)
    mine = found.tracks.samples(0)
    assert found.tracks.vx[mine] == pytest.approx(forward * np.cos(ego.yaw))
    assert found.tracks.vy[mine] == pytest.approx(forward * np.sin(ego.yaw))
    assert np.isnan(found.tracks.vx[found.tracks.samples(1)]).all()
    assert len(found.notes) == 1 and "own axes" in found.notes[0]
    assert passed(found, COMPARISONS) is found


def test_the_frame_of_velocities_is_known_from_agents_off_the_x_axis() -> None:
    """Most cars drive along x, where both frames are the same; two walkers cross."""
    ego = arc(10.0, 0.0, 1e-6)
    cars = [along(ego, 15.0 * k, name=str(k), vx=ego.v, vy=0.0 * ego.v) for k in range(1, 9)]
    t, up = ego.t, np.full(len(ego), 0.5 * np.pi)
    walk = {"yaw": up, "kind": AgentKind.PEDESTRIAN, "length": 0.6, "width": 0.6}
    walkers = [
        handmade.track(f"w{k}", t, 0.0 * t + 60.0 + k, 1.4 * t - 9.0, vx=1.4, vy=0.0, **walk)
        for k in (0, 2)
    ]
    found = passed(made(ego, *cars, *walkers), COMPARISONS).tracks
    assert found.vy[found.samples(8)] == pytest.approx(1.4) and found.vx[
        found.samples(0)
    ] == pytest.approx(10.0)


@given(
    RATES,
    st.sampled_from([0.0, 1.4, 2.5, 0.4]),
    st.floats(0.0, 0.1),
    st.sampled_from(["17", "ego", "x"]),
)
@settings(max_examples=20, deadline=None)
def test_the_ego_among_the_agents_is_left_out(
    rate: float, ahead: float, noise: float, name: str
) -> None:
    ego, rng = arc(rate), np.random.default_rng(4)
    me = along(ego, ahead, name=name)
    me |= {axis: me[axis] + noise * rng.normal(size=len(ego)) for axis in "xy"}  # type: ignore[operator]
    found = passed(made(ego, me, along(ego, 30.0, name="8")), COMPARISONS)
    assert found.tracks.ids == ("8",) and found.notes == (
        f"{name} among the road users is the ego itself: left out.",
    )
    alone = passed(made(ego, me), COMPARISONS)
    assert len(alone.tracks) == 0 and alone.traffic_spans == pytest.approx(
        np.array([[0.0, ego.t[-1]]])
    )


def test_agents_near_the_ego_stay() -> None:
    ego = arc(10.0)
    before, after = along(ego, -3.4, name="follows"), along(ego, 6.3, name="leads")
    beside = along(ego, 1.4, 1.9, name="beside")
    standing = handmade.track(
        "driven through", ego.t, ego.x[60] + 0.0 * ego.t, ego.y[60] + 0.0 * ego.t
    )
    late = {key: values[50:] for key, values in along(ego, 1.4, name="x").items() if key in "txy"}  # type: ignore
    rides = handmade.track(
        "rides a while", ego.t, *(np.r_[np.full(50, 99.0), late[axis]] for axis in "xy")
    )
    near = made(ego, before, after, beside, standing, rides)
    assert passed(near, COMPARISONS) is near
