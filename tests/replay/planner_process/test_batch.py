"""Logs in lock step (`loop.apart.batch`): the answers of a planner that plans them one by one do
not change.
"""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from textwrap import dedent

import pytest
from command_line import replan
from hypothesis import given, settings, strategies as st
from short_logs import short

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.logs.trace import EndReason
from replan.replay.drive import Mark
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.planner_process.connection import in_lockstep
from replan.run import evaluate_logs
from replan.run.evaluate import teams_of

pytestmark = pytest.mark.usefixtures("folder")

PLANNER = """
from replan.planners.constant_speed import ConstantSpeed
from pathlib import Path

class Mine(ConstantSpeed):
    def __init__(self, context):
        super().__init__(context)
        self.count = 0
        {built}
    def plan(self, frame):
        self.count += 1
        return super().plan(frame)
    @classmethod
    def plan_batch(cls, frames, planners):
        with open("sizes.{name}", "a") as file:
            file.write(" " + str(len(frames)) + "@" + str(planners[0].count))
        assert len({{planner.count for planner in planners}}) == 1, "all have made as many steps"
        {batch}
        return [planner.plan(frame) for planner, frame in zip(planners, frames, strict=True)]
"""


def written(name: str, built: str = "", batch: str = "") -> str:
    """A planner that plans its batches one by one."""
    parts = {
        "built": dedent(built).replace("\n", "\n        "),
        "batch": dedent(batch).replace("\n", "\n        "),
    }
    Path(f"{name}.py").write_text(PLANNER.format(name=name, **parts), encoding="utf-8")
    return f"{name}:Mine"


def sizes(name: str) -> list[str]:
    """Frames of each batch, and how many plans were made before."""
    return Path(f"sizes.{name}").read_text(encoding="utf-8").split()


def run(
    planner: str, logs: Path, out: Path, batch: int, workers: int = 0, **options: object
) -> Results:
    loop = LoopConfig(apart=PlannerProcessConfig(batch=batch))
    given = {"mode": "both", "repeat_s": 0.2, **options}
    config = RunConfig(
        planners=("constant_speed", planner), loop=loop, recording=False, internals="none", **given
    )  # type: ignore[arg-type]
    return evaluate_logs([logs], config, out, workers=workers)


def tables(out: Path) -> list[bytes]:
    return [
        path.read_bytes()
        for path in (out / "metrics.parquet", *sorted(out.glob("*/frames.parquet")))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
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
    assert {"2@0", "2@1", "1@0", "1@1"} <= set(counts), "a group of two, and the one that is left"
    assert max(int(size.partition("@")[0]) for size in counts) == 2


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
    first = sizes("lengths")[:21]
    assert first == [f"{3 - (i > 5) - (i > 10)}@{i}" for i in range(21)]


def cut(name: str, end: float) -> object:
    ego = short(name).ego
    kept = ego.t <= end + 1e-9
    return type(ego)(**{key: getattr(ego, key)[kept] for key in ego.__dataclass_fields__})


ONE_FAILS = """
answers = [planner.plan(frame) for planner, frame in zip(planners, frames, strict=True)]
return [ValueError("no way ahead") if f.t > 0.45 and len(f.agents.ids) else a for f, a in zip(frames, answers)]
"""  # noqa: E501
FAILS: dict[str, tuple[str, str, list[bool], str]] = {
    "one": ("", ONE_FAILS, [False, True, False], "raised at 0.50 s: ValueError: no way ahead"),
    "raises_all": (
        "",
        "if frames[0].t > 0.45: raise ValueError('all')",
        [True] * 3,
        "raised at 0.50 s: ValueError: all",
    ),
    "few": (
        "",
        "return []",
        [True] * 3,
        "broke its contract at 0.00 s: plan_batch returned 0 plans instead of 3",
    ),
    "dies": (
        "",
        "import os\nif frames[0].t > 0.45: os._exit(3)",
        [True] * 3,
        "exited in step 6 of drives for 3 logs together: its process ended with code 3",
    ),
}


@pytest.mark.parametrize("name", FAILS)
def test_a_fault_costs_the_log_that_it_is_of_or_each_is_named(
    name: str, logs: Path, tmp_path: Path
) -> None:
    built, batch, failed, said = FAILS[name]
    planner = written(name, built, batch)
    result = run(planner, logs, tmp_path / "out", 3, mode="open", repeat_s=0.0)
    drives = [drive for drive in result.drives.itertuples() if drive.planner == planner]
    assert [drive.end == EndReason.PLANNER_FAILURE.value for drive in drives] == failed
    for drive, wrong in zip(drives, failed, strict=True):
        if wrong:
            assert drive.detail.startswith(f"planner '{planner}' on {drive.log} {said}"), (
                drive.detail
            )
    assert [
        drive.end for drive in result.drives.itertuples() if drive.planner == "constant_speed"
    ] == [EndReason.END_OF_LOG.value] * 3


def test_one_that_cannot_be_built_leaves_the_others(logs: Path, tmp_path: Path) -> None:
    planner = written("unbuilt", "if context.start.v > 12.0: raise KeyError('weights')")
    result = run(planner, logs, tmp_path / "out", 3, mode="open", repeat_s=0.0)
    assert sorted(failure.log for failure in result.failures.itertuples()) == sorted(
        log.log
        for log in result.logs.itertuples()
        if planner not in set(result.drives.query(f"log == '{log.log}'")["planner"])
    )
    assert all(
        "cannot be built: KeyError: 'weights'" in failure.message
        for failure in result.failures.itertuples()
    )
    assert 0 < len(result.failures) < 3


def test_a_run_is_resumed_by_whole_groups(logs: Path, tmp_path: Path) -> None:
    planner, out = written("resumed"), tmp_path / "out"
    first = run(planner, logs, out, 2, mode="open", repeat_s=0.0)
    before = tables(out)
    shutil.rmtree(out / first.logs.iloc[0].folder)
    Path("sizes.resumed").unlink()
    again = evaluate_logs([logs], first.run, out, resume=True)
    assert again.resumed == 1 and tables(out) == before
    assert {size.partition("@")[0] for size in sizes("resumed")} == {"2"}


def test_what_does_not_go_together_is_refused(logs: Path, tmp_path: Path) -> None:
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
def test_what_a_task_raises_ends_all_and_clears_away(counts: list[int], wrong: int) -> None:
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
