"""Families with published grids, and the suites: what is asked is what the publications say, and
always the same.
"""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from command_line import replan
from hypothesis import given, settings, strategies as st

from replan.core.errors import ConfigError
from replan.logs.catalogue import CATALOGUE, FAMILIES, SUITES, scenario, spread, suite
from replan.logs.catalogue.family import touches
from replan.logs.catalogue.family_parts import START_M, drive
from replan.logs.catalogue.iso3888 import cones, double_lane_change
from replan.logs.catalogue.roads import curve
from replan.logs.mcap import write_scenario
from replan.logs.plan import DecisionKind
from replan.logs.readers import read_log
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters
from replan.metrics.health import findings
from replan.paper.manoeuvres import cones_hit

GRIDS = [name for name, family in FAMILIES.items() if family.grid]
CAR = VehicleParameters()
everywhere = pytest.mark.parametrize("name", GRIDS)


def at_constant_speed(log: Scenario, seconds: float) -> Scenario:
    """The scenario with an ego that keeps its speed on a straight road."""
    v = float(log.ego.v[0])
    return replace(
        log, ego=drive(curve((900.0, 0.0, 0.0)), start=START_M, speed=v, cruise=v, duration=seconds)
    )


def same(one: Scenario, two: Scenario) -> bool:
    columns = [
        (each.ego.x, each.ego.v, each.tracks.x, each.tracks.y, each.tracks.t) for each in (one, two)
    ]
    return (
        all(np.array_equal(a, b) for a, b in zip(*columns, strict=True))
        and one.metadata == two.metadata
    )


# laws of families


@everywhere
def test_cells_build_are_clean_and_are_found_again_by_name(name: str, tmp_path: Path) -> None:
    """Of each family the cell that a suite takes first; all of them in the slow test below."""
    label = next(spread(FAMILIES[name]))
    log = scenario(label)
    assert log.name == label
    assert log.metadata["family"] == name and log.metadata["parameter_source"]
    assert same(log, scenario(log.name))
    wanted = (
        json.loads(log.metadata["expected_decisions"])
        if "expected_decisions" in log.metadata
        else {}
    )
    lines = {f"stop line {line.id}" for line in log.road.stop_lines}
    assert set(wanted) <= lines.union(log.tracks.ids)
    assert {kind for kinds in wanted.values() for kind in kinds} <= {
        kind.value for kind in DecisionKind
    }
    assert log.goal is not None and not log.goal.holds_place(
        float(log.ego.x[0]), float(log.ego.y[0])
    )
    if not name.startswith("faults/"):
        assert not findings(log)
    write_scenario(tmp_path / "a.mcap", log)
    assert same(log, read_log(tmp_path / "a.mcap"))


@pytest.mark.slow
@pytest.mark.nightly
@everywhere
def test_every_cell_builds(name: str) -> None:
    for cell in FAMILIES[name].cells():
        FAMILIES[name].scenario(**cell)


@everywhere
def test_parameters_without_a_scenario_are_refused_in_one_line(name: str) -> None:
    family = FAMILIES[name]
    for words in ({"tune": 1.0}, {next(iter(family.grid)): float("nan")}):
        with pytest.raises(ConfigError, match=r"^[^\n]+$"):
            family.scenario(**words)


