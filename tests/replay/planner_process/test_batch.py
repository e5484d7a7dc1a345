"""Logs in lock step (`loop.apart.batch`): the answers of a planner that plans them one by one do
not change.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
from batched import sizes, written
from command_line import replan
from hypothesis import given, settings, strategies as st
from short_logs import short

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason
from replan.replay.drive import Mark
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.planner_process.lockstep import in_lockstep
from replan.run import evaluate_logs
from replan.run.evaluate import teams_of

pytestmark = pytest.mark.usefixtures("folder")


def run(
    planner: str, logs: Path, out: Path, batch: int, workers: int = 0, **options: object
) -> Results:
    loop = LoopConfig(apart=PlannerProcessConfig(batch=batch))
    changes = {"mode": "both", "repeat_s": 0.2, **options}
    config = RunConfig(
        planners=("constant_speed", planner),
        loop=loop,
        recording=False,
        internals="none",
        **changes,
    )  # type: ignore[arg-type]
    return evaluate_logs([logs], config, out, workers=workers)


def tables(out: Path) -> list[bytes]:
    return [
        path.read_bytes()
        for path in (out / "metrics.parquet", *sorted(out.glob("*/frames.parquet")))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_the_numbers_are_those_of_logs_by_themselves(
    workers: int, logs: Path, tmp_path: Path
) -> None:
    planner = written(f"same{workers}")
    alone, together = (
        run(planner, logs, tmp_path / "alone", 0),
        run(planner, logs, tmp_path / "two", 2, workers),
    )
    assert not len(alone.failures) and not len(together.failures)
    assert tables(tmp_path / "alone") == tables(tmp_path / "two")
    for drive in together.drives.itertuples():
        assert drive.marks == ([Mark.BATCHED.value] if drive.planner == planner else [])
    assert not any(drive.marks for drive in alone.drives.itertuples())
    counts = sizes(f"same{workers}")
    assert {(2, 0), (2, 1), (1, 0), (1, 1)} <= set(counts), "a group of two, and the one left"
    assert max(frames for frames, _ in counts) == 2


@pytest.mark.slow
def test_logs_of_other_lengths_and_members_keep_step(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    for name, end in (("a", 1.0), ("b", 2.0), ("c", 0.5)):
        write_scenario(
            tmp_path / "logs" / f"{name}.mcap", replace(short(f"test/{name}"), ego=cut(name, end))
        )
    planner = written("lengths")
    options = {"ensemble": 1, "mode": "open"}
    run(planner, tmp_path / "logs", tmp_path / "alone", 0, **options)
    result = run(planner, tmp_path / "logs", tmp_path / "three", 3, **options)
    assert not len(result.failures)
    assert tables(tmp_path / "alone") == tables(tmp_path / "three")
    frames = [3] * 6 + [2] * 5 + [1] * 10  # until 0.5, 1 and 2 s
    assert sizes("lengths")[:21] == list(zip(frames, range(21), strict=True))


def cut(name: str, end: float) -> Trajectory:
    ego = short(name).ego
    columns = {column: getattr(ego, column)[ego.t <= end + 1e-9] for column in TRAJECTORY_COLUMNS}
    return Trajectory(**columns)


class Fault(NamedTuple):
    """What a planner does with a batch of three, and what happens to each of their drives."""

    hook: str
    fails: tuple[bool, bool, bool]
    detail: str


FAULTS = {
    "one": Fault(
        """
        @classmethod
        def answered(cls, frames, answers):
            late = [frame.t > 0.45 and len(frame.agents.ids) for frame in frames]
            return [ValueError("no way ahead") if k else a for k, a in zip(late, answers)]
        """,
        (False, True, False),
        "raised at 0.50 s: ValueError: no way ahead",
    ),
    "raises_all": Fault(
        """
        @classmethod
        def answered(cls, frames, answers):
            if frames[0].t > 0.45:
                raise ValueError("all")
            return answers
        """,
        (True, True, True),
        "raised at 0.50 s: ValueError: all",
    ),
    "few": Fault(
        """
        @classmethod
        def answered(cls, frames, answers):
            return []
        """,
        (True, True, True),
        "broke its contract at 0.00 s: plan_batch returned 0 plans instead of 3",
    ),
    "dies": Fault(
        """
        @classmethod
        def answered(cls, frames, answers):
            if frames[0].t > 0.45:
                os._exit(3)
            return answers
        """,
        (True, True, True),
        "exited in step 6 of drives for 3 logs together: its process ended with code 3",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_costs_the_log_that_it_is_of_or_each_is_named(
    name: str, logs: Path, tmp_path: Path
) -> None:
    fault = FAULTS[name]
    planner = written(name, fault.hook)
    result = run(planner, logs, tmp_path / "out", 3, mode="open", repeat_s=0.0)
    drives = [drive for drive in result.drives.itertuples() if drive.planner == planner]
    for drive, fails in zip(drives, fault.fails, strict=True):
        assert (drive.end == EndReason.PLANNER_FAILURE.value) is fails
        if fails:
            words = f"planner '{planner}' on {drive.log} {fault.detail}"
            assert drive.detail.startswith(words), drive.detail
    others = result.drives[result.drives["planner"] == "constant_speed"]
    assert list(others["end"]) == [EndReason.END_OF_LOG.value] * 3


def test_a_planner_that_cannot_be_built_costs_its_own_log(logs: Path, tmp_path: Path) -> None:
    hook = """
        def built(self, context):
            if context.start.v > 12.0:
                raise KeyError("weights")
        """
    planner = written("unbuilt", hook)
    result = run(planner, logs, tmp_path / "out", 3, mode="open", repeat_s=0.0)
    driven = set(result.drives["log"][result.drives["planner"] == planner])
    assert set(result.failures["log"]) == set(result.logs["log"]) - driven
    assert result.failures["message"].str.contains("cannot be built: KeyError: 'weights'").all()
    assert 0 < len(result.failures) < 3


def test_a_run_is_resumed_by_whole_groups(logs: Path, tmp_path: Path) -> None:
    planner, out = written("resumed"), tmp_path / "out"
    first = run(planner, logs, out, 2, mode="open", repeat_s=0.0)
    before = tables(out)
    shutil.rmtree(out / first.logs.iloc[0].folder)
    Path("sizes.resumed").unlink()
    again = evaluate_logs([logs], first.run, out, resume=True)
    assert again.resumed == 1 and tables(out) == before
    assert {frames for frames, _ in sizes("resumed")} == {2}


def test_batches_are_refused_with_settings_that_exclude_them(logs: Path, tmp_path: Path) -> None:
    planner = written("refused")
    for options in (
        ["--window", "1"],
        ["--shard", "1/2"],
        ["--set", "loop.apart.trust=true"],
        ["-p", "replan.planners.idm:Idm"],
        ["-p", "exec:true"],
    ):
        ended = replan(
            "evaluate",
            str(logs),
            "-p",
            planner,
            "--set",
            "loop.apart.batch=2",
            *options,
            "-o",
            str(tmp_path / "out"),
        )
        assert ended.exit_code == 2 and "loop.apart.batch" in " ".join(ended.output.split()), (
            options
        )
    with pytest.raises(ConfigError, match="batch"):
        PlannerProcessConfig(batch=65)


@given(st.integers(0, 50), st.integers(0, 8))
def test_each_log_is_in_one_group_and_all_but_the_last_are_full(count: int, batch: int) -> None:
    teams = teams_of(count, batch)
    assert [index for team in teams for index in team] == list(range(count))
    assert all(len(team) == max(batch, 1) for team in teams[:-1])


@settings(max_examples=10)
@given(st.lists(st.integers(0, 3), min_size=1, max_size=5), st.integers(0, 4))
def test_an_error_of_a_task_ends_all_and_each_clears_away(counts: list[int], wrong: int) -> None:
    cleared = list[int]()

    def task(index: int) -> Callable[[], int]:
        def work() -> int:
            try:
                if index == wrong:
                    raise OSError(index)
                return counts[index]
            finally:
                cleared.append(index)

        return work

    tasks = [task(index) for index in range(len(counts))]
    if wrong < len(counts):
        with pytest.raises(OSError, match=str(wrong)):
            in_lockstep(tasks)
        assert cleared == list(range(wrong + 1))
    else:
        assert in_lockstep(tasks) == counts
