"""Recordings: laws of text, fills and axes.

Then what is in the file, read back; then that the viewer shows it.
"""

import os
from dataclasses import replace
from pathlib import Path

import drives
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import rerun as rr
from hypothesis import given, strategies as st
from recordings import Recording
from sample_drive import BLOCKED, LINE, drive, scenario, to_world

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, OutputError
from replan.draw.drawn_scene import NEAR_M, NEAREST, rows_in_full
from replan.draw.markers import Marker
from replan.draw.panels import MEASURED, panels
from replan.draw.plan_graphs import ST
from replan.draw.recording import colours, scene_times, write_log_recording, write_recording
from replan.draw.recording.graphs import HEIGHT, LABEL_GAP, LETTER, WIDTH, Axes, spread_labels
from replan.draw.recording.pages import why
from replan.draw.recording.pictures import (
    Picture,
    ScreenshotError,
    arranged,
    click_theme,
    take_pictures,
)
from replan.draw.recording.plots import MOST_NUMBERS, with_two_numbers
from replan.draw.recording.road_layer import covered, dashes
from replan.draw.recording.tape import (
    DRAWABLE,
    Instants,
    PlaneWindow,
    Tape,
    application_name,
    cell,
    outline_segments,
    path_parts,
    plain,
    strokes,
)
from replan.explain import Explanation, accounts
from replan.explain.drive_events import events
from replan.logs.observed import MAX_AGE_S
from replan.logs.plan import Corridor, Decision, DecisionKind, GridCost, Plan, StGraph
from replan.logs.repair.detections import Repair
from replan.logs.repair.offline import detections_of
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, PlannedFrame
from replan.logs.tracks import Tracks
from replan.metrics import series
from replan.replay.drive import Drive, StageTime


@given(st.text())
def test_plain_text_is_one_line_that_the_font_has(text: str) -> None:
    shown = plain(text)
    assert set(shown) <= DRAWABLE
    assert plain(shown) == shown


@given(st.text(alphabet=st.characters(codec="ascii", categories=["L", "N"]), min_size=1))
def test_plain_text_keeps_what_can_be_drawn(text: str) -> None:
    assert plain(text) == text == cell(text)


@given(st.lists(st.text(), unique=True, max_size=12))
def test_different_words_never_share_an_entity(words: list[str]) -> None:
    parts = path_parts(words)
    assert len(set(parts.values())) == len(words)
    assert all("/" not in part.replace("\\/", "") for part in parts.values())


@given(st.text())
def test_application_names_need_no_migration(text: str) -> None:
    assert set(application_name(text)) <= set(
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 _-"
    )


coordinate = st.floats(-50.0, 50.0)
WINDOW = PlaneWindow((-20.0, 20.0), (-10.0, 15.0))


def polygon_area(points: FloatArray) -> float:
    x, y = points.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


@given(st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=9))
def test_strokes_stay_in_the_window(corners: list[tuple[float, float]]) -> None:
    filled, owner = strokes(np.array(corners), np.array([len(corners)]), WINDOW, 0.5)
    segments, _ = outline_segments(np.array(corners), np.array([len(corners)]), WINDOW)
    assert len(filled) == len(owner)
    for lines in (filled, segments):
        assert (np.abs(lines[:, :, 0]) <= 20.0 + 1e-6).all()
        assert ((lines[:, :, 1] >= -10.0 - 1e-6) & (lines[:, :, 1] <= 15.0 + 1e-6)).all()


@given(st.floats(1.0, 9.0), st.floats(1.0, 9.0), st.floats(0.0, 6.28), st.integers(3, 8))
def test_strokes_fill_the_area_of_a_convex_outline(
    a: float, b: float, turn: float, count: int
) -> None:
    angle = turn + np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    outline = np.column_stack([a * np.cos(angle), b * np.sin(angle)])
    spacing = 0.01
    filled, _ = strokes(
        outline, np.array([count]), PlaneWindow((-10.0, 10.0), (-10.0, 10.0)), spacing
    )
    area = spacing * float((filled[:, 1, 1] - filled[:, 0, 1]).sum())
    assert area == pytest.approx(polygon_area(outline), rel=0.02, abs=0.02)