@pytest.mark.parametrize(
    ("label", "said"),
    [
        ("unece_r157/cut_in@ego_kmh=20,relative_kmh=-20", "would not drive forward"),
        ("unece_r157/cut_out@distance_m=10,ego_kmh=60", "into the car that stands"),
        ("euro_ncap/ccrm_2026@ego_kmh=30,target_kmh=70", "do not reach a target with 70 km/h"),
        ("euro_ncap/cpla_2023@ego_kmh=5", "do not reach"),
        ("faults/flicker@scene=7", "scene is 7"),
        ("faults/late@first_s=500", "nothing is left of a track"),
        ("euro_ncap/cpna_2023@ego_kmh", "there is no '='"),
        ("euro_ncap/cpma_2023", "cpna_2023"),
    ],
)
def test_cells_that_make_no_sense_are_refused(label: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        scenario(label)
    if "@" in label and "=" in label:
        family, _, words = label.partition("@")
        assert (
            label not in {FAMILIES[family].named(cell) for cell in FAMILIES[family].cells()}
            and words
        )


def test_a_log_without_a_way_out_ends_before_the_contact() -> None:
    cut = scenario("unece_r157/cut_in@ego_kmh=60,gap_m=10,lateral_mps=3,relative_kmh=-30")
    who, when = (
        cut.metadata["logged_driver_would_meet"],
        float(cut.metadata["logged_driver_would_meet_s"]),
    )
    assert who == "cutter" and touches(cut) is None
    assert cut.ego.t[-1] == pytest.approx(when - 0.1) and cut.duration > 20.0
    last = cut.ego.state(len(cut.ego) - 1)
    on = drive(curve((900.0, 0.0, 0.0)), start=last.x, speed=last.v, cruise=last.v, duration=0.2)
    assert touches(replace(cut, ego=replace(on, t=on.t + last.t))) == "cutter"
    easy = scenario("unece_r157/cut_in@ego_kmh=60,gap_m=60,lateral_mps=1,relative_kmh=-10")
    assert "logged_driver_would_meet" not in easy.metadata and easy.ego.t[-1] == pytest.approx(18.0)


# what the publications ask


CROSSINGS = {
    "cpna_2023": 0.6,
    "cpfa_2023": 0.6,
    "cpnco_2023": 0.298,
    "cbna_2026": 0.5,
    "cbnao_2026": 0.5,
    "cbfa_2026": 0.5,
}


@settings(max_examples=10, deadline=None)
@given(
    st.sampled_from(list(CROSSINGS)),
    st.integers(10, 60),
    st.sampled_from([10.0, 25.0, 50.0, 75.0, 90.0]),
)
def test_a_crossing_target_is_met_after_six_seconds_at_the_overlap(
    name: str, kmh: int, overlap: float
) -> None:
    """Its middle is `overlap` from the ego's right side as the ego's front comes to its side."""
    log = FAMILIES[f"euro_ncap/{name}"].scenario(ego_kmh=kmh, overlap_percent=overlap)
    track = log.tracks.samples(0)
    t, x, y = log.tracks.t[track], log.tracks.x[track], log.tracks.y[track]
    side = float(x[0]) - 0.5 * CROSSINGS[name]
    assert START_M + CAR.axle_to_front + kmh / 3.6 * 6.0 == pytest.approx(side)
    assert np.interp(6.0, t, y) == pytest.approx(CAR.width * (overlap / 100.0 - 0.5), abs=0.02)
    assert bool(y[0] > 0.0) is name.startswith(("cpfa", "cbfa"))
    speed = float(log.metadata["parameter.target_kmh"]) / 3.6
    assert np.hypot(log.tracks.vx[track], log.tracks.vy[track]).max() == pytest.approx(
        speed, rel=1e-6
    )
    assert touches(at_constant_speed(log, 7.0)) == log.tracks.ids[0]
    assert touches(at_constant_speed(log, 5.8)) is None


@pytest.mark.parametrize(
    "label", ["ccrs_2023@ego_kmh=50,overlap_percent=-50", "ccrm_2026@ego_kmh=90,target_kmh=20"]
)
def test_a_target_ahead_is_met_after_six_seconds(label: str) -> None:
    log = scenario(f"euro_ncap/{label}")
    assert touches(at_constant_speed(log, 6.1)) == "car"
    assert touches(at_constant_speed(log, 5.9)) is None
    assert log.tracks.y[0] == pytest.approx(-0.5 * CAR.width if "overlap" in label else 0.0)


@pytest.mark.parametrize(("gap", "rate"), [(12.0, 2.0), (12.0, 6.0), (40.0, 2.0), (40.0, 6.0)])
def test_the_lead_of_ccrb_brakes_to_two_kilometres_per_hour(gap: float, rate: float) -> None:
    log = FAMILIES["euro_ncap/ccrb_2023"].scenario(gap_m=gap, brake_mps2=rate)
    lead = log.tracks.truth(0.0)
    assert lead.x[0] - 0.5 * lead.length[0] - (START_M + CAR.axle_to_front) == pytest.approx(gap)
    v = log.tracks.vx
    assert v[0] == pytest.approx(50.0 / 3.6) and v[-1] == pytest.approx(2.0 / 3.6)
    assert np.diff(v).min() == pytest.approx(-0.1 * rate)


@pytest.mark.parametrize(
    "label", ["ccftap_2023@ego_kmh=10", "cmftap_2023@target_kmh=60", "cccscp_2026@from_left=1"]
)
def test_ways_cross_at_the_junction(label: str) -> None:
    log = scenario(f"euro_ncap/{label}")
    v = float(log.ego.v[0])
    other = log.tracks.truth(6.0)
    inside = log.road.lanes[18 if 18 in log.road.lanes else 13]
    coarse = np.vstack([log.road.lanes[1].center, inside.center[1:]])
    s = np.r_[0.0, np.cumsum(np.hypot(*np.diff(coarse, axis=0).T))]
    path = np.column_stack(
        [np.interp(np.arange(0.0, s[-1], 0.1), s, column) for column in coarse.T]
    )
    far = np.hypot(*(path - [other.x[0], other.y[0]]).T)
    assert far.min() < 0.3  # the other is on the ego's way
    there = 0.1 * float(np.argmin(far))
    assert there - (log.ego.x[0] + CAR.axle_to_center) == pytest.approx(6.0 * v, abs=0.5)


@pytest.mark.parametrize(("gap", "lateral"), [(0.0, 1.0), (20.0, 0.5), (60.0, 3.0)])
def test_a_cut_in_has_the_gap_and_lateral_speed_of_its_cell(gap: float, lateral: float) -> None:
    log = FAMILIES["unece_r157/cut_in"].scenario(gap_m=gap, lateral_mps=lateral, relative_kmh=-20.0)
    start = at_constant_speed(log, 3.0)
    other = log.tracks.truth(2.0)
    assert other.x[0] - 0.5 * other.length[0] - (
        start.ego.at(2.0).x + CAR.axle_to_front
    ) == pytest.approx(gap)
    assert log.tracks.y[0] == -3.5 and log.tracks.y[-1] == pytest.approx(0.0, abs=1e-9)
    assert log.tracks.vy.max() == pytest.approx(lateral)


@pytest.mark.parametrize("edge_based", [0.0, 1.0])
def test_the_lane_of_iso_3888_runs_between_the_cones(edge_based: float) -> None:
    log = FAMILIES["iso3888/double_lane_change"].scenario(edge_based=edge_based, ego_kmh=80.0)
    lane, ego = log.road.lanes[1], log.ego
    sections = double_lane_change(CAR.width, edge_based=bool(edge_based))
    approach = 40.0 + 0.5 * (80.0 / 3.6) ** 2 / 1.2
    for section in sections:
        x = np.linspace(section.begin, section.end, 5) + approach
        assert np.interp(x, *lane.left.T) == pytest.approx(section.offset + 0.5 * section.width)
        assert np.interp(x, *lane.right.T) == pytest.approx(section.offset - 0.5 * section.width)
    places = cones(sections) + np.array([approach, 0.0])
    assert cones_hit(places, ego.x, ego.y, ego.yaw, CAR) == 0
    assert log.goal is not None and np.abs(ego.v**2 * ego.kappa).max() < 3.0


def test_faults_are_in_the_tracks() -> None:
    whole = CATALOGUE["paper/crossing_pedestrian"].scenario().tracks
    flicker = scenario("faults/flicker@hidden_frames=1,shown_frames=1").tracks
    assert np.array_equal(flicker.t, whole.t[::2])
    gone = scenario("faults/dropout@from_s=6,lasts_s=2").tracks.t
    assert not ((gone >= 6.0 - 1e-9) & (gone < 8.0 - 1e-9)).any() and len(gone) == len(whole.t) - 20
    assert scenario("faults/late@first_s=3").tracks.t[0] == pytest.approx(3.0)
    assert scenario("faults/latency@latency_s=0.3").tracks.t[0] == pytest.approx(0.3)
    one, two, again = (scenario(f"faults/noise@position_m=0.3,seed={k}").tracks for k in (1, 2, 1))
    assert np.std(one.x - whole.x) == pytest.approx(0.3, rel=0.2)
    assert np.array_equal(one.x, again.x) and not np.array_equal(one.x, two.x)
    assert np.isnan(scenario("faults/sparse@every_frames=5").tracks.vx).all()


# suites


def test_suites_have_their_sizes_and_are_parts_of_each_other() -> None:
    smoke, full, nightly = (suite(name) for name in ("smoke", "full", "nightly"))
    assert [len(each) for each in (smoke, full, nightly)] == [
        SUITES[n].size for n in ("smoke", "full", "nightly")
    ]
    assert nightly[:20] == smoke and nightly[:300] == full and len(set(nightly)) == 3000
    apart = suite("separating")
    assert len(apart) == SUITES["separating"].size and not set(apart) & set(suite("nightly", 2))
    assert {name.partition("@")[0] for name in (*full, *apart)} == set(FAMILIES)
    groups = [name.partition("/")[0] for name in smoke]
    assert {groups.count(group) for group in set(groups)} <= {2, 3}


@everywhere
def test_the_first_cells_of_a_grid_lie_far_apart(name: str) -> None:
    """The second is one of the farthest from the first."""
    grid, cells = FAMILIES[name].grid, list(FAMILIES[name].cells())
    numbers = {FAMILIES[name].named(cell): cell for cell in cells}
    first, second = (numbers[label] for label in islice(spread(FAMILIES[name]), 2))

    def far(cell: dict[str, float]) -> float:
        return sum(
            ((v.index(cell[k]) - v.index(first[k])) / max(len(v) - 1, 1)) ** 2
            for k, v in grid.items()
        )

    assert far(second) == pytest.approx(max(map(far, cells)))
    assert sorted(spread(FAMILIES[name])) == sorted(numbers)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["synth", "--suite", "smoke"], "and a folder"),
        (["synth", "paper", "--suite", "smoke", "-o", "x"], "or a --suite"),
        (["synth", "--suite", "smoke", "-o", "x", "--set", "a=1"], "--set changes families"),
        (["synth", "--suite", "smok", "-o", "x"], "smoke"),
        (["evaluate", "x.mcap", "--suite", "smoke"], "leave out other logs"),
        (["evaluate", "--suite", "smok"], "smoke"),
    ],
)
def test_contradictory_choices_of_scenarios_are_refused(
    words: list[str], said: str, tmp_path: Path
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        result = replan(*words)
    assert result.exit_code == 2 and said in result.stderr and result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_page_of_the_catalogue_is_the_tables(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "catalogue.md").read_text(encoding="utf-8")
    assert page == replan("synth", "--markdown").stdout
