"""What a recording tells: the others as the planner was shown them, lanes, why, the road.

Two drives in one.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from recordings import Recording
from sample_drive import drive, road

from replan.core.errors import ConfigError
from replan.draw.recording import write_log_recording, write_recording
from replan.draw.recording.moving import futures, hatching, perceived_only, rim, unseen
from replan.draw.recording.pages import why
from replan.draw.recording.pictures import span
from replan.draw.recording.road_layer import LIGHTS
from replan.draw.recording.state_rows import changes_under_way, choices, lanes_driven
from replan.draw.view import difference, write_pair
from replan.explain import Explanation, accounts
from replan.explain.drive_events import events
from replan.explain.explanation import describe_choice, lane_options
from replan.logs.agents import AgentKind, Agents
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, Predictions, Visibility
from replan.logs.plan import LaneOption, Plan
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import KEPT_STEP_S, PlannedFrame, Trace
from replan.logs.tracks import Tracks
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

EGO = EgoState(3.0, 0.0, 0.0, 0.0, 10.0)
PLAN = drive()[0].trace.frames[30].plan


def page(trace: Trace, index: int, *more: object) -> str:
    """The page of a frame."""
    _, world = drive()
    account = list(accounts(trace, world))[index]
    return "\n".join(why(trace.frames[index], Explanation.of(trace.frames[index], account), *more))  # type: ignore[arg-type]


def agents(count: int) -> Agents:
    """So many cars at the origin."""
    zero = np.zeros(count)
    ids = tuple(f"car {i}" for i in range(count))
    return Agents(
        ids, (AgentKind.CAR,) * count, zero + 4.0, zero + 2.0, zero, zero, zero, zero, zero
    )


@given(st.integers(0, 90), st.sampled_from([0.05, 0.1, 0.2, 0.5, 0.7]), st.integers(0, 3))
def test_recorded_predictions_are_a_subset_of_the_frame(steps: int, step: float, rows: int) -> None:
    t = 3.0 + step * np.arange(steps + 1)
    x = np.arange(rows)[:, None] + t[None, :]
    some = Predictions(
        t, np.zeros(rows, np.int64), np.ones(rows), x, -x, 0.0 * x, "constant_velocity"
    )
    kept = PlannedFrame.of(Frame(3.0, EGO, agents(rows), some), PLAN).predictions
    assert kept is not None
    assert kept.t[0] == t[0] and kept.t[-1] == t[-1]
    assert np.diff(kept.t).max(initial=0.0) <= max(KEPT_STEP_S, step) + 0.5 * step + 1e-9
    for row in range(rows):
        np.testing.assert_array_equal(kept.x[row], row + kept.t)


def visibility(
    shadows: np.ndarray, *, field_of_view: float = 7.0, reach: float = 40.0
) -> Visibility:
    return Visibility(0.0, 0.0, 0.3, reach, field_of_view, shadows)


@given(st.floats(5.0, 30.0), st.floats(-3.0, 3.0), st.floats(0.3, 3.0))
def test_hatched_ground_is_hidden_ground(away: float, turn: float, half: float) -> None:
    along, left = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    near = [away * along - half * left, away * along + half * left]
    far = [60.0 / away * corner for corner in near]
    seen = visibility(np.array([[near[0], far[0], far[1], near[1]]]))
    lines = hatching(seen)
    assert lines
    middles = np.array([line.mean(axis=0) for line in lines[1:-1]]).reshape(-1, 2)
    assert seen.hides(middles).all()
    assert all(np.hypot(*line[1]) == pytest.approx(40.0) for line in lines)


@given(st.floats(0.2, 6.2), st.floats(5.0, 100.0))
def test_the_rim_of_the_sensor_is_the_edge_of_what_it_sees(view: float, reach: float) -> None:
    seen = visibility(np.empty((0, 4, 2)), field_of_view=view, reach=reach)
    (edge,) = rim(seen)
    corners = edge[1:-1]
    assert not seen.hides(0.999 * corners[1:-1]).any()
    assert seen.hides(1.001 * corners).all()


# -------------------------------------------------------------------------------------------- a
# drive by a sensor


@pytest.fixture(scope="module")
def sensed() -> Drive:
    scenario = CATALOGUE["paper/crossing_pedestrian"].scenario()
    config = LoopConfig(perception="sensor", prediction="pedestrian")
    return run_closed_loop(scenario, "constant_speed", config=config)


def test_a_drive_keeps_what_the_planner_was_shown(sensed: Drive) -> None:
    trace = sensed.trace
    assert trace.perceived is not None
    for frame in trace.frames:
        assert frame.predictions is not None and frame.visibility is not None
        assert frame.predictions.t[0] == pytest.approx(frame.t)
        assert np.diff(frame.predictions.t) == pytest.approx(KEPT_STEP_S)
        shown = perceived_only(trace, frame.t)
        assert set(shown.ids) == set(frame.agents)
        for i, agent in enumerate(frame.predictions.agent):
            at = shown.ids.index(frame.agents[agent])
            assert frame.predictions.x[i, 0] == pytest.approx(shown.x[at])


def test_the_recording_draws_hypotheses_ghosts_and_the_sensor(
    sensed: Drive, tmp_path: Path
) -> None:
    scenario = CATALOGUE["paper/crossing_pedestrian"].scenario()
    write_recording(tmp_path / "sensed.rrd", sensed, scenario)
    recording = Recording(tmp_path / "sensed.rrd")
    trace = sensed.trace
    ghosts = recording.counts("/world/perceived", "Boxes3D:centers")
    assert ghosts.tolist() == [len(frame.agents) for frame in trace.frames]
    at = recording.points("/world/perceived", "Boxes3D:centers")
    assert trace.perceived is not None
    assert at[:, 0] == pytest.approx(trace.perceived.x, abs=1e-3)
    drawn = recording.counts("/world/predictions", "LineStrips3D:strips")
    expected = [
        len(futures(f, f.visibility.x, f.visibility.y)) for f in trace.frames if f.visibility
    ]
    assert drawn.tolist() == expected and max(expected) == 1


def test_a_false_detection_is_drawn(sensed: Drive, tmp_path: Path) -> None:
    """A perception of one's own may show false positives."""
    world = replace(CATALOGUE["paper/crossing_pedestrian"].scenario(), tracks=Tracks.empty())
    false = replace(sensed, trace=replace(sensed.trace, agents=Tracks.empty()))
    write_recording(tmp_path / "false.rrd", false, world)
    recording = Recording(tmp_path / "false.rrd")
    ghosts = recording.counts("/world/perceived", "Boxes3D:centers")
    assert (
        ghosts.tolist() == [len(frame.agents) for frame in false.trace.frames] and max(ghosts) == 1
    )
    assert recording.counts("/world/predictions", "LineStrips3D:strips").max() == 1
    assert (recording.counts("/world/sensor/edge", "LineStrips3D:strips") == 1).all()