def test_two_outlines_are_filled_apart() -> None:
    box = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    filled, owner = strokes(
        np.vstack([box, box + np.array([5.0, 3.0])]), np.array([4, 4]), WINDOW, 0.5
    )
    assert owner.tolist() == [0] * 4 + [1] * 4
    np.testing.assert_allclose(filled[0], [[0.25, 0.0], [0.25, 1.0]])
    np.testing.assert_allclose(filled[-1], [[6.75, 3.0], [6.75, 4.0]])


@given(st.lists(st.tuples(st.floats(0.0, 8.0), st.floats(0.0, 100.0)), max_size=6))
def test_labels_never_cover_each_other(places: list[tuple[float, float]]) -> None:
    axes = Axes(ST, (0.0, 8.0), (0.0, 100.0))
    lengths = [10] * len(places)
    placed = spread_labels(np.array(places).reshape(-1, 2), lengths, axes)
    kx, ky = axes.scale
    for i in range(len(placed)):
        for j in range(i):
            if abs(placed[i, 0] - placed[j, 0]) * kx < 10 * LETTER:
                assert abs(placed[i, 1] - placed[j, 1]) * ky >= LABEL_GAP - 1e-6


def test_counts_that_do_not_add_up_are_an_error() -> None:
    tape = Tape(rr.RecordingStream("replan test", recording_id="counts", send_properties=False))
    instants = Instants(np.array([0.0, 0.1]), np.array([0, 1]))
    with pytest.raises(ValueError, match="dots: 3 instances for rows of 4"):
        tape.rows("dots", instants, rr.Points2D.columns(positions=np.zeros((3, 2))), [2, 2])


def test_dashes_leave_gaps_and_stay_on_the_line() -> None:
    pieces = dashes(np.array([[0.0, 0.0], [5.0, 0.0], [20.0, 0.0]]))
    assert [(piece[0, 0], piece[-1, 0]) for piece in pieces] == [
        (0.0, 3.0),
        (9.0, 12.0),
        (18.0, 20.0),
    ]


def test_covered_ignores_the_own_polygon() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    corners, offsets = np.vstack([square, square + 2.0]), np.array([0, 4, 8])
    boxes = np.array([[0.0, 0.0, 4.0, 4.0], [2.0, 2.0, 6.0, 6.0]])
    points = np.array([[1.0, 1.0], [3.0, 3.0], [1.0, 1.0], [9.0, 9.0]])
    assert covered(points, np.array([0, 0, 1, 1]), corners, offsets, boxes).tolist() == [
        False,
        True,
        True,
        False,
    ]


# --------------------------------------------------------------------------------------------------
# reading back


TABLE = pd.DataFrame(
    [
        ("min gap", 1.25, "m", True, "", 9.1),
        ("ade", np.nan, "m", False, "closed loop", np.nan),
        ("collision", 0.0, "", True, "", np.nan),
    ],
    columns=["metric", "value", "unit", "available", "reason", "time_s"],
)


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Drive, Scenario, Recording]:
    path = tmp_path_factory.mktemp("closed") / "deep" / "closed.rrd"
    done, world = drive()
    write_recording(path, done, world, TABLE, series(done.trace, world))
    assert [file.name for file in path.parent.iterdir()] == ["closed.rrd"]
    return done, world, Recording(path)


@pytest.fixture
def recording(closed: tuple[Drive, Scenario, Recording]) -> Recording:
    return closed[2]


def written(
    tmp_path: Path, done: Drive, world: Scenario, table: pd.DataFrame | None = None
) -> Recording:
    write_recording(tmp_path / "some.rrd", done, world, table)
    return Recording(tmp_path / "some.rrd")


def test_both_timelines_are_in_every_row(recording: Recording) -> None:
    for batch in recording.moving.values():
        assert batch.schema.field("sim_time").type == pa.duration("ns")
        assert batch.schema.field("frame").type == pa.int64()
        assert not {"log_time", "log_tick"} & set(batch.schema.names)
    np.testing.assert_array_equal(recording.times("/why"), np.arange(200) / 10.0)
    assert recording.column("/why", "frame").to_pylist() == list(range(200))


