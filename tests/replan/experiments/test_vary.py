"""`replan vary`: the surface, its edge, its files; what cannot be evaluated costs only itself."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import gates as write_gates, replan
from handmade import track, tracks
from hypothesis import given, strategies as st
from short_logs import past_parked

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.experiments.brackets import Bracket, bisect_brackets, brackets
from replan.experiments.ego_encounters import conflicting_agent, encounters, lines
from replan.experiments.question import question, question_about
from replan.experiments.recorded_log import opened, prepared
from replan.experiments.surface import VaryResult, vary
from replan.logs.agents import AgentKind
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.metrics.judge import worst
from replan.metrics.judge.gates import Outcome
from replan.run import evaluate_logs

RUN = RunConfig(planners=("constant_speed",), recording=False, internals="none")
COLLISION = 'metric = "collision_at_fault.count"\nmode = "closed"\nmax = 0'


def log() -> Scenario:
    """Beside the parked car, one that is tracked for an instant, and one far away that drives."""
    blink = track("blink", [1.0, 1.1], [8.0, 8.0], [4.0, 4.0])
    far = track("far", [0.0, 2.9], [0.0, 20.0], [40.0, 40.0])
    return past_parked("test/parked", 22.0, blink, far)


def crosses(name: str) -> dict[str, object]:
    """A pedestrian who walks at 3 m/s over the ego's lane, 14 m ahead of its start."""
    t = [0.1 * k for k in range(30)]
    return track(
        name,
        t,
        [14.0] * 30,
        [-6.0 + 3.0 * time for time in t],
        kind=AgentKind.PEDESTRIAN,
        width=0.5,
        length=0.5,
        vx=0.0,
        vy=3.0,
    )


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> VaryResult:
    """Constant speed past the car, pushed towards its lane.

    An ego start that is off the road is one of the cells.
    """
    out = tmp_path_factory.mktemp("vary")
    write_gates(out / "gates.toml", COLLISION)
    asked = question(["side=-4:0:3", "ego_start=-3:1:2"], ["17"], 0.25)
    return vary(prepared(log()), asked, replace(RUN, gates=str(out / "gates.toml")), out / "out")


def outcomes(result: VaryResult, start: float) -> list[str]:
    table = result.table[(result.table["part"] == "grid") & (result.table["ego_start"] == start)]
    return table.sort_values("side")["outcome"].tolist()


def test_a_cell_has_the_verdict_of_evaluate_on_its_log(result: VaryResult, tmp_path: Path) -> None:
    (cell,) = result.table.query("side == -4 and ego_start == 1").to_dict("records")
    alone = evaluate_logs(
        [result.out / "logs" / cell["log"]],
        replace(RUN, mode="closed", gates=str(result.out.parent / "gates.toml")),
        tmp_path / "alone",
    )
    assert worst(map(Outcome, alone.verdicts["outcome"])).value == cell["outcome"] == "fail"
    gap = alone.metrics.query("metric == 'gap.min' and planner == 'constant_speed'")["value"].item()
    assert gap == cell["least_gap_m"]
    assert "collision_at_fault.count" in cell["gates"] and "17" in cell["contact"]
    assert cell["contact_s"] == alone.drives.iloc[0].t_end_s


def test_the_edge_is_where_the_boxes_touch(result: VaryResult) -> None:
    assert outcomes(result, 1.0) == ["fail", "pass", "pass"]
    (edge,) = result.edges
    touching = -(5.0 - 0.5 * (log().vehicle.width + 1.8))
    assert edge.low <= touching <= edge.high and edge.high - edge.low <= 0.25
    assert (edge.at_low, edge.at_high) == ("fail", "pass")
    assert len(result.table[result.table["part"] != "grid"]) == 3
    written = pd.read_csv(result.out / "edges.csv")
    assert written[["low", "high"]].iloc[0].tolist() == [edge.low, edge.high]


