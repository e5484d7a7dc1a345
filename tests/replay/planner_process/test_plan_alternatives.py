"""Plans with alternatives: the same wherever the planner runs, kept, drawn and explained."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from differences import differences
from fan_planners import FAN

from replan.contract.planner_rules import check_planner
from replan.explain.plan_alternatives import describe_alternatives
from replan.logs.catalogue import scenario
from replan.logs.frame_store import FrameStore, light
from replan.logs.mcap import read_trace, write_trace
from replan.logs.trace import PlannedFrame, Trace
from replan.metrics import GROUPS, evaluate
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig

LOG = replace(scenario("everyday/cut_in"), origin=(500.0, 300.0))
TRUSTED = LoopConfig(apart=PlannerProcessConfig(trust=True))
ASKED = {metric.name: metric for metric in GROUPS["alternatives"]}


def driven(planner: str, config: LoopConfig = TRUSTED) -> Trace:
    return run_closed_loop(LOG, f"fan_planners:{planner}", config=config, until_s=5.0).trace


@pytest.fixture(scope="module")
def fan() -> Trace:
    return driven("Fan")


def alternatives(trace: Trace) -> list[object]:
    return [frame.plan.alternatives for frame in trace.frames]


def test_they_are_the_same_in_a_process_of_its_own(fan: Trace) -> None:
    assert len(fan.frames[0].plan.alternatives) == len(FAN) + 1
    apart = driven("Fan", LoopConfig())
    assert not differences(tuple(alternatives(fan)), tuple(alternatives(apart)))


def test_a_planner_in_the_maps_coordinates_shows_them_in_the_worlds(fan: Trace) -> None:
    for config in (TRUSTED, LoopConfig()):
        in_map = driven("FanInMap", config)
        for old, new in zip(fan.frames, in_map.frames, strict=True):
            for one, two in zip(old.plan.alternatives, new.plan.alternatives, strict=True):
                assert two.trajectory.x == pytest.approx(one.trajectory.x, abs=1e-6)
                assert two.trajectory.y == pytest.approx(one.trajectory.y, abs=1e-6)


def test_they_keep_the_contract() -> None:
    check_planner("fan_planners:Fan", scenarios=[scenario("everyday/follow")])


def test_a_long_drive_gives_them_back_to_the_bit(fan: Trace) -> None:
    store = FrameStore(0)
    for frame in fan.frames:
        store.append(frame)
    back: tuple[PlannedFrame, ...] = store[:]
    assert not differences(
        tuple(frame.plan.alternatives for frame in back), tuple(alternatives(fan))
    )
    stored = evaluate(replace(fan, frames=light(store.frames)), LOG, metrics=ASKED)
    assert stored.equals(evaluate(fan, LOG, metrics=ASKED))


def test_a_trace_keeps_them(tmp_path: Path, fan: Trace) -> None:
    write_trace(tmp_path / "closed.mcap", fan, LOG)
    again, _ = read_trace(tmp_path / "closed.mcap")
    for old, new in zip(fan.frames, again.frames, strict=True):
        for one, two in zip(old.plan.alternatives, new.plan.alternatives, strict=True):
            assert (one.score, one.name) == (two.score, two.name)
            np.testing.assert_array_equal(one.trajectory.x, two.trajectory.x)


def test_each_is_described_the_chosen_first(fan: Trace) -> None:
    described = describe_alternatives(fan, LOG, fan.frames[10])
    assert [name for name, _ in described] == ["idm", "left", "slow", "alternative 4"]
    statements = dict(described)
    assert "score 0.5 (chosen)" in statements["idm"]
    assert "where the plan is" in statements["idm"]
    assert "to the left of the plan" in statements["left"]
    assert "behind the plan" in statements["slow"]