def test_the_ego_is_where_it_was(closed: tuple[Drive, Scenario, Recording]) -> None:
    done, world, recording = closed
    ego = done.trace.ego
    t = recording.times("/world/ego")
    at = recording.points("/world/ego", "Transform3D:translation")
    np.testing.assert_allclose(at[:, 0], np.interp(t, ego.t, ego.x), atol=1e-4)
    turn = recording.points("/world/ego", "Transform3D:quaternion")
    np.testing.assert_allclose(
        2.0 * np.arctan2(turn[:, 2], turn[:, 3]), np.interp(t, ego.t, ego.yaw), atol=1e-6
    )
    center = np.asarray(recording.static("/world/ego/box", "Boxes3D:centers").flatten())
    assert center[0] == pytest.approx(
        world.vehicle.length / 2.0 - world.vehicle.rear_overhang, abs=1e-6
    )
    size = np.asarray(recording.static("/world/ego/box", "Boxes3D:half_sizes").flatten())
    np.testing.assert_allclose(
        2.0 * size[:2], [world.vehicle.length, world.vehicle.width], rtol=1e-6
    )


def test_curves_hold_the_numbers_of_the_trace(closed: tuple[Drive, Scenario, Recording]) -> None:
    done, world, recording = closed
    trace = done.trace
    assert trace.actuation is not None and trace.tracking is not None
    for entity, t, values in (
        ("/plots/speed/ego", trace.ego.t, trace.ego.v),
        ("/plots/speed/log", world.ego.t, world.ego.v),
        ("/plots/pedals/brake", trace.ego.t, trace.actuation.brake),
        ("/plots/tracking/lateral", trace.ego.t, trace.tracking.lateral),
    ):
        np.testing.assert_allclose(recording.times(entity), t, atol=1e-9)
        np.testing.assert_array_equal(recording.scalars(entity), values)
    np.testing.assert_allclose(recording.scalars("/plots/speed/limit"), 13.89)
    jerk = series(trace, world).query("metric == 'lon_jerk_state'")["value"].to_numpy()
    np.testing.assert_array_equal(
        recording.scalars("/plots/jerk/lon_jerk_state"), jerk[np.isfinite(jerk)]
    )
    stage = [timing.seconds * 1e3 for timing in done.timings if timing.stage == "path_qp"]
    np.testing.assert_allclose(recording.scalars("/plots/stages/path_qp"), stage)
    plan = recording.scalars("/plots/speed/plan")
    assert plan[537] == pytest.approx(np.interp(5.37, *plan_speed(done, 53)), abs=1e-9)


@pytest.mark.parametrize(("limit", "is_assumed"), [(5.0, False), (12.0, True)])
def test_the_drawn_limit_is_the_judged_one_and_the_assumed_one_where_none_is_judged(
    limit: float, is_assumed: bool
) -> None:
    """The largest stated limit of overlapping lanes, at the ego's centre."""
    log = drives.world(10.0)
    first = replace(drives.straight_road(limit=limit).lanes[0], successors=(1,))
    x = np.array([20.0, 500.0])
    edges = (np.column_stack([x, np.full(2, y)]) for y in (1.75, -1.75))
    lanes = {0: first, 1: Lane(1, *edges, speed_limit=8.0)}
    assumed = frozenset({0} if is_assumed else ())
    log = replace(log, road=Road(lanes, assumed_limits=assumed))
    nothing = np.empty(0)
    drawn = panels(drives.drive(log), log, lambda metric: (nothing, nothing))
    curve = next(curve for panel in drawn for curve in panel.curves if curve.name == "limit")
    reached_s = (20.0 - log.vehicle.axle_to_center) / 10.0
    np.testing.assert_array_equal(curve.values, np.where(curve.t < reached_s, limit, 8.0))


def plan_speed(done: Drive, frame: int) -> tuple[FloatArray, FloatArray]:
    path = done.trace.frames[frame].plan.trajectory
    return path.t, path.v


def test_graphs_keep_their_units(closed: tuple[Drive, Scenario, Recording]) -> None:
    done, _, recording = closed
    for k, entity in ((0, "/graphs/sl"), (1, "/graphs/st")):
        for name in ("qp", "dp"):
            drawn = recording.points(f"{entity}/window/{name}", "LineStrips2D:strips")
            told = np.concatenate(
                [getattr(frame.plan.internals[k], name) for frame in done.trace.frames]
            )
            np.testing.assert_allclose(drawn, told, rtol=1e-6, atol=1e-5)
            assert (recording.counts(f"{entity}/window/{name}", "LineStrips2D:strips") == 1).all()
        scale = np.asarray(recording.static(entity, "Transform3D:scale").flatten())
        assert abs(float(np.prod(scale.astype(float)))) == pytest.approx(1.0, rel=1e-5)
        assert scale[1] < 0.0 < scale[0]


