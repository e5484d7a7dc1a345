"""The paper's experiments: laws of the avoidability, the grid's cells, the figures, and the whole
command (slow).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.errors import ConfigError
from replan.logs.catalogue.paper import crossing_pedestrian
from replan.logs.plan import DecisionKind, GraphObstacle, Plan, StGraph
from replan.logs.shapes import distance
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
from replan.paper import pedestrian_grid, reproduce
from replan.paper.pedestrian_grid import (
    CELLS,
    Avoidable,
    GridCrossing,
    avoidable,
    braked,
    braking_intervals,
    crossing,
    grid,
    verdict,
    walker_within,
)
from replan.planners.frenet.profiles import SpeedLimits
from replan.replay.loop_config import LoopConfig
from replan.run.calibrate import calibrate

speeds = st.floats(0.5, 20.0)
limits = st.builds(SpeedLimits, st.just(1.8), st.floats(1.0, 9.0), st.floats(1.0, 20.0))
cells = st.sampled_from(CELLS)


@given(v=speeds, limits=limits, u=st.floats(0.0, 15.0))
def test_the_braking_point_mass_is_the_integral_of_its_deceleration(
    v: float, limits: SpeedLimits, u: float
) -> None:
    t = np.linspace(0.0, u, 20_001)
    a = -np.minimum(limits.jerk_mps3 * t, limits.decel_mps2)
    speed = np.maximum(v + np.r_[0.0, np.cumsum(0.5 * (a[1:] + a[:-1]) * np.diff(t))], 0.0)
    way = float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t)))
    assert braked(u, v, limits) == pytest.approx(way, abs=1e-3)


@given(v=speeds, limits=limits, u=st.floats(0.0, 10.0), more=st.floats(0.0, 5.0))
def test_braking_goes_forwards_and_no_further_than_driving(
    v: float, limits: SpeedLimits, u: float, more: float
) -> None:
    assert (
        0.0 <= braked(u, v, limits) <= braked(u + more, v, limits) + 1e-9 <= v * (u + more) + 2e-9
    )


@settings(max_examples=30)
@given(cell=cells)
def test_keeping_the_speed_avoids_the_walker_where_the_boxes_never_meet(cell: GridCrossing) -> None:
    scenario = crossing(cell)
    car, track, v = scenario.vehicle, scenario.tracks, cell.ego_kmh / 3.6
    gap = np.inf
    for t in np.arange(4.0, 14.0, 0.01):
        x = scenario.ego.x[0] + v * t + car.axle_to_center
        walker = (float(track.x[0]), float(np.interp(t, track.t, track.y)), 0.5 * np.pi, 0.5, 0.6)
        gap = min(gap, distance(float(x), 0.0, 0.0, car.length, car.width, *walker))
    if gap > 0.2 or gap == 0.0:  # between, 10 ms and the closed form may disagree
        assert avoidable(cell).keeping_speed is (gap > 0.0)


@given(cell=cells)
def test_hard_braking_avoids_all_that_comfortable_braking_avoids(cell: GridCrossing) -> None:
    can = avoidable(cell)
    assert can.hard or not can.comfortable


@given(cell=cells)
def test_the_walker_is_in_the_middle_of_the_lane_at_the_time_of_the_cell(
    cell: GridCrossing,
) -> None:
    scenario, start = crossing(cell), crossing_pedestrian.parameters["walk_start_s"]
    front = scenario.ego.x[0] + scenario.vehicle.axle_to_front
    ego_there = (scenario.tracks.x[0] - front) / (cell.ego_kmh / 3.6)
    middle = float(np.interp(0.0, scenario.tracks.y, scenario.tracks.t))
    assert middle - ego_there == pytest.approx(cell.late_s, abs=0.02)
    assert middle > start
    entry, leave = walker_within(scenario, 0.0)
    assert entry < middle < leave
    assert len(scenario.ego) == 1


@pytest.mark.parametrize(
    ("can", "contact", "released", "jerk", "word"),
    [
        (Avoidable(True, True, True), True, np.nan, 20.0, "contact"),
        (Avoidable(True, False, False), True, np.nan, 20.0, "drive on"),
        (Avoidable(False, False, False), True, 2.0, 20.0, "unavoidable"),
        (Avoidable(False, True, True), False, 1.5, 2.0, "late release"),
        (Avoidable(False, True, True), False, 0.9, 5.0, "jerk"),
        (Avoidable(False, False, True), False, 0.9, 15.0, "ok"),
        (Avoidable(True, True, True), False, np.nan, 0.5, "ok"),
    ],
)
def test_verdicts(can: Avoidable, contact: bool, released: float, jerk: float, word: str) -> None:
    assert verdict(can, contact=contact, released=released, jerk=jerk) == word


def pedals(brake: list[float]) -> Trace:
    """A trace with this brake every 0.1 s."""
    n = len(brake)
    t, zero = 0.1 * np.arange(n), np.zeros(n)
    ego = Trajectory(t, t, zero, zero, zero + 1.0, zero, zero)
    scenario = crossing_pedestrian.scenario()
    controls = Controls(t, zero, zero, np.array(brake))
    return Trace(
        "x",
        "p",
        Mode.CLOSED,
        False,
        ego,
        scenario.tracks,
        (),
        EndReason.GOAL,
        commands=controls,
        actuation=controls,
    )


def test_short_releases_do_not_end_the_braking() -> None:
    trace = pedals([0.0, 0.2, 0.2, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4, 0.4])
    np.testing.assert_allclose(braking_intervals(trace), [(0.1, 0.6), (1.2, 1.3)])
    assert braking_intervals(replace(trace, commands=None)) == []


def graph_frame(t: float, *, blocked: bool) -> PlannedFrame:
    plan = Trajectory(
        *(np.array([t, t + 8.0]), np.array([0.0, 40.0]), *(np.zeros(2) for _ in range(5)))
    )
    square = np.array([[1.0, 5.0], [3.0, 5.0], [3.0, 9.0], [1.0, 9.0]])
    obstacles = (GraphObstacle("a", square, DecisionKind.YIELD),) if blocked else ()
    line = np.array([[0.0, 0.0], [8.0, 40.0]])
    return PlannedFrame(t, Plan(plan, internals=(StGraph(None, None, line, line, obstacles),)))


def test_the_moments_of_figure_10() -> None:
    frames = [graph_frame(0.1 * i, blocked=3 <= i < 8) for i in range(12)]
    chosen = [frame.t for _, frame in reproduce.blocked_moments(frames)]
    np.testing.assert_allclose(chosen, [0.3, 0.5, 0.8])
    for never in (frames[:3], frames[:8]):
        with pytest.raises(ConfigError, match="blocks the path"):
            reproduce.blocked_moments(never)


def test_settings_are_checked() -> None:
    with pytest.raises(ConfigError, match="did you mean 'single_track'"):
        reproduce.PaperConfig(vehicles=("single_trak",))
    with pytest.raises(ConfigError, match="negative"):
        reproduce.PaperConfig(roads=-1)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kinematic vehicle and the cheap controller, so that nothing slow compiles."""
    monkeypatch.setattr(
        pedestrian_grid, "LOOP", LoopConfig(vehicle="kinematic_bicycle", controller="dlqr_pid")
    )


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_cell_is_driven_the_same_twice_and_drawn(tmp_path: Path) -> None:
    cell = GridCrossing(30.0, 0.8, -0.5)
    table = grid((cell,))
    pd.testing.assert_frame_equal(table, grid((cell,)))
    row = table.iloc[0]
    assert row["hard_braking_avoids"] and not row["contact"] and row["least_gap_m"] > 0.5
    assert row["verdict"] == "ok"
    assert row["brake_begin_s"] < row["brake_end_s"] <= row["path_clear_s"] + 1.0
    pictures = [tmp_path / f"{i}.png" for i in range(2)]
    for picture in pictures:
        reproduce.grid_figure(table).save(picture)
    assert pictures[0].read_bytes() == pictures[1].read_bytes()


