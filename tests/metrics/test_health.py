"""A log's health: each fault that is planted is found, where it was planted, and a clean log has
none.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import handmade
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.config import RunConfig
from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.comparisons import COMPARISONS
from replan.logs.log_checks import passed
from replan.logs.mcap import write_scenario
from replan.logs.road import Lane, Road, RoadSource
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.metrics.health import CHECKS, findings, report, rows
from replan.metrics.log_faults import FaultKind
from replan.run import evaluate_logs

DOCS = Path(__file__).parents[2] / "docs"
T = np.arange(0.0, 8.01, 0.1)
AT = 40
"""Index of the sample after which a fault is planted: 4.0 s."""


def drive(v: float = 10.0) -> Trajectory:
    zero = np.zeros_like(T)
    return Trajectory(T, v * T, zero, zero, zero + v, zero, zero)


def track(
    name: str = "7", y: float = 3.5, v: float = 8.0, t: np.ndarray = T, x0: float = 20.0
) -> Tracks:
    return handmade.tracks(handmade.track(name, t, x0 + v * t, np.full(len(t), y), vx=v, vy=0.0))


def both(one: Tracks, other: Tracks) -> Tracks:
    names = "length", "width", "static"
    columns = "t", "x", "y", "yaw", "vx", "vy"
    return Tracks(
        (*one.ids, *other.ids),
        (*one.kinds, *other.kinds),
        *(np.r_[getattr(one, name), getattr(other, name)] for name in names),
        np.r_[one.offsets, other.offsets[1:] + one.offsets[-1]],
        *(np.r_[getattr(one, name), getattr(other, name)] for name in columns),
    )


def scenario(
    ego: Trajectory | None = None, tracks: Tracks | None = None, **more: object
) -> Scenario:
    ego = ego or drive()
    road = Road.along(np.column_stack([drive().x, drive().y]), speed_limit=14.0)
    return Scenario(
        "made",
        ego,
        track() if tracks is None else tracks,
        road,
        max(8.0, float(ego.t[-1])),
        tags=("recorded",),
        **more,
    )  # type: ignore[arg-type]


def moved(tracks: Tracks, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Tracks:
    return replace(tracks, **{name: change(np.array(getattr(tracks, name)))})


def later(step: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: np.where(np.arange(len(values)) > AT, values + step, values)


def kinds(one: Scenario) -> set[FaultKind]:
    return {finding.kind for finding in findings(one)}


def test_a_clean_log_has_no_findings() -> None:
    assert findings(scenario()) == ()
    assert report(scenario()) == [f"health: nothing found by {len(CHECKS)} checks"]


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_the_catalogue_is_clean(name: str) -> None:
    made = CATALOGUE[name].scenario()
    assert findings(made) == () and passed(made, COMPARISONS) is made


@given(st.floats(0.8, 30.0))
@settings(max_examples=20, deadline=None)
def test_an_ego_jump_is_found_where_it_is(step: float) -> None:
    ego = drive()
    found, *longer = findings(scenario(replace(ego, x=later(step)(np.array(ego.x)))))
    assert {one.kind for one in longer} == (
        {FaultKind.EGO_SPEED} if step > 0.1 * (80.0 + step) else set()
    )
    assert (
        found.kind is FaultKind.EGO_JUMP
        and found.t_from == pytest.approx(4.0)
        and found.t_to == pytest.approx(4.1)
    )
    assert found.value == pytest.approx(step + 1.0)


@given(st.floats(3.0, 60.0))
@settings(max_examples=20, deadline=None)
def test_a_teleport_is_found_where_it_is(step: float) -> None:
    found = [
        one
        for one in findings(scenario(tracks=moved(track(), "x", later(step))))
        if one.kind is FaultKind.TELEPORT
    ]
    assert [one.who for one in found] == ["7"] and found[0].value == pytest.approx(step + 0.8)
    assert (found[0].t_from, found[0].t_to) == (pytest.approx(4.0), pytest.approx(4.1))


@pytest.mark.parametrize(
    ("factor", "word"), [(3.6, "km/h"), (2.237, "mph"), (0.3048, "feet"), (0.001, "mm")]
)
def test_other_units_are_named(factor: float, word: str) -> None:
    ego = drive()
    (found,) = (
        one
        for one in findings(scenario(replace(ego, v=ego.v * factor)))
        if one.kind is FaultKind.UNITS
    )
    assert word in found.text and found.value == pytest.approx(factor)
    fast = replace(track(), vx=track().vx * factor)
    two = both(fast, replace(fast, ids=("8",), y=fast.y + 4.0))
    (found,) = (
        one
        for one in findings(scenario(tracks=two))
        if one.topic == "agents" and one.kind is FaultKind.UNITS
    )
    assert word in found.text


def test_gaps_are_found_with_their_length() -> None:
    kept = (T < 3.05) | (T > 4.95)
    ego = drive()
    columns = {name: getattr(ego, name)[kept] for name in ("t", "x", "y", "yaw", "v", "a", "kappa")}
    holed = scenario(Trajectory(**columns), track(t=T[kept]))
    gap, flicker = findings(holed)
    assert (gap.kind, flicker.kind) == (FaultKind.EGO_GAP, FaultKind.AGENT_GAP)
    assert gap.value == pytest.approx(2.0) and "lost once, 2.0 s together" in flicker.text


def test_a_speed_that_the_positions_deny_is_found() -> None:
    ego = drive()
    assert FaultKind.EGO_SPEED in kinds(scenario(replace(ego, v=ego.v * 1.3)))
    assert FaultKind.EGO_SPEED not in kinds(scenario(replace(ego, v=ego.v * 1.05)))
    assert kinds(scenario(tracks=moved(track(), "vx", lambda v: v * 1.6))) == {
        FaultKind.AGENT_SPEED
    }
    assert kinds(scenario(tracks=moved(track(), "vx", lambda v: v * np.nan))) == set()


def test_wrong_headings_are_found() -> None:
    ego = drive()
    assert FaultKind.EGO_HEADING in kinds(scenario(replace(ego, yaw=ego.yaw + 1.2)))
    assert FaultKind.EGO_HEADING in kinds(scenario(replace(ego, yaw=later(1.5)(np.array(ego.yaw)))))
    assert FaultKind.HEADING_FLIP in kinds(scenario(tracks=moved(track(), "yaw", later(3.0))))
    backwards = replace(ego, yaw=ego.yaw + np.pi, v=-ego.v)
    assert FaultKind.EGO_HEADING not in kinds(scenario(backwards))


@pytest.mark.parametrize("rate", [2.0, 10.0, 50.0, 200.0])
def test_directions_are_found_at_any_rate(rate: float) -> None:
    t = np.arange(0.0, 8.01, 1.0 / rate)
    zero = np.zeros_like(t)
    ego = Trajectory(t, 10.0 * t, zero, zero, zero + 10.0, zero, zero)
    other = replace(
        handmade.tracks(handmade.track("7", t, 20.0 + 8.0 * t, zero + 3.5, vx=8.0, vy=0.0))
    )
    assert findings(scenario(ego, other)) == ()
    (found,) = findings(scenario(replace(ego, yaw=zero + 1.2), other))
    assert (found.kind, found.topic) == (
        FaultKind.EGO_HEADING,
        "ego",
    ) and found.value == pytest.approx(1.2)
    (found,) = findings(scenario(ego, replace(other, yaw=zero + 1.2)))[:1]
    assert (found.kind, found.who) == (
        FaultKind.AGENT_HEADING,
        "7",
    ) and found.value == pytest.approx(1.2)
    (found,) = findings(scenario(ego, replace(other, yaw=zero + np.pi)))
    assert found.kind is FaultKind.AGENT_HEADING and found.value == pytest.approx(np.pi), (
        "8 m/s is too fast for reverse"
    )
    (found,) = findings(scenario(ego, replace(other, vx=zero, vy=zero + 8.0)))
    assert (found.kind, found.who) == (FaultKind.VELOCITY, "7") and found.value == pytest.approx(
        0.5 * np.pi
    )
    slow = replace(other, x=20.0 + 2.0 * t, vx=zero + 2.0, yaw=zero + np.pi)
    assert findings(scenario(ego, slow)) == (), "it reverses"
    walker = replace(
        other, kinds=(AgentKind.PEDESTRIAN,), length=np.array([0.6]), width=np.array([0.6])
    )
    assert findings(scenario(ego, replace(walker, yaw=zero + 1.2))) == (), "people go sideways"


@pytest.mark.parametrize("rate", [5.0, 10.0, 100.0])
def test_reverse_gear_without_a_signed_speed_is_found_where_it_is(rate: float) -> None:
    t = np.arange(0.0, 12.01, 1.0 / rate)
    x, zero = np.where(t < 6.0, 3.0 * t, 36.0 - 3.0 * t), np.zeros_like(t)
    unsigned = Trajectory(t, x, zero, zero, zero + 3.0, zero, zero)
    (found,) = (one for one in findings(scenario(unsigned)) if one.kind is FaultKind.EGO_HEADING)
    assert "reverse gear" in found.text
    assert found.t_from == pytest.approx(6.0, abs=0.5) and found.t_to == pytest.approx(
        12.0, abs=0.5
    )
    signed = replace(unsigned, v=np.where(t < 6.0, 3.0, -3.0))
    assert FaultKind.EGO_HEADING not in kinds(scenario(signed))
    wrong = [
        one
        for one in findings(scenario(replace(signed, v=-signed.v)))
        if one.kind is FaultKind.EGO_HEADING
    ]
    assert sum(one.t_to - one.t_from for one in wrong) > 10.0, (
        "the sign is wrong all along, but where it changes"
    )


def test_headings_beyond_a_turn_may_be_degrees() -> None:
    """Between samples of a fast turn, the unwrapped heading loses turns: not refused, but asked."""
    t = np.arange(0.0, 40.0, 1.25)
    yaw, zero = 1.0 + 0.1 * t, np.zeros_like(t)
    ego = Trajectory(
        t, 100.0 * np.sin(yaw), -100.0 * np.cos(yaw), np.degrees(yaw), zero + 10.0, zero, zero
    )
    (found,) = (
        one for one in findings(scenario(ego, Tracks.empty())) if one.kind is FaultKind.EGO_HEADING
    )
    assert found.text.endswith("in degrees?")
    off = findings(scenario(replace(ego, yaw=yaw + 1.2), Tracks.empty()))[0]
    assert off.kind is FaultKind.EGO_HEADING and "degrees" not in off.text


def test_most_headings_are_one_finding() -> None:
    two = both(track(), track("8", y=8.0))
    (found,) = (
        one
        for one in findings(scenario(tracks=replace(two, yaw=two.yaw + 1.2)))
        if one.kind is FaultKind.AGENT_HEADING
    )
    assert found.who == "" and found.text.startswith("2 of 2 moving agents")


@pytest.mark.parametrize("rate", [10.0, 100.0, 200.0])
def test_noise_of_positions_is_no_way(rate: float) -> None:
    t, rng = np.arange(0.0, 20.0, 1.0 / rate), np.random.default_rng(5)
    noise, zero = 0.02 * rng.normal(size=(2, len(t))), np.zeros_like(t)
    shaken = Trajectory(t, 5.0 * t + noise[0], noise[1], zero, zero + 5.0, zero, zero)
    assert kinds(replace(scenario(shaken, Tracks.empty()), traffic=((0.0, 20.0),))) == set()


def test_an_agent_who_goes_on_under_another_name_is_found() -> None:
    one, other = track("7", t=T[:AT]), track("8", t=T[AT + 2 :])
    (found,) = findings(scenario(tracks=both(one, other)))
    assert found.kind is FaultKind.ID_SWITCH and "goes on as 8" in found.text
    (other_kind,) = (
        replace(
            other, kinds=(AgentKind.PEDESTRIAN,), length=np.array([0.6]), width=np.array([0.6])
        ),
    )
    assert FaultKind.ID_SWITCH not in kinds(scenario(tracks=both(one, other_kind)))


def test_twins_and_odd_sizes_are_found() -> None:
    assert FaultKind.TWIN in kinds(scenario(tracks=both(track("7"), track("8", y=3.6))))
    assert FaultKind.TWIN not in kinds(scenario(tracks=both(track("7"), track("8", y=7.0))))
    assert kinds(scenario(tracks=replace(track(y=9.0), width=np.array([7.0])))) == {FaultKind.SIZE}


@given(st.floats(0.8, 2.3), st.sampled_from([1.0, -1.0]))
@settings(max_examples=20, deadline=None)
def test_a_car_that_steps_across_its_axis_is_found(angle: float, side: float) -> None:
    off = scenario(
        tracks=moved(
            moved(track(), "x", later(4.0 * np.cos(angle) - 0.8)), "y", later(4.0 * np.sin(angle))
        )
    )
    (found,) = (one for one in findings(off) if one.kind is FaultKind.ACROSS)
    assert found.who == "7" and found.t_from == pytest.approx(4.0)
    assert found.value == pytest.approx(min(angle, np.pi - angle), abs=1e-6)
    ahead = scenario(tracks=moved(track(), "x", later(4.0 * side - 0.8)))
    assert FaultKind.ACROSS not in kinds(ahead), "forward and backward are along the axis"


def test_many_short_tracks_are_one_finding() -> None:
    few = both(track(), track("8", 7.0, t=T[:2]))
    assert FaultKind.SHORT not in kinds(scenario(tracks=few))
    (found,) = (
        one
        for one in findings(scenario(tracks=both(few, track("9", 11.0, t=T[:1]))))
        if one.kind is FaultKind.SHORT
    )
    assert found.value == 2.0 and "2 of 3 tracks of vehicles" in found.text


def test_a_phantom_is_named_with_its_time() -> None:
    there = track("ghost", y=0.0, v=0.0, t=T[AT - 3 : AT + 4], x0=40.0)
    found = [one for one in findings(scenario(tracks=there)) if one.kind is FaultKind.PHANTOM]
    assert [one.who for one in found] == [
        "ghost"
    ] and "the logged ego stands in car ghost" in found[0].text


def test_a_map_that_is_elsewhere_and_a_broken_graph_are_found() -> None:
    def lane(name: int, x: float, y: float, successors: tuple[int, ...]) -> Lane:
        along = x + np.linspace(0.0, 50.0, 11)
        left, right = (np.column_stack([along, np.full(11, y + side)]) for side in (1.75, -1.75))
        return Lane(name, left, right, successors)

    def on(*lanes: Lane) -> Scenario:
        return replace(scenario(), road=Road({one.id: one for one in lanes}, RoadSource.LANES))

    whole = on(lane(1, 0.0, 0.0, (2,)), lane(2, 50.0, 0.0, ()))
    assert findings(whole) == ()
    (far,) = findings(on(lane(1, 0.0, 30.0, (2,)), lane(2, 50.0, 30.0, ())))
    assert far.kind is FaultKind.OFF_MAP and far.value == 1.0 and "up to 30.1 m from" in far.text
    loop, apart = findings(on(lane(1, 0.0, 0.0, (1, 2)), lane(2, 58.0, 0.0, ())))[-2:]
    assert "lane 1 follows itself" in loop.text and "begins 8.0 m from its end" in apart.text
    (edge,) = findings(on(lane(1, 0.0, 0.0, (8,)), lane(2, 50.0, 0.0, (9,))))
    assert "2 of 2 lanes are followed only by lanes that are not in the map" in edge.text


def test_a_light_that_no_line_names_is_found() -> None:
    lights = [TrafficLight(name, np.array([0.0]), (Colour.RED,)) for name in (5, 6)]
    (found,) = findings(scenario(lights=tuple(lights)))
    assert (
        found.kind is FaultKind.LIGHT
        and found.text == "2 lights are shown, but the road has no stop lines"
    )
    lined = replace(
        scenario().road,
        stop_lines=(StopLine(1, 0, np.array([[70.0, 2.0], [70.0, -2.0]]), light=6),),
    )
    (found,) = findings(replace(scenario(lights=tuple(lights)), road=lined))
    assert found.kind is FaultKind.LIGHT and found.who == "5"


def test_all_checks_of_a_log_are_documented() -> None:
    text = (DOCS / "logs.md").read_text(encoding="utf-8")
    for row in rows():
        assert f"| {' | '.join(row)} |" in text


def test_findings_go_into_the_results(tmp_path: Path) -> None:
    ego = drive()
    write_scenario(tmp_path / "log.mcap", scenario(replace(ego, x=later(5.0)(np.array(ego.x)))))
    run = RunConfig(("constant_speed",), mode="open", recording=False, internals="none")
    result = evaluate_logs([tmp_path / "log.mcap"], run, tmp_path / "out")
    found = pd.read_parquet(tmp_path / "out" / "health.parquet")
    assert found["kind"].tolist() == ["ego jump"] and found["log"].tolist() == ["made"]
    assert any(note.startswith("Health, ego jump:") for note in result.logs.iloc[0].notes)
    again = evaluate_logs([tmp_path / "log.mcap"], run, tmp_path / "out", resume=True)
    assert again.resumed == 1 and pd.read_parquet(tmp_path / "out" / "health.parquet").equals(found)


POINTS = {"centre": 1.354, "front bumper": 3.608, "rear bumper": -0.9}


def in_bends(rate: float, ahead: float, noise: float, delay: float = 0.0) -> Trajectory:
    """A drive through bends whose positions are those of a point `ahead` m of the rear axle, and
    whose headings are late by `delay` s.
    """
    t = np.arange(0.0, 20.0, 0.005)
    yaw = 0.9 * np.sin(0.4 * t)
    v = 7.0 + 2.0 * np.sin(0.9 * t)
    x, y = np.cumsum(v * np.cos(yaw)) * 0.005, np.cumsum(v * np.sin(yaw)) * 0.005
    keep = slice(None, None, round(200 / rate))
    rng = np.random.default_rng(5)
    dx, dy = noise * rng.normal(size=(2, len(t[keep])))
    place_x, place_y = x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)
    late = np.interp(t - delay, t, yaw)
    kappa = 0.36 * np.cos(0.4 * t) / v
    columns = (late, v, 0.0 * t, kappa)
    return Trajectory(
        t[keep], place_x[keep] + dx, place_y[keep] + dy, *(column[keep] for column in columns)
    )


@pytest.mark.parametrize("rate", [5.0, 10.0, 50.0])
@pytest.mark.parametrize("point", POINTS)
def test_positions_of_another_point_than_the_rear_axle_are_found(point: str, rate: float) -> None:
    ego = in_bends(rate, POINTS[point], 0.02)
    log = Scenario("made", ego, Tracks.empty(), scenario().road, 20.0, tags=("recorded",))
    (found,) = (one for one in findings(log) if one.kind is FaultKind.EGO_POINT)
    assert found.value == pytest.approx(POINTS[point], abs=0.15)
    assert point in found.text and "ego_point" in found.text


@pytest.mark.parametrize("rate", [5.0, 10.0, 50.0])
@pytest.mark.parametrize(("noise", "delay"), [(0.0, 0.0), (0.05, 0.0), (0.02, 0.1), (0.02, 0.2)])
def test_noise_and_late_headings_are_no_other_point(
    noise: float, delay: float, rate: float
) -> None:
    ego = in_bends(rate, 0.0, noise, delay)
    log = Scenario("made", ego, Tracks.empty(), scenario().road, 20.0, tags=("recorded",))
    assert FaultKind.EGO_POINT not in kinds(log)


def test_times_that_are_numbers_of_frames_are_named() -> None:
    t = np.arange(120.0)
    ego = Trajectory(t, 0.4 * t, 0.0 * t, 0.0 * t, 0.0 * t + 10.0, 0.0 * t, 0.0 * t)
    log = Scenario("made", ego, Tracks.empty(), scenario().road, 119.0, tags=("recorded",))
    (found,) = (one for one in findings(log) if "frames of 25 Hz" in one.text)
    assert 'columns = {t = "t [25 Hz]"}' in found.text