def test_graphs_lie_within_their_plot_area(recording: Recording) -> None:
    for entity in ("/graphs/sl", "/graphs/st"):
        scale = np.asarray(recording.static(entity, "Transform3D:scale").flatten())
        moved = np.asarray(recording.static(entity, "Transform3D:translation").flatten())
        start = recording.points(f"{entity}/window", "Transform3D:translation")[:, 0]
        for name in (
            "grid",
            "obstacles",
            "obstacles/fill",
            "corridor",
            "corridor/room",
            "qp",
            "columns",
            "labels",
        ):
            for component in ("LineStrips2D:strips", "Points2D:positions"):
                batch = recording.moving[f"{entity}/window/{name}"]
                if component in batch.schema.names:
                    inside_plot_area(batch, component, start, scale, moved)


def inside_plot_area(
    batch: pa.RecordBatch, component: str, start: FloatArray, scale: FloatArray, moved: FloatArray
) -> None:
    for row, instances in enumerate(batch.column(component)):
        flat = instances.values
        while pa.types.is_list(flat.type) or pa.types.is_fixed_size_list(flat.type):
            flat = flat.flatten()
        points = np.asarray(flat, dtype=float).reshape(-1, 2)
        x = (points[:, 0] + start[row if len(batch) > 1 else 0]) * scale[0] + moved[0]
        y = points[:, 1] * scale[1] + moved[1]
        assert ((x >= -0.01) & (x <= WIDTH + 0.01)).all(), (component, row)
        assert ((y <= 0.01) & (y >= -HEIGHT - 0.01)).all(), (component, row)


def test_the_pedestrian_blocks_the_graph_until_it_has_left(recording: Recording) -> None:
    labels = recording.column("/graphs/st/window/labels", "Points2D:labels").to_pylist()
    assert "ped 7: yield" in labels[80]
    assert all("ped 7: yield" not in row for row in labels[round(10 * BLOCKED[1]) + 1 :])
    names = recording.column("/world/agents/names", "Points3D:labels").to_pylist()
    assert {"ped 7: yield", "car 12: follow"} <= set(names[80])


def test_lanes_of_states_change_when_the_plans_do(recording: Recording) -> None:
    states = recording.column("/Plan", "StateChange:state").to_pylist()
    assert list(zip(recording.times("/Plan").tolist(), states, strict=True)) == [
        (0.0, ["planned"]),
        (14.0, ["previous plan "]),  # too short for its label
        (14.3, ["planned"]),
    ]
    assert recording.column("/Drive", "StateChange:state").to_pylist() == [
        ["driving"],
        ["goal reached "],
    ]
    for lane in ("Plan", "Decision-along", "Decision-across", "Drive"):
        shown = set(recording.column(f"/{lane}", "StateChange:state").flatten().to_pylist())
        assert shown == set(recording.static(f"/{lane}", "StateConfiguration:values").to_pylist())
    labels = recording.static("/Plan", "StateConfiguration:labels").to_pylist()
    assert labels == ["planned", " "]


def test_the_why_page_has_decisions_reasons_solvers_and_costs(recording: Recording) -> None:
    pages = recording.column("/why", "TextDocument:text").flatten().to_pylist()
    assert "t = 8.00 s: slows down: yield" in pages[80]
    for words in ("Slows down for ped 7 (yield)", "in the path until 11.5 s"):
        assert words in pages[80]
    inside = recording.column("/numbers", "TextDocument:text").flatten().to_pylist()
    for words in ("speed QP", "75 iterations", "obstacle 3.5"):
        assert words in inside[80] and words not in pages[80]
    assert "the previous plan goes on" in pages[141] and "not solved" in inside[141]
    assert "Slows down" not in pages[141]


def test_the_summary_and_the_properties_hold_the_metrics(recording: Recording) -> None:
    page = recording.static("/summary", "TextDocument:text").to_pylist()[0]
    for words in (
        "sample/s\\_curve",
        "dp\\_qp",
        "closed loop",
        "goal reached",
        "1.25 m",
        "not available",
    ):
        assert words in page
    (properties,) = recording.still["/__properties/metrics"]
    assert {
        name: properties.column(name)[0].values[0].as_py() for name in ("min_gap", "collision")
    } == {
        "min_gap": 1.25,
        "collision": 0.0,
    }
    assert "ade" not in properties.schema.names


def test_static_things_are_written_once(recording: Recording) -> None:
    for entity in ("/world/road/surface", "/world/road/edges", "/world/goal", "/summary"):
        assert len(recording.still[entity]) == 1
        assert entity not in recording.moving


