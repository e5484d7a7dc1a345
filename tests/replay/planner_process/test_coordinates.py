"""A planner with a map of its own plans in the world's or in the map's coordinates."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import replan
from handmade import drive, lanes_along, scenario, straight, track, tracks
from map_planners import IdmInMap
from scenes import perceive

from replan import evaluate
from replan.contract.planner_rules import check_planner, context_of
from replan.core.errors import PlannerError
from replan.logs.catalogue import scenario as catalogue
from replan.logs.edit.transform import moved
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.planner_process import messages
from replan.replay.planner_process.coordinates import context_in_map, frame_in_map
from replan.replay.planner_process.messages import context_message, decode, encode
from replan.replay.world import World
from replan.run.frame_dump import replan_frame

ROOT = Path(__file__).parents[3]
FAR = (531_234.0, 6_474_123.0)
TRUSTED = LoopConfig(apart=PlannerProcessConfig(trust=True))


def on_the_map(origin: tuple[float, float] = (500.0, 300.0)) -> Scenario:
    """A second along x behind a parked car, in a log that began at `origin`."""
    ego = drive(straight, 10.0, 1.0)
    parked = track("parked", [0.0], [80.0], [-3.0], static=True)
    return replace(
        scenario(ego, road=lanes_along(ego), agents=tracks(parked)), name="log", origin=origin
    )


def driven(
    planner: str, log: Scenario, config: LoopConfig = TRUSTED, until_s: float = 1.0
) -> Trace:
    return run_closed_loop(log, planner, config=config, until_s=until_s).trace


@pytest.mark.parametrize("name", ["Subtracts", "Declares", "DeclaresAndSubtracts"])
@pytest.mark.parametrize("config", [TRUSTED, LoopConfig()], ids=["trusted", "apart"])
def test_way_points_in_the_maps_coordinates_are_followed(name: str, config: LoopConfig) -> None:
    trace = driven(f"map_planners:{name}", on_the_map(), config)
    assert not any(frame.plan.status.is_fallback for frame in trace.frames)
    assert trace.ego.x[-1] == pytest.approx(10.0, abs=0.2) and abs(trace.ego.y).max() < 0.01


def test_a_plan_that_is_off_by_the_origin_is_refused_with_the_remedy() -> None:
    reason = driven("map_planners:Forgets", on_the_map()).frames[0].plan.reason
    assert reason.startswith("it starts 540.42 m from the ego and from the plan being driven; ")
    assert "subtract context.origin, (500, 300) here" in reason
    assert 'declare coordinates = "map"' in reason
    far = driven("map_planners:Forgets", on_the_map((0.0, 0.0))).frames[0].plan.reason
    assert far.endswith("the plan being driven")  # the log has no origin to blame


def test_other_coordinates_are_refused() -> None:
    for config in (TRUSTED, LoopConfig()):
        with pytest.raises(PlannerError, match='coordinates = "utm" in its class is not'):
            driven("map_planners:Unknown", on_the_map(), config)


@pytest.mark.parametrize("config", [TRUSTED, LoopConfig()], ids=["trusted", "apart"])
def test_a_planner_that_needs_no_map_drives_alike_in_both_coordinates(config: LoopConfig) -> None:
    """Road, goal, agents, predictions and the previous plan are moved alike."""
    log = replace(catalogue("everyday/follow"), origin=FAR)
    one, two = driven("idm", log), driven("map_planners:IdmInMap", log, config)
    for name in ("x", "y", "v"):
        np.testing.assert_allclose(getattr(one.ego, name), getattr(two.ego, name), atol=1e-6)


def test_a_program_answers_hello_with_its_coordinates(tmp_path: Path) -> None:
    text = (ROOT / "examples" / "planner_exec.py").read_text(encoding="utf-8")
    ready = '"type": "ready", "schema": 1'
    traces = []
    for more in ("", ', "coordinates": "map"'):
        program = tmp_path / f"program{len(more)}.py"
        program.write_text(text.replace(ready, ready + more), encoding="utf-8")
        traces.append(driven(f"exec:{sys.executable} {program}", on_the_map(FAR)))
    one, two = traces
    assert not any(frame.plan.status.is_fallback for frame in two.frames)
    np.testing.assert_allclose(one.ego.x, two.ego.x, atol=1e-6)


def test_the_context_names_the_origin_and_is_moved_as_a_whole() -> None:
    log = on_the_map()
    context = context_of(log)
    sent = decode(encode(context_message(context)), messages.Context)
    assert sent.origin == context.origin == (500.0, 300.0)
    assert decode(encode({"schema": 1, "type": "ready"}), messages.Ready).coordinates == "world"
    shown, there = context_in_map(context), context_of(moved(log, 500.0, 300.0, 0.0))
    assert shown.origin == (0.0, 0.0)
    assert (shown.start.x, shown.start.y) == (there.start.x, there.start.y) == (500.0, 300.0)
    lanes = zip(shown.road.lanes.values(), there.road.lanes.values(), strict=True)
    for one, two in lanes:
        np.testing.assert_array_equal(one.left, two.left)


def test_frames_move_there_and_back() -> None:
    log = catalogue("everyday/cut_in")
    frame = perceive(World(log.ego.state(0), log.tracks))
    there = frame_in_map(frame, (512.0, 256.0))
    back = frame_in_map(there, (-512.0, -256.0))
    assert there.ego.x == frame.ego.x + 512.0
    np.testing.assert_allclose(there.agents.y, frame.agents.y + 256.0)
    np.testing.assert_allclose(back.predictions.x, frame.predictions.x)


def test_the_contract_is_checked_in_the_planners_coordinates() -> None:
    check_planner(IdmInMap, scenarios=[replace(catalogue("everyday/follow"), origin=FAR)])


def test_a_frame_is_planned_again_in_the_planners_coordinates(tmp_path: Path) -> None:
    given = {"mode": "closed", "recording": False, "report": False, "out": tmp_path / "run"}
    made = evaluate(on_the_map(), planners="map_planners:Declares", **given)
    again = replan_frame(made.drive("log"), 0.5)
    assert again.is_same
    np.testing.assert_array_equal(
        again.dump.planned().trajectory.x, again.dump.plan.trajectory.x, strict=True
    )
    other = replan_frame(made.drive("log"), 0.5, "map_planners:IdmInMap").dump.plan
    assert not other.status.is_fallback


def test_inspect_shows_the_origin(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", on_the_map(FAR))
    line = "origin: 531234, 6474123 m, subtracted from all positions"
    assert line in replan("inspect", tmp_path / "log.mcap").stdout