def test_likelier_futures_are_brighter_and_far_ones_are_left_out(tmp_path: Path) -> None:
    done, world = drive()
    frame = done.trace.frames[0]
    t = np.arange(0.0, 4.1, 0.5)
    start, speed = (
        np.array([[20.0], [20.0], [20.0], [200.0]]),
        np.array([[1.0], [2.0], [0.0], [1.0]]),
    )
    x = frame.plan.trajectory.x[0] + start + speed * t
    some = Predictions(
        t, np.arange(4) // 2, np.array([0.8, 0.2, 1.0, 1.0]), x, 0.0 * x, 0.0 * x, "made up"
    )
    shown = replace(frame, agents=("car 12", "ped 7"), predictions=some)
    trace = replace(done.trace, frames=(shown, *done.trace.frames[1:]))
    write_recording(tmp_path / "some.rrd", replace(done, trace=trace), world)
    recording = Recording(tmp_path / "some.rrd")
    assert recording.counts("/world/predictions", "LineStrips3D:strips").tolist() == [2] + [0] * 199
    alpha = (
        np.asarray(recording.column("/world/predictions", "LineStrips3D:colors").flatten()) & 0xFF
    )
    assert alpha[0] > alpha[1] > 0


def test_ground_truth_draws_ghosts_of_extrapolated_agents_alone() -> None:
    done, _ = drive()
    trace = replace(done.trace, agents=_cut(done.trace, "car 12", 5.0))
    assert perceived_only(trace, 4.9).ids == ()
    assert perceived_only(trace, 5.3).ids == ("car 12",)
    assert perceived_only(trace, 6.0).ids == ()


def _cut(trace: Trace, agent: str, end: float) -> Tracks:
    """The tracks with one that ends earlier."""
    tracks = trace.agents
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    return tracks.taken((owner != tracks.ids.index(agent)) | (tracks.t <= end))


def test_an_undetected_agent_is_named_with_its_distance() -> None:
    done, _ = drive()
    trace = replace(done.trace, perceived=done.trace.agents)
    assert unseen(trace, 0.0) == []
    missing = unseen(replace(trace, perceived=_cut(trace, "car 12", 5.0)), 6.0)
    assert [name for name, _ in missing if name != "parked 3"] == ["car 12"]
    truth = trace.agents.truth(6.0)
    at = truth.ids.index("car 12")
    ego = trace.ego.at(6.0)
    assert dict(missing)["car 12"] == pytest.approx(
        np.hypot(truth.x[at] - ego.x, truth.y[at] - ego.y)
    )
    text = page(done.trace, 60, missing)
    assert "**Not seen by the sensor:**" in text and "car 12 (" in text