def test_no_box_is_not_finite(recording: Recording) -> None:
    for entity, batch in recording.moving.items():
        for name in batch.schema.names:
            if name.split(":")[0] in ("Boxes3D", "Transform3D", "Arrows3D") and not name.endswith(
                ("labels", "colors")
            ):
                assert np.isfinite(recording.points(entity, name)).all()


def test_an_open_loop_recording_shows_no_pedals(tmp_path: Path) -> None:
    recording = written(tmp_path, *drive(Mode.OPEN))
    assert not [entity for entity in recording.moving if "pedals" in entity or "error" in entity]
    assert "/world/log/ego" not in recording.moving
    foreseen = recording.scalars("/plots/speed/plan_1s")
    np.testing.assert_allclose(
        recording.times("/plots/speed/plan_1s"), np.arange(10, len(foreseen) + 10) / 10.0
    )


def bare(done: Drive, *, frames: int) -> Drive:
    """The drive with plans that tell nothing of themselves."""
    plans = tuple(PlannedFrame(f.t, Plan(f.plan.trajectory)) for f in done.trace.frames[:frames])
    ego = done.trace.ego.between(0.0, max(0.1 * (frames - 1), 0.0))
    trace = replace(done.trace, frames=plans, ego=ego, commands=None, actuation=None, tracking=None)
    return Drive(trace, ())


@pytest.mark.parametrize("frames", [0, 1, 2, 30])
def test_a_planner_without_internals_is_recorded(tmp_path: Path, frames: int) -> None:
    done, world = drive(Mode.OPEN)
    recording = written(tmp_path, bare(done, frames=frames), world)
    assert not [entity for entity in recording.moving if entity.startswith("/graphs")]
    assert len(recording.times("/world/ego")) == max(frames, 1)
    assert ("/why" in recording.moving) == (frames > 0)


def test_no_agents_and_no_metrics(tmp_path: Path) -> None:
    done, world = drive()
    empty = Drive(replace(done.trace, agents=Tracks.empty()), ())
    recording = written(tmp_path, empty, replace(world, tracks=Tracks.empty(), goal=None))
    assert recording.counts("/world/agents/names", "Points3D:labels").sum() == 0
    assert "/__properties/metrics" not in recording.still


def test_agents_are_drawn_only_while_they_exist(tmp_path: Path) -> None:
    done, world = drive()
    tracks = done.trace.agents
    moving = np.repeat(~tracks.static, np.diff(tracks.offsets))
    part = tracks.taken(moving & (tracks.t >= 5.0) & (tracks.t <= 8.0))
    recording = written(tmp_path, Drive(replace(done.trace, agents=part), ()), world)
    counts = recording.counts("/world/agents/car", "Boxes3D:centers")
    times = recording.times("/world/agents/car")
    np.testing.assert_array_equal(
        counts, ((times >= 5.0 - 1e-9) & (times <= 8.0 + 1e-9)).astype(int)
    )


def test_removed_tracks_are_a_separate_entity(tmp_path: Path) -> None:
    done, world = drive()
    tracks = done.trace.agents
    keep = np.repeat(np.arange(len(tracks)) == 0, np.diff(tracks.offsets)) & (tracks.t <= 4.0)
    removed = replace(tracks.taken(keep), ids=("removed 1",))
    made = Repair(detections_of(tracks), removed, np.zeros(len(tracks.t), np.bool_), (), tracks)
    recording = written(tmp_path, done, replace(world, repair=made))
    counts, times = (
        recording.counts("/world/removed", "Boxes3D:centers"),
        recording.times("/world/removed"),
    )
    np.testing.assert_array_equal(counts, (times <= 4.0 + MAX_AGE_S + 1e-6).astype(int))
    assert "/world/removed" not in written(tmp_path, done, world).moving


@pytest.mark.slow
def test_three_hundred_agents_are_all_drawn_and_few_are_named(tmp_path: Path) -> None:
    recording = written(tmp_path, *drive(extra=300))
    assert (recording.counts("/world/agents/car", "Boxes3D:centers") == 302).all()
    assert recording.counts("/world/agents/names", "Points3D:labels").max() <= 12


def test_names_are_short_in_pictures_and_in_words(tmp_path: Path) -> None:
    whole = "23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4"
    done, world = drive(pedestrian=whole)
    trace = replace(done.trace, detail=f"pedestrian {whole}")
    texts = list(written(tmp_path, replace(done, trace=trace), world).texts())
    assert not any(whole in text for text in texts)
    assert {"23f7: yield", "23f7: stop"} & set(texts)
    assert any("pedestrian 23f7" in text for text in texts)


