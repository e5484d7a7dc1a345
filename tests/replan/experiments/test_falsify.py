"""`replan falsify`: a case whose distance is known, its files, resume, and wrong words."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from command_line import gates as write_gates, one_error, replan
from handmade import track, tracks
from hypothesis import given, strategies as st
from short_logs import past_parked

from replan.draw.drawn_results import load
from replan.experiments.falsify import BOTH, ERROR, FAIL, PASS, TriedPoint, robustness
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.scenario import Scenario
from replan.metrics.judge.gates import Gate, load_gates

pytest.importorskip(
    "cmaes", reason="the extra improve is not installed: pip install 'replan[improve]'"
)
COLLISION = 'metric = "collision_at_fault.count"\nmode = "closed"\nmax = 0'
GAP = 'metric = "gap.min"\nmode = "closed"\nmin = 0.05'
"""At less, the careful driver fails as well: they pass as near, and brake for who is in their way
only.
"""


def log() -> Scenario:
    """A careful driver stops before the car where it is pushed into the lane."""
    return past_parked("parked", 24.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("falsify")
    write_scenario(out / "log.mcap", log())
    write_gates(out / "gates.toml", COLLISION, GAP)
    return out


def words(
    folder: Path, out: Path, *more: object, budget: int = 24, workers: int = 0
) -> Sequence[object]:
    return (
        "falsify",
        folder / "log.mcap",
        "-p",
        "constant_speed",
        "--gates",
        folder / "gates.toml",
        "--workers",
        workers,
        "--axis",
        "side=-5:1",
        "--axis",
        "ego_speed=0.8:1.2",
        "--agent",
        "17",
        "--budget",
        budget,
        "-o",
        out,
        *more,
    )


@pytest.fixture(scope="module")
def found(folder: Path) -> Path:
    """The parked car is pushed towards the lane: at constant speed the ego touches it."""
    result = replan(*words(folder, folder / "out"))
    assert result.exit_code == 1, result.output
    return folder / "out"


@pytest.mark.slow
def test_the_distance_is_how_far_the_car_is_from_the_way_of_the_ego(found: Path) -> None:
    result = json.loads((found / "falsify.json").read_text(encoding="utf-8"))
    to_lane_m = 5.0 - 0.5 * (log().vehicle.width + 1.8)  # boxes touch
    assert (
        result["falsified"]
        and result["passes_at"] < to_lane_m / 0.375 <= result["distance"] <= 1.1 * to_lane_m / 0.375
    )
    assert "collision_at_fault.count <= 0 [closed]" in result["gates"] and result["agents"] == [
        "17"
    ]


@pytest.mark.slow
def test_the_sentences_of_a_falsification_agree_with_its_table(found: Path) -> None:
    card = json.loads((found / "falsify.json").read_text(encoding="utf-8"))
    table = pd.read_parquet(found / "trials.parquet")
    failing = table[table["outcome"] == FAIL]
    assert card["distance"] == failing["distance"].min() and card["drives"] == len(table) <= 24
    assert (
        f"at distance {card['distance']:.3f} from parked, at side {card['case']['side']:.6g} m"
        in card["said"][0]
    )
    first = failing.sort_values("distance").iloc[0]
    assert (
        f"the value is {first['value']:.4g}" in card["said"][1]
        and str(first["why"]) in card["said"][1]
    )
    assert (
        ("--budget N" in card["said"][-1]) == card["budget_spent"] == (len(table) >= card["budget"])
    )
    assert f"{len(failing)} fail" in card["said"][-1] and card["outcomes"][FAIL] == len(failing)
    assert (
        table["part"].iloc[0] == "recorded"
        and (table.loc[0, ["side", "ego_speed"]] == [0.0, 1.0]).all()
    )
    assert (table.loc[table["outcome"] == PASS, "score"] >= 1.0).all() and (
        failing["score"] <= 1.0
    ).all()


@pytest.mark.slow
def test_the_case_is_a_log_that_fails_again(found: Path, folder: Path, tmp_path: Path) -> None:
    case = read_scenario(found / "case.mcap")
    assert case.metadata["varied.of"] == "parked"
    again = replan(
        "evaluate",
        found / "case.mcap",
        "--config",
        found / "case" / "run.toml",
        "--workers",
        0,
        "--no-recording",
        "-o",
        tmp_path / "again",
    )
    assert again.exit_code == 1
    gates, same = (load(run).gates["gate"] for run in (found / "case", tmp_path / "again"))
    assert list(gates) == list(same) and len(gates) == len(load_gates(folder / "gates.toml").gates)
    assert len(list((found / "case").glob("*/closed.rrd"))) == 1


@pytest.mark.slow
def test_a_planner_that_never_fails_alone_is_not_falsified(folder: Path, tmp_path: Path) -> None:
    """The other drives the same way: whatever one fails, the other fails, too."""
    result = replan(
        *words(
            folder,
            tmp_path / "out",
            "--against",
            "replan.planners.constant_speed:ConstantSpeed",
            "--set",
            "loop.apart.trust=true",
            budget=16,
        )
    )
    assert result.exit_code == 0, result.output
    card = json.loads((tmp_path / "out" / "falsify.json").read_text(encoding="utf-8"))
    assert card["outcomes"][BOTH] > 0 and not card["falsified"] and card["distance"] is None
    assert "No case found in which constant_speed fails and" in result.stdout
    assert not (tmp_path / "out" / "case.mcap").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--axis", "tme=0:1"), "did you mean 'time'"),
        (("--against", "constant_speed"), "is the planner itself"),
        (("--against", "nobody"), "no planner is called 'nobody'"),
        (("--resolution", 0), "must be positive"),
        (("--agent", "18"), "no agent is called '18'"),
        (("--resume",), "contains no study to resume"),
    ],
)
def test_wrong_options_are_one_line_and_leave_no_files(
    folder: Path, tmp_path: Path, more: tuple[object, ...], message: str
) -> None:
    result = replan(*words(folder, tmp_path / "out", *more))
    assert result.exit_code == 2 and message in one_error(result)
    assert not (tmp_path / "out").exists()


def test_a_budget_too_small_for_a_search_is_refused(folder: Path, tmp_path: Path) -> None:
    result = replan(*words(folder, tmp_path / "out", budget=3))
    assert result.exit_code == 2 and "16 drives" in one_error(result)


def test_a_recorded_failure_is_a_case_of_distance_0(folder: Path, tmp_path: Path) -> None:
    in_the_way = track("17", [0.0], [24.0], [0.0], static=True)
    write_scenario(tmp_path / "log.mcap", replace(log(), tracks=tracks(in_the_way), name="blocked"))
    result = replan(
        "falsify",
        tmp_path / "log.mcap",
        "-p",
        "constant_speed",
        "--gates",
        folder / "gates.toml",
        "--workers",
        0,
        "--axis",
        "ego_speed=0.8:1.2",
        "-o",
        tmp_path / "out",
        "--json",
    )
    printed = json.loads(result.stdout)
    assert result.exit_code == printed["exit_code"] == 1 and printed["distance"] == 0.0
    assert printed["said"][0].startswith(
        "constant_speed fails at distance 0.000 from blocked, as recorded, and the careful"
    )
    assert (tmp_path / "out" / "case.mcap").is_file() and (
        tmp_path / "out" / "falsify.png"
    ).is_file()


@given(st.floats(0.96, 20.0), st.floats(0.01, 5.0))
def test_robustness_grows_with_each_margin(ttc: float, more: float) -> None:
    gates = (
        Gate("ttc.time_below_950ms", max=0.0),
        Gate("lon_accel.worst_episode", max=1.0),
        Gate("gap.min", min=0.5),
    )
    values = {
        "ttc.time_below_950ms": 0.0,
        "ttc.min": ttc,
        "lon_accel.worst_episode": 0.3,
        "gap.min": 0.7,
    }
    near, far = robustness(gates, values), robustness(gates, {**values, "ttc.min": ttc + more})
    assert 0.0 <= near < far <= 1.0
    assert robustness(gates[:1], {"ttc.time_below_950ms": 0.3, "ttc.min": 0.2}) == 0.0


def test_scores_are_in_the_order_of_the_outcomes() -> None:
    cases = (
        (TriedPoint(FAIL), 1.0),
        (TriedPoint(PASS, robustness=0.0), 0.3),
        (TriedPoint(PASS), 0.0),
        (TriedPoint(BOTH), 0.0),
        (TriedPoint(ERROR), 0.0),
    )
    assert [case.score(distance) for case, distance in cases] == [1.0, 1.0, 2.0, 2.0, 3.0]