# -------------------------------------------------------------------------------------------------
# lanes and why


def compared(frame: PlannedFrame, name: str, against: str) -> PlannedFrame:
    """The frame with a choice between its lane and the left one; `name` is not taken."""
    costs = {
        "keep": (("time lost", 7.4), ("change", 0.0)),
        "left": (("time lost", 0.3), ("change", 1.0)),
    }
    internals = [
        LaneOption(lane, terms, against if lane == name else "") for lane, terms in costs.items()
    ]
    return replace(frame, plan=replace(frame.plan, internals=(*frame.plan.internals, *internals)))


def changing() -> Trace:
    """Neighbours compared from 1 s, the left one taken at 2 s; the ego never leaves its lane."""
    done, _ = drive()
    frames = list(done.trace.frames)
    for i in range(10, 20):
        frames[i] = compared(frames[i], "left", "car 7 is beside")
    frames[20] = compared(frames[20], "keep", "costs 7.4 s, left 1.3 s")
    return replace(done.trace, frames=tuple(frames))


def test_a_lane_change_is_described_with_its_costs() -> None:
    trace = changing()
    lines = [event for event in events(trace) if "changes lane" in event.words]
    assert [event.t for event in lines] == [2.0]
    assert (
        "to the left: costs 1.3 s (time lost 0.3, change 1.0) instead of keep 7.4 s"
        in lines[0].words
    )
    text = page(trace, 15)
    assert "- **left**: 1.3 s (time lost 0.3, change 1.0); car 7 is beside" in text
    assert "- **keep**: 7.4 s (time lost 7.4); taken" in text
    assert describe_choice(lane_options(trace.frames[20].plan)).endswith(
        "keep 7.4 s (time lost 7.4)"
    )


def test_a_change_is_under_way_until_the_lane_is_left() -> None:
    trace = changing()
    lanes = [*[1] * 35, *[2] * 165]
    rows = choices(trace.frames, lanes)
    assert [rows[i] for i in (0, 15, 20, 34, 35)] == [
        "keep",
        "keep: others compared",
        "change left",
        "change left",
        "keep",
    ]
    under_way = changes_under_way(trace.frames, lanes)
    assert under_way[30] is not None and under_way[30].t == 2.0
    assert "Changes lane to the left** since t = 2.00 s" in page(trace, 30, (), under_way[30])


def test_the_lane_under_the_ego_is_the_one_it_drives() -> None:
    done, _ = drive()
    driven = lanes_driven(done.trace, road())
    assert set(driven) == {1}
    aside = replace(done.trace.ego, x=done.trace.ego.x + 1e4)
    assert set(lanes_driven(replace(done.trace, ego=aside), road())) == {None}


def test_rows_of_lanes_are_in_the_recording(tmp_path: Path) -> None:
    done, world = drive()
    write_recording(tmp_path / "some.rrd", replace(done, trace=changing()), world)
    recording = Recording(tmp_path / "some.rrd")
    states = recording.column("/Choice-of-lane", "StateChange:state").flatten().to_pylist()
    assert [state.rstrip() for state in states] == ["keep", "keep: others compared", "change left"]
    assert "/Lane" not in recording.moving, "one lane needs no row"


def test_the_reason_of_a_plan_is_shown_and_is_an_event_once() -> None:
    done, _ = drive()
    reasons = ["", "braking leaves 1.2 m", "braking leaves 1.1 m", "", "braking leaves 1.0 m"]
    frames = tuple(
        PlannedFrame(frame.t, Plan(frame.plan.trajectory, reason=reason))
        for frame, reason in zip(done.trace.frames, reasons, strict=False)
    )
    found = [
        event.t for event in events(replace(done.trace, frames=frames)) if "leaves" in event.words
    ]
    assert found == pytest.approx([0.1, 0.4])
    assert "**Reason: braking leaves 1.1 m**" in page(replace(done.trace, frames=frames), 2)


def recorded(path: Path, scenario: Scenario) -> Recording:
    write_log_recording(path / "log.rrd", scenario)
    return Recording(path / "log.rrd")


def lights_over_time(recording: Recording) -> dict[float, list[int]]:
    rows = recording.column("/world/lights", "Points3D:colors").to_pylist()
    return dict(zip(recording.times("/world/lights").tolist(), rows, strict=True))