def test_words_of_users_become_drawable(tmp_path: Path) -> None:
    done, world = drive(pedestrian="\u884c\u4eba \u274c|7*\n\u0301")
    odd = "stage/\u65e5 \u672c"
    timings = (StageTime(0.0, odd, 0.001), StageTime(0.0, "stage/\u672c \u65e5", 0.002))
    trace = replace(
        done.trace, planner="mod:\u2705Class", detail="\u0000\u200b", notes=("\U0001f600",)
    )
    recording = written(tmp_path, Drive(trace, timings), replace(world, name="a b/\u65e5 ."))
    assert all(set(text) <= DRAWABLE | {"\n"} for text in recording.texts())
    assert len([entity for entity in recording.moving if entity.startswith("/plots/stages")]) == 2
    labels = recording.column("/world/agents/names", "Points3D:labels").flatten().to_pylist()
    assert any("?? ?|7*" in label for label in labels)


def test_values_that_are_not_finite_are_gaps_or_clipped(tmp_path: Path) -> None:
    done, world = drive()
    assert done.trace.tracking is not None
    errors = replace(done.trace.tracking, heading=np.full(len(done.trace.ego), np.nan))
    errors = replace(errors, lateral=np.where(done.trace.ego.t < 1.0, np.inf, errors.lateral))
    free = np.full(81, np.inf)
    graph = done.trace.frames[0].plan.internals[1]
    assert isinstance(graph, StGraph) and graph.grid is not None
    grid = GridCost(
        graph.grid.first,
        graph.grid.second,
        np.full(graph.grid.cost.shape, np.inf),
        graph.grid.chosen,
    )
    open_graph = replace(
        graph, corridor=Corridor(np.linspace(0.0, 8.0, 81), -free, free), grid=grid, dp=np.empty(0)
    )
    plan = replace(done.trace.frames[0].plan, internals=(open_graph,))
    trace = replace(done.trace, frames=(PlannedFrame(0.0, plan),), tracking=errors)
    recording = written(tmp_path, Drive(trace, ()), world)
    assert "/plots/tracking_heading/heading" not in recording.moving
    assert np.isnan(recording.scalars("/plots/tracking/lateral")[:99]).all()
    assert np.isfinite(recording.points("/graphs/st/window/corridor", "LineStrips2D:strips")).all()
    assert recording.counts("/graphs/st/window/grid", "Points2D:positions").tolist() == [0]
    assert recording.counts("/graphs/st/window/dp", "LineStrips2D:strips").tolist() == [0]


def test_a_failed_writing_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, world = drive()
    monkeypatch.setattr("replan.draw.recording.pages.draw_why", lambda *_: 1 / 0)
    before = rr.strict_mode()
    with pytest.raises(ZeroDivisionError):
        write_recording(tmp_path / "some.rrd", done, world)
    assert list(tmp_path.iterdir()) == []
    assert rr.strict_mode() is before
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        write_recording(tmp_path / "file" / "some.rrd", done, world)


def test_a_log_is_recorded_without_a_drive(tmp_path: Path) -> None:
    world = scenario()
    write_log_recording(tmp_path / "log.rrd", world)
    recording = Recording(tmp_path / "log.rrd")
    np.testing.assert_array_equal(recording.scalars("/plots/speed/ego"), world.ego.v)
    assert len(recording.times("/world/ego")) == 201
    assert not {"/why", "/events", "/Plan"} & set(recording.moving)
    start = replace(world, ego=world.ego.between(0.0, 0.0))
    write_log_recording(tmp_path / "start.rrd", start)
    assert len(Recording(tmp_path / "start.rrd").times("/world/agents/truck")) == 201


def test_events_of_a_log_are_rows_on_its_timeline_and_lines_of_its_list(tmp_path: Path) -> None:
    found = (
        Marker(2.0, 4.0, "cut_in", "car 1"),
        Marker(3.0, 3.5, "cut_in", "car 2"),
        Marker(1.0, 30.0, "queue", ""),
    )
    write_log_recording(tmp_path / "log.rrd", scenario(), found)
    recording = Recording(tmp_path / "log.rrd")
    assert recording.times("/cut-in").tolist() == [0.0, 2.0, 3.0, 3.5, 4.0]
    assert recording.times("/queue").tolist() == [0.0, 1.0]
    assert recording.times("/events").tolist() == [1.0, 2.0, 3.0]
    states = [
        text.strip()
        for text in recording.column("/cut-in", "StateChange:state").flatten().to_pylist()
    ]
    assert states == ["none", "car 1", "car 1; car 2", "car 1", "none"]


