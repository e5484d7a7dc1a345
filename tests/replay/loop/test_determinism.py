"""A planner that gives other plans in the same world is marked; one that does not is not."""

from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from short_logs import QUICK, short

from replan.draw.drawn_results import load
from replan.draw.report.overview import overview
from replan.logs.mcap import write_scenario
from replan.logs.trace import EndReason, Mode
from replan.replay.drive import Mark
from replan.replay.loop.planning import nondeterminism
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.run import evaluate_logs
from replan.run.one_log import LOOPS

PLANNERS = '''
import os
from dataclasses import replace
from replan.planners.constant_speed import ConstantSpeed

class Steady(ConstantSpeed):
    pass

class Dicing(ConstantSpeed):
    """Drives on at a speed that it is dealt, from a time on."""
    def plan(self, frame):
        plan = super().plan(frame)
        v = plan.trajectory.v * (1.0 if frame.t < 0.45 else 1.0 - os.urandom(1)[0] / 1e5 - os.urandom(4)[0] / 1e9)
        return replace(plan, trajectory=replace(plan.trajectory, v=v))

class Failing(ConstantSpeed):
    def plan(self, frame):
        if frame.t > 0.35 and os.path.exists("second"):
            raise RuntimeError("once is enough")
        if frame.t > 1.95:
            open("second", "w").close()
        return super().plan(frame)
'''  # noqa: E501


@pytest.fixture
def here(
    tmp_path: Path, module: Callable[[str, str], str], monkeypatch: pytest.MonkeyPatch
) -> Path:
    module("dealt", PLANNERS)
    write_scenario(tmp_path / "a.mcap", short("test/a"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("trust", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_who_is_dealt_other_plans_is_marked_with_time_and_size(here: Path, trust: bool) -> None:
    planners = ("dealt:Dicing", "dealt:Steady", "constant_speed")
    config = replace(
        QUICK, planners=planners, loop=LoopConfig(apart=PlannerProcessConfig(trust=trust))
    )
    result = evaluate_logs([here / "a.mcap"], config, here / "out")
    for drive in result.drives.itertuples():
        assert (Mark.NOT_DETERMINISTIC.value in drive.marks) == (drive.planner == "dealt:Dicing"), (
            drive
        )
        said = [
            note
            for note in drive.notes
            if "differ by up to 0 m and" in note and "m/s at 0.50 s" in note
        ]
        assert len(said) == (drive.planner == "dealt:Dicing"), drive
    marks = {drive.shown for drive in overview(load(here / "out")).drives}
    assert {
        "dealt:Dicing (trusted) (not deterministic)"
        if trust
        else "dealt:Dicing (not deterministic)"
    } <= marks
    silent = evaluate_logs([here / "a.mcap"], replace(config, repeat_s=0.0), here / "silent")
    assert not any(
        Mark.NOT_DETERMINISTIC.value in drive.marks for drive in silent.drives.itertuples()
    )


@pytest.mark.slow
def test_a_planner_that_fails_only_the_second_time_is_marked(here: Path) -> None:
    config = replace(QUICK, planners=("dealt:Failing",), mode="open", repeat_s=1.0)
    (drive,) = evaluate_logs([here / "a.mcap"], config, here / "out").drives.itertuples()
    assert drive.end == EndReason.END_OF_LOG.value
    assert Mark.NOT_DETERMINISTIC.value in drive.marks
    assert any("goes on only once" in note and "once is enough" in note for note in drive.notes)


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("until", [0.0, 0.95, 1.0, inf])
def test_a_drive_up_to_a_time_is_the_begin_of_the_whole(mode: Mode, until: float) -> None:
    """Law: bit for bit, with a frame at `until` itself."""
    loop, log = LOOPS[mode], short("test/a", parked=True)
    whole = loop(log, "dp_qp").trace
    part = loop(log, "dp_qp", until_s=until).trace
    assert [frame.t for frame in part.frames] == [
        frame.t for frame in whole.frames if frame.t <= until
    ]
    assert nondeterminism(whole, part, until) == ""