@pytest.mark.slow
def test_figures_9_10_and_12_are_drawn(tmp_path: Path) -> None:
    scenario = crossing_pedestrian.scenario()
    trace = replace(pedals([0.0, 0.3, 0.0]), frames=(graph_frame(0.0, blocked=True),))
    points = reproduce.planned_points(trace)
    np.testing.assert_allclose(points, [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    drawn = {
        "9": reproduce.path_figure([("mpc", trace)], points, scenario),
        "10": reproduce.st_figure([("now", trace.frames[0])], trace, scenario),
        "12": reproduce.pedals_figure(trace, [(0.1, 0.2)], 0.2, (0.0, 0.2)),
    }
    for name, figure in drawn.items():
        figure.save(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5_000
    with pytest.raises(ConfigError, match="no commands"):
        reproduce.pedals_figure(replace(trace, commands=None), [], 0.2, (0.0, 0.2))


@pytest.mark.slow
@pytest.mark.nightly
def test_the_paper_command_writes_all_files(tmp_path: Path) -> None:
    said: list[str] = []
    config = reproduce.PaperConfig(roads=1, cells=CELLS[:2])
    page = reproduce.reproduce(tmp_path, config, say=said.append)
    wanted = {
        "fig09_path.png",
        "fig10_st.png",
        "fig12_pedals.png",
        "free_road.rrd",
        "crossing_pedestrian.rrd",
        "manoeuvres.csv",
        "scenarios.csv",
        "pedestrian_grid.csv",
        "pedestrian_grid.png",
        "paper.md",
    }
    assert {path.name for path in tmp_path.iterdir()} == wanted
    assert "2 drives" in page.read_text(encoding="utf-8") and said
    scenarios = pd.read_csv(tmp_path / "scenarios.csv")
    driven = scenarios[(scenarios["controller"].isin(["mpc", "dlqr_pid"]))]
    free = driven[driven["scenario"] == "paper/free_road"]
    assert (driven["end"] == "goal reached").all() and (scenarios["pedals_together"] == 0).all()
    assert (free["lateral_rms_m"] < 0.03).all() and (free["lateral_max_m"] < 0.10).all()


def test_the_calibration_is_written_and_drawn(tmp_path: Path) -> None:
    csv, png = calibrate(tmp_path, "single_track", "small_electric")
    table = pd.read_csv(csv, index_col=0)
    at_10 = table["10_mps"].dropna()
    assert (np.diff(at_10) > 0.0).all()
    assert 0.0 < at_10.loc[-1.0] < at_10.loc[0.0] < 0.3, "its motor brakes by more than 1 m/s2"
    assert -0.5 < at_10.loc[-4.0] < -0.2
    assert png.stat().st_size > 5_000
    assert {path.name for path in tmp_path.iterdir()} == {"calibration.csv", "calibration.png"}
    for wrong in ({"model": "perfect"}, {"model": "single_trak"}, {"car": "beetle"}):
        with pytest.raises(ConfigError):
            calibrate(tmp_path, **wrong)