def test_the_scene_is_drawn_at_every_frame_and_where_frames_are_rare() -> None:
    done, _ = drive()
    rare = replace(done.trace, frames=(done.trace.frames[0], done.trace.frames[55]))
    times = scene_times(rare, 20.0)
    assert np.diff(times).max() <= 0.16 and np.diff(times).min() > 1e-3
    assert {0.0, 5.5, 20.0} <= set(times.tolist())


def test_events_name_changes_and_the_end() -> None:
    done, _ = drive()
    trace = replace(done.trace, end=EndReason.COLLISION, detail="car 12")
    found = events(trace)
    assert (found[-1].level, found[-1].words, found[-1].t) == ("ERROR", "collision: car 12", 20.0)
    assert [event.t for event in found if event.level == "WARN"] == [14.0]
    assert [event.t for event in found] == sorted(event.t for event in found)


def test_many_decisions_are_counted_not_listed() -> None:
    done, world = drive()
    ignored = tuple(Decision(f"car {i}", DecisionKind.IGNORE, "path", "far") for i in range(300))
    stop = Decision("wall", DecisionKind.STOP, "speed", "ahead")
    frame = PlannedFrame(0.0, replace(done.trace.frames[0].plan, internals=(*ignored, stop)))
    (account,) = accounts(replace(done.trace, frames=(frame,)), world)
    page = "\n".join(why(frame, Explanation.of(frame, account)))
    assert "- **wall: stop** (speed): ahead" in page and "and 286 more" in page


# --------------------------------------------------------------------------------------------------
# viewer

DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")


@pytest.fixture(scope="module")
def viewer() -> None:
    if not any(list(Path(folder).glob("*.json")) for folder in DRIVERS):
        pytest.skip("no Vulkan driver: the viewer cannot draw (Debian: mesa-vulkan-drivers)")


def test_a_viewer_that_cannot_draw_names_the_driver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rerun").write_text(
        "#!/bin/sh\necho begin\necho thread panicked at here\nexit 102\n", encoding="utf-8"
    )
    (tmp_path / "rerun").chmod(0o755)
    monkeypatch.setattr("replan.draw.recording.pictures.files", lambda _: tmp_path)
    for drivers, reason in (
        ((), "no Vulkan driver; install one .*mesa-vulkan-drivers"),
        (tmp_path, ": thread panicked"),
    ):
        (tmp_path / "lvp.json").touch()
        monkeypatch.setattr("replan.draw.recording.pictures.DRIVERS", (drivers,) if drivers else ())
        with pytest.raises(ScreenshotError, match=f"ended with code 102.*{reason}"):
            take_pictures(tmp_path / "no.rrd", [Picture(tmp_path / "all.png", 0.0)])


@pytest.mark.slow
@pytest.mark.usefixtures("viewer")
def test_the_viewer_draws_all_views_without_a_complaint(tmp_path: Path) -> None:
    done, world = drive(pedestrian="".join(sorted(DRAWABLE)))
    write_recording(
        tmp_path / "closed.rrd", done, replace(world, name="".join(sorted(DRAWABLE))), TABLE
    )
    pictures = [
        Picture(tmp_path / "all.png", 5.5),
        Picture(tmp_path / "st.png", 5.5, "S-T graph: DP yellow, QP blue, actual occupancy pink"),
        Picture(
            tmp_path / "later.png", 15.0, "S-T graph: DP yellow, QP blue, actual occupancy pink"
        ),
        Picture(tmp_path / "control.png", 15.0, layout="control"),
        Picture(tmp_path / "hidden.png", 15.0, "Steering [rad]"),
    ]
    assert take_pictures(tmp_path / "closed.rrd", pictures, size="1600x900") == []
    assert all(picture.out.read_bytes()[1:4] == b"PNG" for picture in pictures)
    assert len({picture.out.read_bytes() for picture in pictures}) == len(pictures)
    with pytest.raises(ConfigError, match="no view 'nothing'"):
        take_pictures(
            tmp_path / "closed.rrd", [Picture(tmp_path / "x.png", 0.0, "nothing")], size="800x600"
        )