def test_a_cell_that_cannot_be_made_is_named_and_costs_only_itself(result: VaryResult) -> None:
    assert outcomes(result, -3.0) == ["error"] * 3
    broken = result.table[result.table["ego_start"] == -3.0]
    assert broken["why"].str.contains("off the road").all()
    assert result.exit_code == 3 and any("off the road" in line for line in result.lines())


def test_a_pedestrian_who_walks_into_the_ego_is_a_contact(tmp_path: Path) -> None:
    walks = replace(log(), tracks=tracks(crosses("9")))
    into = vary(walks, question(["time=0.2:9.2:2"], ["9"], 9.0), RUN, tmp_path / "out")
    first, second = into.table.to_dict("records")
    assert first["contact"].startswith("pedestrian 9") and first["contact_s"] == pytest.approx(
        1.7, abs=0.3
    )
    assert (
        first["least_gap_m"] == 0.0
        and second["contact"] == ""
        and first["end"] == "the replay ran into the ego"
    )


def test_a_surface_is_written_as_tables_and_a_picture(result: VaryResult) -> None:
    table = pd.read_parquet(result.out / "surface.parquet")
    pd.testing.assert_frame_equal(table, result.table)
    assert table["log"].is_unique
    assert (result.out / "surface.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert {"vary.json", "surface.csv", "edges.csv", "grid", "edge-1"} <= {
        p.name for p in result.out.iterdir()
    }


@given(st.floats(-4.9, 4.9), st.floats(1e-3, 1.0), st.booleans())
def test_halving_brackets_the_edge(edge: float, resolution: float, passes_above: bool) -> None:
    def evaluate(cells: Sequence[tuple[float, ...]]) -> list[str]:
        return ["pass" if (cell[0] >= edge) == passes_above else "fail" for cell in cells]

    cells = [(x, row) for row in (1.0, 2.0) for x in (-5.0, -1.0, 0.0, 5.0)]
    pairs = bisect_brackets(
        brackets(dict(zip(cells, evaluate(cells), strict=True))), evaluate, resolution
    )
    assert [pair.row for pair in pairs] == [(1.0,), (2.0,)]
    for pair in pairs:
        assert pair.low <= edge <= pair.high and pair.high - pair.low <= resolution * (1.0 + 1e-9)
        assert evaluate([(pair.low,), (pair.high,)]) == [pair.at_low, pair.at_high]


def test_an_error_ends_halving_and_is_no_end_of_a_bracket() -> None:
    assert brackets({(0.0,): "pass", (1.0,): "error", (2.0,): "fail"}) == ()
    (pair,) = bisect_brackets([Bracket((), 0.0, 1.0, "pass", "fail")], lambda cells: ["error"], 0.1)
    assert (pair.low, pair.high, pair.is_open) == (0.0, 1.0, False)


def test_encounters_are_sorted_by_distance_and_only_moving_agents_conflict() -> None:
    scenario = prepared(log())
    by_agent = {encounter.agent: encounter for encounter in encounters(scenario)}
    beside = 5.0 - 0.5 * (scenario.vehicle.width + 1.8)
    assert by_agent["17"].least == pytest.approx(beside) and (
        by_agent["17"].t_from,
        by_agent["17"].t_to,
    ) == (0.0, 2.9)
    assert by_agent["far"].way == 20.0 and list(by_agent) == ["blink", "17", "far"]
    assert conflicting_agent(scenario) == "far"  # the only one who goes anywhere
    with pytest.raises(ConfigError, match="there is no agent to vary"):
        conflicting_agent(replace(scenario, tracks=tracks()))


def test_a_crossing_pedestrian_is_in_conflict_and_a_nearer_bystander_is_not() -> None:
    t = [0.1 * k for k in range(30)]
    strolls = track(
        "strolls",
        t,
        [10.0 + time for time in t],
        [2.0] * 30,
        kind=AgentKind.PEDESTRIAN,
        width=0.5,
        length=0.5,
        vx=1.0,
        vy=0.0,
    )
    scenario = prepared(replace(log(), tracks=tracks(crosses("crosses"), strolls)))
    by_agent = {encounter.agent: encounter for encounter in encounters(scenario)}
    front, beside = scenario.vehicle.axle_to_front, 0.5 * scenario.vehicle.width
    assert np.isnan(by_agent["strolls"].conflict) and 0.0 < by_agent["strolls"].least < beside + 2.0
    # They are on the lane's middle then: contact at constant velocity
    meets = (14.0 - 0.25 - front) / 8.0
    assert 0.0 <= by_agent["crosses"].conflict <= meets + 0.1
    assert conflicting_agent(scenario) == "crosses"