def test_a_light_changes_when_the_log_says_so(tmp_path: Path) -> None:
    scenario = CATALOGUE["everyday/traffic_light"].scenario(green_s=6.0, duration_s=20.0)
    recording = recorded(tmp_path, scenario)
    changes = {0.0: Colour.RED, 5.0: Colour.RED_YELLOW, 6.0: Colour.GREEN}
    assert lights_over_time(recording) == {t: [LIGHTS[colour]] for t, colour in changes.items()}
    x, y, z = recording.points("/world/lights", "Points3D:positions")[0]
    np.testing.assert_allclose([x, y], scenario.road.stop_lines[0].points.mean(axis=0), atol=1e-4)
    assert z > 0.0


def test_a_light_that_is_not_known_is_grey_and_lines_have_their_colours(tmp_path: Path) -> None:
    made = CATALOGUE["everyday/traffic_light"].scenario(duration_s=2.0)
    (line,) = made.road.stop_lines
    signed = replace(line, id=2, light=None, must_stop=True, points=line.points + 5.0)
    unknown = StopLine(3, 1, line.points + 9.0, light=77)
    road = replace(made.road, stop_lines=(line, signed, unknown))
    dark = TrafficLight(1, np.array([0.0]), (Colour.GREEN,))
    recording = recorded(tmp_path, replace(made, road=road, lights=(dark,)))
    assert lights_over_time(recording) == {0.0: [LIGHTS[Colour.GREEN], LIGHTS[Colour.OFF]]}
    for entity, count in (("stop_lines", 2), ("stop_signs", 1)):
        assert len(recording.static(f"/world/road/{entity}", "LineStrips3D:strips")) == count


@pytest.mark.parametrize("along", [0.0, 900.0])
def test_a_crosswalk_is_hatched_wherever_others_are(tmp_path: Path, along: float) -> None:
    made = CATALOGUE["everyday/crosswalk"].scenario(duration_s=2.0)
    (zebra,) = made.road.crosswalks
    others = (zebra, Crosswalk(9, zebra.polygon + np.array([along, 0.0]))) if along else (zebra,)
    recording = recorded(tmp_path, replace(made, road=replace(made.road, crosswalks=others)))
    assert len(recording.static("/world/road/crosswalks/fill", "LineStrips3D:strips")) == 6 * len(
        others
    )


def test_a_log_without_rules_draws_none(tmp_path: Path) -> None:
    recording = recorded(tmp_path, CATALOGUE["paper/free_road"].scenario())
    entities = {*recording.moving, *recording.still}
    assert not any(
        "stop" in entity or "lights" in entity or "crosswalk" in entity for entity in entities
    )


def test_the_difference_of_drives_is_antisymmetric() -> None:
    trace = drive()[0].trace
    other = replace(
        trace, ego=replace(trace.ego, x=trace.ego.x + 3.0, y=trace.ego.y - 4.0, v=trace.ego.v + 1.0)
    )
    assert all((values == 0.0).all() for values in difference(trace, trace)[1].values())
    one, two = difference(trace, other)[1], difference(other, trace)[1]
    assert one["gap"] == pytest.approx(5.0) and (one["gap"] == two["gap"]).all()
    assert one["v"] == pytest.approx(1.0) and (one["v"] == -two["v"]).all()
    t, short = difference(trace, replace(trace, ego=trace.ego.between(0.0, 5.0)))
    assert (np.isfinite(short["gap"]) == (t <= 5.0 + 1e-9)).all()


@pytest.mark.slow
def test_a_pair_holds_both_recordings_and_their_first_difference(tmp_path: Path) -> None:
    done, world = drive()
    ego = done.trace.ego
    trace = replace(done.trace, ego=replace(ego, x=ego.x + np.where(ego.t > 3, 1.0, 0)))
    files = tmp_path / "one.rrd", tmp_path / "two.rrd"
    for file, each in zip(files, (done, replace(done, trace=trace)), strict=True):
        write_recording(file, each, world)
    write_pair(tmp_path / "pair.rrd", files, (done.trace, trace), ("first", "se_cond"))
    both, single = Recording(tmp_path / "pair.rrd"), Recording(files[0])
    for side in "AB":
        kept = {f"/{side}{entity}" for entity in single.moving if not entity.startswith("/__")}
        assert kept <= set(both.moving)
    page = both.static("/parting", "TextDocument:text").to_pylist()[0]
    assert (
        "se\\_cond" in page and "First difference: t = 3.0" in page and "apart from t = 3.0" in page
    )
    assert both.times("/parts") == pytest.approx([3.01], abs=0.02)
    assert span(tmp_path / "pair.rrd") == (0.0, pytest.approx(float(trace.ego.t[-1])))
    with pytest.raises(ConfigError, match="the same log"):
        write_pair(
            tmp_path / "no.rrd", files, (done.trace, replace(trace, scenario="other")), ("a", "b")
        )