def test_a_hidden_tab_is_opened_in_the_layout_that_was_asked_for() -> None:
    kept = {
        "/container/r": {
            "ContainerBlueprint": {
                "container_kind": "Tabs",
                "contents": ["container/o", "container/c"],
            }
        },
        "/container/o": {
            "ContainerBlueprint": {
                "container_kind": "Tabs",
                "contents": ["view/1", "view/2"],
                "display_name": "Overview",
            }
        },
        "/container/c": {
            "ContainerBlueprint": {
                "container_kind": "Vertical",
                "contents": "view/3",
                "display_name": "Control",
            }
        },
        **{
            f"/view/{i}": {"ViewBlueprint": {"display_name": name}}
            for i, name in ((1, "a"), (2, "b"), (3, "b"))
        },
    }
    parts, view = arranged(kept, "control", "b")
    assert (
        view == "3" and parts["/container/r"]["ContainerBlueprint"]["active_tab"] == "container/c"
    )
    parts, view = arranged(kept, "overview", "b")
    assert view == "2" and parts["/container/o"]["ContainerBlueprint"]["active_tab"] == "view/2"
    assert parts["/top_panel"]["PanelBlueprint"]["state"] == "Hidden" and "/top_panel" not in kept
    with pytest.raises(ConfigError, match="no layout 'planner'"):
        arranged(kept, "planner", None)


def test_the_road_of_the_sample_is_where_its_line_is() -> None:
    x, y, _ = to_world(np.array([50.0]), np.array([0.0]))
    assert LINE.project(float(x[0]), float(y[0]))[0] == pytest.approx(50.0, abs=0.05)


@pytest.mark.parametrize("colour", [*colours.DECISIONS.values(), colours.TICK, colours.GOAL])
def test_label_colours_have_contrast_on_dark_and_light_plates(colour: int) -> None:
    words = colours.luminance(colours.of_words(colour)) + 0.05
    assert min(words / (0.012 + 0.05), (0.81 + 0.05) / words) >= 3.0


def test_a_viewer_that_does_not_set_its_theme_is_an_error_in_time(tmp_path: Path) -> None:
    hangs = tmp_path / "viewer"
    hangs.write_text("#!/bin/sh\nexec sleep 60\n", encoding="utf-8")
    hangs.chmod(0o755)
    assert click_theme("light", hangs, 1, os.environ, 0.1).endswith("did not answer within 0.1 s")


places = st.lists(st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)), max_size=40)


@given(places, st.sets(st.integers(0, 39)))
def test_the_decided_and_the_nearest_are_drawn_in_full(
    where: list[tuple[float, float]], about: set[int]
) -> None:
    xy, ids = np.array(where).reshape(-1, 2), [f"a{i}" for i in range(len(where))]
    full = rows_in_full(ids, xy[:, 0], xy[:, 1], {f"a{i}" for i in about}, (0.0, 0.0)).tolist()
    assert full == sorted(set(full))
    if len(ids) <= NEAREST:
        assert full == list(range(len(ids)))
        return
    assert {i for i in about if i < len(ids)} <= set(full)
    others = set(full) - about
    assert len(others) <= NEAREST
    away = np.hypot(xy[:, 0], xy[:, 1])
    assert all(away[i] <= NEAR_M for i in others)
    left = set(range(len(ids))) - set(full)
    assert all(away[j] > NEAR_M or away[j] >= np.sort(away)[NEAREST - 1] for j in left)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_an_axis_holds_two_numbers_and_is_not_much_longer(low: float, span: float) -> None:
    bottom, top = with_two_numbers(low, low + span)
    step = 10.0 ** np.ceil(np.log10(span / MOST_NUMBERS) - 1e-9)
    assert np.floor(top / step + 1e-6) - np.ceil(bottom / step - 1e-6) >= 1.0
    assert bottom <= low + 1e-9 * abs(low) and top >= low + span - 1e-9 * abs(low)
    assert top - bottom <= max(span, 0.0) + 1.2 * step


def test_panels_ask_for_the_steps_that_a_run_hands_to_a_recording() -> None:
    asked = set()

    def steps(metric: str) -> tuple[FloatArray, FloatArray]:
        asked.add(metric)
        return np.empty(0), np.empty(0)

    for mode in Mode:
        done, world = drive(mode)
        panels(done.trace, world, steps)
    assert asked == set(MEASURED)