def test_the_conflict_of_a_recorded_drive_is_the_pedestrian_who_crosses(shared_data: Path) -> None:
    scenario, _ = opened(
        str(shared_data / "tartu" / "ros2" / "pedestrian_crossing_10"), LogSettings()
    )
    by_agent = {encounter.agent: encounter for encounter in encounters(scenario)}
    agent = conflicting_agent(scenario)
    assert by_agent[agent].kind == "pedestrian" and by_agent[agent].conflict < 4.0
    nearest = next(
        encounter
        for encounter in by_agent.values()
        if encounter.way >= 1.0 and encounter.t_to - encounter.t_from >= 1.0
    )
    assert nearest.kind == "car" and nearest.least < by_agent[agent].least


def test_a_log_without_a_goal_keeps_the_place_where_its_drive_ended() -> None:
    scenario = prepared(replace(log(), goal=None))
    assert scenario.goal is not None and scenario.goal.holds_place(
        23.2 + scenario.vehicle.axle_to_center, 0.0
    )
    assert any("where its drive ended" in note for note in scenario.notes)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["time=-2:2:1000000000000"], "a surface has at most 10000 cells"),
        (["time=-2:2:200", "speed=0.5:1.5:200"], "40000 cells, a surface has at most 10000"),
        ([], "one or two axes, got 0"),
        (["time=1"], "one or two axes, got 0"),
        (["time=0:1:3", "speed=0.5:1:2", "side=0:1:2"], "got 3"),
        (["tme=0:1:3"], "did you mean 'time'"),
        (["time=0:1:3", "time=2"], "varied twice"),
        (["time=1:0:3"], "LOW below HIGH"),
        (["time=1:1.000000000001:5"], "COUNT values are not apart; lower COUNT"),
        (["time=0:1:1.5"], "COUNT"),
        (["time=now"], "no number"),
        (["time"], "NAME=LOW:HIGH:COUNT"),
        (["time=0:99:3"], "from -30 to 30 s"),
    ],
)
def test_wrong_variations_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        question(words)


def test_vary_lists_agents_and_variations_and_writes_a_surface(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", log())
    listed = replan("vary", tmp_path / "log.mcap", "--list-agents")
    assert [line.split()[:2] for line in listed.stdout.splitlines()[1:]] == [
        ["blink", "car"],
        ["17", "car"],
        ["far", "car"],
    ]
    assert "ego_speed" in replan("vary", "--list").stdout
    words = [
        "vary",
        tmp_path / "log.mcap",
        "--vary",
        "standing_car=10:60:2",
        "-p",
        "constant_speed",
        "--workers",
        0,
    ]
    result = replan(*words, "--resolution", 30, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    table = pd.read_csv(tmp_path / "out" / "surface.csv")
    assert table["outcome"].tolist()[0] in ("fail", "unavoidable", "inconclusive")
    assert "inserted car" in table["contact"][0]
    assert f"written to {tmp_path / 'out'}" in result.stdout.replace("\n", "")


def test_an_agent_is_named_by_the_whole_id_or_by_its_short_name() -> None:
    whole = "23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4"
    coded = replace(log(), tracks=replace(log().tracks, ids=(whole, *log().tracks.ids[1:])))
    assert [line.split()[0] for line in lines(encounters(coded), coded.short_names)[1:]] == [
        "blink",
        "23f7",
        "far",
    ]
    for name in (whole, "23f7"):
        assert question_about(coded, ["time=0:1:2"], [name], None).agents == (whole,)
